"""What the probability says of objects of which it was wrong once: it is low where the result is bad."""

import numpy as np
import pytest

import accelsurf
from accelsurf.clicks.model import Scene, click_model
from accelsurf.clicks.model.confidence import confidence_of
from accelsurf.evolution.records import Stop
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.measure import likely
from accelsurf.measure.metrics import dice
from accelsurf.measure.quality import Judged, assess

SIDE, SPACING = 64, (1.0, 1.0, 1.0)
#: From this probability on a result is said to be good; it is from this Dice on, and failed below the other.
SAID, GOOD, FAILED = 0.7, 0.8, 0.6
DONE = Stop("converged", 0, 0.0, "")


def drawn(name):
    """The truth of a case, and all that is bright."""
    z, y, x = np.ogrid[tuple(slice(-0.5 * (SIDE - 1), 0.5 * SIDE, 1.0) for _ in range(3))]
    ring = np.sqrt(x**2 + y**2)
    cubes = [np.maximum(np.maximum(np.abs(z), np.abs(y)), np.abs(x - c)) < 3.2 for c in (-9.0, 9.0)]
    wavy = (y - 10 * np.sin(x / 8)) ** 2 + (z - 6 * np.cos(x / 6)) ** 2
    truth = {
        "most of the image": (np.abs(z) ** 4 + np.abs(y) ** 4 + np.abs(x) ** 4) ** 0.25 < 33.0,
        "all but a ball": (z - 10) ** 2 + (y + 5) ** 2 + (x - 8) ** 2 > 19.3**2,
        "two cubes": cubes[0] | cubes[1],
        "cube": cubes[0],
        "wavy tube": (wavy < 16) & (np.abs(x) < 30),
        "torus": (ring - 18) ** 2 + z**2 < 36,
        "thin torus": (ring - 22) ** 2 + z**2 < 9,
        "ball": z**2 + y**2 + x**2 < 225,
        "air": z**2 + y**2 + x**2 < 225,
        "nothing": z**2 + y**2 + x**2 < 225,
    }[name]
    bright = {"cube": cubes[0] | cubes[1], "nothing": np.zeros_like(truth)}.get(name, truth)
    return truth, bright


def clicked(place, radius):
    """A ball of voxels."""
    grid = np.ogrid[tuple(slice(0, SIDE) for _ in range(3))]
    return sum((axis - at) ** 2 for axis, at in zip(grid, place, strict=True)) <= radius**2


def first_answer(name, noise):
    """Dice and quality after a click in the middle of a case."""
    from scipy import ndimage

    truth, bright = drawn(name)
    image = (
        100.0 * bright + np.random.default_rng(3).normal(0, noise, truth.shape)
        if noise
        else 100.0 * bright
    )
    depth = ndimage.distance_transform_edt(np.pad(truth, 1))[1:-1, 1:-1, 1:-1]
    place = np.unravel_index(int(depth.argmax()), depth.shape) if name != "air" else (6, 6, 6)
    mask = clicked(place, min(0.5 * depth.max(), 8.0) if name != "air" else 3.0)
    model = click_model(
        Scene((image.astype(np.float32),), SPACING),
        Clicks((Click("inside", whole_box(mask.shape), mask),), truth.shape),
    )
    labels = model.inside_on(whole_box(truth.shape))
    seen = (
        labels.astype(np.uint8),
        image.astype(np.float32) / 100.0,
        Geometry(truth.shape, SPACING),
        [],
        DONE,
    )
    return dice(labels, truth), assess(Judged(*seen, clicked=mask, confidence=confidence_of(model)))


@pytest.mark.parametrize("noise", [0.0, 5.0])
@pytest.mark.parametrize(
    "name", ["most of the image", "all but a ball", "wavy tube", "thin torus", "air"]
)
def test_a_failure_is_not_said_to_be_good(name, noise):
    value, found = first_answer(name, noise)
    assert value >= FAILED or found.probability < SAID
    warned = [line for line in found.warnings if line.startswith("doubt: probably not right (")]
    named = [line for line in found.warnings if line.startswith("ambiguous: ")]
    assert bool(named) == found.is_ambiguous
    is_low = found.probability < likely.warning_threshold(found)
    assert bool(warned or named) == is_low and not (warned and named)


def test_what_a_click_in_mere_noise_finds_is_not_said_to_be_good():
    _, found = first_answer("nothing", 5.0)
    assert found.probability < SAID


def test_a_clear_ball_is_said_to_be_good_and_part_of_a_torus_less_so():
    value, ball = first_answer("ball", 5.0)
    assert value > 0.95 and ball.probability >= SAID and ball.warnings == ()
    value, torus = first_answer("torus", 5.0)
    assert value >= GOOD or torus.probability < ball.probability


def test_nobody_knows_from_a_click_in_a_cube_that_both_are_meant():
    (alone, _), (both, _) = first_answer("cube", 5.0), first_answer("two cubes", 5.0)
    assert alone > 0.95 and both < 0.7


def test_clicks_in_two_separate_objects_name_the_option_for_several():
    z, y, x = np.indices((24, 24, 48)) - 11.5
    balls = (z**2 + y**2 + x**2 < 49) | (z**2 + y**2 + (x - 24) ** 2 < 49)
    image = np.float32(100.0 * balls)
    near, far = "ball:11.5,11.5,11.5,3vox", "ball:35.5,11.5,11.5,3vox"
    found = [
        accelsurf.segment(image, inside=clicks, threads=1).quality.notes
        for clicks in (near, (near, far))
    ]
    assert not any("parts:" in note for note in found[0])
    assert [
        note for note in found[1] if "2 separate parts were clicked" in note and "--objects" in note
    ]
