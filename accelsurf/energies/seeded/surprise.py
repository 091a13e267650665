"""What a click that contradicts the result says of its neighbourhood: F there is wrong by about as much.

A click inside where F > 0, or outside where F < 0, is a surprise of so much as F lies on the wrong side. What made F
wrong there (a value that both sides have, a size that is too small) made it wrong around it as well, so F is moved
towards the click's side by a part of the surprise, less with the distance, within some of the click's own half widths.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from accelsurf.energies.seeded.appearance import Spacing
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.energies.seeded.contest import Balance
from accelsurf.energies.seeded.implied import half_width
from accelsurf.energies.seeded.shown import Shift, Shown
from accelsurf.grid.boxes import common, enclosing, on_box, widened
from accelsurf.grid.clicks import Click

#: F is moved by this part of the surprise, by so much at most.
PART, LARGEST = 0.5, 0.2
#: Standard deviation of the Gaussian of the distance from the click's voxels, of the click's half width; and the
#: distance, of it, beyond which F is not moved.
REACH, ENDS = 3.5, 3.0
#: Larger boxes are coarsened to so many voxels.
MOST = 60_000


def surprise(click: Click, before: Shown) -> float:
    """By how much F was on the wrong side where a click lies: its mean there, cut at -1 and 1; 0 on the right side.

    Examples
    --------
    >>> box = (slice(0, 1), slice(0, 1), slice(0, 2))
    >>> before = Shown(box, np.array([[[-0.5, -0.25]]], np.float32), np.ones((1, 1, 2), bool))
    >>> [surprise(Click(side, box, np.ones((1, 1, 2), bool)), before) for side in ("inside", "outside")]
    [0.0, 0.375]
    """
    force = np.clip(on_box(before.force, before.box, click.box, 1.0)[click.mask], -1.0, 1.0)
    mean = float(np.mean(force, dtype=np.float64))
    return max(mean if click.side == "inside" else -mean, 0.0)


def shift_around(click: Click, before: Shown, spacing: Spacing, shape: tuple[int, int, int]) -> Shift | None:
    """What F is moved by around a new click; None where the click lies on its side already.

    Parameters
    ----------
    click : Click
    before : Shown
        What was shown before it.
    spacing : (hz, hy, hx)
        mm.
    shape : (nz, ny, nx)
        Of the whole grid.

    Returns
    -------
    Shift or None
        -+ min(`PART` s, `LARGEST`) exp(-d^2/(2 w^2)), less for an inside click; s the `surprise`, d the distance from
        the click's voxels and w `REACH` half widths of it.
    """
    amount = min(PART * surprise(click, before), LARGEST)
    if amount == 0.0:
        return None
    width = REACH * half_width(click.mask, spacing, shape)
    margin = [int(np.ceil(ENDS * width / h)) if n > 1 else 0 for h, n in zip(spacing, shape, strict=True)]
    box = common(widened(click.box, shape, margin), enclosing(before.box, click.box))
    steps = coarsening(box, spacing, MOST)
    empty = block_means(click.mask_on(box).astype(np.float32), steps) == 0.0
    mm = np.asarray(ndimage.distance_transform_edt(empty, sampling=np.multiply(spacing, steps)), np.float32)
    sign = -1.0 if click.side == "inside" else 1.0
    values = np.float32(sign * amount) * np.exp(-0.5 * (mm / np.float32(max(width, 1e-20))) ** 2)
    return Shift(box, Balance(box, values, steps).on_box(box))
