"""Whether a click lies in what looks like the background of an image: air, black, the glass of a slide."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies.likelihood import NORMAL_MAD
from accelsurf.grid.boxes import widened
from accelsurf.grid.clicks import Click

#: The image is looked at on at most about so many voxels.
SAMPLES = 1 << 20
#: The background has at least this part of the image; values within so many spreads of the click's are like it.
_COMMON, _WITHIN = 0.05, 4.0
#: A click of one value alone is background where more than this part of it has the image's least or largest value.
_ONE_VALUE = 0.9
#: Values lie at an end of the image's range within this part of it.
_END = 0.15
#: A click of fewer voxels is looked at with so many voxels around it.
_FEW, _AROUND = 20, 2
#: The part around the click has at least this part of the image's corners.
_CORNERS = 0.75
Floats = NDArray[np.float32]


def background_share(image: Floats, click: Click) -> float:
    """Return the share of an image that is background like a click; 0 where the click does not look like it.

    The values under the click are the image's least or largest one with no spread, and many voxels have it. Or they
    lie at an end of the range, and what is like them and connected to the click reaches most corners of the image.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
        Whole, 0 and 1 at its percentiles.
    click : Click
    """
    every = max(1, int(np.ceil((image.size / SAMPLES) ** (1.0 / max(sum(n > 1 for n in image.shape), 1)))))
    steps = [every if n > 1 else 1 for n in image.shape]
    thin = image[tuple(slice(None, None, step) for step in steps)]
    values = image[click.box][click.mask]
    if values.size < _FEW:
        around = [_AROUND if n > 1 else 0 for n in image.shape]
        values = image[widened(click.box, image.shape, (around[0], around[1], around[2]))]
    middle = float(np.median(values))
    same = thin == np.float32(middle)
    is_extreme = middle in (float(thin.min()), float(thin.max()))
    if is_extreme and thin.min() < thin.max() and same.mean() >= _COMMON and (values == middle).mean() > _ONE_VALUE:
        return float(same.mean())
    if _END < middle < 1.0 - _END:
        return 0.0
    spread = max(NORMAL_MAD * float(np.median(np.abs(values - middle))), 0.01)
    parts, _ = ndimage.label(np.abs(thin - middle) <= _WITHIN * spread)
    voxels = (np.argwhere(click.mask) + [side.start for side in click.box]) // steps
    mine = np.unique(parts[tuple(voxels.T)])
    mine = mine[mine > 0]
    if not mine.size:
        return 0.0
    part = int(mine[np.argmax(np.bincount(parts.ravel())[mine])])
    share = float((parts == part).mean())
    at_corners = [parts[place] == part for place in _corners(parts.shape)]
    return share if share >= _COMMON and np.mean(at_corners) >= _CORNERS and share < 1.0 else 0.0


def _corners(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Voxels at the corners of an array, each once."""
    return list(itertools.product(*((0, n - 1) if n > 1 else (0,) for n in shape)))
