"""ClickSession: the object is that of the clicks, whatever was done and undone before."""

import numpy as np
import pytest

import accelsurf
from accelsurf.api import click_session
from accelsurf.errors import GeometryError, InputError
from accelsurf.run.preprocessing import preprocess
from accelsurf.settings import budgets

SHAPE, MIDDLES, RADIUS = (24, 40, 28), ((12, 11, 14), (12, 27, 14)), 8.0


def balls(shape=SHAPE, middles=MIDDLES):
    """Two equal balls that touch, in noise, and which voxels are the first one's."""
    places = np.indices(shape)
    inside = [
        sum((axis - at) ** 2 for axis, at in zip(places, middle, strict=True)) < RADIUS**2
        for middle in middles
    ]
    noise = np.random.default_rng(7).normal(0, 6, shape)
    return (100.0 * (inside[0] | inside[1]) + noise).astype(np.float32), inside[0]


def cube(side, middle, reach=2):
    box = tuple(slice(at - reach, at + reach + 1) for at in middle)
    return accelsurf.Click(side, box, np.ones((2 * reach + 1,) * 3, bool))


CLICKS = [cube("inside", MIDDLES[0]), cube("outside", MIDDLES[1]), cube("inside", (12, 5, 14), 1)]


def played(*steps):
    session = accelsurf.ClickSession(balls()[0])
    for step in steps:
        session.add(step)
    return session


def dice(first, second):
    return (
        2 * np.count_nonzero(first & second) / (np.count_nonzero(first) + np.count_nonzero(second))
    )


def test_an_inside_and_an_outside_click_tell_one_ball_from_the_other():
    session = played([CLICKS[0], CLICKS[1]])
    assert dice(session.labels > 0, balls()[1]) > 0.9


def test_the_labels_are_the_first_surface_of_a_run_with_the_same_clicks():
    image, _ = balls()
    config = accelsurf.RunConfig(start=("clicks",), energy="seeded")
    _, psi = preprocess([accelsurf.Volume.from_array(image)], config, clicks=CLICKS[:2])
    assert np.array_equal(psi < 0, played(CLICKS[:2]).labels > 0)


def test_steps_alone_and_together_give_the_same_bytes():
    alone, together = played(*[[click] for click in CLICKS]), played(CLICKS)
    assert np.array_equal(alone.labels, together.labels)
    assert (alone.count, together.count) == (3, 1)


@pytest.mark.parametrize("memory", [click_session.STORED_BYTES, 0])
def test_every_step_is_undone_whether_its_model_is_in_memory_or_made_again(monkeypatch, memory):
    monkeypatch.setattr(click_session, "STORED_BYTES", memory)
    session, before = accelsurf.ClickSession(balls()[0]), []
    given = np.zeros(SHAPE, np.uint8)
    given[8:16, 8:16, 8:16] = 5
    for step in ([CLICKS[0]], [CLICKS[1]], given, [CLICKS[2]], [cube("outside", (12, 12, 9), 1)]):
        before.append(session.labels)
        session.start_from(step) if isinstance(step, np.ndarray) else session.add(step)
    while session.count:
        shown, wanted = session.labels, before.pop()
        changed = session.undo()
        assert np.array_equal(session.labels, wanted)
        if changed is not None:
            shown[changed] = session.labels_on(changed)  # nothing has changed beyond the box
        assert np.array_equal(shown, wanted)
    assert session.undo() is None
    assert not before


def test_the_box_of_a_step_holds_what_has_changed_and_no_margin():
    session, shown = accelsurf.ClickSession(balls()[0]), np.zeros(SHAPE, np.uint8)
    for click in CLICKS:
        before = shown.copy()
        changed = session.add([click])
        if changed is not None:
            shown[changed] = session.labels_on(changed)
            places = np.argwhere(shown != before)
            box = zip(places.min(axis=0), places.max(axis=0) + 1, strict=True)
            assert [(side.start, side.stop) for side in changed] == [
                (int(a), int(b)) for a, b in box
            ]
        assert np.array_equal(shown, session.labels)
    assert session.clear() is not None
    assert not session.labels.any()


def test_given_labels_stay_where_no_click_corrects_them():
    image, ball = balls()
    session, given = accelsurf.ClickSession(image), ball.copy()
    given[:, :8] = False  # cut
    session.start_from(given)
    assert np.array_equal(session.labels > 0, given)
    session.add([cube("inside", (12, 6, 14), 1)])
    assert dice(session.labels > 0, ball) > dice(given, ball)
    assert (session.labels[given] == 1).all()


def test_nothing_clicked_inside_is_no_object():
    session = played([CLICKS[1]])
    assert not session.labels.any()
    session.add([CLICKS[0]])
    assert np.array_equal(session.labels, played([CLICKS[1], CLICKS[0]]).labels)
    session.add([cube("outside", MIDDLES[0])])  # it takes all that was clicked inside
    assert not session.labels.any()


def test_channels_and_spacing_are_used():
    image, ball = balls()
    plain = accelsurf.ClickSession(
        np.random.default_rng(1).normal(0, 1, SHAPE), channels=[image], spacing=(2, 1, 1)
    )
    plain.add(CLICKS[:2])
    assert dice(plain.labels > 0, ball) > 0.8
    assert plain.geometry.spacing == (2.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("click", "message"),
    [
        (CLICKS[0]._replace(mask=np.zeros((5, 5, 5), bool)), "no voxel"),
        (CLICKS[0]._replace(mask=np.ones((4, 5, 5), bool)), "does not fit"),
        (cube("inside", (1, 10, 10)), "does not fit"),
        (cube("inside", (12, 39, 10)), "does not fit"),
        (CLICKS[0]._replace(box=(slice(None),) * 3), "does not fit"),
    ],
)
def test_clicks_that_cannot_be_are_refused_and_change_nothing(click, message):
    session = played([CLICKS[0]])
    before = session.labels
    with pytest.raises(InputError, match=message):
        session.add([CLICKS[1], click])
    assert session.count == 1
    assert np.array_equal(session.labels, before)


def test_labels_of_another_shape_and_clicks_beyond_the_memory_are_refused(monkeypatch):
    session = played([CLICKS[0]])
    with pytest.raises(GeometryError, match="labels"):
        session.start_from(np.ones((3, 3, 3)))
    monkeypatch.setattr(
        click_session.budgets, "SESSION_CLICKS", budgets.Budget("clicks", 200, "bytes", "clear")
    )
    with pytest.raises(InputError, match="at most 200"):
        session.add([CLICKS[1]])
    session.undo()
    session.add([CLICKS[1]])  # what was undone counts no more
    assert session.count == 1
