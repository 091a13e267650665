"""A click that contradicts what is shown moves F around it, towards its side."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.energies.seeded import after_click as surprises
from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.after_click import (
    CHANGES_REACH,
    LARGEST,
    PART,
    REACH,
    neighbourhood,
    shift_around,
    surprise,
)
from accelsurf.energies.seeded.implied import half_width
from accelsurf.energies.seeded.nearness import ENDS
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from tests.support import clicked_balls


def shown(force):
    return Shown(whole_box(force.shape), force, force < 0)


def plainly(click, force, spacing):
    """The same by distances between all pairs of voxels."""
    inside = np.argwhere(click.mask_on(whole_box(force.shape))) * spacing
    everywhere = np.argwhere(np.ones(force.shape, bool)) * spacing
    mm = np.sqrt(((everywhere[:, None] - inside[None]) ** 2).sum(-1)).min(1).reshape(force.shape)
    beyond = np.argwhere(~np.pad(click.mask, [(int(n > 1),) * 2 for n in force.shape]))
    own = np.argwhere(np.pad(click.mask, [(int(n > 1),) * 2 for n in force.shape]))
    half = np.sqrt((((own[:, None] - beyond[None]) * spacing) ** 2).sum(-1)).min(1).max()
    mean = force[click.mask_on(whole_box(force.shape))].astype(float).clip(-1, 1).mean()
    sign = -1 if click.side == "inside" else 1
    return sign * min(PART * max(-sign * mean, 0), LARGEST) * np.exp(-0.5 * (mm / (REACH * half)) ** 2)


@pytest.mark.parametrize("side", ["inside", "outside"])
@pytest.mark.parametrize(("shape", "spacing"), [((5, 9, 11), (3.0, 1.0, 0.8)), ((1, 13, 9), (1.0, 2.0, 0.5))])
def test_f_moves_by_a_part_of_what_was_wrong(side, shape, spacing):
    random = np.random.default_rng(3)
    # On the wrong side of either click, by less and by more than the largest move.
    for scale in (0.1, 2.0):
        force = (scale * random.random(shape) * (1 if side == "inside" else -1)).astype(np.float32)
        before = force.copy()
        click = clicked_balls.ball(side, [n // 2 for n in shape], 1.6, shape, spacing)
        found = shift_around(click, shown(force), spacing, shape)
        expected = plainly(click, force, np.array(spacing))
        np.testing.assert_allclose(found.by, expected[found.box], atol=1e-6)
        assert np.array_equal(force, before)
        left = expected.copy()
        left[found.box] = 0.0
        assert np.abs(left).max() <= LARGEST * np.exp(-0.5 * ENDS**2) + 1e-6


def test_a_click_on_its_side_moves_nothing():
    force = np.full((5, 7, 9), 0.4, np.float32)
    click = clicked_balls.ball("outside", (2, 3, 4), 1.5, force.shape, (1.0, 1.0, 1.0))
    assert surprise(click, shown(force)) == 0.0
    assert shift_around(click, shown(force), (1.0, 1.0, 1.0), force.shape) is None


def test_a_click_beyond_what_was_shown_is_a_surprise_of_one():
    """There F is 1, and what is moved lies within what was shown and the click."""
    corner = np.full((3, 3, 3), -0.5, np.float32)
    before = Shown(whole_box(corner.shape), corner, corner < 0)
    click = Click("inside", (slice(6, 7),) * 3, np.ones((1, 1, 1), bool))
    assert surprise(click, before) == 1.0
    found = shift_around(click, before, (1.0, 1.0, 1.0), (9, 9, 9))
    assert found.box == (slice(0, 7),) * 3
    assert found.by[6, 6, 6] == pytest.approx(-LARGEST)


def test_the_more_clicks_the_nearer_is_what_changes():
    shape, one = (9, 60, 60), (1.0, 1.0, 1.0)
    force = np.full(shape, 0.2, np.float32)
    click = clicked_balls.ball("inside", (4, 8, 8), 1.1, shape, one)
    mm = ndimage.distance_transform_edt(~click.mask_on(whole_box(shape)))
    assert neighbourhood(click, 2, shown(force), one, shape).near is None
    for number, within in enumerate(CHANGES_REACH[1:] + CHANGES_REACH[-1:], start=3):
        near = neighbourhood(click, number, shown(force), one, shape).near(whole_box(shape))
        found = np.zeros(shape, np.float32)
        found[near.box] = near.values
        # The half width of a ball of seven voxels is the diagonal to what is beside two of them.
        np.testing.assert_allclose(found, np.exp(-0.5 * (mm / (within * np.sqrt(2.0))) ** 2), atol=0.012)


def test_near_is_what_lies_beyond_what_was_shown_too():
    shape, one = (1, 1, 60), (1.0, 1.0, 1.0)
    force = np.full((1, 1, 20), 0.2, np.float32)
    before = Shown((slice(0, 1), slice(0, 1), slice(0, 20)), force, force < 0)
    click = Click("inside", (slice(0, 1), slice(0, 1), slice(19, 21)), np.ones((1, 1, 2), bool))
    around = neighbourhood(click, 3, before, one, shape)
    box = slice(0, 1), slice(0, 1), slice(0, 50)
    assert around.shift.box[2].stop == 21
    near = around.near(box)
    assert near.box == box
    np.testing.assert_allclose(near.values[0, 0, 20:], np.exp(-0.5 * (np.arange(30) / 24.0) ** 2), rtol=1e-5)


def test_a_thin_stroke_through_a_large_box_has_a_width():
    shape = (80, 80, 80)
    diagonal = np.zeros(shape, bool)
    diagonal[(np.arange(80),) * 3] = True
    click = Click("inside", whole_box(shape), diagonal)
    assert half_width(diagonal, (1.0, 1.0, 1.0), shape) == 1.0
    around = neighbourhood(click, 6, shown(np.full(shape, 0.2, np.float32)), (1.0, 1.0, 1.0), shape)
    near = around.near(whole_box(shape))
    assert near.values[40, 40, 46] > 0.6 and near.values[40, 40, 79] < 0.01


def test_large_boxes_are_coarsened_and_say_about_the_same():
    shape, spacing = (60, 70, 64), (1.5, 1.0, 1.0)
    force = np.full(shape, -0.3, np.float32)
    click = clicked_balls.ball("outside", (30, 35, 32), 6.0, shape, spacing)
    found = shift_around(click, shown(force), spacing, shape)
    mm = ndimage.distance_transform_edt(~click.mask_on(whole_box(shape)), sampling=spacing)
    expected = PART * 0.3 * np.exp(-0.5 * (mm / (REACH * 6.0)) ** 2)
    assert np.abs(found.by - expected[found.box]).max() < 0.02 * LARGEST / 0.2


def test_a_stroke_reaches_as_far_as_it_is_wide_not_long():
    shape, one = (9, 41, 41), (1.0, 1.0, 1.0)
    force = np.full(shape, 0.3, np.float32)
    stroke = Click("inside", (slice(4, 5), slice(20, 21), slice(2, 39)), np.ones((1, 1, 37), bool))
    found = shift_around(stroke, shown(force), one, shape)
    full = np.zeros(shape, np.float32)
    full[found.box] = found.by
    np.testing.assert_allclose(full[4, 20, [2, 20, 38]], -0.15, rtol=1e-6)
    assert np.abs(full[4, 20 + int(2 * REACH) + 1]).max() < 0.15 * np.exp(-2.0)


def test_what_is_wrong_around_an_outside_click_goes_with_it(monkeypatch):
    """Two equal balls that touch: the click in the second one says more of it than its own voxels."""
    shape, spacing = (20, 28, 48), (1.0, 1.0, 1.0)
    one = clicked_balls.distance((10, 14, 15), shape, spacing) < 9
    other = clicked_balls.distance((10, 14, 32), shape, spacing) < 9
    image = ((one | other) + np.random.default_rng(2).normal(0, 0.2, shape)).astype(np.float32)
    clicks = Clicks((clicked_balls.ball("inside", (10, 14, 15), 4.0, shape, spacing),), shape)
    more = clicks.with_more([clicked_balls.ball("outside", (10, 14, 32), 2.0, shape, spacing)])
    with_it = seeded_model([image], spacing, more, size_mm3=2.0 * float(one.sum()))
    monkeypatch.setattr(surprises, "PART", 0.0)
    without = seeded_model([image], spacing, more, size_mm3=2.0 * float(one.sum()))
    assert (without.start & other).sum() > (with_it.start & other).sum()
    assert (with_it.start & one).sum() > 0.97 * (without.start & one).sum()
