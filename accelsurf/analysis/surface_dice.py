"""Surface Dice at a tolerance: the part of two surfaces that lies near each other.

The definition is that of S. Nikolov et al., "Clinically applicable segmentation of head and neck anatomy for
radiotherapy", J. Med. Internet Res. 23(7), 2021, and of their program surface-distance; challenges call it normalized
surface distance (NSD):

- Each 2 x 2 x 2 neighbourhood of voxel centres that holds both object and other voxels is a *surface element*. It lies
  in the middle of the neighbourhood. Its area is that of the marching-cubes triangles there, with corners in the middle
  of the edges, in mm2. In a 2D image the neighbourhood has 2 x 2 voxels, and the element is a length in mm.
- What lies outside the volume is not object: an object cut by the volume's border has a surface there.
- The distance of an element is that to the nearest element of the other surface, in mm.
- Surface Dice is the area of all elements of both surfaces whose distance is at most the tolerance, over the area of
  all elements of both.

The triangles are those of scikit-image's table ("lorensen"), of the kind, object or not, that has fewer of the eight
voxels. For cubic voxels each kind of neighbourhood has the area that surface-distance gives it. Where five or six edges
are cut and voxels are no cubes, tables may differ in the diagonal of the polygon, and so in the area of that element.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from accelsurf.grid.boxes import bounding_box, corner_of

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Spacing = tuple[float, float, float]


def surface_dice(a: Mask, b: Mask, spacing: Spacing, tolerances: Sequence[float]) -> list[float]:
    """Part of the two surfaces that lies within a tolerance of the other one, for each tolerance.

    Parameters
    ----------
    a, b : ndarray of bool, shape (nz, ny, nx)
        The objects.
    spacing : tuple of float
        (hz, hy, hx) in mm.
    tolerances : sequence of float
        In mm, at least 0.

    Returns
    -------
    list of float
        Between 0 and 1; 0 when one of the objects is empty, NaN when both are.

    Examples
    --------
    >>> a, b = np.zeros((2, 12, 12, 12), bool)
    >>> a[2:8, 2:8, 2:8] = b[3:9, 2:8, 2:8] = True
    >>> surface_dice(a, b, (1.5, 1.0, 1.0), [1.5, 2.0])
    [1.0, 1.0]
    """
    (points_a, areas_a), (points_b, areas_b) = surface_elements(a, spacing), surface_elements(b, spacing)
    total = float(areas_a.sum() + areas_b.sum())
    if not total:
        return [math.nan] * len(tolerances)
    if not len(points_a) or not len(points_b):
        return [0.0] * len(tolerances)
    from_a, from_b = _nearest(points_a, points_b), _nearest(points_b, points_a)
    # A distance equal to the tolerance counts, also where its rounding differs by the place in the volume.
    near = [tolerance * (1 + 1e-9) + 1e-9 for tolerance in tolerances]
    return [float(areas_a[from_a <= most].sum() + areas_b[from_b <= most].sum()) / total for most in near]


def surface_elements(mask: Mask, spacing: Spacing) -> tuple[Floats, Floats]:
    """Middle and size of each surface element of an object.

    Parameters
    ----------
    mask : ndarray of bool, shape (nz, ny, nx)
        The object.
    spacing : tuple of float
        (hz, hy, hx) in mm.

    Returns
    -------
    points : ndarray, shape (n, 3), float64
        (z, y, x) in mm from the centre of voxel (0, 0, 0), scan order.
    sizes : ndarray, shape (n,), float64
        In mm2; in mm where one axis of the volume has a single voxel, and 1 where two have.

    Examples
    --------
    >>> points, sizes = surface_elements(np.ones((1, 1, 1), bool), (1.0, 1.0, 1.0))
    >>> len(points), len(sizes)
    (0, 0)
    """
    bounds = bounding_box(mask)
    along = tuple(axis for axis in range(3) if mask.shape[axis] > 1)
    if bounds is None or not along:
        return np.empty((0, 3)), np.empty(0)
    box = np.pad(mask[bounds], [(1, 1) if axis in along else (0, 0) for axis in range(3)]).view(np.uint8)
    code: NDArray[Any] = box
    for bit, axis in enumerate(along):
        n = code.shape[axis]
        low, high = (code.take(range(first, n - 1 + first), axis) for first in (0, 1))
        code = low | (high << (1 << bit))
    sizes = _sizes(tuple(spacing[axis] for axis in along))
    cut = np.argwhere((code > 0) & (code < len(sizes) - 1))
    shift = [corner_of(bounds)[axis] - (0.5 if axis in along else 0.0) for axis in range(3)]
    return (cut + np.array(shift)) * np.asarray(spacing, dtype=np.float64), sizes[code[tuple(cut.T)]]


@lru_cache(maxsize=16)
def _sizes(spacing: tuple[float, ...]) -> Floats:
    """Size of the surface element of each neighbourhood.

    A neighbourhood along d axes is a number of 2^d bits: bit i + 2 j (+ 4 k) is the voxel i further along the first of
    the axes, j along the second, k along the third.
    """
    corners = 2 ** len(spacing)
    sizes = np.zeros(2**corners)
    for code in range(1, len(sizes) - 1):
        fewer = code if code.bit_count() <= corners // 2 else len(sizes) - 1 - code
        values = np.array([fewer >> bit & 1 for bit in range(corners)], np.float32)
        sizes[code] = _MEASURES[len(spacing)](values.reshape((2,) * len(spacing)).T, spacing)
    sizes.setflags(write=False)
    return sizes


def _area(values: NDArray[np.float32], spacing: tuple[float, ...]) -> float:
    """Of the triangles in a neighbourhood of 2 x 2 x 2."""
    from skimage.measure import marching_cubes, mesh_surface_area

    vertices, faces, _, _ = marching_cubes(values, 0.5, spacing=spacing, method="lorensen")
    return float(mesh_surface_area(vertices, faces))


def _length(values: NDArray[np.float32], spacing: tuple[float, ...]) -> float:
    """Of the lines in a neighbourhood of 2 x 2: they join the middles of the edges that are cut."""
    if values[0, 0] == values[1, 1] and values[0, 1] == values[1, 0]:  # two corners across are cut off
        return math.hypot(*spacing)
    if values[0, 0] == values[0, 1] and values[1, 0] == values[1, 1]:
        return spacing[1]
    if values[0, 0] == values[1, 0] and values[0, 1] == values[1, 1]:
        return spacing[0]
    return math.hypot(*spacing) / 2


_MEASURES = {3: _area, 2: _length, 1: lambda values, spacing: 1.0}


def _nearest(points: Floats, targets: Floats) -> Floats:
    tree = cKDTree(targets, balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(points)[0], dtype=np.float64)
