"""A window: a box of a grid on which a run is made, that is large enough to have the bytes of a run on the whole.

A run depends on the image near its surface and on a few numbers of the whole image. So a run in a window is
that on the whole grid as long as nothing that it looks at comes near a face of the window that is no face of the grid:
an *open face*. `LeavesWindow` says that something did; a larger window is then taken, and the run begins again.

Grids of a pyramid have the same blocks in the window as in the whole: its first voxel is a multiple of the coarsest
block, and its number of voxels is that of the whole but for a multiple of it (along axes that are halved).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.grid.boxes import Box, Corner, corner_of, counted_from
from accelsurf.grid.geometry import Geometry

#: Least distance of a run's voxels from an open face, voxels: room for stencils, smoothing, and voxels that enter the
#: band within a step.
GUARD = 8


class LeavesWindow(Exception):
    """Something that a run looks at comes near an open face: ``low`` and ``high``, for each axis, say which."""

    def __init__(self, low: Sequence[bool], high: Sequence[bool]) -> None:
        super().__init__(f"open faces reached: low {tuple(low)}, high {tuple(high)} (z, y, x)")
        self.low, self.high = tuple(low), tuple(high)


class NeedsLevels(Exception):
    """A run goes over more levels than the ``levels`` of its window: at least ``count``."""

    def __init__(self, count: int) -> None:
        super().__init__(f"{count} levels")
        self.count = count


class Window(NamedTuple):
    """A box of a whole grid.

    Attributes
    ----------
    geometry : Geometry
        Of the whole grid.
    box : tuple of slice
        The window's voxels.
    levels : int
        Number of levels of a pyramid, from the finest on, on which it has the blocks of the whole grid.
    """

    geometry: Geometry
    box: Box
    levels: int = 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the window."""
        z, y, x = (s.stop - s.start for s in self.box)
        return z, y, x

    @property
    def corner(self) -> Corner:
        """First voxel of the window."""
        return corner_of(self.box)

    @property
    def voxels(self) -> int:
        """Number of voxels of the whole grid."""
        return int(np.prod(np.array(self.geometry.shape, dtype=object)))

    @property
    def is_whole(self) -> bool:
        """True if it is the whole grid."""
        return self.shape == self.geometry.shape

    def local(self, box: Box) -> Box:
        """A box of the whole grid, counted from the window's first voxel."""
        return counted_from(box, self.corner)

    def place_on_whole(self, place: Sequence[float]) -> tuple[float, float, float]:
        """World mm (x, y, z) of the centre of a voxel of any level as the whole grid gives it, of a place in a window.

        The grid of a window gives it with another rounding.
        """
        index = self.geometry.world_to_index(np.asarray(place, np.float64))
        # Centres are at whole and half voxels, on all levels of a pyramid.
        x, y, z = (float(v) for v in self.geometry.index_to_world(np.rint(2.0 * index) / 2.0))
        return x, y, z

    def check(
        self, low: Sequence[int], high: Sequence[int], factors: Sequence[int] = (1, 1, 1)
    ) -> None:
        """Refuse voxels that come near an open face.

        Parameters
        ----------
        low, high : sequence of int
            First voxel and the one after the last, counted from the window's first, on a level of its pyramid.
        factors : sequence of int, optional
            Voxels of the window per voxel of the level, along each axis.

        Raises
        ------
        LeavesWindow

        Examples
        --------
        >>> window = Window(Geometry((40, 40, 40), (1.0, 1.0, 1.0)), (slice(0, 20), slice(8, 40), slice(0, 40)))
        >>> window.check((0, 9, 0), (12, 32, 40))
        >>> try:
        ...     window.check((0, 7, 0), (12, 32, 40))
        ... except LeavesWindow as face:
        ...     face.low, face.high
        ((False, True, False), (False, False, False))
        """
        begins, ends = [], []
        for side, whole, a, b, factor in zip(
            self.box, self.geometry.shape, low, high, factors, strict=True
        ):
            guard = GUARD * factor
            begins.append(side.start > 0 and a * factor < guard)
            ends.append(side.stop < whole and b * factor > side.stop - side.start - guard)
        if any(begins) or any(ends):
            raise LeavesWindow(begins, ends)

    def check_box(self, box: Box, factors: Sequence[int] = (1, 1, 1)) -> None:
        """`check` of a box that is counted from the window's first voxel."""
        self.check([s.start for s in box], [s.stop for s in box], factors)


def aligned(box: Box, geometry: Geometry, blocks: Sequence[int]) -> Box:
    """Return the smallest box around another on which a pyramid has the blocks of the whole grid.

    Parameters
    ----------
    box : tuple of slice
    geometry : Geometry
        Of the whole grid.
    blocks : sequence of int
        Voxels of a block of the coarsest grid, along each axis: powers of two.

    Examples
    --------
    >>> aligned((slice(9, 12), slice(0, 9), slice(3, 5)), Geometry((50, 51, 9), (1.0, 1.0, 1.0)), (4, 4, 1))
    (slice(8, 14, None), slice(0, 11, None), slice(3, 5, None))
    """
    sides = []
    for side, whole, block in zip(box, geometry.shape, blocks, strict=True):
        first = side.start // block * block
        sides.append(slice(first, whole - (whole - side.stop) // block * block))
    return sides[0], sides[1], sides[2]


def enlarged(window: Window, face: LeavesWindow, blocks: Sequence[int], factor: float) -> Box:
    """Return a box that is larger at the faces that were reached, by ``factor`` times the window's extent there."""
    sides = []
    for side, whole, low, high in zip(
        window.box, window.geometry.shape, face.low, face.high, strict=True
    ):
        more = max(GUARD, round(factor * (side.stop - side.start)))
        first, end = (more if low else 0), (more if high else 0)
        sides.append(slice(max(side.start - first, 0), min(side.stop + end, whole)))
    return aligned((sides[0], sides[1], sides[2]), window.geometry, blocks)
