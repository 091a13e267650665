"""What an inside click adds far from it: held where it looks like the surroundings."""

import numpy as np
import pytest

from accelsurf.correct.local_model import LocalModel, LocalState
from accelsurf.energies.seeded import after_click, seeded_model
from accelsurf.energies.seeded.after_click import CLEAR_CONTRAST, neighbourhood, unlike_object
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.phantoms import recipes
from tests.support import clicked_balls

ONE = (1.0, 1.0, 1.0)


def shown(inside):
    return Shown(whole_box(inside.shape), np.where(inside, np.float32(-0.5), np.float32(0.5)), inside)


def plate(shape=(7, 10, 60), added=(30, 36)):
    """x, what was inside (x < 30), what is added to it, and a click at its beginning."""
    x = np.indices(shape)[2]
    place = *(slice(n // 2, n // 2 + 1) for n in shape[:2]), slice(1, 2)
    click = Click("inside", place, np.ones((1, 1, 1), bool))
    return x, x < 30, (x >= added[0]) & (x < added[1]), click


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [(7, 10, 60), (1, 10, 60)])
@pytest.mark.parametrize(("like", "held"), [(0.0, 1.0), (0.25, 1.0), (0.325, 0.5), (0.4, 0.0), (1.0, 0.0), (-1.0, 0.0)])
def test_what_looks_like_the_surroundings_is_held(shape, like, held):
    x, was, added, click = plate(shape)
    # Two values on either side, one apart: a spread of a half, a step of two.
    image = np.where(was, 3.0, 1.0) + np.where(np.indices(shape).sum(0) % 2, 0.5, -0.5)
    image[added] = 1.0 + 2.0 * like
    contrast = 2.0 / 0.5
    expected = held * contrast**2 / (contrast**2 + CLEAR_CONTRAST**2)
    for values in (image, 5.0 - 7.0 * image):
        found = unlike_object([values.astype(np.float32)], ONE, click, shown(was), shown(was | added))
        assert found == pytest.approx(expected, abs=0.02)


def test_the_channel_that_tells_them_apart_counts():
    x, was, added, click = plate()
    alike = np.random.default_rng(1).normal(0, 1, was.shape).astype(np.float32)
    told = (was + 0.01 * alike).astype(np.float32)
    for images in ([alike, told], [told, alike]):
        assert unlike_object(images, ONE, click, shown(was), shown(was | added)) > 0.99
    assert unlike_object([alike], ONE, click, shown(was), shown(was | added)) < 0.1
    assert unlike_object([np.zeros_like(alike)], ONE, click, shown(was), shown(was | added)) == 0.0


@pytest.mark.parametrize("spacing", [(3.0, 1.0, 1.0), (0.3, 1.0, 1.0)])
def test_a_slice_of_any_thickness_is_looked_at(spacing):
    _, was, added, click = plate((1, 10, 60))
    assert unlike_object([was.astype(np.float32)], spacing, click, shown(was), shown(was | added)) > 0.99


def test_what_is_added_where_the_object_cannot_be_is_not_looked_at():
    """A hole of the mask, filled: its values say nothing."""
    _, was, added, click = plate()
    hole = added & (np.indices(was.shape)[1] == 3)
    image = np.where(hole, np.float32(1e15), was.astype(np.float32))
    found = unlike_object([image], ONE, click, shown(was), shown(was | added), open=~hole)
    assert found > 0.99 and unlike_object([image], ONE, click, shown(was), shown(was | added)) == 0.0


def test_what_is_near_the_click_or_not_open_or_little_says_nothing():
    x, was, added, click = plate()
    image = was.astype(np.float32)
    near = Click("inside", click.box[:2] + (slice(31, 32),), click.mask)
    given = [image], ONE
    assert unlike_object(*given, click, shown(was), shown(was | added)) > 0.99
    # All that is added lies within 3.5 voxels in y and z, and x of this click.
    few = added & (np.abs(np.indices(was.shape)[1] - 5) < 2) & (np.abs(np.indices(was.shape)[0] - 3) < 2) & (x < 33)
    assert unlike_object(*given, near, shown(was), shown(was | few)) == 0.0
    one = added & (x == 30) & (np.indices(was.shape)[1] == 5) & (np.indices(was.shape)[0] < 4)
    assert 0 < one.sum() < 5 and unlike_object(*given, click, shown(was), shown(was | one)) == 0.0
    assert unlike_object(*given, click, shown(was), shown(was | added), open=x < 36) == 0.0
    assert unlike_object(*given, click, shown(was), shown(was)) == 0.0


@pytest.mark.parametrize("number", [2, 4])
def test_held_is_what_lies_beyond_the_clicks_own_neighbourhood(number):
    _, was, _, click = plate()
    whole = whole_box(was.shape)
    found = []
    for held in (0.0, 0.5, 1.0):
        near = neighbourhood(click, number, shown(was), ONE, was.shape, held).near
        found.append(np.ones(was.shape) if near is None else on_grid(near(whole), was.shape))
    free, half, none = (values[3, 5] for values in found)
    assert free[1] == half[1] == none[1] == 1.0 and free[20] > 0.2
    np.testing.assert_allclose(half[20:], 0.5 * free[20:], atol=1e-6)
    assert not none[20:].any()


def on_grid(near, shape):
    out = np.zeros(shape)
    out[near.box] = near.values
    return out


@pytest.fixture(scope="module")
def cube():
    """A cube in noise of its contrast; a click in its middle and one into a corner, which the noise hides."""
    recipe = recipes.load_recipe("cube")
    made, shape = recipes.make(recipe.changed(noise=recipe.contrast)), recipe.shape
    balls = ((31, 31, 31), 8.0), ((46, 17, 17), 0.6)
    clicks = tuple(clicked_balls.ball("inside", *one, shape, ONE) for one in balls)
    return made.image.as_float32(), made.truth.array > 0, clicks


def dice(one, other):
    return 2 * np.sum(one & other) / (one.sum() + other.sum())


def test_a_click_into_a_corner_adds_no_layer_all_around(cube, monkeypatch):
    image, truth, clicks = cube
    before = seeded_model([image], ONE, Clicks(clicks[:1], truth.shape))
    after = seeded_model([image], ONE, Clicks(clicks, truth.shape), previous=before)
    assert after.start[46, 17, 17] and dice(after.start, truth) > dice(before.start, truth) - 0.005 > 0.9
    local = LocalModel(LocalState.of(before), [image], ONE, None, lambda made: None)
    local.add(clicks[1])
    assert local.field_on(whole_box(truth.shape)).tobytes() == after.field.tobytes()
    monkeypatch.setattr(after_click, "unlike_object", lambda *_: 0.0)
    free = seeded_model([image], ONE, Clicks(clicks, truth.shape), previous=before)
    assert dice(free.start, truth) < dice(before.start, truth) - 0.02
