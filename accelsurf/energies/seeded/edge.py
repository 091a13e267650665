"""Edge of the object, within a voxel: halfway between the values on both sides of the model's boundary.

In a window around each voxel near the boundary the mean values inside and outside are compared, without the voxels
next to the boundary, which blur mixes. An edge counts by how far apart the means are, in spreads; elsewhere, and more
than two voxels from the boundary, F decides alone. Where a size was stated, F is shifted by a constant that keeps it.

With a weight alpha of the area the surface comes to lie where F = -alpha H, inside of F = 0 wherever it is convex. So
F is lowered by alpha times the mean of H over the boundary: the area smooths the object and does not shrink it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.seeded.answers import CLICKED, object_of, offset_to
from accelsurf.energies.seeded.appearance import Image, Mask, Spacing
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.energies.seeded.implied import any_around, voxels_within
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.boxes import Box, bounding_box, corner_of, on_box, shared, widened
from accelsurf.grid.clicks import Clicks
from accelsurf.image.noise import SECOND_DIFFERENCE

#: The window reaches so many of the smallest spacings to each side.
WINDOW = 4.0
#: Means that differ by so many spreads count half, by much more fully.
CLEAR_CONTRAST = 4.0
#: A spread is at least this part of the range of the values.
MIN_RANGE = 1e-3
#: What voxels next to the boundary count in the means: where a part is so thin that it has no others.
MIXED = 0.02
#: Rounds; each looks at the boundary of the round before.
ROUNDS = 2
#: 1 - w counts as this at least.
MIN_FIELD_PART = 1e-6
#: What F is lowered by for a stated size, or these parts of it: whatever comes nearest to the size.
PARTS_OF_OFFSET = (1.0, 0.5, 0.25)
#: Noise and contrast are read off where a window of so many voxels sees both sides.
REACH = 9
#: Noise of this part of the contrast asks for an image that is smoothed in full.
NOISE = 0.2
#: Means of less than this part of a window do not count.
MIN_PART = 1e-4
#: Weight of the area, of the smallest spacing, without noise; and what noise of the contrast's size adds. More noise
#: adds no more.
AREA, NOISY_AREA = 0.1, 0.2
#: Parallel surfaces are so many of the smallest spacings away.
APART = 2.0
#: Larger boxes are coarsened to so many voxels.
MOST = 40_000
#: F is lowered by so much at most: on a tiny object the area would otherwise outweigh what the clicks say.
MAX_OFFSET = 0.2


def edge_balance(
    images: Sequence[Image], spacing: Spacing, inside: Mask, open: Mask | None, pool: Executor | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Find the side that each voxel near a boundary is on by its value, and how much that counts.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    spacing : (hz, hy, hx)
        mm.
    inside : ndarray (nz, ny, nx) of bool
    open : ndarray (nz, ny, nx) of bool, optional
        Elsewhere nothing is looked at and nothing counts.
    pool : Executor, optional
        Sums over windows are made in its threads.

    Returns
    -------
    balance, weight : ndarray (nz, ny, nx), float32
        f = (m - I) sign(u_in - u_out)/(|u_in - u_out|/2), from -1 inside to 1 outside, m = (u_in + u_out)/2; of several
        channels the mean, each weighted by its contrast. The weight is from 0 to 1. Beyond two voxels both are 0.

    Notes
    -----
    c^2 = sum over channels of (u_in - u_out)^2/(spread^2), spread^2 the variance within both sides. The weight is
    c^4/(c^4 + `CLEAR_CONTRAST`^4), half of that in the second voxel from the boundary, 0 beyond.
    """
    seen = np.ones(inside.shape, np.bool_) if open is None else open
    near, next_to_it = _seen_both(inside, 5) & seen, _seen_both(inside, 3) & seen
    counts = np.where(next_to_it, np.float32(MIXED), np.float32(1.0)) * seen
    sizes = [2 * half + 1 for half in voxels_within(WINDOW, spacing, inside.shape)]

    def window(values: NDArray) -> NDArray[np.float32]:
        return np.asarray(ndimage.uniform_filter(values, sizes, np.float32, mode="constant"))[near]

    def windows(*arrays: NDArray) -> list[NDArray[np.float32]]:
        return list((map if pool is None else pool.map)(window, arrays))

    within, both = windows(counts * inside, counts)
    beyond = both - within  # at voxels near the boundary alone, as all that follows
    found = (within > MIN_PART) & (beyond > MIN_PART)
    within, beyond = np.maximum(within, MIN_PART), np.maximum(beyond, MIN_PART)
    balance, total = np.zeros(within.shape, np.float32), np.zeros(within.shape, np.float32)
    for image in images:
        values = (image - np.float32(image[inside & seen].mean(dtype=np.float64))) * seen
        counted = counts * values
        sum_in, sum_both, squares = windows(counted * inside, counted, counted * values)
        sum_out = sum_both - sum_in
        mean_in, mean_out = sum_in / within, sum_out / beyond
        least = max(MIN_RANGE * float(np.ptp(values)), 1e-20)
        variance = np.maximum((squares - sum_in * mean_in - sum_out * mean_out) / (within + beyond), 0.0)
        variance += np.float32(least**2)
        half = 0.5 * (mean_in - mean_out)
        contrast = 4.0 * half * half / variance
        middle = 0.5 * (mean_in + mean_out)
        side = np.clip((middle - values[near]) * half / np.maximum(half * half, least**2), -1.0, 1.0)
        balance += contrast * side
        total += contrast
    weight = total**2 / (total**2 + np.float32(CLEAR_CONTRAST**4)) * found * (0.5 + 0.5 * next_to_it[near])
    return _on_grid(balance / np.maximum(total, 1e-12), near), _on_grid(weight, near)


def _on_grid(values: NDArray[np.floating], where: Mask) -> NDArray[np.float32]:
    """Values of some voxels on the grid, 0 elsewhere."""
    out = np.zeros(where.shape, np.float32)
    out[where] = values
    return out


def _seen_both(inside: Mask, size: int) -> Mask:
    """Voxels in whose window of so many voxels, cut off at the border, both sides lie."""
    reach = [size // 2] * inside.ndim
    return any_around(inside, reach) & any_around(~inside, reach)


def at_edges(
    shown: Shown,
    images: Sequence[Image],
    smooth: Sequence[Image],
    spacing: Spacing,
    clicks: Clicks,
    open: Mask | None,
    pool: Executor | None = None,
    *,
    stated_mm3: float | None = None,
) -> Shown:
    """Put the boundary of what is shown at the edges of the image: F near it is w f + (1 - w) F.

    Parameters
    ----------
    shown : Shown
        See `accelsurf.energies.seeded.shown.mixed_answer`; not modified.
    images, smooth : sequence of ndarray (nz, ny, nx), float32
        The channels on the whole grid as they are, and smoothed.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
    open : ndarray (nz, ny, nx) of bool, optional
        The object lies in it.
    pool : Executor, optional
        Some of it is made in its threads.
    stated_mm3 : float, optional
        A volume that was stated: edges may bring the object's from what is shown to it, not farther.
    """
    box, force, inside = shown
    stated = None if stated_mm3 is None else round(stated_mm3 / math.prod(spacing))
    for _ in range(ROUNDS):
        here = _around(inside, box, spacing, clicks.shape)
        if here is None:
            break
        mine, theirs = shared(corner_of(box), force.shape, corner_of(here), [s.stop - s.start for s in here])
        seen = on_box(inside, box, here, False)
        passes = None if open is None else open[here]
        near = _near(seen, passes)
        pairs = zip(images, smooth, strict=True)
        parts = [_as_smooth_as_needed(first[here], second[here], seen, near) for first, second in pairs]
        balance, weight = edge_balance(parts, spacing, seen, passes, pool)
        for click in clicks.clicks:
            weight[click.mask_on(here)] = 0.0
        force, inside = _with_edges(shown, mine, balance[theirs], weight[theirs], clicks, stated)
    return Shown(box, force, inside)


def _with_edges(
    shown: Shown, part: Box, balance: Image, weight: Image, clicks: Clicks, stated: int | None
) -> tuple[Image, Mask]:
    """F = w f + (1 - w) (F - c) in a part of what is shown, F - c elsewhere, and the object; c = 0 without a size.

    With one, F < 0 where F + w/(1 - w) f < c: a rank of these is c, so that the object has as many voxels as without
    edges, or as many as were stated where edges bring it towards that. Voxels at a clear edge do not move for any c;
    if others would have to make up for all of them the object is cut off from its rim, and c = 0 comes nearer.
    """

    def with_offset(c: np.float32) -> tuple[Image, Mask]:
        force = shown.force.copy()
        force[np.abs(force) < CLICKED["outside"]] -= c
        force[part] += weight * (balance - force[part])
        return force, object_of(force, shown.box, clicks.clicks)

    best = with_offset(np.float32(0.0))
    if stated is None:
        return best
    now, then = (int(np.count_nonzero(mask)) for mask in (shown.inside, best[1]))
    aim = min(max(then, min(now, stated)), max(now, stated))
    ranked = shown.force.copy()
    ranked[part] += weight / np.maximum(1.0 - weight, np.float32(MIN_FIELD_PART)) * balance
    c = offset_to(ranked, max(int(np.count_nonzero(ranked < 0)) + aim - then, 0))
    for tried in PARTS_OF_OFFSET if c else ():
        found = with_offset(np.float32(tried) * c)
        if abs(np.count_nonzero(found[1]) - aim) < abs(np.count_nonzero(best[1]) - aim):
            best = found
    return best


def _around(inside: Mask, box: Box, spacing: Spacing, shape: Sequence[int]) -> Box | None:
    """The part of the grid that the windows around an object's boundary see; None without an object."""
    tight = bounding_box(inside)
    if tight is None:
        return None
    on_grid = [slice(s.start + b.start, s.stop + b.start) for s, b in zip(tight, box, strict=True)]
    margins = [half + 2 for half in voxels_within(WINDOW, spacing, shape)]
    return widened((on_grid[0], on_grid[1], on_grid[2]), shape, margins)


def _near(inside: Mask, open: Mask | None) -> Mask:
    """Mask of the voxels where noise and contrast are read off."""
    near = _seen_both(inside, REACH)
    return near if open is None else near & open


def _as_smooth_as_needed(image: Image, smooth: Image, inside: Mask, near: Mask) -> Image:
    """A channel near a boundary, as it is without noise, smoothed where it has some: smoothing moves curved edges."""
    share = min(_noise_share(image, inside, near) / NOISE, 1.0)
    return np.asarray(image + np.float32(share) * (smooth - image))


def area_weight(images: Sequence[Image], spacing: Spacing, inside: Mask, open: Mask | None = None) -> float:
    """Weight of the area (mm) that suits the noise: more, the more noise there is for the contrast of the boundary.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, not smoothed; that with the least noise for its contrast counts.
    spacing : (hz, hy, hx)
        mm.
    inside : ndarray (nz, ny, nx) of bool
        The object; its boundary's contrast is the difference of the medians on both sides.
    open : ndarray (nz, ny, nx) of bool, optional
        Elsewhere nothing is looked at.
    """
    box = bounding_box(inside, REACH)
    share = 1.0
    if box is not None:
        near = _near(inside[box], None if open is None else open[box])
        for image in images:
            share = min(share, _noise_share(image[box], inside[box], near))
    return (AREA + NOISY_AREA * share) * min(spacing)


def _noise_share(image: Image, inside: Mask, near: Mask) -> float:
    """Noise in parts of the contrast near a boundary, at most 1."""
    within, beyond = near & inside, near & ~inside
    if not (within.any() and beyond.any()):
        return 1.0
    contrast = abs(float(np.median(image[within])) - float(np.median(image[beyond])))
    found = []
    for axis in (i for i in range(3) if image.shape[i] > 2):
        before, at, after = ((slice(None),) * axis + (slice(k, k - 2 or None),) for k in range(3))
        here, value = near[at], image[at][near[at]]
        second = np.abs((image[after][here] - value) - (value - image[before][here]))
        if second.size:
            found.append(float(np.median(second)) / SECOND_DIFFERENCE)
    return min(min(found, default=0.0) / max(contrast, 1e-20), 1.0)


def mean_curvature(inside: Mask, spacing: Spacing) -> float:
    """Mean of H, the sum of the principal curvatures, over the boundary of a mask, 1/mm; 0 without a boundary.

    Parameters
    ----------
    inside : ndarray (nz, ny, nx) of bool
    spacing : (hz, hy, hx)
        mm.

    Notes
    -----
    V(t), the volume within the parallel surface at the distance t, has V' = A and V'' = int H dA (Steiner):
    <H> = (V(t) - 2 V(0) + V(-t))/t^2 over (V(t) - V(-t))/(2 t). Of a ball of radius r this is 2/r/(1 + t^2/(3 r^2)).
    """
    box = bounding_box(inside, 0)
    if box is None or inside.all():
        return 0.0
    # Where the volume ends there is no boundary; elsewhere there is room for the outer surface.
    steps = coarsening(box, spacing, MOST)
    h = np.multiply(spacing, steps)
    axes = [axis for axis, n in enumerate(inside.shape) if n > 1]
    apart = APART * float(h[axes].min())
    margin = [int(apart / size) + 1 if axis in axes else 0 for axis, size in enumerate(h)]
    coarse = block_means(inside[box].astype(np.float32), steps) >= 0.5
    beyond = [_room(side.start, step, m) for side, step, m in zip(box, steps, margin, strict=True)]
    after = [_room(n - side.stop, step, m) for side, n, step, m in zip(box, inside.shape, steps, margin, strict=True)]
    seen = np.pad(coarse, list(zip(beyond, after, strict=True)))
    if seen.all() or not seen.any():
        return 0.0
    half = 0.5 * float(h[axes].min())
    outer = ndimage.distance_transform_edt(~seen, sampling=h) - half
    inner = ndimage.distance_transform_edt(seen, sampling=h) - half
    larger, same = np.count_nonzero(outer < apart), np.count_nonzero(seen)
    smaller = np.count_nonzero(inner >= apart)
    return float((larger - 2 * same + smaller) / apart**2 / max((larger - smaller) / (2.0 * apart), 1e-20))


def _room(voxels: int, step: int, margin: int) -> int:
    """Number of blocks that lie beyond, at most as many as are needed."""
    return min(-(-voxels // step), margin)


def offset(area_weight_mm: float, curvature: float) -> float:
    """Find what F is lowered by for a weight of the area (mm) and a mean curvature (1/mm); 0 of a hollow object.

    Examples
    --------
    >>> round(offset(0.3, 0.2), 3), offset(0.3, -0.2), offset(0.3, 4.0)
    (0.06, 0.0, 0.2)
    """
    return min(max(area_weight_mm * curvature, 0.0), MAX_OFFSET)
