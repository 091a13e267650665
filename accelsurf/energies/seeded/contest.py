"""Labelling by the clicks without a model: each voxel to the side that it is nearer to, on a box around the clicks.

Two labellings, each -1 at inside clicks and 1 at outside ones: geodesic, where a change of the values is what costs
(Criminisi et al. 2008), and by random walks (Grady 2006). The first finds edges that leak little, the second closes
gaps smoothly. The box is larger than the inside clicks by some multiples of their depth, twice a click's radius: people
click deep inside. Its faces count as outside, but for those close to an inside click.

Marches from inside and from outside give the arrival times, and which of them is earlier.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, at_least_of_changes, radius_of, robust
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.energies.seeded.implied import implied
from accelsurf.grid.boxes import Box, Corner, bounding_box, corner_of, whole_box
from accelsurf.grid.clicks import SIDES, Click, Clicks
from accelsurf.grid.window import Window
from accelsurf.kernels.arrival import Medium, Tissue, march, shortest_paths
from accelsurf.kernels.blocks import add_between, scaled_means
from accelsurf.kernels.grid import Grid
from accelsurf.kernels.walker import walk

#: Margins of the box around the inside clicks for both labellings, in depths. The depth is twice a click's radius, for
#: people click deep inside; or, where that is more, RADIUS_PART of the radius of the first click's size hypothesis.
PATHS_REACH, WALKS_REACH, RADIUS_PART = 2.0, 4.0, 1.0
#: Larger boxes are coarsened to so many voxels.
PATHS_MOST, WALKS_MOST = 1_000_000, 120_000
#: A change of values by one spread is as long as so many voxels.
CHANGE = 64.0
#: Smoothing for the paths, of the smallest spacing.
SMOOTHING = 0.5
#: A link of the walks weighs exp(-SHARPNESS (change of values)^2 / (all values' standard deviation)).
SHARPNESS = 30.0
#: The walks end at this residual, or after so many iterations.
TOLERANCE, MAX_ITERATIONS = 1e-2, 500
#: The walks' box ends where all beyond it is outside by so much.
CERTAIN = 0.9
#: Values are cut at so many spreads from the median of the inside clicks.
WINDOW = 10.0
#: A spread is at least this part of the range.
MIN_RANGE = 1e-3
Times = NDArray[np.float32]
Order = NDArray[np.int64]
_NO_CAP, _ALL_OPEN = np.zeros(0, np.float32), np.zeros(0, np.bool_)
_NEVER_LATE = (0, np.inf)


class Around(NamedTuple):
    """A box around the clicks, coarsened.

    ``values`` (channels, nz, ny, nx) float32, 0 at the median of the inside clicks, in their spread; ``seeds`` float32,
    -1 inside, 1 outside, 0 open; ``spacing`` (3,), of the smallest; ``steps`` of the coarsening.
    """

    box: Box
    steps: tuple[int, int, int]
    values: NDArray[np.float32]
    seeds: NDArray[np.float32]
    spacing: NDArray[np.float64]


class Balance(NamedTuple):
    """Values on a box of the grid, by those of blocks; beyond the box they are 1.

    Attributes
    ----------
    box : tuple of slice
    values : ndarray, float32
        Of the blocks; between their middles values are linear.
    steps : (int, int, int)
        Voxels of a block along each axis.
    first : (int, int, int)
        The box's first voxel, counted from the first of the first block.
    """

    box: Box
    values: Image
    steps: Corner = (1, 1, 1)
    first: Corner = (0, 0, 0)

    def add_to(self, out: Image, box: Box, share: float) -> None:
        """Add ``share`` times the values to an array on a box of the grid that holds the own one."""
        axes = []
        for axis, (side, extent, step, begin) in enumerate(zip(box, self.box, self.steps, self.first, strict=True)):
            at = (np.arange(begin, begin + extent.stop - extent.start) - 0.5 * (step - 1)) / step
            below = np.clip(np.floor(at).astype(np.int64), 0, self.values.shape[axis] - 1)
            axes.append((extent.start - side.start, below, np.clip(at - below, 0.0, 1.0).astype(np.float32)))
        add_between(out, np.float32(share), self.values, *axes)

    def on_box(self, box: Box) -> Image:
        """The values of the voxels of a box of the grid that holds the own one.

        Examples
        --------
        >>> row = (slice(0, 1), slice(0, 1), slice(4, 7))
        >>> part = Balance(row, np.array([[[1, 3]]], np.float32), (1, 1, 2), (0, 0, 1))
        >>> part.on_box((slice(0, 1), slice(0, 1), slice(3, 7))).tolist()
        [[[1.0, 1.5, 2.5, 3.0]]]
        """
        out = np.zeros([s.stop - s.start for s in box], np.float32)
        self.add_to(out, box, 1.0)
        return out


def contest(
    images: Sequence[Image],
    spacing: Spacing,
    clicks: Clicks,
    allowed: Mask | None,
    count: int,
    pool: Executor | None = None,
) -> tuple[Balance, Balance]:
    """Both contests, by paths and by walks, from -1 inside to 1 outside.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
        Of one object; at least one inside.
    allowed : ndarray (nz, ny, nx) of bool, optional
        Elsewhere all is outside.
    count : int
        Voxels of the size that the first click proposed.
    pool : Executor, optional
        Both are made in its threads, at the same time where it has two.
    """
    hints = implied(images, spacing, clicks, box_around(clicks, spacing, WALKS_REACH, count)[0])
    extents = (PATHS_REACH, PATHS_MOST, count), (WALKS_REACH, WALKS_MOST, count)
    each = map if pool is None else pool.map
    near, far = each(lambda extent: around(images, spacing, clicks, allowed, extent, hints), extents)
    widths = [SMOOTHING / h if n > 1 else 0.0 for h, n in zip(near.spacing, near.seeds.shape, strict=True)]
    smooth = np.stack([ndimage.gaussian_filter(values, widths) for values in near.values])

    def lengths(side: float) -> Image:
        return np.asarray(shortest_paths(near.seeds == side, smooth, near.spacing, CHANGE))

    jobs: tuple[Callable[[], Any], ...] = (lambda: lengths(-1.0), lambda: lengths(1.0), lambda: _by_walks(far))
    inside, outside, walks = each(lambda job: job(), jobs)
    return _by_paths(near, inside, outside), walks


def _by_paths(part: Around, inside: Image, outside: Image) -> Balance:
    """The contest by the lengths of the shortest paths from either side."""
    both = np.where(np.isfinite(outside), inside + outside, 1.0)
    balance = np.where(np.isfinite(outside), inside - outside, -1.0) / np.maximum(both, 1e-6)
    return Balance(part.box, balance.astype(np.float32), part.steps)


def _by_walks(part: Around) -> Balance:
    """The contest by random walks, on the box in which it is not certain that all is outside."""
    found = part.seeds.astype(np.float64)
    spread = max(float(np.sqrt(sum(values.var() for values in part.values))), 1e-6)
    walk(found, part.seeds != 0, part.values, part.spacing, SHARPNESS / spread, TOLERANCE, MAX_ITERATIONS)
    # Before it has converged it may lie beyond the values at the seeds.
    balance = np.clip(found, -1.0, 1.0).astype(np.float32)
    seen = bounding_box(balance < CERTAIN, 1) or whole_box(balance.shape)
    z, y, x = (
        slice(whole.start + part_seen.start * step, min(whole.start + part_seen.stop * step, whole.stop))
        for whole, part_seen, step in zip(part.box, seen, part.steps, strict=True)
    )
    return Balance((z, y, x), balance[seen].copy(), part.steps)


def around(
    images: Sequence[Image],
    spacing: Spacing,
    clicks: Clicks,
    allowed: Mask | None,
    extent: tuple[float, int, int],
    hints: Sequence[Click] = (),
) -> Around:
    """Cut the box out, coarsen it, scale the values, and mark what is inside and outside.

    Parameters
    ----------
    extent : (reach, most, count)
        Depths around the inside clicks, voxels above which the box is coarsened, voxels of the proposed size.
    hints : sequence of Click, optional
        What the clicks imply; it counts where no click lies, and not where two say the opposite.
    """
    box, margin = box_around(clicks, spacing, extent[0], extent[2])
    steps = coarsening(box, spacing, extent[1])
    inside = [click for click in clicks.clicks if click.side == "inside"]
    values = np.stack([_scaled(np.ascontiguousarray(image[box]), image, inside, steps) for image in images])
    blocks = values.shape[1:]
    held = _marked(clicks.clicks, box, steps, blocks)
    if allowed is not None:
        held["outside"] |= np.asarray(block_means((~allowed[box]).astype(np.float32), steps) > 0)
    seeds = held["outside"].astype(np.float32) - held["inside"]
    if hints:
        guessed, is_open = _marked(hints, box, steps, blocks), ~(held["outside"] | held["inside"])
        seeds[is_open] = guessed["outside"][is_open].astype(np.float32) - guessed["inside"][is_open]
    for axis, end in outer_faces(inside, spacing, box, margin):
        face: list[slice] = [slice(None)] * 3
        face[axis] = slice(0, 1) if end == 0 else slice(-1, None)
        layer = tuple(face)
        seeds[layer] = np.where(seeds[layer] == 0, 1.0, seeds[layer])
    relative = np.array(spacing) * steps
    return Around(box, steps, values, seeds, relative / relative.min())


def _marked(clicks: Sequence[Click], box: Box, steps: Corner, blocks: Sequence[int]) -> dict[str, Mask]:
    """The blocks of a box in which clicks have voxels, by side."""
    held: dict[str, Mask] = {side: np.zeros(blocks, np.bool_) for side in SIDES}
    shape = [s.stop - s.start for s in box]
    for click in clicks:
        voxels = np.argwhere(click.mask) + corner_of(click.box) - corner_of(box)
        seen = voxels[((voxels >= 0) & (voxels < shape)).all(axis=1)]
        held[click.side][tuple((seen // steps).T)] = True
    return held


def box_around(clicks: Clicks, spacing: Spacing, reach: float, count: int) -> tuple[Box, float]:
    """The box that reaches so many depths around the inside clicks, and one around the others; and the margin (mm)."""
    flat = clicks.shape[0] == 1
    radii = [radius_of(float(np.count_nonzero(click.mask)), spacing, flat) for click in clicks.clicks]
    widest = max(r for r, click in zip(radii, clicks.clicks, strict=True) if click.side == "inside")
    margin = reach * max(2.0 * widest, RADIUS_PART * radius_of(count, spacing, flat))
    low, high = list(clicks.shape), [0, 0, 0]
    for radius, click in zip(radii, clicks.clicks, strict=True):
        # From the click's voxels, not from its centre: a stroke is long.
        width = margin - radius if click.side == "inside" else radius
        for axis in range(3):
            more = int(np.ceil(width / spacing[axis]))
            low[axis] = min(low[axis], max(click.box[axis].start - more, 0))
            high[axis] = max(high[axis], min(click.box[axis].stop + more, clicks.shape[axis]))
    return (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2])), margin


def outer_faces(inside: Sequence[Click], spacing: Spacing, box: Box, margin: float) -> list[tuple[int, int]]:
    """Faces (axis, end 0 or 1) that count as outside: half the margin from all inside clicks, or the farthest one."""
    far = {}
    for axis, end in itertools.product(range(3), range(2)):
        if box[axis].stop - box[axis].start == 1:
            continue
        middles = [(click.box[axis].start + click.box[axis].stop - 1) / 2 for click in inside]
        at = box[axis].start if end == 0 else box[axis].stop - 1
        far[axis, end] = min(abs(middle - at) for middle in middles) * spacing[axis]
    outer = [face for face, mm in far.items() if mm >= 0.5 * margin]
    return outer or [max(far, key=lambda face: far[face])] if far else []


def _scaled(part: Image, image: Image, inside: Sequence[Click], steps: Corner) -> Image:
    """A part of a channel in blocks, 0 at the median of the inside clicks and in units of their spread, cut."""
    middle, spread = robust(np.concatenate([image[click.box][click.mask] for click in inside]))
    spread = at_least_of_changes(part, max(spread, MIN_RANGE * float(np.ptp(part)), 1e-20))
    return np.asarray(scaled_means(part, np.float32(middle), np.float32(spread), np.float32(WINDOW), steps))


class Field(NamedTuple):
    """Field of a march: the channels in one array, where nothing passes, the grid, and of what it is a window.

    A voxel of the grid is a block of ``steps`` voxels of the window.
    """

    medium: Medium
    grid: Grid
    window: Window | None = None
    steps: tuple[int, int, int] = (1, 1, 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return self.grid.nz, self.grid.ny, self.grid.nx

    @property
    def size(self) -> int:
        """Number of voxels of the whole grid."""
        return self.grid.nz * self.grid.ny * self.grid.nx if self.window is None else self.window.voxels

    def images_on(self, box: Box) -> list[NDArray[np.float32]]:
        """The channels on a box."""
        return [image.reshape(self.shape)[box] for image in self.medium.values]

    def on_box(self, box: Box) -> Field:
        """The same on a box, where all is open."""
        values = np.stack([image.ravel() for image in self.images_on(box)])
        nz, ny, nx = (s.stop - s.start for s in box)
        return Field(Medium(values, _ALL_OPEN), self.grid._replace(nz=nz, ny=ny, nx=nx))


def field_of(
    images: Sequence[NDArray[np.float32]],
    spacing: Sequence[float],
    mask: Mask | None,
    window: Window | None = None,
    steps: tuple[int, int, int] = (1, 1, 1),
) -> Field:
    """The channels for marches on their grid; a single one is not copied."""
    nz, ny, nx = images[0].shape
    channels = [np.ravel(image) for image in images]
    values = channels[0][None] if len(channels) == 1 else np.stack(channels)
    passes = np.zeros(0, np.bool_) if mask is None else np.ascontiguousarray(mask).ravel()
    return Field(Medium(values, passes), Grid(nz, ny, nx, *(float(h) for h in spacing)), window, steps)


def arrival(
    field: Field,
    tissue: Tissue,
    seeds: NDArray[np.int64],
    max_count: int,
    cap: Times = _NO_CAP,
    late: tuple[int, float] = _NEVER_LATE,
) -> tuple[Times, Order]:
    """Times from seeds (each at 0), inf where the march does not come, and its voxels in the order of their times.

    See `reached`.
    """
    times, cells = reached(field, tissue, seeds, max_count, cap, late)
    return times, cells[np.argsort(times[cells], kind="stable")]


def reached(
    field: Field,
    tissue: Tissue,
    seeds: NDArray[np.int64],
    max_count: int,
    cap: Times = _NO_CAP,
    late: tuple[int, float] = _NEVER_LATE,
) -> tuple[Times, Order]:
    """Times from seeds (each at 0), inf where the march does not come, and its voxels in no order.

    It does not come where its time is not below ``cap`` (n,) float32, nor, with ``late`` = (count, factor), to times
    later than a bucket after ``factor`` times that of the voxel number ``count``.

    Raises
    ------
    LeavesWindow
        When it comes near an open face of the field's window.
    """
    times = np.full(field.medium.values.shape[1], np.inf, np.float32)
    times[seeds] = 0.0
    order = march(times, field.medium, tissue, field.grid, seeds, cap, late, max(max_count, len(seeds)))
    if field.window is not None:
        field.window.check_cells(order, field.shape, field.steps)
    return times, order


def from_beyond(field: Field, tissue: Tissue, beyond: Mask) -> NDArray[np.float32]:
    """Times from the voxels ``beyond`` to the others, on the field's grid; all inf where there are none.

    Edges alone slow this march: the values of the surroundings are not known.
    """
    times = np.where(beyond, np.float32(0.0), np.float32(np.inf))
    seeds = beyond & ndimage.binary_dilation(~beyond, ndimage.generate_binary_structure(3, 1))
    edges = tissue._replace(weights=tissue.weights * np.array((1, 1, 1, 0, 1, 1)))
    return times_from(field, edges, times, seeds)


def times_from(field: Field, tissue: Tissue, times: NDArray[np.float32], seeds: Mask) -> NDArray[np.float32]:
    """Times, on the field's grid, also where they are inf, from ``seeds``, where they are not; ``times`` is used up."""
    times = np.ravel(times)
    march(times, field.medium, tissue, field.grid, np.flatnonzero(seeds), _NO_CAP, _NEVER_LATE, times.size)
    return times.reshape(seeds.shape)


def balance(inside: Times, outside: Times) -> Times:
    """(T_in - T_out)/(T_in + T_out): -1 at the inside clicks, 1 outside; 1 where T_in is inf, 0 where both are 0.

    Examples
    --------
    >>> balance(np.array([0, 1, 3, 0, np.inf], np.float32), np.array([1, 3, 1, 0, 2], np.float32)).tolist()
    [-1.0, -0.5, 0.5, 0.0, 1.0]
    """
    with np.errstate(invalid="ignore"):
        out = (inside - outside) / (inside + outside)
    out[np.isinf(outside)] = -1.0
    out[np.isinf(inside)] = 1.0
    out[inside + outside == 0.0] = 0.0
    return out
