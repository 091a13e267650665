"""Masks that a start can be: the largest component, Otsu's threshold, and a region grown from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.filters import threshold_otsu
from skimage.graph import MCP_Geometric

from accelsurf.grid.boxes import Box, sum_in_order, widened
from accelsurf.grid.geometry import Geometry

#: A path through a voxel counts twice its length when the value differs from the seed's by this many standard
#: deviations of the seed's neighbours, but at least by this fraction of the range of the image's middle 99 percent.
_SEED_DEVIATIONS = 3.0
MIN_RANGE_FRACTION = 0.1

#: A place is half-way between two voxels if it is so up to this fraction of one: world coordinates are rounded.
TIE = 1e-6


def otsu_level(values: NDArray[Any]) -> float:
    """Otsu's threshold, placed in the middle between the means of the two classes.

    At a unique optimum it lies there anyway. Between classes that are far apart every value is optimal, and the usual
    choice, the smallest, lies just above the lower class.

    Examples
    --------
    >>> otsu_level(np.array([0.0, 0.0, 10.0, 10.0]))
    5.0
    """
    array = np.asarray(values)
    first = threshold_otsu(array.ravel())
    planes = array if array.ndim > 2 else array[np.newaxis]
    return between_means(sum_in_order(sums_beside(plane, first) for plane in planes))


def sums_beside(plane: NDArray[Any], threshold: Any) -> NDArray[np.float64]:
    """Number and sum of the values above a threshold, then of the others, (4,)."""
    above = plane > threshold
    sums = ((np.count_nonzero(side), plane[side].sum(dtype=np.float64)) for side in (above, ~above))
    return np.array([v for pair in sums for v in pair], np.float64)


def between_means(sums: NDArray[np.float64]) -> float:
    """The middle between the means of two classes, of their `sums_beside`."""
    return 0.5 * (float(sums[1] / sums[0]) + float(sums[3] / sums[2]))


def otsu(values: NDArray[Any], dark: bool = False) -> NDArray[np.bool_]:
    """Voxels above Otsu's threshold, or those below it.

    Examples
    --------
    >>> otsu(np.array([[[0.0, 0.0, 10.0, 10.0]]])).astype(int)
    array([[[0, 0, 1, 1]]])
    """
    level = otsu_level(values)
    return np.asarray(values <= level if dark else values > level)


def largest(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Largest 6-connected component of a mask; of components of the same size the one with the first voxel.

    Examples
    --------
    >>> largest(np.array([[[True, False, True, True]]])).astype(int)
    array([[[0, 0, 1, 1]]])
    """
    parts, count = ndimage.label(mask)
    if count < 2:
        return mask
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return np.asarray(parts == sizes.argmax())


def grow_region(
    values: NDArray[Any], geometry: Geometry, centre: tuple[float, float, float], radius: float
) -> NDArray[np.bool_]:
    """Voxels within a geodesic distance ``radius`` of a seed, where values like the seed's make paths short.

    A mm through value I counts as 1 + ((I - m)/s)^2 mm, m being the median of the seed's neighbours and s their
    standard deviation (from the median absolute deviation) times `_SEED_DEVIATIONS`: in a region like the seed's that
    gives a ball, which stops at the region's edge. The shortest paths go from voxel to voxel over the 26 neighbours
    (Dijkstra); they are up to an eighth (with thick slices a fifth) longer than straight ones.

    Parameters
    ----------
    values : ndarray (nz, ny, nx)
    geometry : Geometry
    centre : (z, y, x)
        Voxel indices.
    radius : float
        mm.

    Returns
    -------
    ndarray (nz, ny, nx) of bool
        Empty when the seed is outside.
    """
    out = np.zeros(values.shape, np.bool_)
    voxel = _nearest_voxels(centre)
    if any(s.start < 0 or s.stop > n for s, n in zip(voxel, values.shape, strict=True)):
        return out
    box = widened(voxel, values.shape, [int(np.ceil(radius / h)) + 1 for h in geometry.spacing])
    near = values[widened(voxel, values.shape, (1, 1, 1))].astype(np.float64)
    middle = float(np.median(near))
    low, high = np.percentile(values, (0.5, 99.5))
    deviation = 1.4826 * float(np.median(np.abs(near - middle)))
    spread = max(_SEED_DEVIATIONS * deviation, MIN_RANGE_FRACTION * float(high - low), 1e-30)
    cost = 1.0 + ((values[box].astype(np.float64) - middle) / spread) ** 2
    march = MCP_Geometric(cost, sampling=geometry.spacing)
    ranges = (range(v.start - s.start, v.stop - s.start) for v, s in zip(voxel, box, strict=True))
    length, _ = march.find_costs([list(seed) for seed in product(*ranges)])
    out[box] = length <= radius
    return out


def _nearest_voxels(centre: Sequence[float]) -> Box:
    """The voxel nearest to a place, in voxels; half-way between two it is both, from whichever side one counts.

    Examples
    --------
    >>> _nearest_voxels((3.0, 4.4, 5.5))
    (slice(3, 4, None), slice(4, 5, None), slice(5, 7, None))
    """
    z, y, x = (slice(int(np.ceil(c - 0.5 - TIE)), int(np.floor(c + 0.5 + TIE)) + 1) for c in centre)
    return z, y, x
