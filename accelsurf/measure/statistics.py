"""Figures of an object that need no reference: its size, where it lies, its extents, and the image within it.

Volume and area are measured on the surface, sub-voxel; all others are over the voxels whose centres are inside. Extents
are taken between the outer corners of voxels, so that a box of voxels has the length of its edges.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.diameters import Diameters, diameters

if TYPE_CHECKING:
    from accelsurf.measure.intervals import Estimates, Intervals

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


def object_statistics(segmented: Any, values: NDArray[Any]) -> dict[str, Any]:
    """Figures of an object.

    Parameters
    ----------
    segmented : accelsurf.run.result.SegmentedObject
        With a voxel.
    values : ndarray (nz, ny, nx)
        The image on the object's grid, as it was read.

    Returns
    -------
    dict
        In this order: ``volume_ml``, ``volume_mm3``, ``area_mm2`` of the surface; ``volume_estimate_mm3``,
        ``volume_low_mm3``, ``volume_high_mm3`` and so on of ``area`` and ``diameter``, see
        `accelsurf.measure.intervals`; ``voxels``; ``mean``, ``sd``, ``min``, ``p1`` to
        ``p99``, ``max`` of the image; ``box_first``, ``box_last`` (voxel indices x, y, z, both in the object);
        ``centroid_mm``; ``axes_mm``, the lengths of the ellipsoid with the same moments, longest first, and
        ``axes_directions``; ``diameter_mm``, ``diameter_across_mm``, ``diameter_axial_mm`` and
        ``diameter_axial_across_mm``, see `accelsurf.measure.diameters`; ``sphere_mm``, the diameter of a ball of the
        same volume; ``sphericity``, the area of that ball by its own. Places and directions are (x, y, z), LPS; an
        undefined figure is None.
    """
    box = bounding_box(segmented.labels > 0)
    assert box is not None  # it has a voxel
    inside, corner = segmented.labels[box] > 0, np.array([part.start for part in box])
    first = corner + [side.start or 0 for side in segmented.box]
    count, middle, moments = _moments(inside)
    return {
        "volume_ml": segmented.volume_mm3 / 1000,
        "volume_mm3": segmented.volume_mm3,
        "area_mm2": segmented.area_mm2,
        **_estimated(segmented.estimates, segmented.intervals),
        "voxels": count,
        **_of_image(values[box][inside]),
        "box_first": [int(part) for part in first[::-1]],
        "box_last": [int(part) for part in (first + inside.shape - 1)[::-1]],
        "centroid_mm": [float(part) for part in segmented.geometry.index_to_world(middle + corner)],
        **_axes(moments, segmented.geometry),
        **diameters_mm(diameters(inside, tuple(part.start for part in box), segmented.geometry)),
        **_roundness(segmented.volume_mm3, segmented.area_mm2),
    }


def _estimated(estimates: Estimates, intervals: Intervals | None) -> dict[str, float | None]:
    """Return the estimate of each measure and both ends of the interval around it."""
    out: dict[str, float | None] = {}
    for key, best in estimates._asdict().items():
        stem, unit = key.rsplit("_", 1)
        low, high = getattr(intervals, key, None) or (None, None)
        out |= {
            f"{stem}_estimate_{unit}": best,
            f"{stem}_low_{unit}": low,
            f"{stem}_high_{unit}": high,
        }
    return out


def _moments(inside: NDArray[np.bool_]) -> tuple[int, Floats, Floats]:
    """Return the number of voxels, their mean index (z, y, x), and the covariance of their indices.

    By sums over the planes of two axes, which have all that second moments need.
    """
    planes = {(0, 1): inside.sum(axis=2), (0, 2): inside.sum(axis=1), (1, 2): inside.sum(axis=0)}
    places = [np.arange(n, dtype=np.float64) for n in inside.shape]
    along = [planes[0, 1].sum(axis=1), planes[0, 1].sum(axis=0), planes[0, 2].sum(axis=0)]
    count = int(along[0].sum())
    middle = (
        np.array([float(weights @ place) for weights, place in zip(along, places, strict=True)])
        / count
    )
    offsets = [place - mean for place, mean in zip(places, middle, strict=True)]
    moments = np.diag(
        [float(weights @ off**2) for weights, off in zip(along, offsets, strict=True)]
    )
    for (a, b), plane in planes.items():
        moments[a, b] = moments[b, a] = offsets[a] @ plane @ offsets[b]
    return count, middle, moments / count


def _of_image(values: NDArray[Any]) -> dict[str, float]:
    """Mean, deviation and percentiles."""
    flat = values.astype(np.float64)
    steps = np.percentile(flat, PERCENTILES)
    return {
        "mean": float(flat.mean()),
        "sd": float(flat.std()),
        "min": float(flat.min()),
        **{f"p{share}": float(step) for share, step in zip(PERCENTILES, steps, strict=True)},
        "max": float(flat.max()),
    }


def _axes(moments: Floats, geometry: Geometry) -> dict[str, Any]:
    """Lengths and directions of the ellipsoid that has the moments of the voxels, each taken as a filled block."""
    steps = geometry.direction * geometry.spacing_xyz  # columns: a step along x, y, z
    in_world = steps @ (moments[::-1, ::-1] + np.eye(3) / 12) @ steps.T
    sizes, directions = np.linalg.eigh(in_world)
    longest_first = directions[:, ::-1].T
    # A direction and its opposite are the same axis: its largest part is positive.
    signs = np.sign(
        np.take_along_axis(longest_first, np.abs(longest_first).argmax(axis=1)[:, None], axis=1)
    )
    return {
        "axes_mm": [float(2 * math.sqrt(5 * max(size, 0.0))) for size in sizes[::-1]],
        "axes_directions": (longest_first * signs).tolist(),
    }


def diameters_mm(lines: Diameters) -> dict[str, float]:
    """Return the lengths of an object's longest lines by their names in tables."""
    names = ("diameter_mm", "diameter_across_mm", "diameter_axial_mm", "diameter_axial_across_mm")
    return {name: float(np.linalg.norm(b - a)) for name, (a, b) in zip(names, lines, strict=True)}


def _roundness(volume_mm3: float, area_mm2: float) -> dict[str, float | None]:
    diameter = (6 * volume_mm3 / math.pi) ** (1 / 3)
    round_area = math.pi * diameter**2
    return {"sphere_mm": diameter, "sphericity": round_area / area_mm2 if area_mm2 > 0 else None}
