"""Objects that part the space between them: what they share is computed once, and is what each would find alone."""

import numpy as np
import pytest

from accelsurf.clicks.model.partition import BasinsOnce, partition_model
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Click, Clicks
from tests.support.tissues import membrane_cells

SHAPE, SPACING = (16, 30, 30), (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def cells():
    return membrane_cells(SHAPE, 5, noise=0.2, seed=3)


@pytest.fixture(scope="module")
def clicks(cells):
    return Clicks(tuple(point("inside", at, own) for own, at in enumerate(cells[2], 1)), SHAPE)


def point(side, at, own=1):
    return Click(side, box_at(tuple(map(int, at)), (1, 1, 1)), np.ones((1, 1, 1), bool), own)


def alone(found, seen):
    """Where own clicks are nearer than all others, by two marches over everything."""
    inside, outside = (seen.mask(side) for side in ("inside", "outside"))
    infinite = np.float32(np.inf)
    times_out = found.field.times(found.tissue, np.where(outside, np.float32(0), infinite), np.flatnonzero(outside))
    begin = np.where(inside, np.float32(0), infinite)
    times_in = found.field.times(found.tissue, begin, np.flatnonzero(inside), times_out.ravel())
    return times_in < times_out


def whole(model):
    """Its object and F on all of the grid."""
    everywhere = whole_box(SHAPE)
    return model.inside_on(everywhere), model.field_on(everywhere)


def test_each_object_has_what_it_would_find_alone(cells, clicks):
    image, truth, _ = cells
    once, starts = BasinsOnce(), []
    for own in clicks.ids():
        seen = clicks.of(own)
        model = partition_model([image], SPACING, seen, basins=once)
        expected = alone(once.of([image], SPACING, seen, None), seen)
        # Where two fronts meet, an update from both neighbours differs from one of a single front.
        start, field = whole(model)
        assert np.count_nonzero(start != expected) <= 0.01 * expected.sum()
        starts.append(start)
        same = start & (truth == own)
        assert 2 * same.sum() / (start.sum() + (truth == own).sum()) > 0.8
        assert (field[~start & (truth != own)] >= 0).all() and (field == 1.0).any()
    assert (np.sum(starts, axis=0) <= 1).mean() > 0.999 and (np.sum(starts, axis=0) == 1).mean() > 0.98


def test_what_objects_share_is_computed_once_for_the_same_clicks(cells, clicks):
    image = cells[0]
    images, once = [image], BasinsOnce()
    first = once.of(images, SPACING, clicks.of(1), None)
    assert once.of(images, SPACING, clicks.of(2), None) is first
    with_outside = clicks.with_more([point("outside", (0, 0, 0), 2)]).of(2)
    assert once.of(images, SPACING, with_outside, None) is first  # it says nothing of the others
    more = clicks.with_more([point("inside", (0, 0, 0), 2)])
    assert once.of(images, SPACING, more.of(2), None) is not first
    assert once.of([image.copy()], SPACING, more.of(2), None) is not once.of(images, SPACING, more.of(2), None)


def test_an_outside_click_takes_from_its_object_alone(cells, clicks):
    image, once = cells[0], BasinsOnce()
    before = partition_model([image], SPACING, clicks.of(1), basins=once)
    start = whole(before)[0]
    inside = np.argwhere(start)
    at = inside[np.argmax(np.abs(inside - cells[2][0]).sum(axis=1))]
    more = clicks.with_more([point("outside", at, 1)])
    after = partition_model([image], SPACING, more.of(1), basins=once)
    left = whole(after)[0]
    assert not left[tuple(at)] and left.sum() < start.sum()
    other = partition_model([image], SPACING, more.of(2), basins=once)
    assert other.field.tobytes() == partition_model([image], SPACING, clicks.of(2), basins=once).field.tobytes()


def test_background_that_is_clicked_and_a_mask(cells, clicks):
    """Of one object with the others clicked as no object (id 0), and within a mask."""
    image = cells[0]
    seen = Clicks((clicks.clicks[1], *(one._replace(id=0) for one in clicks.clicks if one.id != 2)), SHAPE).of(2)
    model = partition_model([image], SPACING, seen)
    start = whole(model)[0]
    assert np.array_equal(start, alone(BasinsOnce().of([image], SPACING, seen, None), seen) & start)
    assert start.any() and (cells[1][start] == 2).mean() > 0.6
    mask = np.ones(SHAPE, bool)
    mask[:, 8:] = False
    bounded = whole(partition_model([image], SPACING, seen, mask=mask))[0]
    assert bounded.any() and not bounded[~mask].any()


def test_clicks_of_one_object_need_no_owner(cells, clicks):
    own, other = clicks.clicks[0], clicks.clicks[1]._replace(side="outside", id=1)
    plain = Clicks((own, other), SHAPE)
    same = [partition_model([cells[0]], SPACING, one).field.tobytes() for one in (plain, plain.of(1))]
    assert same[0] == same[1]
