"""Confidence of the model of the clicks in its object, as numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.appearance import Spacing, radius_of
from accelsurf.energies.seeded.proposal import Proposal
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.boxes import Box, bounding_box, box_at, connected_to, on_box, whole_box, widened
from accelsurf.grid.clicks import Click, Clicks

#: F is compared with this on both sides of 0.
LEVEL = 0.1
#: The larger object may reach so far beyond the object on each side, as a part of the extent of the object.
AROUND = 0.5


class Sureness(NamedTuple):
    """Sureness of a model of clicks.

    Attributes
    ----------
    overlap : float
        Dice of the objects {F < -0.1} and {F < 0.1}: 1 where F is steep at its boundary.
    corrections : int
        Number of clicks that were on the wrong side of what was shown before them.
    correction : float or None
        How far the last one of these was from its own side, in radii of the object; None where there was none.
    spread : float
        Of the size that the first click proposed: `Proposal.spread`.
    proposal : Proposal
        That size, and other likely ones.
    """

    overlap: float
    corrections: int
    correction: float | None
    spread: float
    proposal: Proposal


def sureness_of(shown: Shown, clicks: Clicks, proposal: Proposal, corrections: Sequence[float]) -> Sureness:
    """Measure how sure a model is.

    Parameters
    ----------
    shown : Shown
        After all clicks.
    clicks : Clicks
    proposal : Proposal
        Of the first click.
    corrections : sequence of float
        See `corrections_with`.
    """
    extent = bounding_box(shown.inside) or whole_box(shown.inside.shape)
    part = widened(extent, shown.inside.shape, [math.ceil(AROUND * (side.stop - side.start)) for side in extent])
    force, inside = shown.force[part], shown.inside[part]
    corner = [a.start + b.start for a, b in zip(shown.box, part, strict=True)]
    here = box_at((corner[0], corner[1], corner[2]), force.shape)
    clicked = np.zeros(force.shape, np.bool_)
    for click in clicks.clicks:
        if click.side == "inside":
            clicked |= click.mask_on(here)
    # F is -3 and 3 in clicks: they are on their sides of both.
    smaller = int(np.count_nonzero(inside & (force < -LEVEL)))
    both = smaller + int(np.count_nonzero(connected_to(force < LEVEL, clicked)))
    return Sureness(
        overlap=2.0 * smaller / both if both else 0.0,
        corrections=len(corrections),
        correction=corrections[-1] if corrections else None,
        spread=proposal.spread,
        proposal=proposal,
    )


def corrections_with(
    earlier: tuple[float, ...],
    click: Click,
    before: Shown,
    after: Shown,
    spacing: Spacing,
    shape: Sequence[int],
) -> tuple[float, ...]:
    """Distances by which clicks were off, with one more: from its middle to its side of what was shown before it.

    In radii of what is shown after it. A person clicks where most is wrong: far from its side is very wrong. A click
    that was on its side already corrects nothing, and is left out.

    Parameters
    ----------
    earlier : tuple of float
        Those of the clicks before.
    click : Click
    before, after : Shown
        What is shown before and after it.
    spacing : (hz, hy, hx)
        mm.
    shape : (nz, ny, nx)
        Of the grid.
    """
    places = np.argwhere(click.mask) + [s.start for s in click.box]
    steps = np.array(spacing)
    middle = places[int(np.argmin((((places - places.mean(axis=0)) * steps) ** 2).sum(axis=1)))]
    away = _distance(before, click.side == "inside", middle, steps, shape)
    count = int(np.count_nonzero(after.inside))
    radius = radius_of(float(max(count, 1)), spacing, shape[0] == 1)
    return (*earlier, away / radius) if away > 0 else earlier


def _distance(
    shown: Shown, inside: bool, place: NDArray[np.int64], spacing: NDArray[np.float64], shape: Sequence[int]
) -> float:
    """Distance, mm, from a voxel to the nearest one on a side; that of the grid's diagonal where there is none."""
    longest = float(np.linalg.norm(np.array(shape) * spacing))
    reach = 4.0 * float(spacing.max())
    at: Box = (slice(place[0], place[0] + 1), slice(place[1], place[1] + 1), slice(place[2], place[2] + 1))
    while True:
        box = widened(at, shape, [math.ceil(reach / h) for h in spacing])
        wanted = on_box(shown.inside, shown.box, box, False) == inside
        z, y, x = (((np.arange(s.start, s.stop) - p) * h) ** 2 for s, p, h in zip(box, place, spacing, strict=True))
        plane = y[:, None] + x
        found = [z[k] + float(plane[part].min()) for k, part in enumerate(wanted) if part.any()]
        nearest = math.sqrt(min(found, default=math.inf))
        # Beyond the box lies nothing nearer than its reach.
        if nearest <= reach or reach > longest:
            return min(nearest, longest)
        reach = nearest if math.isfinite(nearest) else 2.0 * reach
