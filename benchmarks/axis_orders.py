"""Does the surface depend on the order and direction in which a scan's axes are stored? All 48, with levels.

Each case is one scan that is stored in 48 ways and segmented. The distance between two surfaces is the difference of
their psi, interpolated linearly, at the vertices of their meshes, in voxels of the smallest spacing.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import accelsurf
from accelsurf.api.segment import Result, segment, segment_objects
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import ball_distance
from accelsurf.image.volume import Volume
from accelsurf.phantoms import recipes
from accelsurf.run.region_of_interest import cropped
from tests.support.axis_orders import WAYS, Way, permuted, stored

#: Phantoms of odd and even sizes (x, y, z), the objects off the middle, in noise.
CUBIC = recipes.Recipe(
    kind="two-balls",
    shape=(51, 38, 45),
    radius=9,
    gap=0,
    center=(2, -1.5, 1),
    rotation=(10, -5, 20),
    background=100,
    contrast=50,
    antialias=True,
    blur=0.7,
    bias=0.1,
    noise=8,
    seed=3,
)
UNEQUAL = CUBIC.model_copy(update={"shape": (47, 38, 31), "spacing": (1.0, 0.8, 1.6)})
#: Parts of real scans, as `docs/explanation/real-scans.md` names their sources.
CORD, NUCLEI = (
    ("mri_cord_iso", np.s_[0:51, 0:54, 6:57]),
    ("fluo_nuclei1136", np.s_[20:71, 15:70, 18:75]),
)
BRAIN = ("mri_brain_oblique", np.s_[30:101, 40:129, 35:106])
#: Start of the phantoms, world mm, and how much they are smoothed.
BALL: dict[str, Any] = {"start": "ball:-7,-3,2,5", "presmooth": 0.8}
#: Name -> the scan; settings. ``start`` of the scans in files: voxel (z, y, x) and radius, mm, of a ball.
CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "one level": (CUBIC, {**BALL, "levels": 1}),
    "2 levels": (CUBIC, {**BALL, "levels": 2}),
    "3 levels": (CUBIC, {**BALL, "levels": 3}),
    "auto": (CUBIC, {**BALL, "levels": "auto"}),
    "unequal spacing, 2 levels": (UNEQUAL, {**BALL, "levels": 2}),
    "unequal spacing, 3 levels": (UNEQUAL, {**BALL, "levels": 3}),
    "local-region, 2 levels": (CUBIC, {**BALL, "levels": 2, "energy": "local-region"}),
    "threshold, 2 levels": (CUBIC, {**BALL, "levels": 2, "energy": "threshold:125,"}),
    "geodesic, 2 levels": (CUBIC, {**BALL, "levels": 2, "energy": "geodesic", "balloon": -0.3}),
    "likelihood, 2 levels": (CUBIC, {**BALL, "levels": 2, "energy": "likelihood"}),
    "flowable mass, 2 levels": (CUBIC, {**BALL, "levels": 2, "flow": "flowable-mass"}),
    "descent, 2 levels": (CUBIC, {**BALL, "levels": 2, "flow": "gradient"}),
    "seed, 2 levels": (CUBIC, {**BALL, "levels": 2, "start": "seed:-8,-4,3,6"}),
    "region of interest, 2 levels": (CUBIC, {**BALL, "levels": 2, "roi": "-20,-17,-18,21,16,19"}),
    "mask, 2 levels": (CUBIC, {**BALL, "levels": 2, "mask": True}),
    "two objects, 2 levels": (CUBIC, {"levels": 2, "objects": True, "presmooth": 0.8}),
    "cord, 2 levels": (CORD, {"start": (25, 27, 25, 4.0), "levels": 2, "presmooth": 2.0}),
    "nucleus, 2 levels": (NUCLEI, {"start": (22, 12, 44, 1.0), "levels": 2, "presmooth": 0.3}),
    "nucleus, local-region": (
        NUCLEI,
        {"start": (22, 12, 44, 1.0), "levels": 2, "presmooth": 0.3, "energy": "local-region"},
    ),
    # Thin, folded structures in noise: rounding decides at single places where a run has many ends to choose from.
    "cord, little smoothing": (CORD, {"start": (25, 27, 25, 4.0), "levels": 2, "presmooth": 1.0}),
    "folds of a brain": (
        BRAIN,
        {
            "start": (33.3, 47.2, 36.4, 22.0),
            "levels": 2,
            "presmooth": 2.0,
            "energy": "threshold:90,",
        },
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path(__file__).parent / "results" / "axis_orders.json"
    )
    parser.add_argument("--every", type=int, default=1, help="only every N-th of the 48 ways")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    options = parser.parse_args()
    found: dict[str, Any] = (
        json.loads(options.output.read_text()) if options.output.exists() else {}
    )
    for name, (source, settings) in CASES.items():
        if options.only in name:
            found[name] = measure(source, settings, WAYS[1 :: options.every])
            print(name, found[name], flush=True)
            options.output.write_text(json.dumps(found, indent=1) + "\n")


def scan_of(source: Any) -> Volume:
    """A phantom, or the part of a scan in a file."""
    if isinstance(source, recipes.Recipe):
        return recipes.make(source).image
    folder = os.environ.get("ACCELSURF_VOLUMES")
    if not folder:
        sys.exit(
            "ACCELSURF_VOLUMES is not set: name the folder with the scans (docs/explanation/real-scans.md)"
        )
    file, box = source
    volume = accelsurf.read(Path(folder) / f"{file}.nii.gz")
    return Volume(np.ascontiguousarray(volume.array[box]), cropped(volume.geometry, box))


def measure(source: Any, settings: dict[str, Any], ways: list[Way]) -> dict[str, float]:
    """Largest mean and largest single distance over the ways, voxels."""
    scan = scan_of(source)
    first = run(scan, settings, WAYS[0])
    figures = [apart(first, run(scan, settings, way), scan) for way in ways]
    means, largest = zip(*figures, strict=True)
    return {
        "ways": len(ways),
        "mean": round(max(means), 4),
        "hausdorff": round(max(largest), 4),
        "steps": sum(level.steps for level in first.levels),
    }


def run(scan: Volume, settings: dict[str, Any], way: Way) -> Result:
    """Segment a scan that is stored in one of the ways."""
    settings, volume = dict(settings), stored(scan, way)
    geometry, whole = scan.geometry, tuple(slice(0, n) for n in scan.geometry.shape)
    if isinstance(settings.get("start"), tuple):
        *index, radius = settings["start"]
        settings["start"] = "ball:" + ",".join(
            f"{v:.17g}" for v in (*geometry.index_to_world(index), radius)
        )
    if settings.get("mask"):
        settings["mask"] = permuted(ball(geometry, whole, (-4, -2, 2), 16.0) < 0, way)
    if settings.pop("objects", False):
        balls = [ball(geometry, whole, at, 5.0) < 0 for at in ((-7, -3, 2), (10, 2, 0))]
        labels = permuted(balls[0] + 2 * balls[1].astype(np.uint8), way)
        return segment_objects(volume, labels, threads=1, **settings)
    return segment(volume, threads=1, **settings)


def ball(
    geometry: Any, box: Box, centre: tuple[float, float, float], radius: float
) -> NDArray[np.float32]:
    """Distance to a ball; ``centre`` in world mm."""
    return ball_distance(box, geometry.spacing, geometry.world_to_index(centre), radius)


def _psi_at(result: Result, part: Any, world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Psi of an object of a result at world points, linear between voxels."""
    index = result.geometry.world_to_index(world) - [s.start or 0 for s in part.box]
    return np.asarray(ndimage.map_coordinates(part.psi, index.T, order=1, mode="nearest"))


def apart(one: Result, two: Result, scan: Volume) -> tuple[float, float]:
    """Mean and largest distance of the surfaces of two results, voxels."""
    distances = []
    for first, second in ((one, two), (two, one)):
        for a, b in zip(first.objects, second.objects, strict=True):
            at = first.geometry.world_to_index(b.surface.vertices)
            # Half a voxel beyond the border are the caps of a surface that the border cuts.
            at = at[((at >= 0) & (at <= np.array(first.geometry.shape) - 1)).all(axis=1)]
            index = first.geometry.index_to_world(at)
            distances.append(np.abs(_psi_at(first, a, index) - _psi_at(second, b, index)))
    every = np.concatenate(distances) / min(scan.geometry.steps)
    return float(every.mean()), float(every.max())


if __name__ == "__main__":
    main()
