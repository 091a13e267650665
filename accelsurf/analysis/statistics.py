"""Figures of an object that need no reference: its size, where it lies, its extents, and the image within it.

Volume and surface are those of the surface, sub-voxel; all others are over the voxels whose centres are inside. Extents
are taken between the outer corners of voxels, so that a box of voxels has the length of its edges.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.geometry import Geometry

if TYPE_CHECKING:
    from accelsurf.segmentation.result import SegmentedObject

Floats = NDArray[np.float64]
PERCENTILES = (1, 5, 25, 50, 75, 95, 99)


def statistics(one: SegmentedObject, values: NDArray[Any]) -> dict[str, Any]:
    """Figures of an object.

    Parameters
    ----------
    one : SegmentedObject
        With a voxel.
    values : ndarray (nz, ny, nx)
        The image on the object's grid, as it was read.

    Returns
    -------
    dict
        In this order: ``volume_ml``, ``volume_mm3``, ``area_mm2``; ``voxels``; ``mean``, ``sd``, ``min``, ``p1`` to
        ``p99``, ``max`` of the image; ``box_first``, ``box_last`` (voxel indices x, y, z, both in the object);
        ``centroid_mm``; ``axes_mm``, the lengths of the ellipsoid with the same moments, longest first, and
        ``axes_directions``; ``diameter_mm``, the largest distance of two points of it, ``diameter_axial_mm``, the
        largest within one slice; ``sphere_mm``, the diameter of a ball of the same volume; ``sphericity``, the area of
        that ball by its own. Places and directions are (x, y, z), LPS; an undefined figure is None.
    """
    inside = one.labels > 0
    box = bounding_box(inside)
    assert box is not None  # it has a voxel
    index = np.argwhere(inside[box]) + [part.start for part in box]
    world = one.geometry.index_to_world(index)
    return {
        "volume_ml": one.volume_mm3 / 1000,
        "volume_mm3": one.volume_mm3,
        "area_mm2": one.area_mm2,
        "voxels": len(index),
        **_of_image(values[inside]),
        "box_first": [int(part.start + side.start) for part, side in zip(reversed(box), _first(one), strict=True)],
        "box_last": [int(part.stop - 1 + side.start) for part, side in zip(reversed(box), _first(one), strict=True)],
        "centroid_mm": [float(part) for part in world.mean(axis=0)],
        **_axes(world, one.geometry),
        "diameter_mm": _diameter(_corners(index, one.geometry)),
        "diameter_axial_mm": _axial_diameter(index, one.geometry),
        **_roundness(one.volume_mm3, one.area_mm2),
    }


def _first(one: SegmentedObject) -> list[slice]:
    """Where the object's box begins in the image, (x, y, z)."""
    return [slice(side.start or 0, None) for side in reversed(one.box)]


def _of_image(values: NDArray[Any]) -> dict[str, float]:
    """Mean, spread and percentiles."""
    flat = values.astype(np.float64)
    steps = np.percentile(flat, PERCENTILES)
    return {
        "mean": float(flat.mean()),
        "sd": float(flat.std()),
        "min": float(flat.min()),
        **{f"p{share}": float(step) for share, step in zip(PERCENTILES, steps, strict=True)},
        "max": float(flat.max()),
    }


def _axes(world: Floats, geometry: Geometry) -> dict[str, Any]:
    """Lengths and directions of the ellipsoid that has the moments of the voxels, each taken as a filled block."""
    offsets = world - world.mean(axis=0)
    moments = offsets.T @ offsets / len(world)
    moments += geometry.direction @ np.diag(np.square(geometry.spacing_xyz) / 12) @ geometry.direction.T
    sizes, directions = np.linalg.eigh(moments)
    longest_first = directions[:, ::-1].T
    # A direction and its opposite are the same axis: its largest part is positive.
    signs = np.sign(np.take_along_axis(longest_first, np.abs(longest_first).argmax(axis=1)[:, None], axis=1))
    return {
        "axes_mm": [float(2 * math.sqrt(5 * max(size, 0.0))) for size in sizes[::-1]],
        "axes_directions": (longest_first * signs).tolist(),
    }


def _corners(index: NDArray[np.int64], geometry: Geometry) -> Floats:
    """Corners of the voxels at the ends of each row along x, from which the farthest two points of all can be taken."""
    order = np.lexsort((index[:, 2], index[:, 1], index[:, 0]))
    ordered = index[order]
    row = (np.diff(ordered[:, :2], axis=0) != 0).any(axis=1)
    ends = np.concatenate([ordered[np.r_[True, row]], ordered[np.r_[row, True]]]).astype(np.float64)
    flat = np.array([0.5 if n > 1 else 0.0 for n in geometry.shape])
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    points = (ends[:, None, :] + signs * flat).reshape(-1, 3)
    return np.asarray(geometry.index_to_world(np.unique(points, axis=0)))


def _diameter(points: Floats) -> float:
    """Largest distance of two points, by those on their convex hull."""
    try:
        points = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # all in one plane or on one line
        centred = points - points.mean(axis=0)
        _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
        rank = int((sizes > 1e-9 * max(float(sizes[0]), 1e-300)).sum())
        if rank == 2 and len(points) > 3:
            points = points[ConvexHull(centred @ axes[:2].T).vertices]
        elif rank == 1:
            along = centred @ axes[0]
            points = points[[int(along.argmin()), int(along.argmax())]]
    return float(pdist(points).max()) if len(points) > 1 else 0.0


def _axial_diameter(index: NDArray[np.int64], geometry: Geometry) -> float:
    """Largest distance of two points within one slice z."""
    largest = 0.0
    for slice_number in np.unique(index[:, 0]):
        own = index[index[:, 0] == slice_number]
        plane = Geometry((1, *geometry.shape[1:]), geometry.spacing, geometry.origin, geometry.direction)
        largest = max(largest, _diameter(_corners(own * [0, 1, 1], plane)))
    return largest


def _roundness(volume_mm3: float, area_mm2: float) -> dict[str, float | None]:
    diameter = (6 * volume_mm3 / math.pi) ** (1 / 3)
    round_area = math.pi * diameter**2
    return {"sphere_mm": diameter, "sphericity": round_area / area_mm2 if area_mm2 > 0 else None}
