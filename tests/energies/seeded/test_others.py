"""Clicks inside other objects: near ones say where an object ends, far ones nothing, click by click as at once."""

from functools import partial

import numpy as np
import pytest

from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.contest import PATHS_REACH, box_around
from accelsurf.energies.seeded.others import heard
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Clicks
from accelsurf.segmentation.local_model import LocalModel, LocalState
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


def dice(one, other):
    return 2.0 * np.logical_and(one, other).sum() / (one.sum() + other.sum())


def test_far_objects_say_nothing_and_near_ones_where_this_one_ends(image):
    all_of_them, near = (seeded_model([image], SPACING, clicked(*ids)) for ids in ((1, 3, 2), (1, 2)))
    assert all_of_them.field.tobytes() == near.field.tobytes()
    assert len(all_of_them.clicks) == 3 and [len(stage.clicks) for stage in all_of_them.stages][-1] == 2
    alone, own = seeded_model([image], SPACING, clicked(1)), distance(PLACES[1]) < 7.5
    assert dice(near.start, own) > max(0.93, dice(alone.start, own))
    assert not near.start[distance(PLACES[2]) < 3].any()


def test_clicks_on_the_object_and_on_none_are_heard_from_afar(image):
    answer = answer_of(seeded_model([image], SPACING, clicked(1)))
    outside = ball("outside", (11, 15, 100), 2.0)
    on_none = ball("inside", (11, 15, 90), 2.0)._replace(id=0)
    of_another = on_none._replace(id=7)
    given = Clicks((ball("inside", PLACES[1], 3.0), outside, on_none, of_another), SHAPE).of(1)
    # What lies between the object and its own far click is looked at, and who is clicked there is heard.
    assert heard(given, answer, SPACING).clicks == given.clicks
    without = Clicks((given.clicks[0], given.clicks[3]), SHAPE)
    assert heard(without, answer, SPACING).clicks == given.clicks[:1]
    none = Clicks(given.clicks[1:], SHAPE)
    assert heard(none, answer, SPACING) is none


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
