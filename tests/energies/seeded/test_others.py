"""Clicks inside other objects: near ones say where an object ends, far ones nothing, click by click as at once."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from accelsurf.correct.local_model import LocalModel, LocalState
from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.contest import PATHS_REACH, WALKS_REACH, box_around
from accelsurf.energies.seeded.model import heard
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Clicks
from tests.energies.seeded.test_seeded_model import dice
from tests.support import clicked_balls

SPACING = (1.5, 1.0, 0.8)
SHAPE = (22, 30, 140)
distance = partial(clicked_balls.distance, shape=SHAPE, spacing=SPACING)
ball = partial(clicked_balls.ball, shape=SHAPE, spacing=SPACING)
#: Two balls that touch, and one far from both; their ids.
PLACES = {1: (11, 15, 14), 2: (11, 15, 32), 3: (11, 15, 124)}


@pytest.fixture(scope="module")
def image():
    inside = np.any([distance(at) < 7.5 for at in PLACES.values()], axis=0)
    return (inside + np.random.default_rng(3).normal(0, 0.15, SHAPE)).astype(np.float32)


def clicked(*ids):
    """The clicks in objects, as the first one sees them."""
    given = tuple(ball("inside", PLACES[id], 3.0)._replace(id=id) for id in ids)
    return Clicks(given, SHAPE).of(1)


def answer_of(model):
    return model.stages[-1].answer


def test_far_objects_say_nothing_and_near_ones_where_this_one_ends(image):
    all_of_them, near = (seeded_model([image], SPACING, clicked(*ids)) for ids in ((1, 3, 2), (1, 2)))
    assert all_of_them.field.tobytes() == near.field.tobytes()
    assert len(all_of_them.clicks) == 3 and [len(stage.clicks) for stage in all_of_them.stages][-1] == 2
    alone, own = seeded_model([image], SPACING, clicked(1)), distance(PLACES[1]) < 7.5
    assert dice(near.start, own) > max(0.93, dice(alone.start, own))
    assert not near.start[distance(PLACES[2]) < 3].any()


def test_clicks_given_for_the_object_are_heard_from_afar_and_who_is_clicked_on_the_way(image):
    answer = answer_of(seeded_model([image], SPACING, clicked(1)))
    own, outside = ball("inside", PLACES[1], 3.0), ball("outside", (11, 15, 100), 2.0)
    on_none = ball("inside", (11, 15, 90), 2.0)._replace(id=0)
    of_another = on_none._replace(id=7)
    given = Clicks((own, outside, on_none, of_another), SHAPE).of(1)
    assert heard(given, answer, SPACING).clicks == given.clicks
    for far in (on_none, of_another):
        without = Clicks((own, far), SHAPE).of(1)
        assert heard(without, answer, SPACING).clicks == without.clicks[:1]
    assert heard(Clicks(given.clicks[1:], SHAPE), answer, SPACING).clicks == given.clicks[1:]


def test_clicks_on_no_object_are_heard_as_far_as_the_walks_look(image):
    answer = answer_of(seeded_model([image], SPACING, clicked(1)))
    own = Clicks((ball("inside", PLACES[1], 3.0),), SHAPE)
    near, far = (box_around(own, SPACING, reach, answer.count)[0][2].stop for reach in (PATHS_REACH, WALKS_REACH))
    between = ball("inside", (11, 15, (near + far) // 2), 0.5)
    for id, count in ((0, 2), (7, 1)):
        given = Clicks((*own.clicks, between._replace(id=id)), SHAPE).of(1)
        assert len(heard(given, answer, SPACING)) == count


def test_a_click_that_calls_the_proposal_far_too_large_is_heard_wherever_it_lies():
    """A dim ball in tissue nearly as dim, and a click in another object beside it, which makes the proposal smaller."""
    z, y, x = np.indices(SHAPE)
    dim = ((z - 11) * 1.5) ** 2 + (y - 15) ** 2 + ((x - 30) * 0.8) ** 2 < 4**2
    image = (100.0 + 4.0 * dim + np.random.default_rng(0).normal(0, 2.0, SHAPE)).astype(np.float32)
    own, beside = ball("inside", (11, 15, 30), 0.4), ball("inside", (11, 15, 36), 0.4)._replace(id=2)
    alone, both = Clicks((own,), SHAPE), Clicks((own, beside), SHAPE).of(1)
    first, whole = seeded_model([image], SPACING, alone), seeded_model([image], SPACING, both)
    assert whole.proposal.volume_mm3 < 0.5 * first.proposal.volume_mm3
    assert seeded_model([image], SPACING, both, previous=first).field.tobytes() == whole.field.tobytes()
    # Without that click the size is that of before again.
    assert seeded_model([image], SPACING, alone, previous=whole).field.tobytes() == first.field.tobytes()
    # Were the smaller object far from it, it would have to be heard all the same.
    tiny = dataclasses.replace(answer_of(whole), count=1, around=box_at((0, 0, 0), (1, 1, 1)))
    far = dataclasses.replace(tiny, first=tiny.first._replace(early=-np.inf, proposed=None))
    assert [len(heard(both, one, SPACING)) for one in (tiny, far)] == [2, 1]


def test_another_object_at_the_end_of_a_leak_is_heard():
    """The march goes along a bar to a click that lies far beyond where the contests look."""
    bar = np.zeros(SHAPE, bool)
    bar[7:15, 10:20, 4:130] = True
    image = (bar + np.random.default_rng(4).normal(0, 0.05, SHAPE)).astype(np.float32)
    own, other = ball("inside", (11, 15, 10), 2.5), ball("inside", (11, 15, 120), 2.5)
    alone = answer_of(seeded_model([image], SPACING, Clicks((own,), SHAPE)))
    looked = box_around(Clicks((own,), SHAPE), SPACING, PATHS_REACH, alone.count)[0]
    model = seeded_model([image], SPACING, Clicks((own, other._replace(id=2)), SHAPE).of(1))
    assert looked[2].stop < 60 and len(model.stages[-1].clicks) == 2
    # From the click on, where the first answer held the bar to its end.
    ends = [max(np.nonzero(one.inside)[2]) + one.box[2].start for one in (alone, answer_of(model))]
    assert ends[0] > 125 and ends[1] < 118


@pytest.mark.slow
def test_click_by_click_the_model_is_that_of_all_clicks(image):
    """Also where a click on the object lies beside another object that was too far to be heard."""
    clicks = clicked(1, 2, 3)
    whole, model = whole_box(SHAPE), seeded_model([image], SPACING, clicks)
    local = LocalModel(LocalState.of(model), [image], SPACING, None, partial(seeded_model, [image], SPACING))
    counts = []
    later = ball("outside", (11, 8, 20), 1.0), ball("inside", (11, 15, 104), 2.0), ball("outside", (5, 15, 90), 1.0)
    for click in later:
        clicks = clicks.with_more([click])
        local.add(click)
        model, at_once = (seeded_model([image], SPACING, clicks, previous=before) for before in (model, None))
        assert local.field_on(whole).tobytes() == model.field.tobytes() == at_once.field.tobytes()
        counts.append(len(local.state.stages[-1].clicks))
    assert counts == [3, 5, 6] and len(local.state.clicks) == 6
