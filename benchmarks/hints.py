"""Whether the command that a warning names helps: Dice before and after it, on real scans.

Each object of `benchmarks/clicks/objects.json`, one of a scan unless ``--each`` says more, is cut out with its own
extent around it and segmented in the situations of `SITUATIONS`, which make warnings appear. Each line that says "try"
is taken at its word: the command that it names is run, and its Dice compared. ``python -m benchmarks.hints`` writes
results/hints.json and prints a table by the first word of the lines.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.api.segment import segment
from accelsurf.cases.outcome import shortcoming
from accelsurf.errors import AccelsurfError
from accelsurf.grid.boxes import bounding_box, widened
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.run.region_of_interest import cropped
from benchmarks.clicks.objects import ClickObject, Scene, load, selected
from benchmarks.clicks.own import text_of
from benchmarks.clicks.person import PersonClick, next_click

OUTPUT = Path(__file__).parent / "results" / "hints.json"
#: A Dice that differs by less is the same; voxels of the cut-out along an axis at most.
SAME, MOST = 0.02, 80
#: Lines that name what a person does, not what is typed: the next click of the simulated person stands for it.
AT_THE_FAULT = ("--inside or --outside where it is most wrong", "--inside at the object")
Options = dict[str, Any]


def _bounds(scene: Scene, low: float, high: float) -> str:
    """An energy between two percentiles of the object's values; beyond 0 and 100 it is open."""
    values = scene.image.array[scene.truth]
    ends = [
        "" if not 0 <= part <= 100 else f"{np.percentile(values, part):.6g}" for part in (low, high)
    ]
    return f"threshold:{','.join(ends)}"


def _background(scene: Scene) -> PersonClick:
    """A click in the middle of what is not the object."""
    click = next_click(~scene.truth, None, scene.image.geometry)
    assert click is not None
    return click


#: Options by the name of a situation, of a scene and its first click, and how much wider than it a ball is.
SITUATIONS: dict[str, Callable[[Scene, Callable[[float], str]], Options]] = {
    "a click": lambda scene, ball: {"inside": ball(1.0)},
    "a click across the edge": lambda scene, ball: {"inside": ball(2.6)},
    "a click in the background": lambda scene, ball: {
        "inside": text_of(_background(scene), scene.image)
    },
    "a size that is too large": lambda scene, ball: {"inside": ball(1.0), "size": "9000ml"},
    "a start": lambda scene, ball: {"start": ball(1.0)},
    "a start across the edge": lambda scene, ball: {
        "start": ball(2.6),
        "energy": "threshold:learned,learned",
    },
    "bounds beyond the object": lambda scene, ball: {
        "start": ball(1.0),
        "energy": _bounds(scene, 99.9, 101),
    },
    "bounds with the surroundings": lambda scene, ball: {
        "start": ball(1.0),
        "energy": _bounds(scene, 0.1, 101),
    },
    "too smooth": lambda scene, ball: {
        "start": ball(1.0),
        "smoothness": 20 * max(scene.image.geometry.spacing),
    },
    "too large": lambda scene, ball: {
        "start": ball(1.0),
        "max_volume": 1.3 * scene.truth.sum() * scene.image.geometry.voxel_volume,
    },
    "few steps": lambda scene, ball: {"start": ball(1.0), "max_steps": 30},
    "few steps of a click": lambda scene, ball: {"inside": ball(1.0), "max_steps": 4},
}


def applied(options: Options, tried: str, at_the_fault: str) -> Options | None:
    """Options after what a line says to try; None for what names no option of a run on one object.

    Examples
    --------
    >>> applied({"start": "otsu", "energy": "chan-vese"}, "--outside point:1,2,3, its place, in place of --energy", "")
    {'start': 'otsu', 'outside': 'point:1,2,3'}
    >>> applied({"inside": "ball:1,2,3,4", "size": "9ml"}, "it without --size", "")
    {'inside': 'ball:1,2,3,4'}
    >>> applied({"start": "otsu"}, "--inside at the object in place of --start", "inside point:1,2,3")
    {'inside': ('point:1,2,3',)}
    """
    gone = re.findall(
        r"--([a-z-]+)", tried.partition("in place of")[2] or tried.partition("without")[2]
    )
    out = {key: value for key, value in options.items() if key.replace("_", "-") not in gone}
    if tried in AT_THE_FAULT or tried.startswith(AT_THE_FAULT[1]):
        side, _, place = at_the_fault.partition(" ")
        before = options.get(side, ()) if tried == AT_THE_FAULT[0] else ()
        return {**out, side: (*((before,) if isinstance(before, str) else before), place)}
    if "without" in tried:
        return out
    found = re.match(r"--([a-z-]+)(?: ([^ ]+?))?(?:,? |,?$)", tried.partition(" in place of")[0])
    if found is None or found[1] == "objects":
        return None
    value: Any = True if found[2] is None else found[2]
    return {**out, found[1].replace("-", "_"): "yes" if value is True else value}


def run(scene: Scene, options: Options) -> tuple[NDArray[np.bool_], list[str]]:
    """Labels of a run, and its lines that name something to try."""
    try:
        result = segment(scene.image, threads=1, **options)
    except AccelsurfError as error:
        return np.zeros_like(scene.truth), [f"refused: {error.message}; {error.hint}"]
    error, warnings = shortcoming("scan", result, False)
    lines = [*result.warnings, *warnings, *result.objects[0].quality.notes]
    if error is not None and error.hint.startswith("try "):
        lines.append(f"{result.stop.reason}: {error.message}; {error.hint}")
    return np.asarray(result.labels > 0), [
        line.removeprefix("note: ") for line in lines if "; try " in line
    ]


def rows_of(
    which: ClickObject, situations: Collection[str], say: Callable[[dict[str, Any]], None]
) -> None:
    """Tell a row for each line of each of the ``situations`` of an object."""
    scene = _cut(load(which))
    first = next_click(scene.truth, None, scene.image.geometry)
    assert first is not None

    def ball(wider: float) -> str:
        # As large as it can be seen: a start has two voxels at least.
        return text_of(
            first._replace(radius=wider * max(first.radius, 2.0 * min(scene.image.geometry.steps))),
            scene.image,
        )

    for name in situations:
        options = SITUATIONS[name](scene, ball)
        labels, lines = run(scene, options)
        known: dict[str, float] = {}
        for line in dict.fromkeys(lines):
            tried = line.rpartition("; try ")[2]
            wrong = next_click(
                scene.truth, labels if tried == AT_THE_FAULT[0] else None, scene.image.geometry
            )
            fault = "" if wrong is None else f"{wrong.side} {text_of(wrong, scene.image)}"
            after = applied(options, tried, fault)
            if after is not None:
                if tried not in known:
                    known[tried] = round(dice(run(scene, after)[0], scene.truth), 3)
                say(
                    {
                        "object": which.name,
                        "scan": which.volume,
                        "situation": name,
                        "line": line,
                        "before": round(dice(labels, scene.truth), 3),
                        "after": known[tried],
                    }
                )


def _cut(scene: Scene) -> Scene:
    """The object with its own extent around it, as far as the scan goes, and not larger than `MOST`."""
    box = bounding_box(scene.truth)
    assert box is not None
    room = [
        max(8, min(side.stop - side.start, (MOST - side.stop + side.start) // 2)) for side in box
    ]
    around = widened(box, scene.truth.shape, (room[0], room[1], room[2]))
    image, geometry = scene.image, cropped(scene.image.geometry, around)
    return Scene(
        Volume(np.ascontiguousarray(image.array[around]), geometry, dict(image.metadata)),
        scene.truth[around],
    )


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A line for each kind of what is tried: how often, better and worse, and the medians."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        option = re.search(r"--[a-z-]+", row["line"].rpartition("; try ")[2])
        kinds.setdefault(
            f"{row['line'].partition(':')[0]}: {option[0] if option else ''}", []
        ).append(row)
    out = [f"{'line':34} {'count':>5} {'better':>6} {'worse':>5} {'before':>6} {'after':>6}"]
    for kind, found in sorted(kinds.items()):
        gains = [row["after"] - row["before"] for row in found]
        medians = (statistics.median(row[key] for row in found) for key in ("before", "after"))
        counts = sum(gain > SAME for gain in gains), sum(gain < -SAME for gain in gains)
        out.append(
            f"{kind:34} {len(found):5} {counts[0]:6} {counts[1]:5} "
            + " ".join(f"{m:6.3f}" for m in medians)
        )
    return out


def main() -> None:
    """Run all; rows are written as they come."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hints", description=__doc__)
    parser.add_argument("--each", type=int, default=1, help="objects of each scan, default 1")
    parser.add_argument("--only", nargs="*", default=(), help="names of objects")
    parser.add_argument("--situations", nargs="*", choices=SITUATIONS, default=tuple(SITUATIONS))
    parser.add_argument("--output", type=Path, default=OUTPUT, help="rows of others in it stay")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = (
        json.loads(given.output.read_text())["rows"] if given.output.exists() else []
    )

    def say(row: dict[str, Any]) -> None:
        rows.append(row)
        print(json.dumps(row), flush=True)
        given.output.write_text(json.dumps({"rows": rows}, indent=1) + "\n", encoding="utf-8")

    seen: dict[str, int] = {}
    for which in selected(names=given.only):
        seen[which.volume] = seen.get(which.volume, 0) + 1
        if seen[which.volume] <= given.each or given.only:
            began = time.perf_counter()
            rows[:] = [
                row
                for row in rows
                if row["object"] != which.name or row["situation"] not in given.situations
            ]
            rows_of(which, given.situations, say)
            print(f"{which.name}: {time.perf_counter() - began:.0f} s", flush=True)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
