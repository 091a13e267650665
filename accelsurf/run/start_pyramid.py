"""First surfaces of an object, images and masks on every level of a run, made when they are first needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, as_corner, corner_of
from accelsurf.grid.click_bounds import KnownDistances
from accelsurf.grid.geometry import farthest
from accelsurf.grid.pyramid import Level, prolong, restrict
from accelsurf.starts import ObjectStart


class StartPyramid:
    """The start of an object on the levels of a run; coarser levels than the present one are released.

    Parameters
    ----------
    start : ObjectStart
    grids : sequence of Level
        Finest first. On each the start lies on the box of all blocks that it touches; beyond its array it
        is far outside.
    """

    def __init__(self, start: ObjectStart, grids: Sequence[Level]) -> None:
        self._starts = [(start.corner, start.psi)]
        far = farthest(start.psi)
        for fine, coarse in zip(grids, grids[1:], strict=False):
            corner, psi = self._starts[-1]
            at, shape = coarser_box(corner, psi.shape, coarse, fine)
            corner, psi = _widened(corner, psi, touched_box(at, shape, coarse, fine), far)
            self._starts.append(
                (at, restrict(psi, fine.on_box(corner, psi.shape), coarse.on_box(at, shape)))
            )

    @property
    def level(self) -> int:
        """The present level."""
        return len(self._starts) - 1

    def is_resolved(self) -> bool:
        """Return True if the start has something inside and outside on the present level."""
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


def _widened(
    corner: Corner, psi: NDArray[np.float32], box: Box, value: float
) -> tuple[Corner, NDArray[np.float32]]:
    """The same on a larger box, with ``value`` beyond the array."""
    pad = [(c - s.start, s.stop - c - n) for c, n, s in zip(corner, psi.shape, box, strict=True)]
    return corner_of(box), psi if not np.any(pad) else np.pad(psi, pad, constant_values=value)


def _ratio_of(coarse: Level, fine: Level) -> tuple[int, int, int]:
    """Voxels of the finer level per voxel of the coarser one, along each axis."""
    return as_corner(np.floor_divide(coarse.factors, fine.factors))


def coarser_box(
    corner: Corner, shape: tuple[int, ...], coarse: Level, fine: Level
) -> tuple[Corner, tuple[int, int, int]]:
    """First voxel and shape, on the next coarser level, of the voxels that a box touches."""
    at, counts = [], []
    for c, n, ratio, whole in zip(corner, shape, _ratio_of(coarse, fine), fine.shape, strict=True):
        # A block of an axis of odd size takes half of the voxel after its last as well.
        at.append(c // ratio)
        counts.append((c + n - (1 if ratio == 1 or whole % 2 == 0 else 0)) // ratio + 1 - at[-1])
    return as_corner(at), as_corner(counts)


def touched_box(corner: Corner, shape: tuple[int, ...], coarse: Level, fine: Level) -> Box:
    """The voxels of the next finer level that a box of blocks touches."""
    ends = []
    for c, n, ratio, whole in zip(corner, shape, _ratio_of(coarse, fine), fine.shape, strict=True):
        half = 1 if ratio > 1 and whole % 2 else 0
        ends.append(slice(max(c * ratio - half, 0), min((c + n) * ratio, whole)))
    return ends[0], ends[1], ends[2]


def finer_box(
    corner: Corner, shape: tuple[int, ...], coarse: Level, fine: Level
) -> tuple[Corner, tuple[int, int, int]]:
    """First voxel and shape, on the next finer level, of a box of voxels.

    Along an axis of odd size it goes from the centre of the first voxel to that of the last.
    """
    ratio = _ratio_of(coarse, fine)
    counts = (
        n * r - (1 if r > 1 and whole % 2 else 0)
        for n, r, whole in zip(shape, ratio, fine.shape, strict=True)
    )
    return as_corner(np.multiply(corner, ratio)), as_corner(counts)


def to_finest(
    corner: Corner, psi: NDArray[np.float32], level: int, grids: Sequence[Level]
) -> tuple[Corner, NDArray[np.float32]]:
    """First voxel and psi on the finest level's grid, interpolated from a coarser one."""
    for number in range(level, 0, -1):
        coarse, fine = grids[number], grids[number - 1]
        at, shape = finer_box(corner, psi.shape, coarse, fine)
        psi = prolong(psi, coarse.on_box(corner, psi.shape), fine.on_box(at, shape))
        corner = at
    return corner, psi


class LevelArrays:
    """One array on all levels, restricted from the finest.

    Parameters
    ----------
    finest : ndarray (nz, ny, nx), float32
    grids : sequence of Level
        Finest first.
    """

    def __init__(self, finest: NDArray[np.float32], grids: Sequence[Level]) -> None:
        self._arrays, self._grids = [finest], grids

    def on(self, level: int, box: Box) -> NDArray[np.float32]:
        """The array on a box of a level."""
        while len(self._arrays) <= level:
            n = len(self._arrays)
            self._arrays.append(restrict(self._arrays[-1], self._grids[n - 1], self._grids[n]))
        return np.ascontiguousarray(self._arrays[level][box])

    def release_coarser(self, level: int) -> None:
        """Release the arrays of coarser levels."""
        del self._arrays[level + 1 :]


class LevelInputs:
    """Image, further channels and mask on the levels of a run.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        Channels on the finest level.
    mask_distance : ndarray or None
        Signed distance of the mask there, mm, negative within.
    grids : sequence of Level
        Finest first.

    Attributes
    ----------
    grids : tuple of Level
    known_distances : dict
        Distances to clicks on the finest, see `click_bounds`; they are added by who needs them.
    """

    def __init__(
        self,
        images: Sequence[NDArray[np.float32]],
        mask_distance: NDArray[np.float32] | None,
        grids: Sequence[Level],
    ) -> None:
        self.grids = tuple(grids)
        self.known_distances: KnownDistances = {}
        self._images = [LevelArrays(image, self.grids) for image in images]
        self._mask_distance = (
            None if mask_distance is None else LevelArrays(mask_distance, self.grids)
        )

    def images(self, level: int, box: Box) -> list[NDArray[np.float32]]:
        """The channels on a box of a level."""
        return [image.on(level, box) for image in self._images]

    def mask_distance(self, level: int, box: Box) -> NDArray[np.float32] | None:
        """The mask's distance on a box of a level; None without a mask."""
        return None if self._mask_distance is None else self._mask_distance.on(level, box)

    def release_coarser(self, level: int) -> None:
        """Release the arrays of levels coarser than ``level``."""
        for image in (
            *self._images,
            *([self._mask_distance] if self._mask_distance is not None else []),
        ):
            image.release_coarser(level)
