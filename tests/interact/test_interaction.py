"""Interaction: the objects are those of `segment` and `refine`, whatever was done and undone before."""

import numpy as np
import pytest

import accelsurf
from accelsurf.errors import AccelsurfError, GeometryError, InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.interact import interaction
from accelsurf.settings import budgets
from accelsurf.text.voxel_lists import click_of_voxels_text, voxels_text

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


INSIDE, OUTSIDE = cube("inside", MIDDLES[0]), cube("outside", MIDDLES[1])
MORE = cube("inside", (12, 5, 14), 1)
#: Gestures: keywords of `Interaction.add`.
GESTURES = [{"inside": INSIDE}, {"outside": OUTSIDE}, {"inside": MORE}]


def played(*gestures):
    found = accelsurf.Interaction(balls()[0])
    for gesture in gestures:
        found.add(**gesture)
    return found


def dice(first, second):
    return (
        2 * np.count_nonzero(first & second) / (np.count_nonzero(first) + np.count_nonzero(second))
    )


def test_an_inside_and_an_outside_click_tell_one_ball_from_the_other():
    assert dice(played(*GESTURES[:2]).labels > 0, balls()[1]) > 0.9


def test_gestures_give_the_bytes_of_segment_and_refine():
    image, _ = balls()
    result = accelsurf.segment(image, inside=voxels_text(INSIDE))
    assert np.array_equal(played(GESTURES[0]).labels, result.labels)
    for gesture in GESTURES[1:]:
        result = accelsurf.refine(result, **{s: voxels_text(c) for s, c in gesture.items()})
    found = played(*GESTURES)
    assert np.array_equal(found.labels, result.labels)
    assert found.result.psi.tobytes() == result.psi.tobytes()


def test_the_settings_of_the_result_repeat_every_gesture():
    found = played(*GESTURES)
    again = accelsurf.segment(balls()[0], config=found.result.config)
    assert np.array_equal(again.labels, found.labels)


def test_corrections_alone_and_together_give_the_same_bytes():
    alone = played(*GESTURES)
    together = played(GESTURES[0], {"inside": MORE, "outside": OUTSIDE})
    in_this_order = played(GESTURES[0], GESTURES[2], GESTURES[1])
    assert np.array_equal(together.labels, in_this_order.labels)
    assert (alone.count, together.count) == (3, 2)


def test_every_gesture_is_undone():
    found, before = accelsurf.Interaction(balls()[0]), []
    given = np.zeros(SHAPE, np.uint8)
    given[8:16, 8:16, 8:16] = 1
    gestures = [*GESTURES[:2], given, GESTURES[2], {"outside": cube("outside", (12, 12, 9), 1)}]
    for gesture in gestures:
        before.append(found.labels.copy())
        found.start_from(gesture) if isinstance(gesture, np.ndarray) else found.add(**gesture)
    while found.count:
        shown, wanted = found.labels.copy(), before.pop()
        changed = found.undo()
        assert np.array_equal(found.labels, wanted)
        if changed is not None:
            shown[changed] = found.labels_on(changed)  # nothing has changed beyond the box
        assert np.array_equal(shown, wanted)
    assert found.undo() is None
    assert not before


def test_the_box_of_a_gesture_holds_what_has_changed():
    found, shown = accelsurf.Interaction(balls()[0]), np.zeros(SHAPE, np.uint8)
    for gesture in GESTURES:
        changed = found.add(**gesture)
        if changed is not None:
            shown[changed] = found.labels_on(changed)
        assert np.array_equal(shown, found.labels)
    assert found.clear() is not None
    assert not found.labels.any() and found.count == 0


def test_given_labels_stay_where_no_click_corrects_them():
    image, ball = balls()
    found, given = accelsurf.Interaction(image), ball.copy()
    given[:, :8] = False  # cut
    found.start_from(given)
    assert np.array_equal(found.labels > 0, given)
    found.add(inside=cube("inside", (12, 6, 14), 1))
    assert dice(found.labels > 0, ball) > dice(given, ball)
    assert (found.labels[given] == 1).all()


def test_clicks_outside_wait_for_an_object():
    found = played(GESTURES[1])
    assert not found.labels.any() and found.result is None
    found.add(**GESTURES[0])
    image, _ = balls()
    clicks = {"inside": voxels_text(INSIDE), "outside": voxels_text(OUTSIDE)}
    assert np.array_equal(found.labels, accelsurf.segment(image, **clicks).labels)
    with pytest.raises(InputError, match="nothing would be left"):
        found.add(outside=cube("outside", MIDDLES[0]))
    assert found.count == 2 and found.labels.any()


def test_a_size_and_another_answer_begin_anew_and_objects_stand_beside():
    image, ball = balls()
    found = accelsurf.Interaction(image)
    found.add(inside=INSIDE)
    found.segment(INSIDE, size=f"{np.count_nonzero(ball)}mm3")
    assert dice(found.labels > 0, ball) > 0.9
    found.apply(accelsurf.Correction(new=2, inside=(voxels_text(cube("inside", MIDDLES[1])),)))
    assert set(np.unique(found.labels)) == {0, 1, 2}
    found.undo()
    assert set(np.unique(found.labels)) == {0, 1}


def test_channels_and_spacing_are_used():
    image, ball = balls()
    found = accelsurf.Interaction(
        np.random.default_rng(1).normal(0, 1, SHAPE), channels=[image], spacing=(2, 1, 1)
    )
    found.add(INSIDE, OUTSIDE)
    assert dice(found.labels > 0, ball) > 0.8
    assert found.geometry.spacing == (2.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("click", "message"),
    [
        (INSIDE._replace(mask=np.zeros((5, 5, 5), bool)), "no voxel"),
        (INSIDE._replace(mask=np.ones((4, 5, 5), bool)), "does not fit"),
        (cube("inside", (1, 10, 10)), "does not fit"),
        (cube("inside", (12, 39, 10)), "does not fit"),
        (INSIDE._replace(box=(slice(None),) * 3), "does not fit"),
    ],
)
def test_clicks_that_cannot_be_are_refused_and_change_nothing(click, message):
    found = played(GESTURES[0])
    before = found.labels
    with pytest.raises(InputError, match=message):
        found.add(click, OUTSIDE)
    assert found.count == 1
    assert np.array_equal(found.labels, before)


def test_labels_of_another_shape_and_clicks_beyond_the_memory_are_refused(monkeypatch):
    found = played(GESTURES[0])
    with pytest.raises(GeometryError, match="labels"):
        found.start_from(np.ones((3, 3, 3)))
    small = budgets.Budget("clicks", 60, "bytes", "clear")
    monkeypatch.setattr(interaction.budgets, "SESSION_CLICKS", small)
    with pytest.raises(InputError, match="at most 60"):
        found.add(outside=OUTSIDE)
    found.undo()
    found.add(**GESTURES[0])  # what was undone counts no more
    assert found.count == 1


# ---------------------------------------------------------------------------------------------- voxels as a text


@pytest.mark.parametrize("seed", range(8))
def test_a_click_of_any_voxels_is_written_and_read(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(1, 24, 3))
    low = [int(rng.integers(0, n)) for n in shape]
    box = tuple(slice(a, int(rng.integers(a + 1, n + 1))) for a, n in zip(low, shape, strict=True))
    mask = rng.random([s.stop - s.start for s in box]) < rng.random()
    mask[0, 0, 0] = True
    side = ("inside", "outside")[seed % 2]
    grid = Geometry(shape, (1.0, 2.0, 0.5))
    read = click_of_voxels_text(voxels_text(accelsurf.Click(side, box, mask)), side, grid, 3)
    assert (read.side, read.box, read.id) == (side, box, 3) and np.array_equal(read.mask, mask)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text[:-6],
        lambda text: text + "AAAA",
        lambda text: text.replace(";5,5,5;", ";5,5;"),
        lambda text: text.replace(";5,5,5;", ";50000,50000,50000;"),
        lambda text: text.replace(";5,5,5;", ";5,5,4;"),
        lambda text: text.replace(";5,5,5;", ";5,5,-5;"),
        lambda text: text.replace("voxels:1", "voxels:-1"),
        lambda text: text.replace("voxels:1", "voxels:99999"),
        lambda text: text.partition(";")[0],
        lambda text: "voxels:",
        lambda text: "voxels:0,0,0;5,5,5;@@@@",
        lambda text: voxels_text(INSIDE._replace(mask=np.zeros((5, 5, 5), bool))),
        lambda text: "voxels:0,0,0;5,5,5;" + "A" * (1 << 18),
    ],
)
def test_a_damaged_text_of_voxels_is_a_line(change):
    text = change(voxels_text(INSIDE))
    with pytest.raises((UsageError, InputError)) as caught:
        accelsurf.segment(balls()[0], inside=text)
    assert isinstance(caught.value, AccelsurfError) and len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("correction", "words"),
    [
        ({"nearr": 3}, "nearr: there is no such setting"),
        ({"near": -1.0}, "near -1.0 was given"),
        ({"merge": (1, 2)}, "was given with merge"),
    ],
)
def test_a_correction_that_is_none_is_refused_and_changes_nothing(correction, words):
    found = played(GESTURES[0])
    before = found.labels.copy()
    with pytest.raises(accelsurf.UsageError, match=words):
        found.add(outside=OUTSIDE, **correction)
    assert found.count == 1 and np.array_equal(found.labels, before)
