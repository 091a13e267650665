"""How sure a model is: how steep F is at its boundary, how far off the last click was, how well the size is known."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.correct.finished import confidence_from
from accelsurf.energies.seeded import Proposal, seeded_model
from accelsurf.energies.seeded.proposal import spread_of
from accelsurf.energies.seeded.shown import Shown
from accelsurf.energies.seeded.sureness import corrections_with, sureness_of
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from tests.energies.seeded.test_seeded_model import SHAPE, SPACING, ball, distance, volume_of

LINE = (1, 1, 40)
SIZED = Proposal(10.0, 1.0, (), 0.3)


def point(side, *index):
    return Click(side, tuple(slice(i, i + 1) for i in index), np.ones((1, 1, 1), bool))


def shown(force):
    return Shown(whole_box(force.shape), force.astype(np.float32), force < 0)


def overlap(force, *clicks):
    return sureness_of(shown(force), Clicks(clicks, force.shape), SIZED, ()).overlap


@pytest.mark.parametrize("slope, smaller, larger", [(1.0, 20, 20), (0.03, 17, 23), (0.0085, 8, 30)])
def test_overlap_is_the_dice_of_two_levels(slope, smaller, larger):
    # F crosses 0 at 19.5: 20 voxels are inside. The larger one ends 0.1/slope or, the flattest, half the object beyond.
    force = slope * (np.arange(40.0) - 19.5).reshape(LINE)
    force[0, 0, 0] = -3.0
    assert overlap(force, point("inside", 0, 0, 0)) == pytest.approx(2 * smaller / (smaller + larger))


def test_what_is_connected_to_no_click_does_not_count():
    force = np.full(LINE, 0.5)
    force[0, 0, :10], force[0, 0, 12:15] = -0.5, 0.05
    assert overlap(force, point("inside", 0, 0, 2)) == 1.0
    force[0, 0, 10:12] = 0.05
    assert overlap(force, point("inside", 0, 0, 2)) == pytest.approx(2 * 10 / (10 + 15))


def test_the_box_of_what_is_shown_makes_no_difference():
    force = (0.06 * (distance((13, 20, 24)) - 8)).astype(np.float32)
    clicks = Clicks((ball("inside", (13, 20, 24), 3.0),), SHAPE)
    whole = sureness_of(shown(force), clicks, SIZED, (0.9, 0.4))
    box = (slice(2, 25), slice(3, 38), slice(5, 44))
    assert sureness_of(Shown(box, force[box], force[box] < 0), clicks, SIZED, (0.9, 0.4)) == whole
    assert (whole.corrections, whole.correction, whole.spread) == (2, 0.4, 0.3)
    low, high = (8 - 0.1 / 0.06) ** 3, (8 + 0.1 / 0.06) ** 3
    assert whole.overlap == pytest.approx(2 * low / (low + high), abs=0.02)


def test_a_correction_is_measured_in_radii_from_the_side_that_it_should_be_on():
    force = np.where(np.arange(64) < 20, -0.5, 0.5)[None, None] * np.ones((8, 8, 1))
    before, spacing = shown(force), (1.5, 1.0, 0.8)
    radius = (0.75 * 8 * 8 * 20 * 1.2 / np.pi) ** (1 / 3)
    for side, x, voxels in (("inside", 24, 5), ("inside", 60, 41), ("inside", 19, 0), ("outside", 3, 17),
                            ("outside", 20, 0)):
        found = corrections_with((9.0,), point(side, 4, 4, x), before, before, spacing, force.shape)
        assert found == pytest.approx((9.0, 0.8 * voxels / radius) if voxels else (9.0,))
    # In radii of what is shown after it.
    after = shown(np.where(np.arange(64) < 40, -0.5, 0.5)[None, None] * np.ones((8, 8, 1)))
    found = corrections_with((), point("inside", 4, 4, 24), before, after, spacing, force.shape)
    assert found == pytest.approx((0.8 * 5 / (radius * 2 ** (1 / 3)),))
    # A ball is where its middle is.
    click = Click("inside", (slice(3, 6), slice(3, 6), slice(23, 26)), np.ones((3, 3, 3), bool))
    found = corrections_with((), click, before, before, spacing, force.shape)
    assert found == pytest.approx((0.8 * 5 / radius,))


def test_the_distance_is_exact_in_space():
    random = np.random.default_rng(3)
    inside = ndimage.gaussian_filter(random.normal(size=SHAPE), 3) > 0.06
    before = Shown(whole_box(SHAPE), np.where(inside, -1, 1).astype(np.float32), inside)
    away = ndimage.distance_transform_edt(~inside, sampling=SPACING)
    radius = (0.75 * volume_of(inside) / np.pi) ** (1 / 3)
    for index in random.integers(0, SHAPE, (30, 3)):
        found = corrections_with((), point("inside", *index), before, before, SPACING, SHAPE)
        assert found == pytest.approx((away[tuple(index)] / radius,) if away[tuple(index)] else (), rel=1e-5)


def test_the_spread_of_a_size_is_that_of_the_evidence():
    counts = np.array([100, 200, 400, 800])
    assert spread_of(counts, np.array([0.0, -np.inf, -np.inf, 0.0])) == pytest.approx(0.5 * np.log(8))
    assert spread_of(counts, np.array([-900.0, -60.0, 0.0, -900.0])) < 1e-6
    inside = distance((13, 20, 24)) < 9
    image = (inside + np.random.default_rng(0).normal(0, 0.2, SHAPE)).astype(np.float32)
    faint = (0.1 * inside + np.random.default_rng(0).normal(0, 0.2, SHAPE)).astype(np.float32)
    clicks = Clicks((ball("inside", (13, 20, 24), 4.5),), SHAPE)
    clear, unclear = (seeded_model([one], SPACING, clicks).proposal.spread for one in (image, faint))
    assert clear < 0.5 < unclear
    assert seeded_model([faint], SPACING, clicks, size_mm3=volume_of(inside)).proposal.spread == 0.25


def test_click_by_click_or_at_once_is_the_same():
    inside = distance((13, 20, 24)) < 9
    image = (inside + np.random.default_rng(0).normal(0, 0.6, SHAPE)).astype(np.float32)
    clicks = [ball("inside", (13, 20, 24), 4.5), ball("outside", (13, 20, 40), 2.0), ball("inside", (13, 31, 24), 1.0)]
    model = None
    for n in (1, 2, 3):
        given = Clicks(tuple(clicks[:n]), SHAPE)
        model = seeded_model([image], SPACING, given, previous=model)
        found = confidence_from(model)
        assert found == confidence_from(seeded_model([image], SPACING, given))
        assert found == confidence_from(seeded_model([image], SPACING, given, previous=model))
        # The outside click lies where nothing was found, and corrects nothing.
        assert found.corrections == (n == 3) and (found.correction is None) == (n < 3)
