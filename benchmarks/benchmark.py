"""accelsurf beside its peers: each benchmark leaves JSON and a picture, all together RESULTS.md.

scripts/benchmark NAME...|all [--quick] [--volumes DIR] [--repeats N] [--threads N] [--results DIR]
scripts/benchmark --render        RESULTS.md again, from the JSON files alone
scripts/benchmark kernels [...]   the kernels, before and after a change (see CONTRIBUTING.md)
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.figures.common import plain
from benchmarks.pages import put_table
from benchmarks.peers import render
from benchmarks.peers.measure import MissingError, Options, machine, scans_folder, set_threads

HERE = Path(__file__).resolve().parent
#: The page with the tables of `start`.
START_PAGE = HERE.parent / "docs" / "explanation" / "start-up.md"
#: Name -> module and function; imported when run, so that the number of threads is set before their libraries load.
BENCHMARKS: dict[str, tuple[str, str]] = {
    "march": ("march", "march"),
    "advance": ("advance", "advance"),
    "segment-noise": ("segment_noise", "segment_noise"),
    "segment-hard": ("segment_hard", "segment_hard"),
    "segment-real": ("segment_scan", "segment_real"),
    "regularised": ("regularised", "regularised"),
    "step": ("step", "step"),
    "memory": ("memory", "memory"),
    "start": ("start", "start"),
    "threads": ("threads", "threads"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run what is named; 1 when a benchmark could not be run."""
    options = parse(arguments)
    results = options.results or HERE / "results" / ("quick" if options.quick else "")
    target = results / "RESULTS.md" if options.quick or options.results else HERE / "RESULTS.md"
    results.mkdir(parents=True, exist_ok=True)
    names = [name for name in BENCHMARKS if "all" in options.name or name in options.name]
    set_threads(options.threads)
    failed = [name for name in names if not run(name, options, results)]
    print(f"written: {render.render(results, target)}")
    if target.parent == HERE:
        tables = render.load(results)["start"]["tables"]
        put_table(START_PAGE, "start", "\n".join([*_lines(tables), ""]), "scripts/benchmark")
    return 1 if failed else 0


def _lines(tables: list[dict[str, Any]]) -> list[str]:
    """Tables of a result, one below the other."""
    return [
        line
        for each in tables
        for line in (f"**{each['title']}**", "", *render.as_markdown(each), "")
    ]


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="scripts/benchmark", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("name", nargs="*", metavar="NAME", help=f"{', '.join(BENCHMARKS)}, or all")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="tiny sizes, to see that it works; figures mean nothing",
    )
    parser.add_argument(
        "--repeats", type=int, default=5, help="timed runs, of which the median counts (5)"
    )
    parser.add_argument(
        "--threads", type=int, default=min(2, os.cpu_count() or 1), help="of whole segmentations"
    )
    parser.add_argument(
        "--volumes",
        type=Path,
        default=scans_folder(),
        help="folder of the scans (default: ACCELSURF_VOLUMES; sources: docs/explanation/real-scans.md)",
    )
    parser.add_argument(
        "--results", type=Path, help="folder for JSON and pictures (benchmarks/results)"
    )
    parser.add_argument(
        "--again",
        action="store_true",
        help="segment-real, segment-noise: time the peers' best of the last search again",
    )
    parser.add_argument("--render", action="store_true", help="only write RESULTS.md again")
    options = parser.parse_args(arguments)
    if options.repeats < 1 or options.threads < 1:
        parser.error("--repeats and --threads must be at least 1")
    unknown = [name for name in options.name if name not in (*BENCHMARKS, "all")]
    if unknown:
        parser.error(f"{unknown[0]}: no such benchmark; there are {', '.join(BENCHMARKS)}, all")
    if options.again and not set(options.name) <= {"segment-real", "segment-noise"}:
        parser.error(
            "--again is for segment-real and segment-noise: no other benchmark keeps its search"
        )
    if not options.name and not options.render:
        parser.error("name a benchmark, or all, or --render")
    return options


def run(name: str, given: argparse.Namespace, results: Path) -> bool:
    """Run one benchmark and write what it found; False when something that it needs is missing."""
    search = results / f"{name}-search.json"
    options = Options(
        given.quick,
        1 if given.quick else given.repeats,
        given.threads,
        given.volumes,
        search,
        given.again,
    )
    print(f"== {name}", flush=True)
    about, began = machine(), time.perf_counter()
    module, function = BENCHMARKS[name]
    try:
        result: dict[str, Any] = getattr(
            importlib.import_module(f"benchmarks.peers.{module}"), function
        )(options)
    except MissingError as missing:
        print(f"{name}: not run: {missing}", file=sys.stderr)
        return False
    result = plain(
        {
            "name": name,
            "machine": about,
            "quick": given.quick,
            "repeats": options.repeats,
            **result,
            "messages": options.messages,
            "total_seconds": time.perf_counter() - began,
        }
    )
    result["picture"] = render.picture(results, name, result)
    render.json_path(results, name).write_text(json.dumps(result, indent=1) + "\n")
    for entry in result["goals"]:
        print(
            f"   {entry['what']}: {render.measured(entry)}, wanted {entry['sense']} "
            f"{render.measured(entry, 'wanted')}: {render.verdict(entry)}"
        )
    print(
        f"   {result['total_seconds']:.0f} s; written: {render.json_path(results, name).name}",
        flush=True,
    )
    return True


if __name__ == "__main__":
    sys.exit(main())
