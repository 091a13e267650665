"""Local balance of the mass on a moving surface: mass from before a motion is there after it, or has left."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from accelsurf.kernels import region, windows
from accelsurf.levelset import LevelSet

#: Distance of the nodes at which masses are compared, in voxels of the largest spacing.
STRIDE = 6.0
#: Half width of the layer, in voxels along the normal, that the masses are measured in. The mass of a piece of curve as
#: long as the nodes are apart errs by 2 parts in 10,000, in the layer of the areas (1.5) by 3 in 1000: as the surface
#: moves through the grid that error would be taken for a loss.
LAYER_WIDTH = 2.5
#: In a step the balance may change a density by at most this factor.
MAX_FACTOR = 2.0
#: The mass that the transport gives at the border is believed within this factor of the flow through it.
BORDER_RANGE = 2.0


class Prediction(NamedTuple):
    """Mass that a motion takes to every node: ``total`` of all, the least and the most at each, (mz, my, mx)."""

    total: float
    least: np.ndarray
    most: np.ndarray


class Balance(NamedTuple):
    """Result of a comparison: ``factor`` (n,) of the density, and ``mass``, the total that the surface should have."""

    factor: np.ndarray
    mass: float


def lattice_shape(surface: LevelSet) -> tuple[np.ndarray, tuple[int, ...]]:
    """Voxels between nodes along z, y, x, and the number of nodes."""
    grid, far = surface.grid, STRIDE * surface.largest_spacing
    stride = np.array([far / h for h in (grid.hz, grid.hy, grid.hx)])
    return stride, tuple(
        3 + math.ceil((n - 1) / s) for n, s in zip(surface.shape, stride, strict=True)
    )


def layer_area(surface: LevelSet, width: float = LAYER_WIDTH) -> np.ndarray:
    """Area (mm2) of the surface at every cell (n,), in a layer of ``width``; the default can compare its parts."""
    out = np.empty(surface.size)
    surface.workers.parallel(
        region.wide_areas, surface.size, surface.dense.psi, surface.grid, surface.band, width, out
    )
    # A single slice is thicker or thinner than the grid has it.
    grid = surface.grid
    return out * (surface.voxel_volume / (grid.hz * grid.hy * grid.hx))


def predict(surface: LevelSet, mass: np.ndarray, velocity: np.ndarray, dt: float) -> Prediction:
    """Move the ``mass`` (n,) of the cells by ``dt`` of motion.

    The flow through the border may be up to `BORDER_RANGE` times the flow by the velocity (n, 3) there.
    """
    motion = velocity, dt
    there = _deposited(surface, mass, motion)
    outflow = np.empty(surface.size, np.float32)
    surface.workers.parallel(
        windows.border_outflow, surface.size, surface.grid, surface.band.cells, motion, outflow
    )
    crossing = BORDER_RANGE * mass * np.clip(outflow, -1.0, 1.0)
    least = most = there
    if (crossing > 0.0).any():
        least = np.maximum(there - _deposited(surface, crossing, motion), 0.0)
    if (crossing < 0.0).any():
        most = there + _deposited(surface, -crossing, motion)
    return Prediction(float(there.sum()), least, most)


def balance(surface: LevelSet, mass: np.ndarray, before: Prediction) -> Balance:
    """Compare the ``mass`` (n,) that the transport gave the cells with the mass that the prediction took there.

    Every node gives back its lack, or takes its excess, in the shares in which the masses were added to it: sum of mass
    x factor is the sum of the masses that the nodes should have. Exceptions: nodes where nothing is left of the
    surface, and nodes at the limit `MAX_FACTOR`; their lack is missing in the sum.
    """
    motion = np.zeros((surface.size, 3), np.float32), 0.0
    here = _deposited(surface, mass, motion)
    wanted = np.clip(here, before.least, before.most)
    # Where all is gone at the border, it has left.
    wanted[(here <= 0.0) & (before.least < before.most)] = 0.0
    ratio = np.divide(
        wanted, here, out=np.ones_like(here), where=here > 1e-6 * before.total / here.size
    )
    np.clip(ratio, 1.0 / MAX_FACTOR, MAX_FACTOR, out=ratio)
    factor = np.empty(surface.size, np.float32)
    stride, _ = lattice_shape(surface)
    surface.workers.parallel(
        windows.lattice_factors, surface.size, surface.grid, surface.band, ratio, stride, factor
    )
    return Balance(factor, float(wanted.sum()))


def _deposited(surface: LevelSet, mass: np.ndarray, motion: tuple[np.ndarray, float]) -> np.ndarray:
    stride, shape = lattice_shape(surface)
    lattice = np.zeros(shape)
    surface.workers.serial(
        windows.deposit, surface.grid, surface.band, mass, motion, stride, lattice
    )
    return lattice
