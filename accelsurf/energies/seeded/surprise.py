"""Surprise of a click: what it says of its neighbourhood, and of nothing else.

A click inside where F > 0, or outside where F < 0, is a surprise of so much as F lies on the wrong side. What made F
wrong there (a value that both sides have, a size that is too small) made it wrong around it as well, so F is moved
towards the click's side by a part of the surprise, less with the distance, within some of the click's own half widths.

From the third click on F changes only where it is near, whatever the contests say elsewhere: most is right by then, and
people click about half as wide as what is wrong.
"""

from __future__ import annotations

import numpy as np

from accelsurf.energies.seeded.appearance import Spacing
from accelsurf.energies.seeded.nearness import Nearness, nearness
from accelsurf.energies.seeded.shown import Neighbourhood, Shift, Shown
from accelsurf.grid.boxes import Box, corner_of, counted_from, enclosing, on_box
from accelsurf.grid.clicks import Click

#: F is moved by this part of the surprise, by so much at most.
PART, LARGEST = 0.5, 0.2
#: Standard deviation, in half widths of the click, see `accelsurf.energies.seeded.nearness.nearness`.
REACH = 3.5
#: The same for where F changes after 2, 3, ... clicks.
CHANGES_REACH = (np.inf, 24.0, 12.0, 8.0, 6.0)


def neighbourhood(
    click: Click, number: int, before: Shown, spacing: Spacing, shape: tuple[int, int, int], held: float = 0.0
) -> Neighbourhood:
    """Find what the last of some clicks says of its neighbourhood.

    Parameters
    ----------
    click : Click
    number : int
        Of the clicks, with this one; 2 at least.
    before : Shown
        What was shown before it.
    spacing : (hz, hy, hx)
        mm.
    shape : (nz, ny, nx)
        Of the whole grid.
    held : float, optional
        By how much less F changes beyond what the click says of its own neighbourhood, from 0 to 1.
    """
    half_widths = CHANGES_REACH[min(number - 2, len(CHANGES_REACH) - 1)]

    def near(box: Box) -> Nearness:
        far = nearness(click, box, half_widths, spacing, shape)
        if held == 0.0:
            return far
        close = nearness(click, far.box, REACH, spacing, shape)
        changes = np.full(far.values.shape, 1.0 - held, np.float32)
        part = counted_from(close.box, corner_of(far.box))
        changes[part] = np.maximum(changes[part], close.values)
        return Nearness(far.box, far.values * changes)

    shift = shift_around(click, before, spacing, shape)
    return Neighbourhood(shift, near if held or np.isfinite(half_widths) else None)


def surprise(click: Click, before: Shown) -> float:
    """Mean of F on the wrong side where a click lies, cut at -1 and 1; 0 on the right side.

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
    """Shift of F around a new click; None where the click lies on its side already.

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
    near = nearness(click, enclosing(before.box, click.box), REACH, spacing, shape)
    return Shift(near.box, np.float32(-amount if click.side == "inside" else amount) * near.values)
