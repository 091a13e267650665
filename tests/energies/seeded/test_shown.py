"""What a click changes in what is shown: labels towards its side alone, and F by a part."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.answers import Answer, FirstTimes
from accelsurf.energies.seeded.blocks import in_blocks
from accelsurf.energies.seeded.contest import Balance
from accelsurf.energies.seeded.nearness import Nearness
from accelsurf.energies.seeded.shown import EVERYWHERE, INERTIA, Neighbourhood, Shift, Shown, mixed_answer
from accelsurf.grid.clicks import Click, Clicks
from tests.energies.seeded.test_seeded_model import SHAPE, SPACING, ball, dice, distance, volume_of

LINE = (1, 1, 12)
WHOLE = tuple(slice(0, n) for n in LINE)


def line(values):
    return np.array(values, np.float32).reshape(LINE)


def point(side, x):
    return Click(side, (slice(0, 1), slice(0, 1), slice(x, x + 1)), np.ones((1, 1, 1), bool))


def mixed(force, clicks, before, inside=None, around=EVERYWHERE):
    """What is shown where the learned answer and both contests agree on F."""
    none = np.zeros(LINE, np.float32)
    inside = force < 0 if inside is None else inside
    blocks, first = in_blocks([none], (1.0, 1.0, 1.0), None, None, 5), FirstTimes(WHOLE, none, 0.0)
    numbers = 5, 1.0, 3.0
    answer = Answer(blocks, WHOLE, WHOLE, *numbers, None, none, none, none, none, force, inside, tuple(clicks), first)
    return mixed_answer(answer, [Balance(WHOLE, force)] * 2, Clicks(tuple(clicks), LINE), False, before, around)


BEFORE = line([0.8, -0.5, -0.5, -0.5, -0.2, -0.2, 0.3, 0.3, 0.8, 0.8, 0.8, 0.8])


def test_an_inside_click_takes_nothing_away():
    before = Shown(WHOLE, BEFORE, BEFORE < 0)
    now = line([0.8, -0.5, -0.5, 0.4, 0.4, -0.4, -0.4, -0.4, 0.8, 0.8, 0.8, 0.8])
    shown = mixed(now, [point("inside", 1), point("inside", 6)], before)
    assert shown.inside.ravel().tolist() == [x in range(1, 8) for x in range(12)]
    assert shown.force.ravel()[[3, 4, 7]] == pytest.approx((-0.5, -0.2, -0.4))


def test_an_outside_click_adds_nothing():
    before = Shown(WHOLE, BEFORE, BEFORE < 0)
    now = line([-0.4, -0.5, -0.5, -0.5, 0.4, 0.4, 0.3, 0.3, 0.8, 0.8, 0.8, 0.8])
    shown = mixed(now, [point("inside", 2), point("outside", 5)], before)
    assert shown.inside.ravel().tolist() == [x in (1, 2, 3) for x in range(12)]
    assert shown.force.ravel()[0] == pytest.approx(0.8)


def test_an_outside_click_joins_no_island():
    """F < 0 that no inside click was connected to stays outside when a bridge to it appears, and F says so."""
    island = BEFORE.copy()
    island[0, 0, 8:10] = -0.6
    inside = BEFORE < 0
    now = island.copy()
    now[0, 0, 6:8] = -0.4
    shown = mixed(now, [point("inside", 2), point("outside", 11)], Shown(WHOLE, island, inside))
    np.testing.assert_array_equal(shown.inside, inside)
    assert (shown.force[~inside] > 0).all()


def test_a_hole_that_was_filled_keeps_its_side():
    force = line([0.8, -0.5, -0.5, 0.0, -0.5, -0.5, 0.3, 0.3, 0.8, 0.8, 0.8, 0.8])
    before = Shown(WHOLE, force, (force < 0) | (force == 0))
    shown = mixed(force, [point("inside", 1), point("inside", 7)], before)
    assert shown.inside.ravel()[3] and shown.force.ravel()[3] < 0


def test_later_clicks_keep_a_part_of_the_field():
    now = line([0.9, -0.9, -0.9, -0.9, -0.9, -0.9, -0.9, 0.9, 0.9, 0.9, 0.9, 0.9])
    clicks = [point("inside", 1), point("inside", 6)]
    for part in INERTIA + INERTIA[-1:]:
        shown = mixed(now, clicks, Shown(WHOLE, BEFORE, BEFORE < 0))
        expected = (1 - part) * now + part * BEFORE
        np.testing.assert_allclose(shown.force.ravel()[2:6], expected.ravel()[2:6], rtol=1e-5)
        np.testing.assert_allclose(shown.force.ravel()[8:], expected.ravel()[8:], rtol=1e-5)
        clicks.insert(1, point("inside", 1))


def test_the_first_field_has_the_size_of_the_learned_answer():
    """The contests may say what belongs to it, not how much."""
    force = line([0.3, 0.1, 0.0, 0.2, 0.25, 0.28, 0.3, 0.3, 0.8, 0.8, 0.8, 0.8])
    inside = line([0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0]) > 0
    shown = mixed(force, [point("inside", 2)], None, inside)
    assert shown.inside.ravel().tolist() == [x in (1, 2, 3) for x in range(12)]
    far = mixed(line([0.9, 0.8, 0.6, 0.7] + [0.9] * 8), [point("inside", 2)], None, inside)
    assert np.count_nonzero(far.inside) == 1


def test_a_later_field_goes_half_way_to_the_size_of_the_learned_answer():
    """The contests alone took in half of the scan where a large organ has neighbours of its own brightness."""
    force = line([0.5, -0.4, -0.3, -0.2, -0.09, -0.05, -0.04, 0.3, 0.8, 0.8, 0.8, 0.8])
    inside = line([0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]) > 0
    clicks, far = [point("inside", 1), point("outside", 11)], Shown(WHOLE, force, force < 0)
    # Two voxels would be inside below -0.2: F is moved by 0.1.
    shown = mixed(force, clicks, far, inside)
    np.testing.assert_allclose(shown.force.ravel()[2:5], [-0.2, -0.1, 0.01], atol=1e-6)
    assert shown.inside.ravel().tolist() == [x in (1, 2, 3) for x in range(12)], shown.force
    larger = line([0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0]) > 0
    shown = mixed(force, [point("inside", 1), point("inside", 2)], Shown(WHOLE, force, force < 0), larger)
    np.testing.assert_allclose(shown.force.ravel()[4:8], force.ravel()[4:8] - 0.25, atol=1e-6)


def test_an_outside_click_takes_nothing_far_from_it():
    """One inside click alone tells the contests little: a click at the end of a rib took a quarter of it elsewhere."""
    force = line([0.5, -0.4, -0.3, -0.2, 0.09, 0.2, 0.25, 0.3, 0.8, 0.8, 0.8, 0.8])
    before = Shown(WHOLE, line([0.5, -0.4, -0.3, -0.2, -0.3, -0.2, 0.4, 0.4, 0.8, 0.8, 0.8, 0.8]), BEFORE < 0)
    learned = line([0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]) > 0
    # Five voxels are inside below 0.25: F is moved by as much.
    shown = mixed(force, [point("inside", 1), point("outside", 11)], before, learned)
    np.testing.assert_allclose(shown.force.ravel()[4:6], [-0.16, -0.05], atol=1e-6)
    np.testing.assert_array_equal(shown.inside, before.inside)


def test_a_size_far_from_that_of_the_contests_says_nothing():
    force = line([0.5, -0.4, -0.3, -0.2, -0.1, -0.05, -0.04, 0.3, 0.8, 0.8, 0.8, 0.8])
    inside = line([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]) > 0
    shown = mixed(force, [point("inside", 1), point("outside", 11)], Shown(WHOLE, force, force < 0), inside)
    np.testing.assert_allclose(shown.force.ravel()[2:11], force.ravel()[2:11], rtol=1e-6)


def test_f_changes_near_a_click_alone():
    now = line([-0.9, -0.9, -0.9, -0.9, -0.9, -0.9, -0.9, -0.4, -0.4, -0.4, -0.4, -0.4])
    before = Shown(WHOLE, BEFORE, BEFORE < 0)
    box = slice(0, 1), slice(0, 1), slice(5, 9)
    weights = np.array([0.5, 1.0, 1.0, 0.25], np.float32).reshape(1, 1, 4)
    around = Neighbourhood(None, lambda _: Nearness(box, weights))
    shown = mixed(now, [point("inside", 1), point("inside", 6)], before, around=around)
    expected = BEFORE.copy()
    expected[box] += weights * (now[box] - BEFORE[box])
    expected[0, 0, [1, 6]] = -3.0
    np.testing.assert_allclose(shown.force, expected, rtol=1e-5)
    assert shown.inside.ravel().tolist() == [x in range(1, 8) for x in range(12)]
    shift = Shift((slice(0, 1), slice(0, 1), slice(7, 8)), np.full((1, 1, 1), 0.2, np.float32))
    shown = mixed(now, [point("inside", 1), point("inside", 6)], before, around=around._replace(shift=shift))
    expected[0, 0, 7] += 0.2
    np.testing.assert_allclose(shown.force, expected, rtol=1e-5)
    np.testing.assert_array_equal(before.force, BEFORE)


def on_grid(model):
    """Where what is shown is inside, before it is brought to the edges of the image."""
    out = np.zeros(SHAPE, bool)
    shown = model.stages[-1].shown
    out[shown.box] = shown.inside
    return out


def test_no_click_changes_labels_towards_the_other_side():
    """Nor does the start, but for the edge, which is found anew and within a voxel."""
    random = np.random.default_rng(5)
    one, other = distance((13, 20, 14)) < 8, distance((13, 20, 34)) < 9
    image = (one + 0.7 * other + random.normal(0, 0.35, SHAPE)).astype(np.float32)
    clicks, model = Clicks((ball("inside", (13, 20, 14), 3.0),), SHAPE), None
    for _ in range(7):
        later = seeded_model([image], SPACING, clicks, previous=model)
        if model is not None:
            is_inside = clicks.clicks[-1].side == "inside"
            now, before = on_grid(later), on_grid(model)
            assert not (before & ~now if is_inside else now & ~before).any()
            other = model.start & ~later.start if is_inside else later.start & ~model.start
            assert not (other & (ndimage.distance_transform_edt(model.start == is_inside, SPACING) > 3.0)).any()
        model = later
        centre = [int(random.integers(3, n - 3)) for n in SHAPE]
        side = "inside" if one[tuple(centre)] else "outside"
        clicks = clicks.with_more([ball(side, centre, 1.6)])


def test_an_inside_click_with_a_size_stays_near_it():
    """The contests at the first click do not undo the size."""
    one = distance((13, 20, 24)) < 9
    image = (one + np.random.default_rng(1).normal(0, 0.2, SHAPE)).astype(np.float32)
    clicks = Clicks((ball("inside", (13, 20, 24), 4.0),), SHAPE)
    for factor in (0.6, 1.0):
        model = seeded_model([image], SPACING, clicks, size_mm3=factor * volume_of(one))
        assert volume_of(on_grid(model)) == pytest.approx(factor * volume_of(one), rel=0.12)
    assert dice(model.start, one) > 0.93
