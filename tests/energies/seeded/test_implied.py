"""What a click implies of the voxels around it."""

import numpy as np
import pytest

from accelsurf.energies.seeded import implied as module
from accelsurf.energies.seeded.contest import around, contest
from accelsurf.energies.seeded.implied import half_width, implied
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Clicks
from tests.energies.seeded.test_seeded_model import SHAPE, SPACING, ball, dice, distance

WHOLE, FLAT = whole_box(SHAPE), np.zeros(SHAPE, np.float32)


def mask_of(click):
    return click.mask_on(WHOLE)


def implied_by(image, *clicks, within=WHOLE):
    return implied([image], SPACING, Clicks(clicks, SHAPE), within)


def test_half_as_far_again_as_the_click_is_wide():
    click = ball("inside", (13, 20, 24), 4.5)
    (found,) = implied_by(FLAT, click)
    own = np.argwhere(mask_of(click)) * SPACING
    every = np.indices(SHAPE).reshape(3, -1).T * SPACING
    nearest = np.min([np.linalg.norm(every - voxel, axis=1) for voxel in own], axis=0).reshape(SHAPE)
    deepest = np.min(np.linalg.norm(every[~mask_of(click).ravel()] - np.multiply((13, 20, 24), SPACING), axis=1))
    assert np.array_equal(mask_of(found), nearest <= 0.5 * deepest)
    assert 2.5 < np.count_nonzero(mask_of(found)) / np.count_nonzero(mask_of(click)) < 3.5
    assert found.side == "inside"


def test_what_looks_different_is_not_implied():
    image = (np.random.default_rng(1).normal(0, 0.1, SHAPE) + (distance((13, 20, 24)) >= 5.2)).astype(np.float32)
    (found,) = implied_by(image, ball("inside", (13, 20, 24), 4.5))
    assert np.mean(distance((13, 20, 24))[mask_of(found)] < 5.2) > 0.99
    assert np.mean(mask_of(found)[distance((13, 20, 24)) < 5.2]) > 0.9


def test_what_is_nearer_to_an_opposite_click_is_not_implied():
    one, other = ball("inside", (13, 20, 20), 4.5), ball("outside", (13, 20, 28), 1.2)
    (inside,) = implied_by(FLAT, one, other)
    assert not (mask_of(inside) & mask_of(other)).any()
    from_one, from_other = distance((13, 20, 20)) - 4.5, distance((13, 20, 28)) - 1.2
    assert (from_one <= from_other + 0.8)[mask_of(inside)].all()
    alone = mask_of(implied_by(FLAT, one)[0])
    assert (alone & ~mask_of(inside)).any()
    # Far from the other click nothing changes.
    assert np.array_equal(alone[:, :, :20], mask_of(inside)[:, :, :20])


def test_clicks_on_one_side_do_not_hinder_each_other():
    one, other = ball("inside", (13, 20, 20), 4.5), ball("inside", (13, 20, 28), 3.0)
    assert np.array_equal(mask_of(implied_by(FLAT, one, other)[0]), mask_of(implied_by(FLAT, one)[0]))


def test_a_point_implies_nothing():
    assert implied_by(FLAT, ball("inside", (13, 20, 24), 0.4)) == []


def test_nothing_beyond_the_box_is_looked_at():
    image = FLAT.copy()
    within = (slice(0, 20), slice(16, 30), slice(20, 40))
    image[tuple(slice(s.stop, None) for s in within)] = np.nan
    (found,) = implied_by(image, ball("inside", (13, 20, 24), 4.5), within=within)
    assert all(a.start >= b.start and a.stop <= b.stop for a, b in zip(found.box, within, strict=True))
    assert implied_by(image, ball("inside", (13, 8, 8), 3.0), within=within) == []


def test_a_large_click_is_looked_at_in_blocks(monkeypatch):
    click = ball("inside", (13, 20, 24), 6.0)
    fine = mask_of(implied_by(FLAT, click)[0])
    monkeypatch.setattr(module, "MOST", 2000)
    (coarse,) = implied_by(FLAT, click)
    assert coarse.mask.shape == tuple(s.stop - s.start for s in coarse.box)
    assert dice(mask_of(coarse), fine) > 0.85
    assert (mask_of(coarse) | ~mask_of(click)).all()


def test_a_disk_in_one_slice_is_widened_in_it():
    mask = np.zeros((1, 40, 40), bool)
    yy, xx = np.mgrid[:40, :40]
    mask[0] = np.hypot(yy - 20, xx - 20) < 6
    assert half_width(mask, (5.0, 1.0, 1.0), (1, 40, 40)) == pytest.approx(6.0, abs=0.5)


def test_the_contests_take_it_for_said_but_for_clicks():
    clicks = Clicks((ball("inside", (13, 20, 20), 4.5), ball("outside", (13, 20, 26), 1.2)), SHAPE)
    hints = implied([FLAT], SPACING, clicks, WHOLE)
    plain = around([FLAT], SPACING, clicks, None, (8.0, 10**9, 1))
    hinted = around([FLAT], SPACING, clicks, None, (8.0, 10**9, 1), hints)
    assert np.array_equal(plain.box, hinted.box)
    held = plain.seeds != 0
    faces = np.ones(held.shape, bool)
    faces[1:-1, 1:-1, 1:-1] = False
    assert np.array_equal(plain.seeds[held & ~faces], hinted.seeds[held & ~faces])
    assert np.count_nonzero(hinted.seeds == -1) > 2 * np.count_nonzero(plain.seeds == -1)


def test_a_wrong_guess_is_put_right_by_a_click():
    """A ball that fills its object up to where a neighbour of the same brightness begins: then a click in that one."""
    image = ((distance((13, 20, 18)) < 6) | (distance((13, 20, 30)) < 6)).astype(np.float32)
    clicks = Clicks((ball("inside", (13, 20, 18), 5.5), ball("outside", (13, 20, 30), 2.0)), SHAPE)
    for part in contest([image], SPACING, clicks, None, 900):
        found = part.on_box(WHOLE) < 0
        assert dice(found & (image > 0), distance((13, 20, 18)) < 6) > 0.9
