"""Tracking closes: after a beat the surface is where it began, and both directions agree, within .3 voxel."""

from __future__ import annotations

import pytest

from accelsurf.phantoms.motions import MovingPhantom, motion_from
from benchmarks.tracking_closing import WANTED, ThereAndBack, apart, rows_of, surfaces


def test_there_and_back_is_the_same_as_not_having_moved() -> None:
    """A disc in noise: every frame as it was on the way there."""
    values = {
        "motion": "translation",
        "shape": [48, 32, 1],
        "radius": 7.0,
        "speed": 2.0,
        "frames": 5,
        "noise": 0.2,
    }
    phantom = MovingPhantom(motion_from(values, "disc"))
    back = surfaces(ThereAndBack(phantom), 0, "forward", phantom.truth(0))
    each = [apart(back[n], back[8 - n], phantom) for n in range(1, 4)]
    moved = apart(back[1], back[3], phantom)
    assert max(one[0] for one in each) < 0.1 and max(one[2] for one in each) < WANTED
    assert moved[0] > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["beat", "acceleration", "rotation"])
def test_a_beat_and_both_ways(name: str) -> None:
    assert all(row["largest"] < WANTED for row in rows_of(name, 0.0))
    assert all(row["mean"] < WANTED for row in rows_of(name, 0.2))
