"""Windows of blocks of voxels around clicks: the part of an image that a click is read in.

A window is as wide as some radii of the click, and its blocks are as large as a part of that radius, so that a small
click and a large one look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import Box, overlap
from accelsurf.grid.clicks import Click
from accelsurf.grid.window import Window as Part
from accelsurf.image.blocks import block_means, on_voxels

#: Most blocks of a window; larger blocks are taken above.
MOST = 42_000
#: Least depth that the object around a click is taken to have, in the smallest spacings.
MIN_RADIUS = 1.5
#: People click balls of half the object's depth: inscribed radius of the object, in radii of the click.
DEEPER = 2.0
#: Radius, in the smallest spacings, from which on a click is as large as clicks get.
LARGEST = 7.5
#: Parts of a box that the object in it is taken to fill: a ball fills half, half of the objects in drawn scenes fill
#: between .2 and .45.
IN_BOX = (0.25, 0.5)
#: Voxels of a click count as its core from this part of the largest depth on; largest number of voxels used.
CORE = 0.95
CORE_VOXELS = 64


class Scale(NamedTuple):
    """Scale of a window: blocks in a radius, and radii from the click to a face."""

    blocks: float
    reach: float


#: From near to far: the next one is taken where an answer touches a face.
SCALES = (Scale(3.6, 5.0), Scale(2.2, 9.0), Scale(1.3, 16.0), Scale(0.8, 30.0))


class Scene(NamedTuple):
    """Images that clicks are made in, their extent, and bounds of the object.

    Attributes
    ----------
    images : tuple of ndarray (nz, ny, nx), float32
        The channels.
    spacing : (hz, hy, hx)
        mm.
    open : ndarray (nz, ny, nx) of bool or None
        The object lies in it; None for everywhere.
    part : accelsurf.grid.window.Window or None
        The images are this part of larger ones.
    sizes : (float, float) or None
        Least and largest volume of the object by its first click, mm3, where that is known.
    """

    images: tuple[Singles, ...]
    spacing: Spacing
    open: Mask | None = None
    part: Part | None = None
    sizes: tuple[float, float] | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx) of the images at hand."""
        nz, ny, nx = self.images[0].shape
        return nz, ny, nx

    @property
    def whole_shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx) of the images that they are a part of."""
        return self.shape if self.part is None else self.part.geometry.shape

    @property
    def corner(self) -> tuple[int, int, int]:
        """First voxel of the images at hand in the whole ones."""
        return (0, 0, 0) if self.part is None else self.part.corner

    @property
    def is_flat(self) -> bool:
        """True if there is one slice alone."""
        return self.whole_shape[0] == 1

    @property
    def step(self) -> float:
        """Smallest spacing, mm; of a flat image, within the slice."""
        return min(self.spacing[1:]) if self.is_flat else min(self.spacing)


class Seed(NamedTuple):
    """A click as it is read.

    Attributes
    ----------
    click : Click
    core : ndarray (k, 3) float64
        The deepest voxels (z, y, x), that in the middle first; of a stroke the line along it.
    radius : float
        Of the click around its core, mm.
    is_limited : bool
        It is as large as clicks get, or a single voxel: its radius says little of the object's.
    """

    click: Click
    core: NDArray[np.float64]
    radius: float
    is_limited: bool


@dataclass(frozen=True, eq=False)
class Window:
    """A window of blocks.

    Attributes
    ----------
    scene : Scene
    box : tuple of slice
        Voxels of the images at hand.
    steps : ndarray (3,) int
        Voxels of a block along z, y, x.
    values : ndarray (nz, ny, nx) float32
        Means of the blocks; of several channels the combination in which the click differs most from its surroundings.
    weights : tuple of float
        Of the channels in that combination.
    mine, theirs : ndarray (nz, ny, nx) of bool
        Blocks of clicks on the side of the click that is answered, and on the other side.
    seed : Seed
        The click that is answered.
    radius : float
        Inscribed radius of the object by the click, mm: the unit of lengths.
    friends, others : tuple of Seed
        Earlier clicks on its side, and those on the other.
    faces : ndarray (nz, ny, nx) of bool
        Blocks at faces beyond which the image goes on.
    closed : ndarray (nz, ny, nx) of bool or None
        Blocks where the object cannot be.
    """

    scene: Scene
    box: Box
    steps: NDArray[np.int64]
    values: Singles
    weights: tuple[float, ...]
    mine: Mask
    theirs: Mask
    seed: Seed
    radius: float
    friends: tuple[Seed, ...]
    others: tuple[Seed, ...]
    faces: Mask
    closed: Mask | None

    @property
    def size(self) -> NDArray[np.float64]:
        """Size (3,) of a block, mm."""
        return np.asarray(self.scene.spacing) * self.steps

    @property
    def step(self) -> float:
        """Smallest side of a block, mm; of a flat image, within the slice."""
        return float(self.size[1:].min() if self.scene.is_flat else self.size.min())

    @property
    def block_mm3(self) -> float:
        """Volume of a block, mm3."""
        return float(np.prod(self.size))

    @property
    def volume_mm3(self) -> float:
        """Volume of the window, mm3."""
        return self.block_mm3 * self.values.size

    @property
    def count_of_ball(self) -> float:
        """Number of blocks in a ball of the radius, at least 1; of a flat image in a disc."""
        if self.scene.is_flat:
            return max(float(np.pi * self.radius**2 / np.prod(self.size[1:])), 1.0)
        return max(float(4.0 / 3.0 * np.pi * self.radius**3 / np.prod(self.size)), 1.0)

    @property
    def width(self) -> float:
        """Mean width of a block, mm; of a flat image, within the slice."""
        return float(
            np.sqrt(np.prod(self.size[1:])) if self.scene.is_flat else np.prod(self.size) ** (1 / 3)
        )

    def image_on(self, box: Box) -> Singles:
        """The combination of the channels on a box of the images."""
        parts = (
            np.float32(w) * image[box]
            for w, image in zip(self.weights, self.scene.images, strict=True)
        )
        return np.asarray(sum(parts)) if len(self.weights) > 1 else self.scene.images[0][box]

    def means(self, values: NDArray[np.generic]) -> Singles:
        """Means of blocks of an array on the images' grid."""
        return block_means(values[self.box].astype(np.float32), self.steps.tolist())

    def place_of(self, seed: Seed) -> NDArray[np.float64]:
        """Places (k, 3) of a click's core in blocks, counted from the middle of the first one."""
        low = np.array([side.start for side in self.box])
        return (seed.core - low - 0.5 * (self.steps - 1)) / self.steps

    def distance_to(self, seed: Seed) -> Singles:
        """Distance (mm) of each block from a click's core."""
        out = np.full(self.values.shape, np.inf)
        for place in self.place_of(seed):
            z, y, x = (
                ((np.arange(n) - p) * h) ** 2
                for n, p, h in zip(self.values.shape, place, self.size, strict=True)
            )
            np.minimum(out, z[:, None, None] + y[:, None] + x, out=out)
        return np.sqrt(out).astype(np.float32)

    def blocks_of(self, seed: Seed) -> Mask:
        """Blocks of which a click has half, and blocks of its core."""
        out, count = np.zeros(self.values.shape, np.bool_), int(np.prod(self.steps))
        low, shape = np.array([side.start for side in self.box]), np.array(self.values.shape)
        voxels = np.argwhere(seed.click.mask) + [side.start for side in seed.click.box]
        for places, least in ((voxels, 0.5 * count), (seed.core.astype(np.int64), 0.0)):
            blocks = (places - low) // self.steps
            blocks = blocks[((places >= low) & (blocks < shape)).all(axis=1)]
            found = np.bincount(
                np.ravel_multi_index(tuple(blocks.T), tuple(shape)), minlength=out.size
            )
            out |= (found > 0).reshape(out.shape) & (found >= least).reshape(out.shape)
        return out

    def on_voxels(self, field: Singles) -> Singles:
        """Values at the voxels of the box, linear between the middles of blocks."""
        return on_voxels(field, self.steps.tolist(), [side.stop - side.start for side in self.box])


def sizes_in_box(volume_mm3: float) -> tuple[float, float]:
    """Least and largest volume, mm3, of an object around which a box of a volume was drawn."""
    return IN_BOX[0] * volume_mm3, IN_BOX[1] * volume_mm3


def seed_of(click: Click, scene: Scene) -> Seed:
    """Read a click: where it is deepest, and how wide.

    Parameters
    ----------
    click : Click
    scene : Scene

    Notes
    -----
    The radius is that of a ball (of a flat image a disc) with as many voxels, at most the largest depth: a stroke has
    more voxels than a ball of its width.
    """
    mask, spacing = click.mask, np.asarray(scene.spacing)
    # Beyond a face of the image the click may go on: there is no end of it there.
    sides = zip(click.box, scene.corner, scene.whole_shape, strict=True)
    ends = [(s.start + first > 0, s.stop + first < n) for s, first, n in sides]
    if mask.all() and not np.any(ends):  # all of the image is clicked: it ends there
        ends = [(n > 1 or not scene.is_flat, n > 1 or not scene.is_flat) for n in mask.shape]
    padded = np.pad(mask, np.array(ends, np.int64))
    depth = ndimage.distance_transform_edt(padded, sampling=spacing)
    depth = depth[
        tuple(slice(int(a), int(a) + n) for (a, _), n in zip(ends, mask.shape, strict=True))
    ]
    largest, count = float(depth.max()), int(np.count_nonzero(mask))
    core = np.argwhere(depth >= CORE * largest).astype(np.float64)
    core = core[:: -(-len(core) // CORE_VOXELS)]
    apart = (((core - core.mean(axis=0)) * spacing) ** 2).sum(axis=1)
    core = core[np.argsort(apart, kind="stable")] + [side.start for side in click.box]
    ball = radius_of_count(count, scene)
    is_cut = not np.all(np.array(ends)[np.array(scene.whole_shape) > 1])
    radius = largest if is_cut and count > 1 else min(ball, largest)
    return Seed(click, core, radius, count == 1 or radius >= LARGEST * scene.step)


def radius_of_count(count: int, scene: Scene) -> float:
    """Radius (mm) of a ball, in a flat image of a disc, with a number of voxels."""
    area = count * float(np.prod(scene.spacing[1:]))
    return float(
        np.sqrt(area / np.pi)
        if scene.is_flat
        else (0.75 * area * scene.spacing[0] / np.pi) ** (1 / 3)
    )


def inscribed_radius(seed: Seed, scene: Scene) -> float:
    """Radius (mm) of the largest ball in the object around a click, as far as the click tells."""
    return max(DEEPER * seed.radius, MIN_RADIUS * scene.step)


def window_around(scene: Scene, seeds: Sequence[Seed], scale: Scale) -> Window:
    """The window around the last of some clicks.

    Parameters
    ----------
    scene : Scene
    seeds : sequence of Seed
        Of those before the last the ones that lie in the window count.
    scale : Scale

    Raises
    ------
    LeavesWindow
        When it comes near an open face of the scene's part.
    """
    last = seeds[-1]
    mm = np.asarray(scene.spacing)
    shape = np.array(scene.whole_shape)
    radius, corner = inscribed_radius(last, scene), np.array(scene.corner)
    block = max(radius / scale.blocks, scene.step)
    while True:
        steps = np.maximum(np.rint(block / mm).astype(np.int64), 1)
        extent, middle = scale.reach * radius / mm, last.core[0] + corner
        low = np.maximum(np.floor(middle - extent).astype(np.int64), 0) // steps * steps
        high = np.minimum(np.ceil(middle + extent).astype(np.int64) + 1, shape)
        if np.prod(-(-(high - low) // steps)) <= MOST:
            break
        block *= 1.12
    first, end = (low - corner).tolist(), (high - corner).tolist()
    box: Box = (slice(first[0], end[0]), slice(first[1], end[1]), slice(first[2], end[2]))
    if scene.part is not None:
        scene.part.check_box(box)
    counts = [int(n) for n in -(-(high - low) // steps)]
    faces = np.zeros(counts, np.bool_)
    for axis in range(3):
        ends = np.moveaxis(faces, axis, 0)
        ends[0] |= low[axis] > 0
        ends[-1] |= high[axis] < shape[axis]
    here = [seed for seed in seeds[:-1] if overlap(seed.click.box, box)]
    friends = tuple(seed for seed in here if seed.click.side == last.click.side)
    others = tuple(seed for seed in here if seed.click.side != last.click.side)
    closed = None
    if scene.open is not None:
        closed = block_means((~scene.open[box]).astype(np.float32), steps.tolist()) > 0.5
    channels = [block_means(image[box], steps.tolist()) for image in scene.images]
    empty = np.zeros(counts, np.bool_)
    window = Window(
        scene,
        box,
        steps,
        channels[0],
        (1.0,),
        empty,
        empty,
        last,
        radius,
        friends,
        others,
        faces,
        closed,
    )
    mine, theirs = window.blocks_of(last), empty.copy()
    for other in others:
        theirs |= window.blocks_of(other) & ~mine
    weights = (1.0,) if len(channels) == 1 else _weights(channels, mine)
    values = np.asarray(
        sum(np.float32(w) * channel for w, channel in zip(weights, channels, strict=True))
    )
    return replace(window, values=values, weights=weights, mine=mine, theirs=theirs)


def _weights(channels: Sequence[Singles], mine: Mask) -> tuple[float, ...]:
    """Weights of the channels by which a click differs most from its surroundings, in spreads (Fisher, 1936)."""
    values = np.stack([channel.ravel() for channel in channels]).astype(np.float64)
    sample, rest = values[:, mine.ravel()], values[:, ~mine.ravel()]
    least = 1e-6 * max(float(np.ptp(values)), 1e-20) ** 2 * np.eye(len(values))
    spread = np.cov(rest) + least if rest.shape[1] > 1 else least
    way = np.linalg.solve(spread, sample.mean(axis=1) - (rest.mean(axis=1) if rest.size else 0.0))
    return tuple((way / max(float(np.abs(way).max()), 1e-20)).tolist())
