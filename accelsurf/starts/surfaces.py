"""First surfaces of shapes: psi of a ball, a box and a set of voxels on the grid of an image, negative inside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import slabs
from accelsurf.grid.geometry import Geometry, ball_distance
from accelsurf.grid.window import Window


def psi_of_mask(mask: NDArray[np.bool_], geometry: Geometry) -> NDArray[np.float32]:
    """Psi of a mask: half a voxel of the smallest spacing to either side of its boundary, mm."""
    half = np.float32(0.5 * min(geometry.steps))
    return np.where(mask, -half, half)


def psi_of_ball(window: Window, centre: Sequence[float], radius: float) -> NDArray[np.float32]:
    """Psi of a ball: the distance, mm.

    Parameters
    ----------
    window : Window
        The part of a grid that psi is wanted on.
    centre : (z, y, x)
        Index on the whole grid.
    radius : float
        mm.
    """
    # Whole volumes: sums of squares in single precision take half the time.
    return ball_distance(window.box, window.geometry.spacing, centre, radius, np.float32)


def middle_ball(window: Window) -> NDArray[np.float32]:
    """Psi of a ball in the middle of the whole grid, a quarter of its shortest side in radius."""
    geometry = window.geometry
    extents = [e for e, n in zip(geometry.extent_mm, geometry.shape, strict=True) if n > 1]
    centre = [0.5 * (n - 1) for n in geometry.shape]
    return psi_of_ball(window, centre, 0.25 * min(extents or [geometry.spacing[0]]))


def psi_of_box(window: Window, corners: Sequence[float], in_voxels: bool) -> NDArray[np.float32]:
    """Psi of a box: the distance, mm.

    Parameters
    ----------
    window : Window
        The part of a grid that psi is wanted on.
    corners : (x0, y0, z0, x1, y1, z1)
        In world mm (LPS), along whose axes the box then lies, or as indices.
    in_voxels : bool
        True if they are indices.
    """
    geometry, shape = window.geometry, window.shape
    low, high = np.array(corners[:3]), np.array(corners[3:])
    scale = np.array(geometry.spacing_xyz) if in_voxels else np.ones(3)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * scale

    nz, ny, nx = (np.arange(s.start, s.stop, dtype=float) for s in window.box)
    psi = np.empty(shape, np.float32)
    for planes in slabs(shape):
        z = nz[planes, None, None]
        y = ny[:, None]
        x = nx
        if in_voxels:
            offsets = [(c - m) * s for c, m, s in zip((x, y, z), middle, scale, strict=True)]
        else:
            world = geometry.index_to_world(np.stack(np.broadcast_arrays(z, y, x), axis=-1))
            offsets = [world[..., axis] - middle[axis] for axis in range(3)]
        q = [np.abs(o) - a for o, a in zip(offsets, half, strict=True)]
        outside = np.sqrt(sum(np.maximum(a, 0.0) ** 2 for a in q))
        psi[planes] = outside + np.minimum(np.maximum(np.maximum(q[0], q[1]), q[2]), 0.0)
    return psi
