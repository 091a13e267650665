"""Label maps of formats that store only where labels are, as DICOM segmentations, put on the grid of an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.headers import ZERO_BEYOND_KEY

#: Distance, in voxels of the smallest spacing, within which voxels of two grids are the same ones.
_TOLERANCE = 1e-3


def on_grid(labels: Volume, geometry: Geometry) -> Volume:
    """Labels on another grid of the same voxels, 0 beyond those that are stored.

    Parameters
    ----------
    labels : Volume
    geometry : Geometry
        Its axes may be in another order, or reversed.

    Returns
    -------
    Volume
        ``labels`` as they are where their format stores all voxels, where their voxels are none of the grid's, or where
        one with a label lies beyond it.

    Examples
    --------
    >>> stored = Volume(np.array([[[5, 6]]]), Geometry((1, 1, 2), (1, 1, 1), (1, 0, 2)), {ZERO_BEYOND_KEY: "yes"})
    >>> on_grid(stored, Geometry((4, 1, 3), (1, 1, 1))).array[2]
    array([[0, 5, 6]])
    """
    if ZERO_BEYOND_KEY not in labels.metadata or labels.geometry.matches(geometry):
        return labels
    places = _places(labels.geometry, geometry)
    if places is None:
        return labels
    first, axes = places
    order = np.abs(axes).argmax(axis=0)  # the stored axis that is each of the grid's
    signs = axes[order, range(3)]
    array = labels.array.transpose(order)[tuple(slice(None, None, sign) for sign in signs)]
    low = np.where(signs > 0, first, first - np.array(array.shape) + 1)
    begin = np.clip(low, 0, geometry.shape)
    end = np.clip(low + array.shape, begin, geometry.shape)
    inside = array[tuple(slice(a, b) for a, b in zip(begin - low, end - low, strict=True))]
    if np.count_nonzero(inside) < np.count_nonzero(array):
        return labels
    out = np.zeros(geometry.shape, array.dtype)
    out[tuple(slice(a, b) for a, b in zip(begin, end, strict=True))] = inside
    return Volume(out, geometry, labels.metadata, labels.source)


def on_one_grid(a: Volume, b: Volume) -> tuple[Volume, Volume]:
    """Two label maps on the grid of the one that stores all voxels; on one that holds both where none does."""
    if not {ZERO_BEYOND_KEY} <= a.metadata.keys() & b.metadata.keys():
        return on_grid(a, b.geometry), on_grid(b, a.geometry)
    if (places := _places(a.geometry, b.geometry)) is None:
        return a, b
    first, axes = places
    corners = np.stack([np.zeros(3, int), np.array(b.geometry.shape) - 1, first, first + axes.T @ _last(a.geometry)])
    low = corners.min(axis=0)
    shape = corners.max(axis=0) - low + 1
    grid = b.geometry
    whole = Geometry(tuple(shape.tolist()), grid.spacing, tuple(grid.index_to_world(low).tolist()), grid.direction)
    return on_grid(a, whole), on_grid(b, whole)


def _last(geometry: Geometry) -> NDArray[np.int64]:
    return np.array(geometry.shape) - 1


def _places(stored: Geometry, geometry: Geometry) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Index on a grid of the first stored voxel, and steps there along each stored axis, (3, 3); None where the voxels
    are others.
    """
    begin = geometry.world_to_index(stored.index_to_world((0, 0, 0)))
    steps = geometry.world_to_index(stored.index_to_world(np.eye(3))) - begin
    single = np.array(stored.shape) == 1  # of one slice the distance to the next does not matter
    steps[single] /= np.abs(steps[single]).max(axis=1, keepdims=True)
    first, axes = np.rint(begin).astype(int), np.rint(steps).astype(int)
    if any((np.abs(axes).sum(axis=axis) != 1).any() for axis in (0, 1)):
        return None
    ends = np.array(np.meshgrid(*((0, n - 1) for n in stored.shape))).reshape(3, -1).T
    off = stored.index_to_world(ends) - geometry.index_to_world(first + ends @ axes)
    near = np.linalg.norm(off, axis=1).max() <= _TOLERANCE * min(*stored.spacing, *geometry.spacing)
    return (first, axes) if near else None
