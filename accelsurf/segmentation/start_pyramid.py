"""First surfaces of an object on every level of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Corner
from accelsurf.grid.pyramid import Level, prolong, restrict
from accelsurf.initialization.object_starts import ObjectStart


class StartPyramid:
    """The start of an object on the levels of a run; those of coarser levels than the present one are released.

    Parameters
    ----------
    start : ObjectStart
    grids : sequence of Level
        Finest first. On several levels the start is put on a box of whole blocks of the coarsest.
    """

    def __init__(self, start: ObjectStart, grids: Sequence[Level]) -> None:
        corner, psi = start.corner, start.psi
        if len(grids) > 1:
            corner, psi = _aligned(corner, psi, grids)
        self._starts = [(corner, psi)]
        for fine, coarse in zip(grids, grids[1:], strict=False):
            corner, psi = self._starts[-1]
            ratio = ratio_of(coarse, fine)
            nz, ny, nx = (-(-n // r) for n, r in zip(psi.shape, ratio, strict=True))
            z, y, x = (c // r for c, r in zip(corner, ratio, strict=True))
            small, blocks = fine._replace(shape=shape_of(psi)), coarse._replace(shape=(nz, ny, nx))
            self._starts.append(((z, y, x), restrict(psi, small, blocks)))

    @property
    def level(self) -> int:
        """The present level."""
        return len(self._starts) - 1

    def is_resolved(self) -> bool:
        """Whether the start has something inside and outside on the present level."""
        inside = self._starts[-1][1] < 0
        return bool(inside.any() and not inside.all())

    def to_finer(self) -> None:
        """Go to the next finer level."""
        self._starts.pop()

    def current(self) -> tuple[Corner, NDArray[np.float32]]:
        """First voxel and psi on the present level; on the finest level it is released, as nothing needs it again."""
        found = self._starts[-1]
        if self.level == 0:
            self.release()
        return found

    def release(self) -> None:
        """Release the present level's start: a whole volume on the finest level."""
        self._starts[-1] = ((0, 0, 0), np.zeros((0, 0, 0), np.float32))


def _aligned(
    corner: Corner, psi: NDArray[np.float32], grids: Sequence[Level]
) -> tuple[Corner, NDArray[np.float32]]:
    """A start on a box of whole blocks of the coarsest level; beyond the known values it is far outside."""
    blocks, whole = grids[-1].factors, grids[0].shape
    low = [c // f * f for c, f in zip(corner, blocks, strict=True)]
    high = [min(-(-(c + n) // f) * f, w) for c, n, f, w in zip(corner, psi.shape, blocks, whole, strict=True)]
    if low == list(corner) and [b - a for a, b in zip(low, high, strict=True)] == list(psi.shape):
        return corner, psi
    pad = [(c - a, b - c - n) for a, b, c, n in zip(low, high, corner, psi.shape, strict=True)]
    far = float(np.abs(psi[np.isfinite(psi)]).max())
    return (low[0], low[1], low[2]), np.pad(psi, pad, constant_values=far)


def ratio_of(coarse: Level, fine: Level) -> tuple[int, int, int]:
    """Voxels of the finer level per voxel of the coarser one, along each axis."""
    z, y, x = (c // f for c, f in zip(coarse.factors, fine.factors, strict=True))
    return z, y, x


def shape_of(array: NDArray[np.float32]) -> tuple[int, int, int]:
    """The shape of a volume."""
    nz, ny, nx = array.shape
    return nz, ny, nx


def finer_box(
    corner: Corner, shape: tuple[int, ...], coarse: Level, fine: Level
) -> tuple[Corner, tuple[int, int, int]]:
    """First voxel and shape, on the next finer level, of a box of voxels."""
    ratio = ratio_of(coarse, fine)
    z, y, x = (c * r for c, r in zip(corner, ratio, strict=True))
    nz, ny, nx = (
        min(n * r, whole - c) for n, r, whole, c in zip(shape, ratio, fine.shape, (z, y, x), strict=True)
    )
    return (z, y, x), (nz, ny, nx)


def to_finest(
    corner: Corner, psi: NDArray[np.float32], level: int, grids: Sequence[Level]
) -> tuple[Corner, NDArray[np.float32]]:
    """First voxel and psi on the finest level's grid, interpolated from a coarser one."""
    for number in range(level, 0, -1):
        coarse, fine = grids[number], grids[number - 1]
        at, shape = finer_box(corner, psi.shape, coarse, fine)
        psi = prolong(psi, coarse._replace(shape=shape_of(psi)), fine._replace(shape=shape))
        corner = at
    return corner, psi
