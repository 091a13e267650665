"""A pyramid of grids: shapes and spacings, restriction by block means, prolongation of psi by cubic interpolation.

Level 0 is the image's own grid. All grids have the same centre, so that nothing depends on the direction of an axis. A
voxel of a coarser level is a block of two voxels along each axis that is halved. Along an axis of odd size the blocks
are centred on every other voxel and take half of its neighbours; the first and the last reach half a voxel beyond the
border, where the array is continued linearly. Positions are (z, y, x) in voxels of level 0; its first voxel is at 0.

The number of levels is that on which each part of the first surface is thick enough to be resolved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Corner, bounding_box, slabs

#: Largest spacing, over the finest, of an axis that is halved together with the finest one: voxels become more cubic.
MAX_SPACING_RATIO = math.sqrt(2.0)
#: Smallest number of voxels along an axis that is halved: a coarser grid resolves no object.
MIN_VOXELS = 8
#: Catmull-Rom weights of four neighbours at a quarter of the way from the second to the third.
QUARTER_WEIGHTS = (-0.0703125, 0.8671875, 0.2265625, -0.0234375)
#: The same half-way between the second and the third: of the outer two, of the inner two.
HALF_WEIGHTS = (-0.0625, 0.5625)
#: Where the number of levels is selected automatically: the smallest number of voxels along an axis that is halved, and
#: how deep each part of the start must be, voxels.
AUTO_MIN_VOXELS = 24
AUTO_MIN_DEPTH = 2.0


class Level(NamedTuple):
    """A grid of the pyramid, or a box of one.

    Attributes
    ----------
    number : int
        0 is the image's own grid.
    factors : (int, int, int)
        Voxels of level 0 per voxel, along each axis.
    shape : (nz, ny, nx)
    spacing : (hz, hy, hx)
        mm.
    first : (float, float, float)
        Centre of the first voxel, in voxels of level 0.
    """

    number: int
    factors: tuple[int, int, int]
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    first: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def on_box(self, corner: Corner, shape: Sequence[int]) -> Level:
        """A box of this grid, from voxel ``corner`` on."""
        nz, ny, nx = shape
        z, y, x = (
            f + c * width for f, c, width in zip(self.first, corner, self.factors, strict=True)
        )
        return self._replace(shape=(nz, ny, nx), first=(z, y, x))

    def places_in(self, coarse: Level) -> NDArray[np.float64]:
        """Rows (3,) of factors and of additions that take an index of this grid to one of a coarser grid."""
        widths = np.array(coarse.factors, float)
        return np.stack([self.factors / widths, (np.array(self.first) - coarse.first) / widths])


def levels(
    shape: tuple[int, int, int],
    spacing: tuple[float, float, float],
    max_levels: int | None = None,
    min_voxels: int = MIN_VOXELS,
) -> list[Level]:
    """Return the grids of a pyramid, finest first.

    Each level halves the axes whose spacing is finest, until one of them would have fewer than ``min_voxels`` voxels.

    Parameters
    ----------
    shape, spacing : tuple
        (nz, ny, nx) and (hz, hy, hx) in mm of the image.
    max_levels : int, optional
        Largest number of levels.
    min_voxels : int, optional
        Smallest number of voxels along an axis that is halved.

    Examples
    --------
    >>> for level in levels((40, 97, 96), (3.0, 1.0, 1.0)):
    ...     print(level.shape, level.spacing)
    (40, 97, 96) (3.0, 1.0, 1.0)
    (40, 49, 48) (3.0, 2.0, 2.0)
    (40, 25, 24) (3.0, 4.0, 4.0)
    (20, 13, 12) (6.0, 8.0, 8.0)
    """
    made = [Level(0, (1, 1, 1), shape, spacing)]
    axes = [axis for axis, n in enumerate(shape) if n > 1]
    while axes and (max_levels is None or len(made) < max_levels):
        last = made[-1]
        finest = min(last.spacing[axis] for axis in axes)
        halved = [axis for axis in axes if last.spacing[axis] <= MAX_SPACING_RATIO * finest]
        if min(-(-last.shape[axis] // 2) for axis in halved) < min_voxels:
            break
        made.append(_halved_level(last, halved, spacing))
    return made


def _halved_level(fine: Level, halved: Sequence[int], spacing: Sequence[float]) -> Level:
    """The next coarser level; ``spacing`` of level 0."""
    factors = list(fine.factors)
    counts = list(fine.shape)
    first = list(fine.first)
    for axis in halved:
        if counts[axis] % 2 == 0:
            first[axis] += 0.5 * factors[axis]
        factors[axis], counts[axis] = 2 * factors[axis], -(-counts[axis] // 2)
    widths = [h * f for h, f in zip(spacing, factors, strict=True)]
    # mypy does not see that these lists have three items.
    return Level(fine.number + 1, tuple(factors), tuple(counts), tuple(widths), tuple(first))  # type: ignore[arg-type]


def restrict(array: NDArray[np.float32], fine: Level, coarse: Level) -> NDArray[np.float32]:
    """Return the means over blocks of an array on ``fine``, on the next level ``coarse``.

    Constant and linear arrays keep their values at the centres of the blocks, at the border too.

    Parameters
    ----------
    array : ndarray (nz, ny, nx), float32
    fine, coarse : Level
        Grids of two levels, or boxes of them.

    Examples
    --------
    >>> fine, coarse = levels((1, 1, 5), (1.0, 1.0, 1.0), min_voxels=2)[:2]
    >>> restrict(np.array([[[0, 1, 2, 3, 8]]], np.float32), fine, coarse)
    array([[[0., 2., 8.]]], dtype=float32)
    """
    for axis in _halved(fine, coarse):
        array = _block_means(array, axis, _offset(fine, coarse, axis), coarse.shape[axis])
    return np.ascontiguousarray(array)


def planes_of_blocks(planes: slice, fine: Level, coarse: Level) -> slice:
    """Planes of ``fine``, along the first axis, that the means on some planes of the next level ``coarse`` are of.

    Examples
    --------
    >>> fine, coarse = levels((17, 17, 17), (1.0, 1.0, 1.0))
    >>> planes_of_blocks(slice(2, 4), fine, coarse)
    slice(3, 8, None)
    """
    if 0 not in _halved(fine, coarse):
        return planes
    offset = _offset(fine, coarse, 0)
    low, high = _touched(offset, planes.start)[0], _touched(offset, planes.stop - 1)[1]
    return slice(max(low, 0), min(high, fine.shape[0]))


def _block_means(
    array: NDArray[np.float32], axis: int, offset: float, count: int
) -> NDArray[np.float32]:
    """The means over ``count`` blocks along an axis; the first is centred at index ``offset`` of the array."""
    n = array.shape[axis]
    low, high = _touched(offset, 0)[0], _touched(offset, count - 1)[1]
    # Blocks beyond the ends are made apart: the array would have to be copied with the voxels added.
    begin, end = -(min(low, 0) // 2), count + min(n - high, 0) // 2
    pieces = [(0, begin), (begin, end), (end, count)] if begin < end else [(0, count)]
    parts = []
    for start, stop in pieces:
        if start < stop:
            low, high = _touched(offset, start)[0], _touched(offset, stop - 1)[1]
            part = _along(array, axis, slice(max(low, 0), min(high, n)))
            parts.append(
                _pairs(_continued(part, axis, max(-low, 0), max(high - n, 0)), axis, offset)
            )
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=axis)


def _touched(offset: float, block: int) -> tuple[int, int]:
    """The first voxel that a block touches, and the one after the last."""
    return math.ceil(offset - 1.0) + 2 * block, math.floor(offset + 1.0) + 2 * block + 1


def _pairs(array: NDArray[np.float32], axis: int, offset: float) -> NDArray[np.float32]:
    """The means over blocks that begin with the first voxel: of two, or of a voxel and half of its neighbours."""
    n = array.shape[axis]
    if offset % 1.0:
        means = _along(array, axis, slice(0, n, 2)) + _along(array, axis, slice(1, n, 2))
    else:
        # Neighbours are added first: the sum is the same, bit by bit, from either side.
        means = _along(array, axis, slice(0, n - 1, 2)) + _along(array, axis, slice(2, n, 2))
        means *= np.float32(0.5)
        means += _along(array, axis, slice(1, n, 2))
    means *= np.float32(0.5)
    return means


def _continued(
    array: NDArray[np.float32], axis: int, before: int, after: int
) -> NDArray[np.float32]:
    """The array with more voxels along an axis: its values and their slope at the ends go on there."""
    if not before and not after:
        return array
    first, last = _along(array, axis, slice(0, 1)), _along(array, axis, slice(-1, None))
    second, before_last = _along(array, axis, slice(1, 2)), _along(array, axis, slice(-2, -1))
    low = [first + np.float32(i) * (first - second) for i in range(before, 0, -1)]
    high = [last + np.float32(i) * (last - before_last) for i in range(1, after + 1)]
    return np.concatenate([*low, array, *high], axis=axis)


def prolong(psi: NDArray[np.float32], coarse: Level, fine: Level) -> NDArray[np.float32]:
    """Return psi of a surface on ``coarse`` on the next finer level, by cubic interpolation.

    Near the surface psi is a distance, which is smooth but for its ridges; where it is +-gamma it stays so. Beyond the
    border it is extrapolated linearly, so that a surface that runs into the border keeps its direction.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx), float32
    coarse, fine : Level
        Grids of two levels, or boxes of them: the first voxel of ``fine`` lies in the first of ``coarse``.

    Examples
    --------
    >>> fine, coarse = levels((1, 1, 16), (1.0, 1.0, 1.0))
    >>> psi = np.linspace(-6.5, 7.5, 8, dtype=np.float32).reshape(1, 1, 8)
    >>> float(prolong(psi, coarse, fine)[0, 0, 0]), float(prolong(psi, coarse, fine)[0, 0, 15])
    (-7.0, 8.0)
    """
    halved = {axis: _offset(fine, coarse, axis) for axis in _halved(fine, coarse)}
    if 0 not in halved:
        return _prolong(psi, halved, fine)
    # By slabs of planes: otherwise three copies of the whole array would be needed.
    padded, offset = _continued(psi, 0, 2, 2), halved.pop(0)
    out = np.empty(fine.shape, np.float32)
    for planes in slabs(fine.shape, multiple=2):
        part = padded[planes.start // 2 : (planes.stop + 1) // 2 + 4]
        out[planes] = _prolong(_between(part, 0, offset, planes.stop - planes.start), halved, fine)
    return out


def _prolong(
    psi: NDArray[np.float32], offsets: Mapping[int, float], fine: Level
) -> NDArray[np.float32]:
    for axis, offset in offsets.items():
        psi = _between(_continued(psi, axis, 2, 2), axis, offset, fine.shape[axis])
    return psi


def _between(padded: NDArray[np.float32], axis: int, offset: float, n: int) -> NDArray[np.float32]:
    """Return ``n`` values along an axis of an array padded by two; its first voxel lies at ``offset`` among them.

    ``offset`` 0: at the voxels and half-way between them; 0.5: at a quarter to either side of them.
    """
    shape = list(padded.shape)
    shape[axis] = n
    out = np.zeros(shape, np.float32)
    for parity in (0, 1):
        half = _along(out, axis, slice(parity, n, 2))
        count = half.shape[axis]
        if not offset and parity == 0:
            half[...] = _along(padded, axis, slice(2, 2 + count))
            continue
        nodes = [
            _along(padded, axis, slice(begin, begin + count)) for begin in range(parity, parity + 4)
        ]
        if not offset:
            half += np.float32(HALF_WEIGHTS[0]) * (nodes[0] + nodes[3])
            half += np.float32(HALF_WEIGHTS[1]) * (nodes[1] + nodes[2])
            continue
        # In the same order from either side.
        for weight, node in zip(QUARTER_WEIGHTS, nodes if parity else nodes[::-1], strict=True):
            half += np.float32(weight) * node
    return out


def _halved(fine: Level, coarse: Level) -> list[int]:
    return [axis for axis in range(3) if coarse.factors[axis] != fine.factors[axis]]


def _offset(fine: Level, coarse: Level, axis: int) -> float:
    """Index on ``fine`` of the centre of the first voxel of ``coarse``, along an axis: a multiple of a half."""
    return (coarse.first[axis] - fine.first[axis]) / fine.factors[axis]


def _along(array: NDArray[np.float32], axis: int, where: slice) -> NDArray[np.float32]:
    return array[(slice(None),) * axis + (where,)]


def min_component_depth(psi: NDArray[np.float32]) -> float:
    """Return the depth, voxels, of the thinnest component of {psi < 0}: from its innermost voxel to the outside.

    0 where nothing is inside. Voxels beyond the border count as inside.

    Examples
    --------
    >>> z, y, x = np.indices((21, 21, 21)) - 10
    >>> round(min_component_depth(np.minimum(np.sqrt(z**2 + y**2 + x**2) - 6, np.maximum(abs(z), abs(y - 9)) - 1.5)), 1)
    2.0
    """
    inside = psi < 0
    box = bounding_box(inside, 1)
    if box is None or inside.all():
        return 0.0
    # Only where the object is, and a voxel around it: the distances take much memory.
    inside = inside[box]
    from scipy import ndimage  # the viewer draws an image before SciPy is loaded

    parts, count = ndimage.label(inside)
    depth = ndimage.distance_transform_edt(inside)
    return float(np.min(ndimage.maximum(depth, parts, np.arange(1, count + 1))))


def count_resolved_levels(grids: Sequence[Level], psi: NDArray[np.float32]) -> int:
    """Return on how many levels, from the finest on, each part of a start is at least `AUTO_MIN_DEPTH` voxels deep."""
    count = 1
    for fine, coarse in zip(grids, grids[1:], strict=False):
        psi = restrict(psi, fine, coarse)
        if min_component_depth(psi) < AUTO_MIN_DEPTH:
            break
        count += 1
    return count
