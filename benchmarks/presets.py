"""How each preset does with 1 and 3 clicks of a simulated person: on public scans (for ct-bone all bones of the
abdominal CT of which enough is seen), and on phantoms.

    python -m benchmarks.presets [NAME ...] [--clicks 1 3] [--set KEY=VALUE ...] [-o FILE]

Writes Dice, seconds and warnings of every trial as JSON. ``--set`` tries other values in place of the preset's.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.api.segment import segment
from accelsurf.errors import AccelsurfError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.phantoms import recipes, tissues
from benchmarks.clicks.objects import ClickObject, load, objects
from benchmarks.clicks.person import next_click
from benchmarks.peers.measure import scans_folder

#: Bones of 2,000 voxels and more in the abdominal CT, by TotalSegmentator's classes; closing and bound of ct-bone were
#: chosen on five of them (benchmarks/notes/presets-and-pictures.md).
BONES = (
    *(ClickObject(name, "ct_abdomen_hires", (label,)) for name, label in (
        ("vertebra-T12", 32), ("vertebra-T11", 33), ("humerus-left", 69), ("humerus-right", 70),
        *((f"rib-left-{label - 91}", label) for label in (98, 99, 100, 101)),
        *((f"rib-right-{label - 103}", label) for label in (110, 111, 112, 113, 114)))),
)  # fmt: skip
#: Preset -> objects of scans, and phantoms.
TRIALS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "ct-organ": (("spleen", "liver", "stomach"), ()),
    "ct-bone": (tuple(one.name for one in BONES), ("bone",)),
    "ct-vessel": (("aorta", "vena-cava"), ()),
    "mr-vessel": ((), ("vessel",)),
    "mr-white-matter": (("white-matter",), ()),
    "mr-nuclei": (
        ("thalamus-left", "caudate-left", "putamen-left", "pallidum-left", "thalamus-right", "caudate-right",
         "putamen-right", "pallidum-right"),
        (),
    ),
    "mr-ventricle": (("ventricle-left", "third-ventricle", "fourth-ventricle", "ventricle-right"), ()),
    "mr-cord": (("cord",), ()),
    "tumour": ((), ("tumour",)),
    "em-cell": ((), ("organelle",)),
    "nuclei": (tuple(f"nucleus-{n}" for n in (17, 18, 19, 26, 27, 28)), ()),
}  # fmt: skip
RESULTS = Path(__file__).parent / "results" / "presets.json"
#: A trial below this Dice counts as failed.
FAILED = 0.8


def phantom(name: str, seed: int) -> tuple[Volume, np.ndarray]:
    """A phantom and its truth."""
    if name == "vessel":
        made = recipes.make(recipes.load_recipe("vessel").changed(seed=seed))
        return made.image, made.truth.array > 0
    image, labels = getattr(tissues, name)(seed=seed)
    return Volume(image, Geometry(image.shape, (1.0, 1.0, 1.0))), labels > 0


def play(volume: Volume, truth: np.ndarray, clicks: int, options: dict[str, Any]) -> list[dict[str, Any]]:
    """What is reached after each click."""
    sides: dict[str, list[str]] = {"inside": [], "outside": []}
    labels, out = None, []
    for number in range(1, clicks + 1):
        click = next_click(truth, labels, volume.geometry)
        if click is None:
            break
        sides[click.side].append("ball:" + ",".join(f"{v!r}" for v in (*click.centre, click.radius)))
        began = time.perf_counter()
        try:
            result = segment(volume, inside=tuple(sides["inside"]), outside=tuple(sides["outside"]), **options)
        except AccelsurfError as error:
            out.append({"clicks": number, "dice": 0.0, "error": error.message})
            break
        labels = result.labels > 0
        out.append(
            {
                "clicks": number, "dice": round(dice(labels, truth), 4), "steps": result.stop.steps,
                "seconds": round(time.perf_counter() - began, 2), "volume_mm3": round(result.volume_mm3, 3),
            }
        )  # fmt: skip
    return out


def main() -> None:
    """Run the trials that are named, all unless named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--clicks", type=int, default=3)
    parser.add_argument("--volumes", type=Path, default=scans_folder())
    parser.add_argument("--objects", nargs="*")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--no-preset", action="store_true")
    parser.add_argument("--set", nargs="*", default=[], dest="values")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    given = parser.parse_args()
    values = dict(text.split("=", 1) for text in given.values)
    tuned = {one.name: one for one in (*objects(), *BONES)}
    found = json.loads(given.output.read_text()) if given.output.exists() else {}
    for name in given.names or TRIALS:
        options = {**({} if given.no_preset else {"preset": name}), **values}
        scans, phantoms = TRIALS[name]
        for what in scans:
            if what in tuned and (given.objects is None or what in given.objects):
                scene = load(tuned[what], given.volumes)
                store(found, name, what, play(scene.image, scene.truth, given.clicks, options), given.output)
        for what in phantoms:
            for seed in range(given.seeds):
                volume, truth = phantom(what, seed)
                store(found, name, f"{what} phantom {seed}", play(volume, truth, given.clicks, options), given.output)


def store(found: dict[str, Any], name: str, what: str, rows: list[dict[str, Any]], path: Path) -> None:
    """Add a trial, and write the file anew."""
    found.setdefault(name, {})[what] = rows
    path.write_text(json.dumps(found, indent=1) + "\n")
    print(name, what, *(f"{row['dice']:.3f} ({row.get('seconds', 0):.0f} s)" for row in rows), flush=True)


if __name__ == "__main__":
    main()
