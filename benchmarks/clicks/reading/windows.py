"""Windows of blocks of voxels around clicks: what a reading looks at.

A window is as wide as some radii of the click, and its blocks are as large as a part of that radius, so that a small
click and a large one look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from benchmarks.clicks.domain import block_mean, enlarged
from benchmarks.clicks.person import PersonClick

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]
#: Most blocks of a window; larger blocks are taken above.
MOST = 42_000
#: A click's inscribed radius is at least so many of the smallest spacings.
LEAST_RADIUS = 1.5


class Scale(NamedTuple):
    """Scale of a window: blocks in a radius, and radii from the click to a face."""

    blocks: float
    reach: float


#: From near to far: the next one is taken where an answer touches a face.
SCALES = (Scale(3.6, 5.0), Scale(2.2, 9.0), Scale(1.3, 16.0), Scale(0.8, 30.0))


class Seed(NamedTuple):
    """A click in blocks: its middle (z, y, x, counted from the first block's), and its radius, mm."""

    middle: NDArray[np.float64]
    radius: float


@dataclass(frozen=True, eq=False)
class Window:
    """A window of blocks.

    Attributes
    ----------
    box : tuple of slice
        Voxels of the image.
    steps : ndarray (3,) int
        Voxels of a block along z, y, x.
    size : ndarray (3,) float64
        Of a block, mm.
    values : ndarray (nz, ny, nx) float32
        Means of the blocks.
    mine, theirs : ndarray (nz, ny, nx) of bool
        Blocks of clicks on the side of the click that is answered, and on the other side.
    click : Seed
        The click that is answered.
    friends, others : tuple of Seed
        Earlier clicks on its side, and those on the other.
    faces : ndarray (nz, ny, nx) of bool
        Blocks at faces beyond which the image goes on.
    is_limited : bool
        The click is as large as clicks get, or a single voxel: its radius says little of the object's.
    """

    box: Box
    steps: NDArray[np.int64]
    size: NDArray[np.float64]
    values: Floats
    mine: Mask
    theirs: Mask
    click: Seed
    friends: tuple[Seed, ...]
    others: tuple[Seed, ...]
    faces: Mask
    is_limited: bool

    def means(self, values: NDArray[np.generic]) -> Floats:
        """Means of blocks of an array on the image's grid."""
        return block_mean(values[self.box].astype(np.float32), self.steps)

    def distance_to(self, seed: Seed) -> Floats:
        """Distance (mm) of each block from a click's middle."""
        return np.sqrt(_squares(seed.middle, self.size, self.values.shape)).astype(np.float32)

    def on_voxels(self, field: Floats) -> Floats:
        """Values at the voxels of the box, linear between the middles of blocks."""
        return enlarged(field, self.steps, [side.stop - side.start for side in self.box])


def inscribed_radius(click: PersonClick, spacing: Sequence[float]) -> float:
    """Radius (mm) of the largest ball around a click: people click balls of half the depth."""
    return max(2.0 * click.radius, LEAST_RADIUS * min(spacing))


def window_around(
    image: NDArray[np.generic], spacing: Sequence[float], clicks: Sequence[PersonClick], scale: Scale, largest: float
) -> Window:
    """The window around the last of some clicks.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
    spacing : (hz, hy, hx)
        mm.
    clicks : sequence of PersonClick
        Of those before the last the ones that lie in the window count.
    scale : Scale
    largest : float
        Largest radius of a click, mm.
    """
    last, mm = clicks[-1], np.asarray(spacing, np.float64)
    radius = inscribed_radius(last, spacing)
    block, shape = max(radius / scale.blocks, float(mm.min())), np.array(image.shape)
    while True:
        steps = np.maximum(np.rint(block / mm).astype(np.int64), 1)
        extent = scale.reach * radius / mm
        low = np.maximum(np.floor(last.index - extent).astype(np.int64), 0) // steps * steps
        high = np.minimum(np.ceil(last.index + extent).astype(np.int64) + 1, shape)
        if np.prod(-(-(high - low) // steps)) <= MOST:
            break
        block *= 1.12
    box: Box = (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))
    values, size = block_mean(image[box].astype(np.float32), steps), mm * steps
    here = [c for c in clicks[:-1] if all(s.start <= i < s.stop for s, i in zip(box, c.index, strict=True))]
    seed = {id(c): Seed((np.array(c.index) - low - 0.5 * (steps - 1)) / steps, c.radius) for c in (*here, last)}
    mine, theirs = _ball(seed[id(last)], size, values.shape), np.zeros(values.shape, np.bool_)
    friends = tuple(seed[id(c)] for c in here if c.side == last.side)
    others = tuple(seed[id(c)] for c in here if c.side != last.side)
    for other in others:
        theirs |= _ball(other, size, values.shape) & ~mine
    faces = np.zeros(values.shape, np.bool_)
    for axis in range(3):
        ends = np.moveaxis(faces, axis, 0)
        ends[0] |= low[axis] > 0
        ends[-1] |= high[axis] < shape[axis]
    is_limited = last.radius >= largest * (1 - 1e-6) or last.radius <= 0.5 * float(mm.min())
    return Window(box, steps, size, values, mine, theirs, seed[id(last)], friends, others, faces, is_limited)


def _squares(middle: NDArray[np.float64], size: NDArray[np.float64], shape: Sequence[int]) -> NDArray[np.float64]:
    z, y, x = (((np.arange(n) - m) * h) ** 2 for n, m, h in zip(shape, middle, size, strict=True))
    return np.asarray(z[:, None, None] + y[:, None] + x)


def _ball(seed: Seed, size: NDArray[np.float64], shape: Sequence[int]) -> Mask:
    """Blocks of a click, at least the one that its middle is in."""
    out = _squares(seed.middle, size, shape) <= seed.radius**2 * (1 + 1e-9)
    out[tuple(np.clip(np.rint(seed.middle).astype(int), 0, np.array(shape) - 1))] = True
    return out
