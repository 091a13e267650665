"""Voxels that a click implies around it, as hints for peers: people click inside of what they mean.

Voxels around a click, half as far again as the click is wide, are on its side too, unless they look different or a
click of the other side is nearer. Without such hints the peers know of a click no more than its own voxels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.model.fronts import robust
from accelsurf.grid.boxes import Box, common, connected_to, overlap, widened
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.image.blocks import block_means, coarsening

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Spacing = tuple[float, float, float]
#: What is implied is so many times as wide as the click.
WIDER = 1.5
#: It is looked for among so many voxels; around a larger click among as many blocks.
MOST = 100_000
#: Voxels look like a click within so many spreads of its median; a spread is at least this part of the median change
#: between neighbours, and of the range of the values.
ALIKE, MIN_CHANGE, MIN_RANGE = 2.5, 0.5, 1e-3


def implied(images: Sequence[Image], spacing: Spacing, clicks: Clicks, within: Box) -> list[Click]:
    """Add what the clicks imply, one more for each that is wide enough: a single voxel implies nothing.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
        Of one object.
    within : tuple of slice
        What lies beyond this box is not looked at.
    """
    out = []
    for click in clicks.clicks:
        if overlap(click.box, within):
            more = (WIDER - 1.0) * half_width(click.mask, spacing, clicks.shape)
            opposite = [other for other in clicks.clicks if other.side != click.side]
            out += _implied_by(images, spacing, click, opposite, more, clicks.shape, within)
    return out


def half_width(mask: Mask, spacing: Spacing, shape: Sequence[int]) -> float:
    """Largest distance (mm) from a voxel of a mask to one that is not in it; an axis of one voxel has no such voxels.

    Parameters
    ----------
    mask : ndarray of bool
    spacing : (hz, hy, hx)
        mm.
    shape : (nz, ny, nx)
        Of the grid that it is a part of.

    Examples
    --------
    >>> half_width(np.ones((1, 3, 9), bool), (1.0, 1.0, 1.0), (1, 20, 20))
    2.0
    >>> half_width(np.ones((1, 3, 9), bool), (1.5, 1.0, 1.0), (5, 20, 20))
    1.5
    """
    around = np.pad(mask, [(1, 1) if n > 1 else (0, 0) for n in shape])
    if around.all():
        return 0.0
    steps = coarsening(around.shape, spacing, MOST)
    coarse = block_means(around.astype(np.float32), steps) == 1.0
    found = float(
        ndimage.distance_transform_edt(coarse, sampling=np.multiply(spacing, steps)).max()
    )
    # A thin stroke fills no block of a restricted box.
    return max(found, min(h for h, n in zip(spacing, shape, strict=True) if n > 1))


def _implied_by(
    images: Sequence[Image],
    spacing: Spacing,
    click: Click,
    opposite: Sequence[Click],
    more: float,
    shape: tuple[int, int, int],
    within: Box,
) -> list[Click]:
    """Find what one click implies within ``more`` mm of it, as a list of one or of none.

    The clicks ``opposite`` say the opposite; ``shape`` is the grid's, ``within`` the box to stay in.
    """
    margin = [int(more / h) if n > 1 else 0 for h, n in zip(spacing, shape, strict=True)]
    if not any(margin):
        return []
    box = common(widened(click.box, shape, margin), within)
    # An opposite click may be nearer though it lies beyond that box, no farther than a margin.
    larger = common(widened(box, shape, margin), within)
    near = [other for other in opposite if overlap(other.box, larger)]
    seen = larger if near else box
    steps = coarsening([s.stop - s.start for s in seen], spacing, MOST)
    alike = _looks_alike(images, click, seen, steps)

    def distance(clicked: Sequence[Click]) -> Image:
        mask = np.zeros([s.stop - s.start for s in seen], np.float32)
        for click in clicked:
            mask[click.mask_on(seen)] = 1.0
        far = block_means(mask, steps) == 0.0
        return np.asarray(
            ndimage.distance_transform_edt(far, sampling=np.multiply(spacing, steps)), np.float32
        )

    distances = distance([click])
    alike &= distances <= more
    if near:
        alike &= distances < distance(near)
    mask = connected_to(alike | (distances == 0.0), distances == 0.0)
    for axis, step in enumerate(steps):
        mask = np.repeat(mask, step, axis)
    z, y, x = (slice(0, s.stop - s.start) for s in seen)
    return [click._replace(box=seen, mask=mask[z, y, x])]


def _looks_alike(
    images: Sequence[Image], click: Click, box: Box, steps: tuple[int, int, int]
) -> Mask:
    """Mask of the blocks of a box that look like a click: within `ALIKE` spreads of each channel's median."""
    alike = np.array(True)
    for image in images:
        part = image[box]
        middle, spread = robust(image[click.box][click.mask])
        spread = _with_changes(part, max(spread, MIN_RANGE * float(np.ptp(part))))
        alike = alike & (np.abs(block_means(part, steps) - np.float32(middle)) <= ALIKE * spread)
    return np.asarray(alike)


def _with_changes(part: Image, spread: float) -> float:
    """A spread, or `MIN_CHANGE` times the median change between neighbours where that is more."""
    changes = [
        np.abs(np.diff(part, axis=axis)).ravel() for axis in range(3) if part.shape[axis] > 1
    ]
    return (
        max(spread, MIN_CHANGE * float(np.median(np.concatenate(changes)))) if changes else spread
    )
