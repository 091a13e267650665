"""Coarser grids under an image's: their shapes and spacings, block means onto them, and surfaces back from them.

Level 0 is the image's own grid. A voxel of a coarser level is a block of its voxels; its centre is the block's. A
block that reaches beyond the last voxel is filled with the last one's value, as the image is held at its border
everywhere else, so that odd sizes shift nothing. Positions are (z, y, x) in mm along the grid's axes, the first voxel
of level 0 at 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

#: An axis is halved together with the finest when it is at most this much coarser: voxels tend to become cubes.
ALIKE = math.sqrt(2.0)
#: Fewest voxels along an axis that is halved: a coarser grid resolves no object.
FEWEST = 8
#: The same for a number of levels that nobody asked for, and how deep each part of the start is there, voxels.
AUTO_FEWEST, AUTO_DEPTH = 24, 2.0
#: Catmull-Rom weights of four neighbours at a quarter of the way from the second to the third.
QUARTER = (-0.0703125, 0.8671875, 0.2265625, -0.0234375)


class Level(NamedTuple):
    """A grid of the pyramid: its ``number``, 0 being the image's; ``factors``, the voxels of level 0 per block along
    each axis; ``shape``; and ``spacing`` (hz, hy, hx), mm.
    """

    number: int
    factors: tuple[int, int, int]
    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]

    def first_centre(self, finest: Level) -> NDArray[np.float64]:
        """Position of the first voxel's centre; ``finest`` is level 0."""
        return 0.5 * (np.array(self.factors) - 1.0) * np.array(finest.spacing)


#: Voxels of a slab that is worked on at once, for the sake of memory.
SLAB_VOXELS = 1 << 21


def levels(
    shape: tuple[int, int, int], spacing: tuple[float, float, float], most: int | None = None, fewest: int = FEWEST
) -> list[Level]:
    """Return the grids of a pyramid, finest first.

    Each level halves the axes whose spacing is finest, until one of them would have fewer than ``fewest`` voxels.

    Parameters
    ----------
    shape, spacing : tuple
        (nz, ny, nx) and (hz, hy, hx) in mm of the image.
    most : int, optional
        At most so many levels.
    fewest : int, optional
        Fewest voxels along an axis that is halved.

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
    while axes and (most is None or len(made) < most):
        last = made[-1]
        finest = min(last.spacing[axis] for axis in axes)
        halved = [axis for axis in axes if last.spacing[axis] <= ALIKE * finest]
        factors = [f * 2 if axis in halved else f for axis, f in enumerate(last.factors)]
        counts = [-(-n // f) for n, f in zip(shape, factors, strict=True)]
        if min(counts[axis] for axis in halved) < fewest:
            break
        widths = [h * f for h, f in zip(spacing, factors, strict=True)]
        # mypy does not see that these lists have three items.
        made.append(Level(len(made), tuple(factors), tuple(counts), tuple(widths)))  # type: ignore[arg-type]
    return made


def restrict(array: NDArray[np.float32], fine: Level, coarse: Level) -> NDArray[np.float32]:
    """Return the means over blocks of an array on ``fine``, on the next level ``coarse``.

    Examples
    --------
    >>> image = np.arange(5, dtype=np.float32).reshape(1, 1, 5)
    >>> restrict(image, Level(0, (1, 1, 1), (1, 1, 5), (1, 1, 1)), Level(1, (1, 1, 2), (1, 1, 3), (1, 1, 2)))
    array([[[0.5, 2.5, 4. ]]], dtype=float32)
    """
    for axis in _halved(fine, coarse):
        n = array.shape[axis]
        even, odd = _part(array, axis, slice(0, n, 2)), _part(array, axis, slice(1, n, 2))
        means = np.multiply(even, np.float32(0.5))
        # The last block of an odd number of voxels is the last voxel twice.
        full = _part(means, axis, slice(0, n // 2))
        full += np.float32(0.5) * odd
        if n % 2:
            last = _part(means, axis, slice(n // 2, None))
            last += last.copy()
        array = means
    return np.ascontiguousarray(array)


def prolong(psi: NDArray[np.float32], coarse: Level, fine: Level) -> NDArray[np.float32]:
    """Return psi of a surface on ``coarse`` on the next finer level, by cubic interpolation.

    Near the surface psi is a distance, which is smooth but for its ridges; where it is +-gamma it stays so. Beyond the
    border it goes on linearly, so that a surface that runs into the border keeps its direction.

    Examples
    --------
    >>> fine, coarse = levels((1, 1, 16), (1.0, 1.0, 1.0))
    >>> psi = np.linspace(-6.5, 7.5, 8, dtype=np.float32).reshape(1, 1, 8)
    >>> float(prolong(psi, coarse, fine)[0, 0, 0]), float(prolong(psi, coarse, fine)[0, 0, 15])
    (-7.0, 8.0)
    """
    halved = _halved(fine, coarse)
    if 0 not in halved:
        return _prolong(psi, halved, fine)
    # By slabs of planes: the whole would be held three times over.
    padded, n = _padded(psi, 0), fine.shape[0]
    out = np.empty(fine.shape, np.float32)
    step = 2 * max(1, SLAB_VOXELS // (2 * fine.shape[1] * fine.shape[2]))
    for begin in range(0, n, step):
        stop = min(begin + step, n)
        planes = _between(padded[begin // 2 : (stop + 1) // 2 + 4], 0, stop - begin)
        out[begin:stop] = _prolong(planes, [axis for axis in halved if axis > 0], fine)
    return out


def _prolong(psi: NDArray[np.float32], axes: Sequence[int], fine: Level) -> NDArray[np.float32]:
    for axis in axes:
        psi = _between(_padded(psi, axis), axis, fine.shape[axis])
    return psi


def _padded(psi: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Go on linearly by two voxels to both sides."""
    first, second = _part(psi, axis, slice(0, 1)), _part(psi, axis, slice(1, 2))
    last, before = _part(psi, axis, slice(-1, None)), _part(psi, axis, slice(-2, -1))
    low, high = first - second, last - before
    return np.concatenate((first + 2 * low, first + low, psi, last + high, last + 2 * high), axis=axis)


def _between(padded: NDArray[np.float32], axis: int, n: int) -> NDArray[np.float32]:
    """Return the ``n`` values at a quarter to either side of the voxels of a padded array."""
    shape = list(padded.shape)
    shape[axis] = n
    out = np.zeros(shape, np.float32)
    for parity in (0, 1):
        half = _part(out, axis, slice(parity, n, 2))
        count = half.shape[axis]
        for j, weight in enumerate(QUARTER):
            begin = 3 - j if parity == 0 else 1 + j
            half += np.float32(weight) * _part(padded, axis, slice(begin, begin + count))
    return out


def smallest_depth(psi: NDArray[np.float32]) -> float:
    """Return how deep, in voxels, the thinnest part of {psi < 0} is: from its innermost voxel to the next outside it.

    0 where nothing is inside. What lies beyond the border counts as inside.

    Examples
    --------
    >>> z, y, x = np.indices((21, 21, 21)) - 10
    >>> round(smallest_depth(np.minimum(np.sqrt(z**2 + y**2 + x**2) - 6, np.maximum(abs(z), abs(y - 9)) - 1.5)), 1)
    2.0
    """
    inside = psi < 0
    if not inside.any() or inside.all():
        return 0.0
    # Only where the object is, and a voxel around it: the distances take much memory.
    for axis in range(3):
        on = np.flatnonzero(inside.any(axis=tuple(other for other in range(3) if other != axis)))
        inside = inside[(slice(None),) * axis + (slice(max(on[0] - 1, 0), on[-1] + 2),)]
    parts, count = ndimage.label(inside)
    depth = ndimage.distance_transform_edt(inside)
    return float(np.min(ndimage.maximum(depth, parts, np.arange(1, count + 1))))


def resolved(grids: Sequence[Level], psi: NDArray[np.float32]) -> int:
    """Return how many of the levels, finest first, each part of a start is at least `AUTO_DEPTH` voxels deep on."""
    count = 1
    for fine, coarse in zip(grids, grids[1:], strict=False):
        psi = restrict(psi, fine, coarse)
        if smallest_depth(psi) < AUTO_DEPTH:
            break
        count += 1
    return count


def _halved(fine: Level, coarse: Level) -> list[int]:
    return [axis for axis in range(3) if coarse.factors[axis] != fine.factors[axis]]


def _part(array: NDArray[np.float32], axis: int, where: slice) -> NDArray[np.float32]:
    return array[(slice(None),) * axis + (where,)]
