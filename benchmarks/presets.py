"""Each preset beside the default: with the same clicks of the simulated person, or from the same start.

    python -m benchmarks.presets [NAME ...] [--objects NAME ...] [--again] [-o FILE]

Objects are those of the click benchmark, all of the kind that a preset is for; its scans that the preset was tuned on
are told apart. Clicks are exact: `segment` at the first, `refine` at the later ones. What begins without a click is
compared with the same start without the preset. Games that the file has are not played again without ``--again``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from accelsurf.api.segment import segment, segment_objects
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks.games import Hints, play
from benchmarks.clicks.objects import ClickObject, load, objects
from benchmarks.clicks.own import Corrected
from benchmarks.peers.measure import scans_folder
from tests.support.tissues import membrane_cells

RESULTS = Path(__file__).parent / "results" / "presets.json"
DEFAULT = "default"
CLICKS = 3


class Trial(NamedTuple):
    """Objects that a preset is for, and the scans that it was tuned on."""

    objects: tuple[str, ...]
    tuned: tuple[str, ...] = ()


#: By clicks.
TRIALS = {
    "mr-white-matter": Trial(
        ("macaque-white-matter", "mean-white", "white-matter"), ("mri_brain_oblique",)
    ),
}


@dataclass(frozen=True)
class Started:
    """An object that a preset finds without a click, and the start that it is given (none: its own)."""

    which: ClickObject
    start: tuple[str, ...] = ()


def _named(name: str) -> ClickObject:
    return next(each for each in objects() if each.name == name)


_BONES = (32, 33, 69, 70, *range(97, 104), *range(109, 116))
#: Without a click. Brains are those without a skull.
STARTED = {
    "mr-brain": (
        Started(_named("head-brain"), ("ball:126,110,130,30vox",)),
        Started(_named("oblique-brain"), ("center",)),
        Started(_named("mean-brain"), ("center",)),
    ),
    "ct-skeleton": (
        Started(_named("skull")),
        Started(ClickObject("all bones", "ct_abdomen_hires", _BONES)),
        Started(ClickObject("vertebrae", "ct_vertebra_l3", (21, 22, 23))),
    ),
    "fluorescence-nucleus": tuple(
        Started(ClickObject("all nuclei", scan))
        for scan in ("fluo_nuclei1136", "fluo_nuclei1135", "synthetic_nuclei")
    ),
}
CELLS = "membrane-cells"


class WithPreset(Corrected):
    """`accelsurf segment --preset` at the first click, `accelsurf refine` at every later one."""

    def __init__(self, preset: str, image: Volume, hints: Hints) -> None:
        super().__init__(image, hints)
        self.options = {**self.options, "preset": preset}


def clicked(name: str, which: ClickObject, folder: Path) -> dict[str, Any]:
    """Dice and seconds after each click, with a preset or by default."""
    made = Corrected if name == DEFAULT else partial(WithPreset, name)
    games = play(made, load(which, folder), CLICKS)["clicks"]
    errors = [row["error"] for row in games if "error" in row]
    return {
        "scan": which.volume,
        "dice": [round(row["dice"], 4) for row in games],
        "cpu_s": [round(row["cpu_s"], 1) for row in games],
        **({"errors": errors} if errors else {}),
    }


def started(name: str, trial: Started, folder: Path) -> dict[str, Any]:
    """Dice with a preset, and with the same start by default."""
    scene = load(trial.which, folder)
    out: dict[str, Any] = {"scan": trial.which.volume}
    for said, options in (("preset", {"preset": name}), (DEFAULT, {})):
        began = time.process_time()
        result = segment(scene.image, **({"start": trial.start} if trial.start else {}), **options)
        out[said] = round(dice(result.labels > 0, scene.truth), 4)
        out[f"{said}_cpu_s"] = round(time.process_time() - began, 1)
    return out


def cells(seed: int) -> dict[str, Any]:
    """Mean Dice of cells between membranes with a click in each: `CELLS`, and the clicks' own energy."""
    image, truth, centres = membrane_cells((32, 64, 64), 12, seed=seed)
    rows = [f"{n},{x},{y},{z},2,inside" for n, (z, y, x) in enumerate(centres.tolist(), 1)]
    out: dict[str, Any] = {"scan": "phantom"}
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder, "cells.csv")
        table.write_text("\n".join(["id,x_vox,y_vox,z_vox,r_vox,side", *rows]))
        for said, options in (("preset", {"preset": CELLS}), (DEFAULT, {"energy": "seeded"})):
            found = segment_objects(image, str(table), **options).labels
            out[said] = round(
                float(np.mean([dice(found == n, truth == n) for n in range(1, len(rows) + 1)])), 4
            )
    return out


def after(game: dict[str, Any], clicks: int) -> float:
    """Dice after some clicks; after the last one where nothing was wrong any more.

    Examples
    --------
    >>> after({"dice": [0.5, 0.75]}, 1), after({"dice": [0.5, 0.75]}, 3)
    (0.5, 0.75)
    """
    return float(game["dice"][min(clicks, len(game["dice"])) - 1])


def means(
    found: dict[str, Any], name: str, tuned: bool | None = None
) -> tuple[int, list[float]] | None:
    """Number of scans, and means at 1 and 3 clicks: of the preset, of the default; None where nothing was played.

    ``tuned``: on the scans that the preset was tuned on, or on the others; None on all.
    """
    games, plain = found["clicks"].get(name, {}), found["clicks"].get(DEFAULT, {})
    held = [
        each
        for each in TRIALS[name].objects
        if each in games
        and each in plain
        and (tuned is None or (games[each]["scan"] in TRIALS[name].tuned) == tuned)
    ]
    if not held:
        return None
    figures = [
        statistics.fmean(after(side[each], clicks) for each in held)
        for clicks in (1, CLICKS)
        for side in (games, plain)
    ]
    return len({games[each]["scan"] for each in held}), figures


def lines(found: dict[str, Any]) -> list[str]:
    """Rows of a table: Dice at 1 and 3 clicks with the preset and by default, on all scans, those tuned on, others."""
    out = [
        "| preset | scans | 1 click | default | 3 clicks | default |",
        "|---|---|---|---|---|---|",
    ]
    for name in TRIALS:
        for said, tuned in (("all", None), ("tuned on", True), ("others", False)):
            got = means(found, name, tuned)
            if got is not None:
                figures = " | ".join(f"{value:.3f}" for value in got[1])
                out.append(f"| {name} | {got[0]} ({said}) | {figures} |")
    for name, games in found["started"].items():
        out += [
            f"| {name} | {game['scan']} | {game['preset']:.3f} | {game[DEFAULT]:.3f} | | |"
            for game in games.values()
        ]
    return out


def main(words: Sequence[str] | None = None) -> None:
    """Play the games of the presets that are named, all unless named, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--objects", nargs="+", default=[])
    parser.add_argument("--volumes", type=Path, default=scans_folder())
    parser.add_argument("--again", action="store_true", help="play what the file has too")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    given = parser.parse_args(words)
    found = (
        json.loads(given.output.read_text())
        if given.output.exists()
        else {"clicks": {}, "started": {}}
    )

    def keep(table: str, name: str, what: str, play_it: Any) -> None:
        held = found[table].setdefault(name, {})
        if given.again or what not in held:
            held[what] = play_it()
            given.output.write_text(json.dumps(found, indent=1) + "\n")
            print(name, what, held[what], flush=True)

    for name in given.names or [*TRIALS, *STARTED, CELLS]:
        for what in TRIALS[name].objects if name in TRIALS else ():
            if not given.objects or what in given.objects:
                for said in (name, DEFAULT):
                    keep("clicks", said, what, partial(clicked, said, _named(what), given.volumes))
        for trial in STARTED.get(name, ()):
            what = f"{trial.which.name} of {trial.which.volume}"
            keep("started", name, what, partial(started, name, trial, given.volumes))
        if name == CELLS:
            for seed in range(3):
                keep("started", name, f"cells, seed {seed}", partial(cells, seed))
    print("\n".join(lines(found)))


if __name__ == "__main__":
    main()
