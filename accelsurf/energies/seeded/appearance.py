"""Local appearance under a click, by medians and median-based spreads; likelihood of a value inside and around."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box, widened
from accelsurf.grid.clicks import Click
from accelsurf.grid.window import Window
from accelsurf.kernels.arrival import Tissue
from accelsurf.kernels.blocks import changes_up_to, tally_changes

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Spacing = tuple[float, float, float]

#: Of a normal distribution: its standard deviation, in median absolute deviations.
DEVIATION = 1.4826
#: A click of fewer voxels learns also from its neighbours, so many voxels around it.
MIN_VOXELS = 20
#: The spread is at least this many median differences between neighbours: a small ball deep inside an object knows
#: little of how much the object varies.
MIN_SPREAD = 3.0
#: No spread and no gradient counts as less than this part of the range of the values near the click.
MIN_RANGE_FRACTION = 1e-3
#: A gradient counts as 1 at so many times the median gradient around the click.
EDGE = 6.0
#: Tissue is even as far as this part of each shell around the click lies within so many spreads of its median; it is
#: looked at within so many radii of the click, and smallest spacings.
EVEN_PART, ALIKE, EVEN_REACH, MIN_EVEN_REACH = 0.85, 2.5, 12.0, 15.0
#: It is looked at within so many radii first, and then within twice as many, until it ends.
FIRST_LOOK = 2.0
#: The spread of voxels is at least this part of the median change between neighbours.
MIN_CHANGE = 0.5
#: Cost per mm, see `accelsurf.kernels.arrival.cost_at`.
WEIGHTS = (0.02, 0.1, 50.0, 0.15, 2.0, 16.0)
#: Bins of a histogram and the Gaussian that smooths it, in bins.
BINS, WIDTH = 128, 2.0


def box_around(click: Click, shape: Sequence[int], margin: int) -> tuple[Box, Mask]:
    """A box some voxels larger than a click's, and the click's mask in it."""
    margins = [margin if n > 1 else 0 for n in shape]
    box = widened(click.box, shape, margins)
    return box, click.mask_on(box)


def robust(values: NDArray[np.floating]) -> tuple[float, float]:
    """Median, and spread from the median absolute deviation: the standard deviation of a normal distribution.

    Examples
    --------
    >>> middle, spread = robust(np.array([1.0, 2.0, 3.0, 1000.0, 2.0]))
    >>> middle, round(spread, 2)
    (2.0, 1.48)
    """
    middle = float(np.median(values))
    return middle, DEVIATION * float(np.median(np.abs(values - middle)))


def at_least_of_changes(part: Image, spread: float) -> float:
    """The spread, or `MIN_CHANGE` times the median change between neighbours where that is more."""
    limit = spread / MIN_CHANGE
    change = median_change(part, limit)
    return max(spread, MIN_CHANGE * change) if change > limit else spread


def median_change(part: Image, least: float = 0.0) -> float:
    """Median of the differences of neighbours along all axes, as numpy has it, without a list of them; 0 of one voxel.

    Where it is at most ``least`` this is returned: a count tells that.

    Examples
    --------
    >>> median_change(np.array([[[1, 2, 7, 7]]], np.float32))
    1.0
    """
    part = np.ascontiguousarray(part)  # of rows that lie apart the kernels are slower than the copy
    pairs = sum((n - 1) * part.size // n for n in part.shape)
    limit = np.float32(least)
    limit = np.nextafter(limit, np.float32(-np.inf)) if limit > least else limit
    if pairs == 0 or changes_up_to(part, limit) > pairs // 2:
        return least
    upper = np.cumsum(tally_changes(part, -1))
    ranks = (pairs - 1) // 2, pairs // 2
    halves = [int(np.searchsorted(upper, rank, "right")) for rank in ranks]
    lower = {half: np.cumsum(tally_changes(part, half)) for half in set(halves)}
    middle = np.float32(0.0)
    for rank, half in zip(ranks, halves, strict=True):
        before = int(upper[half - 1]) if half else 0
        middle += _float_of(half << 16 | int(np.searchsorted(lower[half], rank - before, "right")))
    return max(least, float(middle / np.float32(2.0)))


def _float_of(bits: int) -> np.float32:
    """The float of some bits."""
    return np.float32(np.array([bits], np.uint32).view(np.float32)[0])


def radius_of(count: float, spacing: Spacing, flat: bool) -> float:
    """Radius (mm) of the ball, of a flat image the disk, that has so many voxels."""
    if flat:
        return float(np.sqrt(count * spacing[1] * spacing[2] / np.pi))
    return float((count * np.prod(spacing) * 3.0 / (4.0 * np.pi)) ** (1.0 / 3.0))


def count_of(radius: float, spacing: Spacing, flat: bool) -> float:
    """Number of voxels of a ball, in a flat image a disk, of some radius (mm): the inverse of `radius_of`."""
    if flat:
        return float(np.pi * radius**2 / (spacing[1] * spacing[2]))
    return float(4.0 / 3.0 * np.pi * radius**3 / np.prod(spacing))


def gradient(values: Image, spacing: Sequence[float]) -> NDArray[np.float64]:
    """Length of the gradient by central differences, per mm."""
    parts = (np.gradient(values, h, axis=i) for i, h in enumerate(spacing) if values.shape[i] > 1)
    return np.asarray(np.sqrt(sum((part.astype(np.float64) ** 2 for part in parts), np.zeros(values.shape))))


def learn(images: Sequence[Image], spacing: Spacing, click: Click) -> Tissue:
    """The tissue of a click, for a march from it.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    spacing : (hz, hy, hx)
        mm.
    click : Click

    Returns
    -------
    Tissue
    """
    box, mask = box_around(click, images[0].shape, 3)
    cross = ndimage.generate_binary_structure(3, 1)
    sample = mask if np.count_nonzero(mask) >= MIN_VOXELS else ndimage.binary_dilation(mask, cross)
    around = ndimage.binary_dilation(sample, cross, iterations=2)
    smallest = min(spacing)
    found = []
    for image in images:
        part = image[box]
        middle, spread = robust(part[sample])
        noise = float(np.median(gradient(part, spacing)[around]))
        least = max(MIN_RANGE_FRACTION * float(np.ptp(part)), 1e-6)
        found.append((middle, max(spread, MIN_SPREAD * noise * smallest, least), EDGE * max(noise, least / smallest)))
    median, deviation, edge = (np.array(column, np.float64) for column in zip(*found, strict=True))
    return Tissue(median, deviation, edge, np.array(WEIGHTS))


def even_radius(
    images: Sequence[Image], spacing: Spacing, click: Click, tissue: Tissue, window: Window | None = None
) -> float:
    """Radius (mm) of the ball, of a flat image the disk, around a click's middle where most voxels look like the click.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    spacing : (hz, hy, hx)
        mm.
    click : Click
    tissue : Tissue
        Of the click.
    window : Window, optional
        The images are this part of larger ones.

    Raises
    ------
    LeavesWindow
        When voxels near an open face of the window are looked at.
    """
    middle = np.argwhere(click.mask).mean(axis=0) + [s.start for s in click.box]
    flat = images[0].shape[0] == 1
    radius = radius_of(float(np.count_nonzero(click.mask)), spacing, flat)
    # A slice may be thinner than its pixels are wide.
    step = min(spacing[1:]) if flat else min(spacing)
    reach = max(EVEN_REACH * radius, MIN_EVEN_REACH * step)
    looked = min(max(FIRST_LOOK * radius, MIN_EVEN_REACH * step), reach)
    while True:
        counts, alike = _shells(images, spacing, middle, (looked, step), tissue, window)
        radii = np.arange(counts.size) * step
        ends = np.flatnonzero((counts > 0) & (alike < EVEN_PART * counts) & (radii > radius))
        # Of a shell that the ball looked at holds only in part the others' voxels are not known yet.
        if ends.size and radii[ends[0]] + step <= looked:
            return float(radii[ends[0]])
        if looked >= reach:
            return float(min(radii[ends[0]], reach) if ends.size else reach)
        looked = min(2.0 * looked, reach)


def _shells(
    images: Sequence[Image],
    spacing: Spacing,
    middle: NDArray[np.float64],
    ball: tuple[float, float],
    tissue: Tissue,
    window: Window | None,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Count the voxels of each shell around an index (z, y, x), and those of them that look like the tissue.

    ``ball`` is (radius, thickness of a shell), mm; errors as of `even_radius`.
    """
    radius, step = ball
    margin = [int(np.ceil(radius / h)) for h in spacing]
    at = [round(float(i)) for i in middle]
    low, high = [a - m for a, m in zip(at, margin, strict=True)], [a + m + 1 for a, m in zip(at, margin, strict=True)]
    if window is not None:
        window.check(low, high)
    box = tuple(slice(max(a, 0), min(b, n)) for a, b, n in zip(low, high, images[0].shape, strict=True))
    axes = [(np.arange(s.start, s.stop) - a) * h for s, a, h in zip(box, middle, spacing, strict=True)]
    squares = np.meshgrid(*(axis**2 for axis in axes), indexing="ij", sparse=True)
    distance = np.sqrt(sum(squares, np.zeros(1)))
    like = np.ones(distance.shape, np.bool_)
    for image, median, spread in zip(images, tissue.median, tissue.spread, strict=True):
        like &= np.abs(image[box] - median) <= ALIKE * spread
    shell = (distance / step).astype(np.int64).ravel()
    return np.bincount(shell).astype(np.int64), np.bincount(shell, like.ravel()).astype(np.float64)


def log_ratio(
    images: Sequence[NDArray[np.float32]], inside: NDArray[np.bool_], around: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """(p - q)/(p + q) of the densities p inside and q around; the channels count as independent.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
    inside, around : ndarray (nz, ny, nx) of bool
        Without voxels in one of them the ratio is 0.
    """
    total = np.zeros(images[0].shape, np.float32)
    if not (inside.any() and around.any()):
        return total
    for image in images:
        samples = image[inside], image[around]
        both = np.concatenate(samples)
        low, high = (float(v) for v in np.percentile(both, (0.5, 99.5)))
        if not high > low:
            continue
        scale = BINS / (high - low)
        density = [_density(part, low, scale) for part in samples]
        table = np.log(density[0] / density[1]).astype(np.float32)
        total += table[np.clip((image - low) * scale, 0, BINS - 1).astype(np.int32)]
    return np.asarray(np.tanh(0.5 * total))


def _density(values: NDArray[np.float32], low: float, scale: float) -> NDArray[np.float64]:
    counts = np.bincount(np.clip((values - low) * scale, 0, BINS - 1).astype(np.int64), minlength=BINS)
    smooth = ndimage.gaussian_filter1d(counts.astype(np.float64), WIDTH, mode="nearest")
    return np.asarray((smooth + 0.01 * smooth.mean()) / smooth.sum())
