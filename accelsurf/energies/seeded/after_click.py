"""Stage after one click more: what the click says of its neighbourhood, and what of it holds farther away.

As long as few clicks say what is outside, the labelling by the clicks fills more than the object: a click into a
missing corner of a cube in noise took a layer all around the cube as well. So where the mean of all that an inside
click adds far from it looks like the surroundings, F changes in the click's neighbourhood alone. Nothing follows from
the looks of what an outside click takes.

Disagreement at the click: F > 0 at an inside click, or F < 0 at an outside one. Its cause, a value that both sides
have or a size that is too small, made F wrong around it as well. So F is moved towards the click's side by a part of
the disagreement, less with the distance. From the third click on F changes only near the click: most is right by then.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelsurf.energies.seeded.answers import Answer
from accelsurf.energies.seeded.appearance import Image, Mask, Spacing
from accelsurf.energies.seeded.contest import Balance
from accelsurf.energies.seeded.implied import any_around, voxels_within
from accelsurf.energies.seeded.nearness import Nearness, nearness
from accelsurf.energies.seeded.shown import Neighbourhood, Shift, Shown, mixed_answer
from accelsurf.energies.seeded.stages import Stage
from accelsurf.energies.seeded.sureness import corrections_with
from accelsurf.grid.boxes import Box, bounding_box, corner_of, counted_from, enclosing, on_box, placed_at, widened
from accelsurf.grid.clicks import Click, Clicks

#: What is added is compared with what lies within so many of the smallest spacings of it.
SHELL = 4.0
#: 0 is the mean of the surroundings and 1 that of the object: what is added is held up to the first, passes from the
#: second on; below 0 alike, as what is far beyond the surroundings does not look like them either.
LIKE_OUTSIDE, UNLIKE_OUTSIDE = 0.25, 0.4
#: Means that differ by so many spreads of single voxels count half.
CLEAR_CONTRAST = 0.3
#: Fewer voxels than these are not looked at.
FEW = 5
#: F is moved by this part of the surprise, by so much at most.
PART, LARGEST = 0.5, 0.2
#: Standard deviation, in half widths of the click, see `accelsurf.energies.seeded.nearness.nearness`.
REACH = 3.5
#: The same for where F changes after 2, 3, ... clicks.
CHANGES_REACH = (np.inf, 24.0, 12.0, 8.0, 6.0)


def stage_after(
    before: Stage,
    clicks: Clicks,
    answer: Answer,
    parts: Sequence[Balance],
    sized: bool,
    images: Sequence[Image],
    spacing: Spacing,
    open: Mask | None,
) -> Stage:
    """The stage after another and one click more.

    Parameters
    ----------
    before : Stage
    clicks, answer, parts, sized
        See `accelsurf.energies.seeded.shown.mixed_answer`.
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    open : ndarray (nz, ny, nx) of bool or None
        The object lies in it; nothing is compared with what does not.
    """
    click, count, shape = clicks.clicks[-1], len(clicks), clicks.shape
    around = neighbourhood(click, count, before.shown, spacing, shape)
    shown = mixed_answer(answer, parts, clicks, sized, before.shown, around)
    held = unlike_object(images, spacing, click, before.shown, shown, open) if click.side == "inside" else 0.0
    if held > 0.0:
        around = neighbourhood(click, count, before.shown, spacing, shape, held)
        shown = mixed_answer(answer, parts, clicks, sized, before.shown, around)
    off = corrections_with(before.corrections, click, before.shown, shown, spacing, shape)
    return Stage(clicks, answer, shown, off)


def unlike_object(
    images: Sequence[Image], spacing: Spacing, click: Click, before: Shown, after: Shown, open: Mask | None = None
) -> float:
    """Certainty that what an inside click added far from it looks like the surroundings: from 0 to 1.

    Parameters
    ----------
    images, spacing, open
        As of `stage_after`.
    click : Click
    before, after : Shown
        What is shown before it and after it.

    Notes
    -----
    t = (u_D - u_out)/(u_in - u_out), u_D the mean of what is added, u_in of what was inside near it, u_out of what
    stays outside near it; of the channel where u_in and u_out differ most, by c spreads. It is 1 where t is at most
    `LIKE_OUTSIDE`, either way, and c is large.
    """
    box, shape = after.box, images[0].shape
    was, now = on_box(before.inside, before.box, box, False), after.inside
    near = nearness(click, box, REACH, spacing, shape)
    added = now & ~was if open is None else now & ~was & open[box]
    added[counted_from(near.box, corner_of(box))] &= near.values < np.exp(-0.5)
    tight = bounding_box(added, 0)
    if np.count_nonzero(added) < FEW or tight is None:
        return 0.0
    reach = voxels_within(SHELL, spacing, shape)
    tight = widened(tight, added.shape, reach)
    was, now, added, here = was[tight], now[tight], added[tight], placed_at(tight, corner_of(box))
    seen = any_around(added, reach) if open is None else any_around(added, reach) & open[here]
    # What lies next to the boundary is mixed of both.
    inside, outside = seen & was, seen & ~any_around(now | was, [1] * 3)
    if np.count_nonzero(inside) < FEW or np.count_nonzero(outside) < FEW:
        return 0.0
    contrast, likeness = max(
        (_likeness(image[here], added, inside, outside) for image in images), key=lambda found: found[0]
    )
    part = (UNLIKE_OUTSIDE - abs(likeness)) / (UNLIKE_OUTSIDE - LIKE_OUTSIDE)
    return float(np.clip(part, 0.0, 1.0)) * contrast**2 / (contrast**2 + CLEAR_CONTRAST**2)


def _likeness(image: Image, added: Mask, inside: Mask, outside: Mask) -> tuple[float, float]:
    """Spreads by which inside and outside differ, and what is added: 0 like outside, 1 like inside."""
    within, beyond = image[inside].astype(np.float64), image[outside].astype(np.float64)
    step = float(within.mean() - beyond.mean())
    if step == 0.0:
        return 0.0, 1.0
    spread = np.sqrt(0.5 * (within.var() + beyond.var()))
    return abs(step) / max(spread, 1e-6 * abs(step)), float(image[added].mean(dtype=np.float64) - beyond.mean()) / step


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
