"""The contests of the clicks alone: sides, edges, boxes, coarsening."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from accelsurf.energies.seeded import appearance
from accelsurf.energies.seeded import contest as module
from accelsurf.energies.seeded.appearance import radius_of
from accelsurf.energies.seeded.contest import Balance, around, box_around, contest, outer_faces
from accelsurf.grid.clicks import Clicks
from tests.energies.seeded.test_seeded_model import SHAPE, SPACING, ball, dice, distance


@pytest.fixture(scope="module")
def one_ball():
    inside = distance((13, 20, 24)) < 9
    noise = np.random.default_rng(2).normal(0, 0.1, SHAPE)
    return (inside + noise).astype(np.float32), inside


def clicks_of(*extra):
    return Clicks((ball("inside", (13, 20, 24), 4.5), *extra), SHAPE)


def on_whole(part):
    return part.on_box(tuple(slice(0, n) for n in SHAPE))


def test_both_find_an_even_object(one_ball):
    image, inside = one_ball
    for part in contest([image], SPACING, clicks_of(), None, 1):
        whole = on_whole(part)
        assert dice(whole < 0, inside) > 0.9
        assert whole.min() >= -1.0 and whole.max() <= 1.0 and np.isfinite(whole).all()


@pytest.mark.parametrize("most", [120_000, 8000])
def test_the_walks_end_where_all_beyond_is_outside(one_ball, monkeypatch, most):
    """Their box is cut, at blocks, and what is cut off is nearly 1; an unsure block more than there is stays."""
    inside = one_ball[1]
    image = inside.astype(np.float32)
    monkeypatch.setattr(module, "WALKS_MOST", most)
    cut = contest([image], SPACING, clicks_of(), None, 1)[1]
    monkeypatch.setattr(module, "CERTAIN", 2.0)
    whole = contest([image], SPACING, clicks_of(), None, 1)[1]
    assert cut.values.size < 0.8 * whole.values.size and cut.steps == whole.steps
    ours, all_of_them = on_whole(cut), on_whole(whole)
    kept = np.zeros(SHAPE, bool)
    kept[cut.box] = True
    near = tuple(slice(s.start + 1, s.stop - 1) for s in cut.box)  # between blocks values are linear
    assert (all_of_them[~kept] >= 0.9).all() and (ours[~kept] == 1.0).all()
    assert np.array_equal(ours[near], all_of_them[near])


def test_a_coarsened_box_finds_it_too(one_ball, monkeypatch):
    image, inside = one_ball
    monkeypatch.setattr(module, "PATHS_MOST", 8000)
    monkeypatch.setattr(module, "WALKS_MOST", 8000)
    for part in contest([image], SPACING, clicks_of(), None, 1):
        assert dice(on_whole(part) < 0, inside) > 0.85


def test_an_outside_click_takes_its_surroundings(one_ball):
    image, inside = one_ball
    other = ball("outside", (13, 20, 31), 1.2)
    two = clicks_of(other)
    for before, after in zip(
        contest([image], SPACING, clicks_of(), None, 1), contest([image], SPACING, two, None, 1), strict=True
    ):
        near = distance((13, 20, 31)) < 2
        assert on_whole(after)[near].mean() > on_whole(before)[near].mean() + 0.5


def test_what_is_not_allowed_is_outside(one_ball):
    image, _ = one_ball
    allowed = np.zeros(SHAPE, bool)
    allowed[:, :, :26] = True
    for part in contest([image], SPACING, clicks_of(), allowed, 1):
        assert not (on_whole(part)[:, :, 26:] < 0)[~clicks_of().mask("inside")[:, :, 26:]].any()


def test_the_radius_is_that_of_the_ball():
    count = np.count_nonzero(ball("inside", (13, 20, 24), 4.5).mask)
    assert radius_of(count, SPACING, False) == pytest.approx(4.5, rel=0.1)


def test_the_box_reaches_some_depths_and_near_faces_stay_open():
    shape = (60, 60, 60)
    spacing = (1.0, 1.0, 1.0)
    click = ball("inside", (30, 30, 5), 3.0, shape=shape, spacing=spacing)
    box, margin = box_around(Clicks((click,), shape), spacing, 2.0, 1)
    assert margin == pytest.approx(12.0, rel=0.1)
    assert box[2].start == 0 and box[0].start == pytest.approx(18, abs=1) and box[2].stop == pytest.approx(18, abs=1)
    # A size of 12 voxels of radius: the box is that of the object, not of the click.
    assert box_around(Clicks((click,), shape), spacing, 2.0, 7238)[1] == pytest.approx(24, rel=0.01)
    faces = outer_faces([click], spacing, box, margin)
    assert (2, 0) not in faces and (2, 1) in faces and (0, 0) in faces


def test_seeds_of_both_sides_in_a_block_are_none(one_ball):
    image, _ = one_ball
    touching = ball("outside", (13, 20, 30), 0.9)
    clicks = clicks_of(touching)
    coarse = around([image], SPACING, clicks, None, (2.0, 200, 1))
    assert coarse.seeds.size <= 200 and set(np.unique(coarse.seeds)) <= {-1.0, 0.0, 1.0}


def test_a_part_on_a_larger_box_is_outside_beyond():
    part = Balance((slice(1, 2), slice(0, 1), slice(0, 2)), np.full((1, 1, 2), -0.5, np.float32))
    whole = part.on_box((slice(0, 2), slice(0, 1), slice(0, 3)))
    assert whole.tolist() == [[[1.0, 1.0, 1.0]], [[-0.5, -0.5, 1.0]]]


@pytest.mark.parametrize("steps", [(1, 2, 3), (4, 1, 5), (7, 6, 2)])
def test_block_means_are_numpy_s(steps):
    values = np.random.default_rng(1).normal(size=(9, 14, 17)).astype(np.float32)
    expected = values
    for axis, step in enumerate(steps):
        first = np.arange(0, values.shape[axis], step)
        sizes = np.diff(np.append(first, values.shape[axis])).astype(np.float32)
        along = np.expand_dims(sizes, [i for i in range(3) if i != axis])
        expected = np.add.reduceat(expected, first, axis) / along
    np.testing.assert_allclose(module.block_means(values, steps), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("spread", [0.01, 0.3, 0.56, 2.0])
def test_the_spread_is_at_least_that_of_changes(spread):
    part = np.random.default_rng(4).normal(size=(6, 7, 8)).astype(np.float32)
    changes = np.concatenate([np.abs(np.diff(part, axis=axis)).ravel() for axis in range(3)])
    expected = max(spread, appearance.MIN_CHANGE * float(np.median(changes)))
    assert appearance.at_least_of_changes(part, spread) == expected


def test_threads_change_no_byte(one_ball):
    clicks = clicks_of(ball("outside", (13, 20, 36), 2.0))
    with ThreadPoolExecutor(3) as pool:
        threaded = contest([one_ball[0]], SPACING, clicks, None, 1, pool)
    for one, other in zip(contest([one_ball[0]], SPACING, clicks, None, 1), threaded, strict=True):
        assert one.box == other.box and one.values.tobytes() == other.values.tobytes()
