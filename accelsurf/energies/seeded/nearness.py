"""Nearness of voxels to a click, measured in its half widths: it speaks of its neighbourhood, by its size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.energies.seeded.appearance import Image, Spacing
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.energies.seeded.contest import Balance
from accelsurf.energies.seeded.implied import half_width
from accelsurf.grid.boxes import Box, common, widened
from accelsurf.grid.clicks import Click

#: The distance, in standard deviations, from which on nothing is near.
ENDS = 3.0
#: Larger boxes are coarsened to so many voxels.
MOST = 60_000


class Nearness(NamedTuple):
    """About 1 in a click and less with the distance on a ``box`` of the grid, ``values``; 0 beyond it."""

    box: Box
    values: Image


def nearness(
    click: Click, within: Box, half_widths: float, spacing: Spacing, shape: tuple[int, int, int]
) -> Nearness:
    """Nearness of voxels to a click.

    Parameters
    ----------
    click : Click
    within : tuple of slice
        A box that holds the click's; none beyond it is near.
    half_widths : float
        Standard deviation, in half widths of the click; inf: all is near.
    spacing : (hz, hy, hx)
        mm.
    shape : (nz, ny, nx)
        Of the whole grid.

    Returns
    -------
    Nearness
        exp(-d^2/(2 w^2)), d the distance from the click's voxels and w the standard deviation, mm; 0 from `ENDS` w on.
    """
    if np.isinf(half_widths):
        return Nearness(within, np.ones([s.stop - s.start for s in within], np.float32))
    width = half_widths * half_width(click.mask, spacing, shape)
    margin = [int(np.ceil(ENDS * width / h)) if n > 1 else 0 for h, n in zip(spacing, shape, strict=True)]
    box = common(widened(click.box, shape, margin), within)
    steps = coarsening(box, spacing, MOST)
    empty = block_means(click.mask_on(box).astype(np.float32), steps) == 0.0
    mm = np.asarray(ndimage.distance_transform_edt(empty, sampling=np.multiply(spacing, steps)), np.float32)
    values = np.exp(-0.5 * (mm / np.float32(max(width, 1e-20))) ** 2)
    return Nearness(box, Balance(box, values, steps).on_box(box))
