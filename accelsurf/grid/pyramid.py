"""A pyramid of grids: shapes and spacings, restriction by block means, prolongation of psi by cubic interpolation.

Level 0 is the image's own grid. A voxel of a coarser level is a block of its voxels; its centre is the block's. A
block that reaches beyond the last voxel is filled with the last one's value, as the image is continued beyond its
border everywhere else, so that odd sizes shift nothing. Positions are (z, y, x) in mm along the grid's axes, the first
voxel of level 0 at 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.slabs import slabs

#: An axis is halved together with the finest if its spacing is at most so many times larger: voxels become more cubic.
MAX_SPACING_RATIO = math.sqrt(2.0)
#: Smallest number of voxels along an axis that is halved: a coarser grid resolves no object.
MIN_VOXELS = 8
#: The same where the number of levels is chosen automatically, and how deep each part of the start must be, voxels.
AUTO_MIN_VOXELS, AUTO_MIN_DEPTH = 24, 2.0
#: Catmull-Rom weights of four neighbours at a quarter of the way from the second to the third.
QUARTER_WEIGHTS = (-0.0703125, 0.8671875, 0.2265625, -0.0234375)


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
        factors = [f * 2 if axis in halved else f for axis, f in enumerate(last.factors)]
        counts = [-(-n // f) for n, f in zip(shape, factors, strict=True)]
        if min(counts[axis] for axis in halved) < min_voxels:
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
        even, odd = _along(array, axis, slice(0, n, 2)), _along(array, axis, slice(1, n, 2))
        means = np.multiply(even, np.float32(0.5))
        # The last block of an odd number of voxels is the last voxel twice.
        full = _along(means, axis, slice(0, n // 2))
        full += np.float32(0.5) * odd
        if n % 2:
            last = _along(means, axis, slice(n // 2, None))
            last += last.copy()
        array = means
    return np.ascontiguousarray(array)


def prolong(psi: NDArray[np.float32], coarse: Level, fine: Level) -> NDArray[np.float32]:
    """Return psi of a surface on ``coarse`` on the next finer level, by cubic interpolation.

    Near the surface psi is a distance, which is smooth but for its ridges; where it is +-gamma it stays so. Beyond the
    border it is extrapolated linearly, so that a surface that runs into the border keeps its direction.

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
    # By slabs of planes: otherwise three copies of the whole array would be needed.
    padded = _padded(psi, 0)
    out = np.empty(fine.shape, np.float32)
    for planes in slabs(fine.shape, multiple=2):
        values = _between(padded[planes.start // 2 : (planes.stop + 1) // 2 + 4], 0, planes.stop - planes.start)
        out[planes] = _prolong(values, [axis for axis in halved if axis > 0], fine)
    return out


def _prolong(psi: NDArray[np.float32], axes: Sequence[int], fine: Level) -> NDArray[np.float32]:
    for axis in axes:
        psi = _between(_padded(psi, axis), axis, fine.shape[axis])
    return psi


def _padded(psi: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Extrapolate linearly by two voxels to both sides."""
    first, second = _along(psi, axis, slice(0, 1)), _along(psi, axis, slice(1, 2))
    last, before = _along(psi, axis, slice(-1, None)), _along(psi, axis, slice(-2, -1))
    low, high = first - second, last - before
    return np.concatenate((first + 2 * low, first + low, psi, last + high, last + 2 * high), axis=axis)


def _between(padded: NDArray[np.float32], axis: int, n: int) -> NDArray[np.float32]:
    """Return the ``n`` values at a quarter to either side of the voxels of a padded array."""
    shape = list(padded.shape)
    shape[axis] = n
    out = np.zeros(shape, np.float32)
    for parity in (0, 1):
        half = _along(out, axis, slice(parity, n, 2))
        count = half.shape[axis]
        for j, weight in enumerate(QUARTER_WEIGHTS):
            begin = 3 - j if parity == 0 else 1 + j
            half += np.float32(weight) * _along(padded, axis, slice(begin, begin + count))
    return out


def min_component_depth(psi: NDArray[np.float32]) -> float:
    """Return the depth, voxels, of the thinnest component of {psi < 0}: from its innermost voxel to the outside.

    0 where nothing is inside. What lies beyond the border counts as inside.

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


def _halved(fine: Level, coarse: Level) -> list[int]:
    return [axis for axis in range(3) if coarse.factors[axis] != fine.factors[axis]]


def _along(array: NDArray[np.float32], axis: int, where: slice) -> NDArray[np.float32]:
    return array[(slice(None),) * axis + (where,)]
