"""Whether tracking closes: after a beat the surface is where it began, and forward and backward agree.

Usage: python -m benchmarks.tracking_closing [-o FILE]

Distances are between surfaces of two frames, in voxels: mean, 99th percentile, largest. ``beat``: every surface of a
beating ball against that of a period later; ``there and back``: a sequence that goes on backwards through its own
frames, each against itself; ``both ways``: each frame followed forward from the first and backward from the last.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.levelset import LevelSet
from accelsurf.phantoms.motions import MovingPhantom, motion_from
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track.records import SurfacePiece
from accelsurf.track.track import Tracking

ROOT = Path(__file__).parents[1]
#: The most that two surfaces may be apart, voxels, on average.
WANTED = 0.3
PHANTOMS: dict[str, dict[str, Any]] = {
    "beat": {"motion": "beat", "shape": [36, 36, 36], "radius": 10.0, "frames": 21, "period": 10.0},
    "translation": {
        "motion": "translation",
        "shape": [56, 36, 36],
        "radius": 8.0,
        "speed": 2.0,
        "frames": 11,
    },
    "acceleration": {
        "motion": "acceleration",
        "shape": [56, 36, 36],
        "radius": 8.0,
        "speed": 2.0,
        "frames": 11,
    },
    "rotation": {
        "motion": "rotation",
        "shape": [40, 40, 32],
        "radius": 9.0,
        "speed": 0.25,
        "frames": 11,
    },
    "deformation": {"motion": "deformation", "shape": [40, 40, 40], "radius": 9.0, "frames": 11},
}
NOISE = (0.0, 0.2)


class ThereAndBack(ImageSequence):
    """The frames of a phantom forward, then backward to the first; noise is that of the phantom's frame."""

    def __init__(self, phantom: MovingPhantom) -> None:
        self.phantom = phantom
        self.geometry = phantom.geometry
        self.source = phantom.source
        self.times, self.time_unit = tuple(float(n) for n in range(2 * len(phantom) - 1)), "frame"

    def _channels(self, number: int) -> list[Volume]:
        return self.phantom.channels(min(number, 2 * len(self.phantom) - 2 - number))


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/tracking_closing.json"
    )
    given = options.parse_args()
    rows = []
    for name, noise in itertools.product(PHANTOMS, NOISE):
        rows += rows_of(name, noise)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps({"wanted": WANTED, "rows": rows}, indent=1) + "\n")
    for row in rows:
        print(row)


def rows_of(name: str, noise: float) -> list[dict[str, Any]]:
    """What is measured of a phantom."""
    phantom = MovingPhantom(motion_from({**PHANTOMS[name], "noise": noise}, name))
    forward = surfaces(phantom, 0, "forward", phantom.truth(0))
    last = len(phantom) - 1
    backward = surfaces(phantom, last, "backward", phantom.truth(last))
    common = [n for n in forward if n in backward and 0 < n < last]
    found = {"both ways": [apart(forward[n], backward[n], phantom) for n in common]}
    if name == "beat":
        found["beat"] = [apart(forward[n], forward[n + 10], phantom) for n in range(1, 11)]
    else:
        back = surfaces(ThereAndBack(phantom), 0, "forward", phantom.truth(0))
        found["there and back"] = [
            apart(back[n], back[2 * last - n], phantom) for n in range(1, last)
        ]
    return [
        {
            "phantom": name,
            "noise": noise,
            "what": what,
            "frames": len(each),
            "mean": round(worst(each, 0), 4),
            "p99": round(worst(each, 1), 4),
            "largest": round(worst(each, 2), 4),
        }
        for what, each in found.items()
    ]


def worst(each: Iterable[tuple[float, float, float]], which: int) -> float:
    return max(one[which] for one in each)


def surfaces(
    sequence: ImageSequence, frame: int, direction: str, labels: NDArray[Any]
) -> dict[int, SurfacePiece]:
    """The surface of the object in each frame, begun at its truth in one."""
    config = TrackConfig(threads=1, energy="chan-vese", levels=1, frame=frame, direction=direction)
    tracking = Tracking(sequence, config, objects=Volume(labels, sequence.geometry))
    return {
        result.frame: result.objects[0].surface for result in tracking if result.objects[0].seen
    }


def apart(
    one: SurfacePiece, other: SurfacePiece, phantom: MovingPhantom
) -> tuple[float, float, float]:
    """Mean, 99th percentile and largest distance of the points of a surface from another, voxels."""
    spacing = tuple(reversed(phantom.recipe.spacing))
    here = LevelSet(one.psi, (spacing[0], spacing[1], spacing[2]), 3.0)
    there = LevelSet(other.psi, (spacing[0], spacing[1], spacing[2]), 6.0)
    cells = np.stack(np.unravel_index(here.band.cells, here.shape), axis=1)
    near = here.front(1.0)
    closest_points = (cells + here.band.to_closest / np.array(spacing))[near] + np.subtract(
        one.corner, other.corner
    )
    off = np.abs(
        ndimage.map_coordinates(there.psi, closest_points.T, order=1, mode="nearest")
    ) / min(spacing)
    return float(off.mean()), float(np.percentile(off, 99)), float(off.max())


if __name__ == "__main__":
    main()
