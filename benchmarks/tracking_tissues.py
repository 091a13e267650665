"""Speckled tissue in motion: accelsurf beside registration that carries labels along (SimpleITK), and beside copying.

Usage: python -m benchmarks.tracking_tissues [-o FILE] [--seeds N] [--trackers NAME ...]

The phantoms are `shell_beating`, `wall_swinging` and `cell_deforming`, with half of the speckle going with the material
and with none of it. All have the same start, the true labels of frame 0, and the same images. What is told is the mean
Dice over the objects in the other frames, and processor seconds of a frame. Seed 1 was looked at while accelsurf and
the peers' settings were made; the seeds told are others.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.phantoms.recipe_files import read_recipe
from accelsurf.phantoms.tissues import TissuePhantom, TissueRecipe
from accelsurf.settings.track_config import TrackConfig
from accelsurf.track.track import Tracking

ROOT = Path(__file__).parents[1]
PHANTOMS = ("shell_beating", "wall_swinging", "cell_deforming")
COHERENCE = (0.5, 0.0)
FIRST_SEED = 11
#: Blur of the images of the peers, voxels, and rounds of the demons on each grid. The sigma of their field, in its
#: voxels, is 1.5 on all grids and .7 on a half grid: Dice of the shell with seed 1 .815; .744 with 1.5, .788 with 1.
BLUR, DEMONS_ROUNDS = 1.0, 30
#: Cells of the B-spline along each axis, rounds, grids, and the part of the voxels that its metric sees (drawn).
SPLINE_CELLS, SPLINE_ROUNDS, SPLINE_GRIDS, SPLINE_PART = 7, 15, (4, 2), 0.3
Labels = NDArray[np.uint8]
Floats = NDArray[np.float64]


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/tracking_tissues.json"
    )
    options.add_argument("--seeds", type=int, default=3, help="sequences of each kind")
    options.add_argument(
        "--trackers", nargs="+", choices=TRACKERS, default=list(TRACKERS), help="others' rows stay"
    )
    given = options.parse_args()
    old = json.loads(given.output.read_text())["rows"] if given.output.exists() else []
    rows: list[dict[str, Any]] = [row for row in old if row["tracker"] not in given.trackers]
    for seed in range(FIRST_SEED, FIRST_SEED + given.seeds):
        for name in PHANTOMS:
            for coherence in COHERENCE:
                rows += rows_of(name, coherence, seed, given.trackers)
                given.output.parent.mkdir(parents=True, exist_ok=True)
                given.output.write_text(
                    json.dumps({"rows": rows, "summary": summary(rows)}, indent=1) + "\n"
                )
    for line in summary(rows):
        print(line)


def rows_of(
    name: str, coherence: float, seed: int, trackers: Sequence[str]
) -> list[dict[str, Any]]:
    """Scores of trackers on one sequence."""
    _, values = read_recipe(name)
    phantom = TissuePhantom(TissueRecipe(**{**values, "coherence": coherence, "seed": seed}))
    truth = [phantom.truth(n) for n in range(len(phantom))]
    frames = [phantom.channels(n)[0] for n in range(len(phantom))]
    rows = []
    for tracker in trackers:
        began = time.process_time()
        found, quality = TRACKERS[tracker](phantom, frames, truth[0])
        seconds = (time.process_time() - began) / (len(phantom) - 1)
        dice = [mean_dice(labels, true) for labels, true in zip(found[1:], truth[1:], strict=True)]
        rows.append(
            {
                "phantom": name,
                "coherence": coherence,
                "seed": seed,
                "tracker": tracker,
                "dice": [round(value, 4) for value in dice],
                "mean": round(float(np.mean(dice)), 4),
                "quality": [round(value, 3) for value in quality],
                "cpu_seconds_per_frame": round(seconds, 2),
            }
        )
        print(rows[-1], flush=True)
    return rows


def mean_dice(found: NDArray[Any], truth: Labels) -> float:
    """Mean over the objects of the truth."""
    pairs = [(found == id, truth == id) for id in np.unique(truth[truth > 0])]
    return float(np.mean([2.0 * (a & b).sum() / (a.sum() + b.sum()) for a, b in pairs]))


Follow = Callable[[TissuePhantom, Sequence[Volume], Labels], tuple[list[NDArray[Any]], list[float]]]


def by_accelsurf(
    phantom: TissuePhantom, frames: Sequence[Volume], first: Labels
) -> tuple[list[NDArray[Any]], list[float]]:
    """Labels of all frames, and the lowest quality in each frame after the first."""
    config = TrackConfig(threads=1, energy="chan-vese", levels=1)
    results = list(
        Tracking(VolumeSequence(frames), config, objects=Volume(first, phantom.geometry))
    )
    lowest = [
        min(tracked.quality for tracked in result.objects) if result.objects else 0.0
        for result in results[1:]
    ]
    return [result.labels(seen_only=False) for result in results], lowest


def by_copying(
    phantom: TissuePhantom, frames: Sequence[Volume], first: Labels
) -> tuple[list[NDArray[Any]], list[float]]:
    """The first labels in every frame."""
    del phantom
    return [first] * len(frames), []


def by_registration(register: Callable[[Any, Any], Floats]) -> Follow:
    """Labels carried by the displacements from frame to frame, put together: the first labels are moved once."""

    def follow(
        phantom: TissuePhantom, frames: Sequence[Volume], first: Labels
    ) -> tuple[list[NDArray[Any]], list[float]]:
        del phantom
        images = [as_image(frame.array) for frame in frames]
        found, whole = [first], np.zeros((first.ndim, *first.shape))
        for before, now in zip(images, images[1:], strict=False):
            back = register(now, before)
            places = np.indices(first.shape) + back
            whole = back + np.stack(
                [ndimage.map_coordinates(part, places, order=1, mode="nearest") for part in whole]
            )
            found.append(
                ndimage.map_coordinates(
                    first, np.indices(first.shape) + whole, order=0, mode="nearest"
                )
            )
        return found, []

    return follow


def as_image(values: NDArray[np.float32]) -> Any:
    """A frame for SimpleITK, blurred, on a unit grid; a single slice is an image of two axes."""
    sigma = [BLUR if n > 1 else 0.0 for n in values.shape]
    blurred = ndimage.gaussian_filter(values.astype(np.float32), sigma)
    return SimpleITK.GetImageFromArray(blurred[0] if len(blurred) == 1 else blurred)


def as_field(field: Any, shape: tuple[int, ...]) -> Floats:
    """A displacement field of SimpleITK as (3, nz, ny, nx), z y x."""
    parts = np.moveaxis(SimpleITK.GetArrayFromImage(field)[..., ::-1], -1, 0)
    out = np.zeros((3, *shape))
    out[3 - len(parts) :] = parts.reshape(len(parts), *shape)
    return out


def shape_of(image: Any) -> tuple[int, ...]:
    size = tuple(reversed(image.GetSize()))
    return size if len(size) == 3 else (1, *size)


def by_demons(
    fixed: Any, moving: Any, grids: Sequence[int] = (4, 2, 1), sigma: float = 1.5
) -> Floats:
    """Diffeomorphic demons, coarse to fine: on grids with every so many voxels."""
    field = None
    for factor in grids:
        shrunk = [
            SimpleITK.Shrink(image, [factor] * image.GetDimension()) for image in (fixed, moving)
        ]
        demons = SimpleITK.DiffeomorphicDemonsRegistrationFilter()
        demons.SetNumberOfIterations(DEMONS_ROUNDS)
        demons.SetStandardDeviations(sigma)
        demons.SetNumberOfThreads(1)
        field = demons.Execute(*shrunk, *([] if field is None else [on_grid(field, shrunk[0])]))
    return as_field(on_grid(field, fixed), shape_of(fixed))


def on_grid(field: Any, image: Any) -> Any:
    """A displacement field of SimpleITK on the grid of an image."""
    same = SimpleITK.Transform(image.GetDimension(), SimpleITK.sitkIdentity)
    return SimpleITK.Resample(field, image, same, SimpleITK.sitkLinear, 0.0, field.GetPixelID())


def by_spline(fixed: Any, moving: Any) -> Floats:
    """Free-form deformation by B-splines, mean squares, LBFGS, coarse to fine."""
    spline = SimpleITK.BSplineTransformInitializer(fixed, [SPLINE_CELLS] * fixed.GetDimension())
    method = SimpleITK.ImageRegistrationMethod()
    method.SetMetricAsMeanSquares()
    method.SetOptimizerAsLBFGSB(numberOfIterations=SPLINE_ROUNDS)
    method.SetMetricSamplingStrategy(method.RANDOM)
    method.SetMetricSamplingPercentage(SPLINE_PART, 1)
    method.SetShrinkFactorsPerLevel(SPLINE_GRIDS)
    method.SetSmoothingSigmasPerLevel([factor / 2 for factor in SPLINE_GRIDS])
    method.SetInterpolator(SimpleITK.sitkLinear)
    method.SetNumberOfThreads(1)
    method.SetInitialTransform(spline, True)
    method.Execute(fixed, moving)
    to_field = SimpleITK.TransformToDisplacementFieldFilter()
    to_field.SetReferenceImage(fixed)
    return as_field(to_field.Execute(spline), shape_of(fixed))


TRACKERS: dict[str, Follow] = {
    "accelsurf": by_accelsurf,
    "demons": by_registration(by_demons),
    "demons, half grid": by_registration(partial(by_demons, grids=(4, 2), sigma=0.7)),
    "B-spline": by_registration(by_spline),
    "copying": by_copying,
}


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean Dice and seconds of each tracker on each kind of sequence."""
    lines = []
    for key in dict.fromkeys((row["phantom"], row["coherence"], row["tracker"]) for row in rows):
        alike = [row for row in rows if (row["phantom"], row["coherence"], row["tracker"]) == key]
        lines.append(
            {
                "phantom": key[0],
                "coherence": key[1],
                "tracker": key[2],
                "sequences": len(alike),
                "dice": round(float(np.mean([row["mean"] for row in alike])), 3),
                "cpu_seconds_per_frame": round(
                    float(np.mean([row["cpu_seconds_per_frame"] for row in alike])), 2
                ),
            }
        )
    return lines


if __name__ == "__main__":
    main()
