"""A click in what is even is read as large as that: objects of one value, in noise, of any size, in 3D and 2D."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.api.segment import segment
from accelsurf.clicks.model import Scene, click_model
from accelsurf.clicks.model.even import FROM, as_large, homogeneous_ball
from accelsurf.clicks.model.windows import seed_of
from accelsurf.grid.boxes import bounding_box, whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import LeavesWindow, Window
from accelsurf.image.volume import Volume
from accelsurf.run.preprocessing import apply_filters, scale_of
from tests.support import clicked_balls

LOOKS = {
    "mask": lambda truth, noise: truth.astype(np.uint8),
    "mask of 255": lambda truth, noise: truth.astype(np.uint8) * 255,
    "floats": lambda truth, noise: (truth * 37.25 - 12.5).astype(np.float32),
    "dark": lambda truth, noise: np.where(truth, -300, -5).astype(np.int16),
    "saturated in noise": lambda truth, noise: np.where(
        truth, 255, np.clip(100 + 25 * noise, 0, 254)
    ).astype(np.uint8),
    "noise inside": lambda truth, noise: np.where(truth, 100 + 8 * noise, 20),
    "noise outside": lambda truth, noise: np.where(truth, 100, 20 + 8 * noise),
    "noise": lambda truth, noise: truth * 100 + 15 * noise,
}
GRIDS = (
    ((1, 120, 140), (1.0, 1.0, 1.0)),
    ((1, 90, 70), (5.0, 0.5, 0.5)),
    ((48, 44, 50), (1.0, 1.0, 1.0)),
    ((18, 50, 52), (3.0, 1.0, 1.0)),
)
CLICKS = ("point", "ball", "path")
SIZES = (0.17, 0.3, 0.45)
#: Where the middle lies: within the image, or so that its border cuts the object.
PLACES = (0.5, 0.15)


def drawn(shape, spacing, size, place, random):
    """A ball, in a slice a disc, and its depth."""
    sides = [n * h for n, h in zip(shape, spacing, strict=True) if n > 1]
    middle = [n // 2 for n in shape]
    middle[2] = int(place * shape[2])
    truth = clicked_balls.distance(middle, shape, spacing) <= size * min(sides)
    pad = [(1, 1) if n > 1 else (0, 0) for n in shape]
    depth = ndimage.distance_transform_edt(np.pad(truth, pad, mode="edge"), sampling=spacing)
    depth = depth[tuple(slice(a, a + n) for (a, _), n in zip(pad, shape, strict=True))]
    places = np.argwhere(depth > 0.6 * depth.max())
    return truth, tuple(int(i) for i in places[random.integers(len(places))])


def clicked(kind, at, truth, spacing):
    """A click in an object."""
    mask = np.zeros(truth.shape, bool)
    if kind == "ball":
        mask |= clicked_balls.distance(at, truth.shape, spacing) <= 2.5 * min(spacing[1:])
    elif kind == "path":
        mask[at[0], at[1], max(at[2] - 3, 0) : at[2] + 4] = True
    mask &= truth
    mask[at] = True
    box = bounding_box(mask)
    return Clicks((Click("inside", box, mask[box].copy()),), truth.shape)


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def scene_of(image, spacing):
    values = np.array(image, np.float32)
    return Scene((apply_filters(values, scale_of(values)),), spacing)


@pytest.mark.sampled
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", CLICKS)
@pytest.mark.parametrize(("shape", "spacing"), GRIDS)
@pytest.mark.parametrize("look", LOOKS)
def test_an_object_in_which_nothing_differs_is_found(look, shape, spacing, kind, size, place):
    random = np.random.default_rng(
        [len(look), shape[1], int(100 * size), int(100 * place), len(kind)]
    )
    truth, at = drawn(shape, spacing, size, place, random)
    image = LOOKS[look](truth, random.normal(size=shape))
    model = click_model(scene_of(image, spacing), clicked(kind, at, truth, spacing))
    assert dice(model.inside_on(whole_box(shape)), truth) > 0.9


@pytest.mark.parametrize("radius", [2.0, 4.0, 6.0])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_click_in_a_small_object_is_read_as_it_is(radius, noise):
    shape, spacing = (40, 44, 46), (1.0, 1.0, 1.0)
    truth = clicked_balls.distance((20, 22, 23), shape, spacing) <= radius
    image = truth + np.random.default_rng(3).normal(0.0, noise, shape)
    scene = Scene((image.astype(np.float32),), spacing)
    seed = seed_of(clicked("point", (20, 22, 23), truth, spacing).clicks[0], scene)
    found = homogeneous_ball(scene, seed)
    assert found is None or found.radius < FROM
    assert as_large(seed, scene) == (seed, None, False)


def test_the_ball_moves_to_where_it_is_largest_and_stays_around_the_click():
    shape, spacing = (1, 120, 120), (1.0, 1.0, 1.0)
    truth = clicked_balls.distance((0, 60, 60), shape, spacing) <= 40
    image = truth + np.random.default_rng(4).normal(0.0, 0.1, shape)
    scene = Scene((image.astype(np.float32),), spacing)
    found = homogeneous_ball(
        scene, seed_of(clicked("point", (0, 60, 85), truth, spacing).clicks[0], scene)
    )
    assert 30 < found.radius < 44
    assert np.hypot(*(found.middle[1:] - 60)) < 10


def test_where_nothing_differs_in_the_image_a_click_stays_as_it_is():
    shape, spacing = (24, 44, 46), (2.0, 1.0, 1.0)
    noise = np.random.default_rng(0).normal(0.0, 1.0, shape).astype(np.float32)
    scene = Scene((noise,), spacing)
    seed = seed_of(clicked_balls.ball("inside", (12, 20, 22), 4.5, shape, spacing), scene)
    assert as_large(seed, scene) == (seed, None, False)


def test_what_is_even_up_to_a_window_of_the_image_asks_for_more():
    shape, spacing = (1, 100, 300), (1.0, 1.0, 1.0)
    truth = clicked_balls.distance((0, 50, 150), shape, spacing) <= 35
    image = truth.astype(np.float32)
    clicks = clicked("point", (0, 50, 150), truth, spacing)
    box = (slice(0, 1), slice(0, 100), slice(120, 180))
    part = Scene((image[box],), spacing, None, Window(Geometry(shape, spacing), box))
    local = Click("inside", (slice(0, 1), slice(50, 51), slice(30, 31)), np.ones((1, 1, 1), bool))
    with pytest.raises(LeavesWindow):
        click_model(part, Clicks((local,), (1, 100, 60)))
    assert (
        dice(click_model(Scene((image,), spacing), clicks).inside_on(whole_box(shape)), truth)
        > 0.98
    )


@pytest.mark.parametrize("shape", [(48, 48, 48), (1, 96, 100)])
def test_a_point_in_a_mask_gives_the_mask_and_no_word_of_background(shape):
    middle = tuple(n // 2 for n in shape)
    truth = clicked_balls.distance(middle, shape, (1.0, 1.0, 1.0)) <= min(shape[1:]) / 3
    z, y, x = middle
    found = segment(Volume.from_array(truth.astype(np.uint8), 1.0), inside=f"point:{x},{y},{z}vox")
    assert dice(found.labels > 0, truth) > 0.99
    assert not [line for line in found.warnings if "background" in line]
    assert found.quality.probability > 0.7


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_short_stroke_near_a_corner_is_read_as_a_point_there_is(seed, noise):
    """The ball in which nothing differs has moved inwards, and the stroke reaches out of it."""
    shape, spacing = (1, 110, 120), (1.0, 1.0, 1.0)
    random = np.random.default_rng(seed)
    truth = np.zeros(shape, bool)
    truth[:, 25:85, 30:90] = True
    scene = Scene(((truth + random.normal(0.0, noise, shape)).astype(np.float32),), spacing)
    at = (0, int(random.integers(29, 33)), int(random.integers(33, 37)))
    point, stroke = (
        seed_of(clicked(kind, at, truth, spacing).clicks[0], scene) for kind in ("point", "path")
    )
    read = as_large(stroke, scene)
    assert read.seed.radius > 2 * stroke.radius
    assert read.seed.radius == pytest.approx(as_large(point, scene).seed.radius, rel=0.3)
