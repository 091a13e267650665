"""State of a surface, saved and restored bit for bit: its band, and one sign for each stretch of voxels beyond it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.kernels.grid import Band
from accelsurf.levelset.level_set import LevelSet


class SurfaceState(NamedTuple):
    """State of a surface for `restore_surface`.

    ``cells`` (n,) of the band, uint32 where that is enough; ``psi`` (n,) mm; ``closest_points`` (n, 3), the vectors to
    them, mm; ``inside`` bits, whether each stretch of a row beyond the band is inside; ``inside_beyond`` number of
    inside voxels there; ``requested_half_width`` of the band.
    """

    cells: np.ndarray
    psi: np.ndarray
    closest_points: np.ndarray
    inside: np.ndarray
    inside_beyond: int
    requested_half_width: float

    @property
    def nbytes(self) -> int:
        """Its memory, bytes."""
        return int(
            self.cells.nbytes + self.psi.nbytes + self.closest_points.nbytes + self.inside.nbytes
        )


def checkpoint_surface(surface: LevelSet) -> SurfaceState:
    """Return the state of a surface; to be called between two steps.

    The arrays of the band are shared: a step makes new ones and leaves the old as they are.
    """
    return complete_state(band_state(surface), surface)


def band_state(surface: LevelSet) -> SurfaceState:
    """Return the state of the band alone, by reference and at no cost, for `complete_state`."""
    band, beyond = surface.band, surface.inside_beyond_band
    return SurfaceState(
        band.cells,
        band.psi,
        band.to_closest,
        np.empty(0, np.uint8),
        beyond,
        surface.requested_half_width,
    )


def complete_state(state: SurfaceState, surface: LevelSet) -> SurfaceState:
    """Return a state from `band_state` with the sides of the voxels beyond the band, not more than one step later.

    In a step only psi of band cells changes its sign: beyond the band of the state the sides are still the same.
    """
    inside = np.packbits(surface.dense.psi[_stretches(state.cells, surface.shape)] < 0)
    small = surface.dense.psi.size < 2**32
    return state._replace(
        cells=state.cells.astype(np.uint32) if small else state.cells, inside=inside
    )


def restore_surface(surface: LevelSet, state: SurfaceState) -> None:
    """Restore ``surface``, on the same grid, to the state from `checkpoint_surface`."""
    cells = state.cells.astype(np.int64)
    inside = _sides(state, cells, surface.shape)
    band = Band(cells, state.psi, state.closest_points)
    surface.restore(band, inside, state.inside_beyond, state.requested_half_width)


def psi_of(state: SurfaceState, shape: tuple[int, int, int], far: float) -> np.ndarray:
    """Return psi (nz, ny, nx) of a complete state of a surface on a grid: ``far`` mm away outside the band."""
    cells = state.cells.astype(np.int64)
    psi = np.where(_sides(state, cells, shape), np.float32(-far), np.float32(far))
    psi[cells] = state.psi
    return psi.reshape(shape)


def _sides(state: SurfaceState, cells: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Mask of the voxels of the raveled grid that lie inside; of no meaning in the band."""
    total = shape[0] * shape[1] * shape[2]
    first = _stretches(cells, shape)
    signs = np.unpackbits(state.inside, count=first.size).astype(np.bool_)
    # Band cells are overwritten later, so a stretch may continue over them.
    leading = int(first[0]) if first.size else total
    lengths = np.concatenate([[leading], np.diff(first, append=total)])
    return np.repeat(np.concatenate([[False], signs]), lengths)


def _stretches(cells: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """First voxel of each stretch beyond the band: after a band cell, or at the beginning of a row; in raster order.

    The surface crosses no pair of neighbours outside the band, so a stretch within a row is on one side.
    """
    nx, total = shape[2], shape[0] * shape[1] * shape[2]
    # Few cells of the band are the last ones of a run of neighbours.
    after = cells[np.diff(cells, append=total + 1) != 1] + 1 if cells.size else cells
    after = after[(after < total) & (after % nx != 0)]
    rows = np.arange(0, total, nx)
    if cells.size:
        rows = rows[cells[np.minimum(np.searchsorted(cells, rows), cells.size - 1)] != rows]
    first = np.concatenate([after, rows])
    first.sort(kind="stable")
    return first
