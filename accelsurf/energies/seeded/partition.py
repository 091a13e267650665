"""Cells that fill a space: each voxel belongs to the click that comes to it at the lowest cost, whatever lies behind.

No likelihood and no surroundings: neighbours look alike, and only what lies between them, a membrane, tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from accelsurf.energies.seeded.answers import CLICKED
from accelsurf.energies.seeded.appearance import Image, Mask, Spacing, learn
from accelsurf.energies.seeded.competition import arrival, balance, field_of
from accelsurf.energies.seeded.model import SMOOTHING, SeededModel
from accelsurf.energies.seeded.proposal import Proposal
from accelsurf.errors import InputError
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.connected import connected_to
from accelsurf.grid.smoothing import gaussian_mm

#: Default weight of the area, of the smallest spacing.
AREA = 0.3


def partition_model(
    images: Sequence[Image], spacing: Spacing, clicks: Clicks, *, mask: Mask | None = None
) -> SeededModel:
    """Make the model of one of several objects that touch.

    F = (T_in - T_out) / (T_in + T_out), with the arrival times from its own clicks and from those of all others; both
    go through the tissue of its first click.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels, as they are evolved.
    spacing : (hz, hy, hx)
        mm.
    clicks : Clicks
        As the object sees them, see `Clicks.of`.
    mask : ndarray (nz, ny, nx) of bool, optional
        The object lies in it.

    Returns
    -------
    SeededModel

    Raises
    ------
    InputError
        When it has no inside click, or nothing is outside of it.
    """
    inside, outside = clicks.mask("inside"), clicks.mask("outside")
    if not inside.any() or not outside.any():
        raise InputError(
            "partition: clicks inside and outside of the object are needed", "give clicks in its neighbours too"
        )
    first = next(click for click in clicks.clicks if click.side == "inside")
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images]
    field, tissue = field_of(smooth, spacing, mask), learn(smooth, spacing, first)
    shape = inside.shape
    others, _ = arrival(field, tissue, np.flatnonzero(outside).astype(np.int64), field.size)
    # Where others come earlier it is none of the object's: the march need not go there.
    own_times, _ = arrival(field, tissue, np.flatnonzero(inside).astype(np.int64), field.size, others)
    times_in, times_out = own_times.reshape(shape), others.reshape(shape)
    force = balance(times_in, times_out).astype(np.float32)
    force[inside], force[outside] = CLICKED["inside"], CLICKED["outside"]
    start = connected_to(force < 0, inside)
    volume = float(np.count_nonzero(start)) * float(np.prod(spacing))
    proposal = Proposal(volume, 1.0)
    return SeededModel(force, start, proposal, AREA * min(spacing), clicks, None, ())
