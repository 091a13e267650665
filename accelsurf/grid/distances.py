"""Distances from simple bodies on a grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike, NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.slabs import slabs


def ball_distance(
    box: Box,
    spacing: Sequence[float],
    centre: Sequence[float] | NDArray[np.float64],
    radius: float,
    precision: DTypeLike = np.float64,
) -> NDArray[np.float32]:
    """Signed distance from a ball at the voxel centres of a box, mm, negative inside.

    Parameters
    ----------
    box : (slice, slice, slice)
        Voxels of the grid.
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    centre : sequence of 3 floats or ndarray (3,)
        Voxel index (z, y, x) of the ball's centre.
    radius : float
        mm.
    precision : dtype, optional
        Of the sum of the three squares and its root; float32 takes half the time, which counts on whole volumes.

    Returns
    -------
    ndarray, shape of the box, float32

    Examples
    --------
    >>> ball_distance((slice(0, 1), slice(0, 1), slice(2, 5)), (1.0, 1.0, 2.0), (0, 0, 3), 1.5)
    array([[[ 0.5, -1.5,  0.5]]], dtype=float32)
    """
    axes = (np.arange(s.start, s.stop, dtype=np.float64) for s in box)
    z, y, x = (((axis - c) * h) ** 2 for axis, c, h in zip(axes, centre, spacing, strict=True))
    z, y, x = z.astype(precision)[:, None, None], y.astype(precision)[:, None], x.astype(precision)
    out = np.empty((z.size, y.size, x.size), np.float32)
    for planes in slabs(out.shape):
        distance = z[planes] + y + x
        np.sqrt(distance, out=distance)
        distance -= distance.dtype.type(radius)
        out[planes] = distance
    return out


def farthest(psi: NDArray[np.float32]) -> float:
    """Largest finite |psi|, mm, of psi (nz, ny, nx); 0 where none is. Plane by plane: all at once takes two copies.

    Examples
    --------
    >>> farthest(np.array([[[1.0]], [[-3.0]], [[np.inf]]], np.float32))
    3.0
    """
    most = 0.0
    for plane in map(np.abs, psi):
        most = max(most, float(np.max(plane, where=np.isfinite(plane), initial=0.0)))
    return most
