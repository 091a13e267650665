"""Follow the pages as a newcomer: each command as typed, in an empty folder; seconds, their parts, and exit codes.

    scripts/benchmark commands [PAGE ...] [--scan FILE LABEL]... [-o results/newcomer.json]

PAGE is README, first-scan, by-clicks or real-scans; default all. What `accelsurf fetch` would bring, and the scans of
real-scans, come from ACCELSURF_VOLUMES, where it has them. With --scan the first two pages are followed again, with a
scan in place of the example's: its places are read off LABEL of FILE_ref.nii.gz, and the blocks with letters for a
reader's own coordinates are typed, too. Lines that install, build or check are not run here; they are named as left
out.

Seconds are those of a clock, and of the processor with all that a command starts; parts are those of its report. The
table of docs/explanation/start-up.md is made from them. Pages that the file of results has already stay in it unless
they are followed again. Exit code 1 when a command fails.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf import io
from accelsurf.image.volume import Volume
from benchmarks.clicks.person import PersonClick, next_click
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.real_scans import clicks_of
from benchmarks.tutorial import FILE, ROOT, bring

PAGES = (
    {"README": ROOT / "README.md"}
    | {name: ROOT / "docs" / "tutorial" / f"{name}.md" for name in ("first-scan", "by-clicks")}
    | {"real-scans": ROOT / "docs" / "explanation" / "real-scans.md"}
)
#: A block of commands; one that is indented has no kind.
BLOCK = re.compile(
    r"```(console|python|text)\n(.*?)```|(?:^    accelsurf [^\n]*\n)+", re.DOTALL | re.MULTILINE
)
TABLE, SHOWN, SLOWEST = ROOT / "docs" / "explanation" / "start-up.md", 90, 2
#: The clicks that real-scans reads from a table, which it has from a reference.
TABLE_OF_CLICKS, CLICKED = "nuclei_each.csv", "fluo_nuclei1136_ref.nii.gz"
#: The examples' names in files.
EXAMPLES = r"\b(torus|noisy|two_balls)(?=_seg|_truth|\.nii)"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="*", help=", ".join(PAGES))
    parser.add_argument("--scan", nargs=2, action="append", default=[], metavar=("FILE", "LABEL"))
    parser.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/newcomer.json"
    )
    given = parser.parse_args()
    kept: dict[str, Any] = json.loads(given.output.read_text()) if given.output.exists() else {}
    failed = 0
    for page in given.pages or PAGES:
        scans = given.scan if page in ("README", "first-scan") else []
        cases = [(page, None, "")] + [
            (f"{page}, {Path(scan).name}", Path(scan), label) for scan, label in scans
        ]
        for name, scan, label in cases:
            with tempfile.TemporaryDirectory() as folder:
                rows = follow(PAGES[page], Path(folder), scan, label)
            kept[name] = rows
            failed += sum(row["exit"] not in (0, None) for row in rows)
            given.output.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    put_table(TABLE, "commands", text_of(kept), "scripts/benchmark")
    return 1 if failed else 0


def follow(page: Path, work: Path, scan: Path | None, label: str) -> list[dict[str, Any]]:
    """Type what a page says in a folder; returns a row for each command."""
    text = page.read_text(encoding="utf-8")
    env = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    if scan is not None:
        text = with_scan(text, work / "volumes", scan, int(label))
    for name, content in FILE.findall(text):
        (work / name).write_text(content)
    rows = []
    for found in BLOCK.finditer(text):
        kind, block = found[1] or "console", found[2] or found[0]
        lines = (
            [block]
            if kind == "python"
            else [line.strip().removeprefix("$ ") for line in block.splitlines()]
        )
        typed = {
            "console": True,
            "python": scan is None,
            "text": scan is not None and lines[0].startswith("accelsurf"),
        }
        for line in lines if typed[kind] else []:
            if kind == "python":
                (work / "typed.py").write_text(line)
                line = "python typed.py"
            elif line.startswith("accelsurf synth") and scan is not None:
                continue
            elif not line.startswith("accelsurf"):
                rows.append({"command": line, "seconds": None, "exit": None, "said": "left out"})
                continue
            bring(line.split(), work)
            have_scan(line, work, scan)
            row = {"command": line, **typed_in(line, work, env)}
            rows.append(row)
            print(
                f"{row['seconds']:7.1f} s  processor {row['processor_s']:5.1f} s  exit {row['exit']}  {line}  "
                f"{slowest(row)}  {row['said']}",
                flush=True,
            )
    return rows


def typed_in(line: str, work: Path, env: dict[str, str]) -> dict[str, Any]:
    """Run a line of a shell; seconds, exit code, and the last line of what it said, if it failed."""
    now = time.time()
    began = time.monotonic()
    before = os.times()
    run = subprocess.run(line, shell=True, cwd=work, env=env, text=True, capture_output=True)
    said = run.stderr.strip().splitlines()
    seconds, processor = time.monotonic() - began, sum(os.times()[2:4]) - sum(before[2:4])
    row = {"seconds": round(seconds, 1), "processor_s": round(processor, 1), "exit": run.returncode}
    return {
        **row,
        "said": " ".join(said[-2:]) if run.returncode else "",
        "parts": parts_since(now, work, seconds),
    }


def parts_since(began: float, work: Path, seconds: float) -> dict[str, float]:
    """Seconds by part of the one run that wrote a report since then; what it does not count is the program's start."""
    reports = [path for path in work.rglob("*_report.json") if path.stat().st_mtime >= began]
    if len(reports) != 1:
        return {}
    told = json.loads(reports[0].read_text())["seconds"]
    parts = {part: value for part, value in told.items() if value and part != "total"}
    return {
        part: round(value, 1)
        for part, value in {**parts, "program": seconds - sum(parts.values())}.items()
    }


def slowest(row: dict[str, Any]) -> str:
    """The slowest parts of a command, as a cell of the table."""
    parts = sorted(row.get("parts", {}).items(), key=lambda part: -part[1])
    return ", ".join(f"{part} {value:.1f}" for part, value in parts[:SLOWEST])


def text_of(kept: dict[str, list[dict[str, Any]]]) -> str:
    """The table of all commands that were run on the pages themselves."""
    lines = head_of(("command", "s", "processor, s", "slowest parts, s"))
    for page in PAGES:
        rows = [row for row in kept.get(page, []) if row["exit"] == 0]
        lines += [row_of((f"**{page}**", "", "", ""))] if rows else []
        for row in rows:
            command = (
                row["command"] if len(row["command"]) <= SHOWN else f"{row['command'][:SHOWN]} ..."
            )
            cells = (
                f"`{command}`",
                f"{row['seconds']:.1f}",
                f"{row['processor_s']:.1f}",
                slowest(row),
            )
            lines.append(row_of(cells))
    return "\n".join([*lines, ""])


def have_scan(line: str, work: Path, scan: Path | None) -> None:
    """Put the scan into the folder that a reader is thought to have: ``scan.nii.gz``; of real scans the one named."""
    for word in line.split():
        public = Path(os.environ.get("ACCELSURF_VOLUMES", os.devnull), word)
        if word.endswith(".nii.gz") and public.is_file() and not (work / word).exists():
            (work / word).symlink_to(public.resolve())
        elif word == TABLE_OF_CLICKS:
            clicks_of(io.read_labels(public.with_name(CLICKED)), work / word)
    name = work / "scan.nii.gz"
    if scan is not None and name.name in line.split() and not name.exists():
        name.symlink_to(scan.resolve())


def with_scan(text: str, volumes: Path, scan: Path, label: int) -> str:
    """The text of a page with a scan in place of its examples; the scan and what is known of it lie in ``volumes``."""
    name = scan.name.removesuffix(".nii.gz")
    known = io.read_labels(scan.with_name(f"{name}_ref.nii.gz"))
    truth = np.asarray(known.array == label)
    volumes.mkdir()
    (volumes / scan.name).symlink_to(scan.resolve())
    io.write(Volume(truth.astype(np.uint8), known.geometry), volumes / f"{name}_truth.nii.gz")
    first = next_click(truth, None, known.geometry)
    assert first is not None
    around = known.geometry.index_to_world(np.argwhere(np.ones(truth.shape, bool)).astype(float))
    free = (
        np.linalg.norm(around - np.asarray(first.centre), axis=1).reshape(truth.shape)
        > 4.0 * first.radius
    )
    second = next_click(truth & free, None, known.geometry)
    # What a person would click away: the nearest place that is well outside.
    outside = ndimage.distance_transform_edt(~truth, sampling=known.geometry.spacing)
    index = np.unravel_index(int(np.abs(outside - 2.0 * first.radius).argmin()), truth.shape)
    beside = known.geometry.index_to_world(np.array(index, float))
    places = [written(first)] + [written(second or first)]

    def ball(found: re.Match[str]) -> str:
        centre = ",".join(found[1].split(",")[:3])
        centres.setdefault(centre, len(centres) % 2)
        return "ball:" + places[centres[centre]]

    centres: dict[str, int] = {}
    sides = [
        value + sign * first.radius
        for sign in (-1, 1)
        for value in np.asarray((second or first).centre)
    ]
    text = re.sub(EXAMPLES, name, text)
    text = re.sub(
        r"--outside ball:X,Y,Z,\w+", "--outside ball:" + numbers([*beside, first.radius]), text
    )
    text = re.sub(r"ball:(X,Y,Z,\w+)", "ball:" + places[0], text)
    text = re.sub(r"(?<!outside )ball:(-?[\d.]+(?:,-?[\d.]+){3})", ball, text)
    text = re.sub(r"box:(-?[\d.]+(?:,-?[\d.]+){5})", "box:" + numbers(sides), text)
    return re.sub(
        r"^([12]),-?\d+,\d+,\d+,\d+$",
        lambda row: f"{row[1]},{places[int(row[1]) - 1]}",
        text,
        flags=re.M,
    )


def written(click: PersonClick) -> str:
    """A click as it is typed."""
    return numbers([*click.centre, click.radius])


def numbers(values: list[float]) -> str:
    return ",".join(f"{value:.4g}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
