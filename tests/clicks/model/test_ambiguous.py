"""Ambiguous clicks: both sizes are named, the smaller is taken, and the result is never said to be good."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.api.segment import segment
from accelsurf.clicks.model import Scene, click_model
from accelsurf.clicks.model.answers import LIKELIEST, OF_ALIKE, Answer
from accelsurf.clicks.model.confidence import confidence_of
from accelsurf.clicks.model.even import PEOPLES, smaller_clicks
from accelsurf.clicks.model.windows import inscribed_radius, seed_of
from accelsurf.evolution.records import Stop
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.clicks import Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure.likely import UNSURE
from accelsurf.measure.quality import Judged, assess
from tests.support import clicked_balls
from tests.support.part_and_whole import CLICK, part_and_whole

SHAPE, SPACING = (1, 200, 210), (3.0, 0.5, 0.5)
MIDDLE = (0, 100, 105)
DONE = Stop("converged", 0, 0.0, "")


class AsTheClickSays:
    """A network by which an object is one and a half times as deep as the click says."""

    def probability(self, features, shape):
        is_near = np.broadcast_to(features["distance"] < np.log2(1.6), shape)
        return np.where(is_near, np.float32(0.9), np.float32(0.1))


ASKED = {"first": AsTheClickSays(), "later": AsTheClickSays()}


def scene():
    y, x = np.indices(SHAPE[1:])
    image = np.random.default_rng(1).normal(0.0, 0.1, SHAPE) + np.sin(0.2 * y) + np.cos(0.3 * x)
    return Scene((image.astype(np.float32),), SPACING)


def clicks(radius):
    return Clicks((clicked_balls.ball("inside", MIDDLE, radius, SHAPE, SPACING),), SHAPE)


def model(radius, **more):
    return click_model(scene(), clicks(radius), asked=ASKED, **more)


def judged(found):
    labels = found.inside_on(whole_box(SHAPE)).astype(np.uint8)
    clicked = found.clicks.mask("inside")
    return assess(
        Judged(
            labels,
            scene().images[0],
            Geometry(SHAPE, SPACING),
            [],
            DONE,
            clicked=clicked,
            confidence=confidence_of(found),
        )
    )


def test_a_click_larger_than_people_make_is_read_as_a_smaller_one_too():
    found, larger = model(9.0), model(9.0, answer=2)
    assert found.is_ambiguous and larger.is_ambiguous
    assert larger.count > 2 * found.count
    voxel = np.prod(SPACING)
    assert [answer.number for answer in found.answers] == [1, 2, 3]
    assert [answer.number for answer in larger.answers] == [2, 1, 3]
    for answers, first, second in (
        (found.answers, found, larger),
        (larger.answers, larger, found),
    ):
        assert answers[0].volume_mm3 == pytest.approx(first.count * voxel)
        assert answers[1].volume_mm3 == pytest.approx(second.count * voxel, rel=0.01)


@pytest.mark.parametrize("answer", [1, 2])
def test_an_ambiguous_result_is_never_said_to_be_good(answer):
    quality = judged(model(9.0, answer=answer))
    assert quality.is_ambiguous and quality.probability <= UNSURE
    (line,) = (line for line in quality.warnings if line.startswith("ambiguous: "))
    assert line.count(" mm2") == 2 and "--size" in line  # areas in an image of one slice
    assert f"--answer {3 - answer}" in line
    assert ("the smaller one was taken" in line) == (answer == 1)


@pytest.mark.parametrize("radius", [9.5, 12.0, 15.0, 24.0])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (2.0, 0.7, 0.7)])
def test_an_object_is_read_as_no_less_deep_than_the_click_in_it(radius, spacing):
    step = min(spacing)
    shape = tuple(int(2.2 * radius * step / h) + 3 for h in spacing)
    scene = Scene((np.zeros(shape, np.float32),), spacing)
    at = tuple(n // 2 for n in shape)
    seed = seed_of(clicked_balls.ball("inside", at, radius * step, shape, spacing), scene)
    likely, *others = smaller_clicks(seed, scene)
    assert likely.radius < 0.9 * seed.radius
    assert inscribed_radius(likely, scene) > 0.9 * seed.radius  # balls of voxels
    assert len(others) == (radius > 2 * PEOPLES)
    assert min(each.radius for each in (likely, *others)) == pytest.approx(PEOPLES * step, rel=0.1)


@pytest.mark.parametrize("radius", [20.0, 24.0])
def test_the_object_taken_is_as_deep_as_the_click_where_that_is_small_enough(radius):
    """By this network an object is 1.6 times as deep as a click says; that of a person's largest click is 22 deep."""
    found = model(radius * SPACING[1])
    depth = ndimage.distance_transform_edt(found.inside[0]).max()
    assert found.is_ambiguous and 1.3 * radius < depth < 1.8 * radius


def test_a_usual_click_and_a_stated_size_are_not_ambiguous():
    assert not model(3.5).is_ambiguous
    assert not model(9.0, size_mm3=500.0).is_ambiguous


@pytest.mark.parametrize("shape", [(1, 40, 40), (20, 30, 30)])
def test_the_surroundings_of_objects_are_ambiguous(shape):
    inside = np.ones(shape, bool)
    inside[:, 10:20, 10:20] = False
    geometry = Geometry(shape, (1.0, 1.0, 1.0))
    confident = confidence_of(model(3.5))._replace(overlap=1.0, spread=0.0)
    clicked = np.zeros(shape, bool)
    clicked[:, 3, 3] = True
    given = (inside.astype(np.uint8), inside.astype(np.float32), geometry, [], DONE)
    quality = assess(Judged(*given, clicked=clicked, confidence=confident))
    assert quality.is_ambiguous and quality.probability <= UNSURE
    assert [line for line in quality.warnings if "corners of the image" in line]
    other = assess(
        Judged((~inside).astype(np.uint8), *given[1:], clicked=~inside, confidence=confident)
    )
    assert not other.is_ambiguous


@pytest.mark.parametrize("shape", [(1, 60, 60), (20, 40, 40)])
@pytest.mark.parametrize("at", [0, -1])
@pytest.mark.parametrize("is_like", [True, False])
def test_a_part_of_the_air_beside_a_body_is_ambiguous(shape, at, is_like):
    """One corner is held; the others have its grey values, or they do not: then it is an object that is cut."""
    image = np.random.default_rng(4).normal(0.0, 1.0, shape)
    inside = np.zeros(shape, bool)
    near = slice(None, 14) if at == 0 else slice(-14, None)
    inside[:, near, near] = True
    image[:, 16:-16, 16:-16] += 50.0  # the body
    if not is_like:
        image[~inside] += 30.0
    confident = confidence_of(model(3.5))._replace(overlap=1.0, spread=0.0)
    clicked = inside & (np.indices(shape)[2] % 7 == 3)
    given = (inside.astype(np.uint8), image.astype(np.float32), Geometry(shape, (1.0, 1.0, 1.0)))
    quality = assess(Judged(*given, [], DONE, clicked=clicked, confidence=confident))
    assert quality.is_ambiguous == is_like
    assert bool([line for line in quality.warnings if "have its grey values" in line]) == is_like
    assert quality.probability <= UNSURE if is_like else quality.probability > UNSURE


@pytest.mark.parametrize("parts", [1, 3, 4, 6])
@pytest.mark.parametrize("times", [100, 300])
@pytest.mark.parametrize("on_border", [True, False])
def test_many_parts_far_larger_than_the_click_on_the_border_are_ambiguous(parts, times, on_border):
    shape = (24, 60, 24 * parts)
    inside = np.zeros(shape, bool)
    # Rods from face to face, or with ends a voxel apart from it; none has a corner of the image.
    ends = slice(None) if on_border else slice(2, -2)
    for part in range(parts):
        middle = 24 * part + 12
        inside[ends, 8:-8, middle - 8 : middle + 8] = True
    inside[:1, :1, :1] = True  # a speck is no part
    image = (inside * 50.0 + np.random.default_rng(5).normal(0.0, 1.0, shape)).astype(np.float32)
    clicked = np.zeros(shape, bool)
    clicked.reshape(-1)[np.flatnonzero(inside)[100 : 100 + inside.sum() // times]] = True
    confident = confidence_of(model(3.5))._replace(overlap=1.0, spread=0.0)
    quality = assess(
        Judged(
            inside.astype(np.uint8),
            image,
            Geometry(shape, (1.0, 1.0, 1.0)),
            [],
            DONE,
            clicked=clicked,
            confidence=confident,
        )
    )
    wanted = parts >= 4 and times >= 150 and on_border
    assert (quality.border_fraction > 0.2) == on_border
    assert quality.is_ambiguous == wanted
    assert bool([line for line in quality.warnings if f"in {parts} parts" in line]) == wanted


def test_sizes_of_answers_are_those_that_one_gets():
    image = part_and_whole()[0]
    first, second = (segment(image, inside=CLICK, answer=number) for number in (1, 2))
    for found, other in ((first, second), (second, first)):
        assert found.quality.answers[0].volume_mm3 == found.volume_mm3
        (said,) = (
            answer.volume_mm3
            for answer in found.quality.answers
            if answer.number == other.quality.answers[0].number
        )
        assert said == pytest.approx(other.volume_mm3, rel=0.05)


@pytest.mark.parametrize("thickness", [1.0, 6.0])
def test_of_one_slice_the_size_is_that_of_the_disc(thickness):
    shape, spacing = (1, 100, 110), (thickness, 0.5, 0.5)
    far = clicked_balls.distance((0, 50, 55), shape, spacing)
    image = (far <= 14) + np.random.default_rng(0).normal(0.0, 0.1, shape)
    found = segment(Volume.from_array(image.astype(np.float32), spacing), inside="ball:27.5,25,0,7")
    taken = found.quality.answers[0]
    assert taken.volume_mm3 / thickness == pytest.approx(np.pi * 14**2, rel=0.07)
    assert taken.volume_mm3 == pytest.approx(found.enclosed_mm2 * thickness)


@pytest.mark.parametrize("number", [LIKELIEST, OF_ALIKE])
@pytest.mark.parametrize("parts", [1, 2, 5])
def test_all_that_is_alike_says_how_many_parts_it_has(number, parts):
    inside = np.zeros((8, 20, 20 * parts), bool)
    for part in range(parts):
        inside[2:-2, 5:-5, 20 * part + 5 : 20 * part + 15] = True
    seen = inside.astype(np.uint8), inside.astype(np.float32), Geometry(inside.shape, (1, 1, 1))
    confident = confidence_of(model(3.5))._replace(answers=(Answer(None, 100.0, number),))
    notes = assess(Judged(*seen, [], DONE, clicked=inside, confidence=confident)).notes
    said = [note for note in notes if note.startswith("alike: ")]
    assert bool(said) == (number == OF_ALIKE and parts > 1)
    assert all(note.endswith(f"it has {parts} parts") for note in said)
