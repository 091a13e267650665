"""The image in blocks of voxels, in which the score map of later clicks on a large object is computed.

The effect of a later click is found by marches that go over a multiple of the object's volume. On a large object a
person would wait for them, while their value at a single voxel does not count: the labelling by the clicks beside them
is coarsened too, and the surface is brought to the edges of the image voxel by voxel. So the marches go over blocks,
as small as a bound on their number in the object allows. Small objects have blocks of one voxel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.energies.seeded.appearance import Image, Mask, Spacing
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.energies.seeded.contest import Balance, Field, field_of
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, whole_box
from accelsurf.grid.clicks import Click
from accelsurf.grid.window import Window

#: An object has so many blocks at most.
MAX_BLOCKS = 25_000


class Domain(NamedTuple):
    """Voxels that may be the object: a mask, None for all; and the window of the images, None where they are whole."""

    mask: Mask | None
    window: Window | None


class Blocks(NamedTuple):
    """A grid of blocks over a grid of voxels.

    Attributes
    ----------
    images : tuple of ndarray (nz, ny, nx), float32
        Means of the channels in the blocks.
    passes : ndarray of bool or None
        Where at least half of a block is open; None where all is.
    spacing : (hz, hy, hx)
        Of the blocks, mm.
    steps : (int, int, int)
        Voxels of a block along each axis; fewer at the ends of the grid.
    missing : (int, int, int)
        Voxels that the first block lacks along each axis: a window does not begin at a block of the whole grid.
    voxels : (int, int, int)
        Shape of the grid of voxels.
    window : Window or None
        The voxels are this part of a larger grid.
    """

    images: tuple[Image, ...]
    passes: Mask | None
    spacing: Spacing
    steps: Corner
    missing: Corner
    voxels: tuple[int, int, int]
    window: Window | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of blocks along each axis."""
        z, y, x = self.images[0].shape
        return z, y, x

    @property
    def size(self) -> int:
        """Voxels of a block."""
        return math.prod(self.steps)

    def count(self, voxels: float) -> int:
        """Number of blocks that a number of voxels fills, at least one."""
        return max(round(voxels / self.size), 1)

    def box_of(self, box: Box) -> Box:
        """The voxels of a box of blocks."""
        z, y, x = (
            slice(max(side.start * step - lacks, 0), min(side.stop * step - lacks, n))
            for side, step, lacks, n in zip(box, self.steps, self.missing, self.voxels, strict=True)
        )
        return z, y, x

    def on_voxels(self, box: Box, values: Image) -> Balance:
        """Values of the blocks of a box on their voxels, linearly between the middles of the blocks."""
        voxels = self.box_of(box)
        z, y, x = (
            part.start - (side.start * step - lacks)
            for part, side, step, lacks in zip(voxels, box, self.steps, self.missing, strict=True)
        )
        return Balance(voxels, values, self.steps, (z, y, x))

    def click(self, click: Click, answered: Sequence[Click]) -> Click | None:
        """The blocks in which a click has voxels, but for those of earlier clicks on the other side; None for none.

        Parameters
        ----------
        click : Click
            On the voxels.
        answered : sequence of Click
            On the blocks, in their order.
        """
        if self.size == 1:
            return click
        offset = np.array(corner_of(click.box)) + self.missing
        found = (np.argwhere(click.mask) + offset) // self.steps
        low, high = found.min(axis=0), found.max(axis=0) + 1
        mask = np.zeros(high - low, np.bool_)
        mask[tuple((found - low).T)] = True
        z, y, x = (int(a) for a in low)
        return click._replace(box=box_at((z, y, x), mask.shape), mask=mask).without(answered)


def in_blocks(
    images: Sequence[Image], spacing: Spacing, passes: Mask | None, window: Window | None, count: int
) -> Blocks:
    """Blocks of which an object of some voxels has at most `MAX_BLOCKS`, alike to all sides as far as can be.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    spacing : (hz, hy, hx)
        mm.
    passes : ndarray (nz, ny, nx) of bool or None
    window : Window or None
        The images are this part of larger ones, whose blocks these are.
    count : int
        Voxels of the object.
    """
    nz, ny, nx = images[0].shape
    corner = (0, 0, 0) if window is None else window.corner
    whole = images[0].shape if window is None else window.geometry.shape
    steps = (1, 1, 1)
    if count > MAX_BLOCKS:
        steps = coarsening(whole_box(whole), spacing, max(math.prod(whole) * MAX_BLOCKS // count, 1))
    if steps == (1, 1, 1):
        return Blocks(tuple(images), passes, spacing, steps, (0, 0, 0), (nz, ny, nx), window)
    missing = tuple(c % step for c, step in zip(corner, steps, strict=True))
    lacking = [(n, 0) for n in missing]

    def means(values: Image) -> Image:
        # What the first block lacks lies beyond the window: nothing looks at this block.
        return block_means(np.pad(values, lacking, "edge") if any(missing) else values, steps)

    open = None if passes is None else np.asarray(means(passes.astype(np.float32)) >= 0.5)
    hz, hy, hx = (h * step for h, step in zip(spacing, steps, strict=True))
    means_of = tuple(means(image) for image in images)
    return Blocks(means_of, open, (hz, hy, hx), steps, (missing[0], missing[1], missing[2]), (nz, ny, nx), window)


def field_in(blocks: Blocks) -> Field:
    """Field that marches over blocks need."""
    return field_of(blocks.images, blocks.spacing, blocks.passes, blocks.window, blocks.steps)
