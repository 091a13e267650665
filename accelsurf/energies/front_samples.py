"""Samples at the surface for energies: an image, its slope, normals, positions.

The surface is represented by the closest point of each front cell. Every array here has a row
per band cell, zero where ``front`` is False, in the order of `LevelSet.band`; lengths are mm, axes (z, y, x).
"""

from __future__ import annotations

import math

import numpy as np

from accelsurf.errors import InputError
from accelsurf.kernels import motion, point_sampling
from accelsurf.levelset import LevelSet


def raveled(image: np.ndarray, surface: LevelSet) -> np.ndarray:
    """An image as the kernels take it: float32, C-contiguous, one axis; no copy if it is so already.

    Raises
    ------
    InputError
        When it is not on the surface's grid.
    """
    check_shape(np.shape(image), surface)
    return np.ascontiguousarray(image, dtype=np.float32).reshape(-1)


def check_shape(shape: tuple[int, ...], surface: LevelSet) -> None:
    """Refuse an image that is not on the surface's grid; raveled it passes by its size.

    Raises
    ------
    InputError
        When it is not: kernels would read beyond it, or the wrong voxels.
    """
    if shape not in (surface.shape, (math.prod(surface.shape),)):
        raise InputError(
            f"an image of shape {shape} was given to an energy, expected {surface.shape}",
            "an energy's image must lie on the grid of the volume that is segmented",
        )


def sample_at_front(image: np.ndarray, surface: LevelSet, front: np.ndarray) -> np.ndarray:
    """Values of an image at the closest point of every front cell, by cubic interpolation; constant beyond the border.

    Parameters
    ----------
    image : ndarray (nz, ny, nx) or raveled
        Free of copies when float32 and contiguous.
    surface : LevelSet
    front : ndarray (n,) of bool

    Returns
    -------
    ndarray (n,), float32
        In the image's unit.

    Raises
    ------
    InputError
        When the image is not on the surface's grid.
    """
    out = np.empty(surface.size, np.float32)
    flat = raveled(image, surface)
    surface.workers.parallel(
        motion.sample_image, surface.size, flat, surface.grid, surface.band, front, out
    )
    return out


def slope_at_front(
    image: np.ndarray, surface: LevelSet, front: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values of an image at the closest points, and its slopes grad I . n along the outward normal.

    Parameters
    ----------
    image : ndarray (nz, ny, nx) or raveled
    surface : LevelSet
    front : ndarray (n,) of bool

    Returns
    -------
    value, slope : ndarray (n,), float32
        In the image's unit, and that per mm. The slope is the interpolant's own derivative.

    Raises
    ------
    InputError
        When the image is not on the surface's grid.
    """
    out = np.empty((surface.size, 2), np.float32)
    flat, normals = raveled(image, surface), normals_at_front(surface, front)
    surface.workers.parallel(
        point_sampling.value_and_slope,
        surface.size,
        flat,
        surface.grid,
        surface.band,
        normals,
        front,
        out,
    )
    return out[:, 0].copy(), out[:, 1].copy()


def normals_at_front(surface: LevelSet, front: np.ndarray) -> np.ndarray:
    """Outward unit normals n = grad psi/|grad psi| (n, 3), float32, axes (z, y, x) in mm. The inward N is -n."""
    out = np.empty((surface.size, 3), np.float32)
    surface.workers.parallel(
        point_sampling.outward_normals,
        surface.size,
        surface.dense.psi,
        surface.grid,
        surface.band,
        front,
        out,
    )
    return out


def points_at_front(surface: LevelSet, front: np.ndarray) -> np.ndarray:
    """Closest points (n, 3) of the front cells, float64: (z, y, x), mm along the grid's axes from the first voxel."""
    out = np.zeros((surface.size, 3))
    index = np.stack(np.unravel_index(surface.band.cells[front], surface.shape), axis=1)
    grid = surface.grid
    out[front] = index * np.array([grid.hz, grid.hy, grid.hx]) + surface.band.to_closest[front]
    return out
