"""Answers to a click: all that is alike and connected, of a bent tube, what it meets, and where it may not go."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.api.segment import segment
from accelsurf.clicks.model import Scene, click_model
from accelsurf.clicks.model.answers import OF_ALIKE
from accelsurf.clicks.model.model import first_blocks
from accelsurf.clicks.model.windows import seed_of
from accelsurf.grid.boxes import bounding_box, whole_box
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import LeavesWindow, Window
from tests.support.part_and_whole import CLICK, part_and_whole


def tube(shape, spacing):
    """A helix of radius 3 around the middle, in mm, and a click in it of one voxel."""
    turn = np.linspace(0.0, 4.0 * np.pi, 400)
    extent = np.array(shape) * spacing
    middle = 0.5 * extent
    line = np.stack(
        [
            extent[0] * (0.1 + 0.8 * turn / turn[-1]),
            middle[1] + 0.3 * extent[1] * np.sin(turn),
            middle[2] + 0.3 * extent[2] * np.cos(turn),
        ],
        1,
    )
    index = np.rint(line / spacing).astype(int)
    mask = np.ones(shape, bool)
    mask[tuple(index.T)] = False
    truth = ndimage.distance_transform_edt(mask, sampling=spacing) <= 3.0
    return truth, tuple(int(i) for i in index[200])


def click(place, shape):
    box = tuple(slice(max(i - 1, 0), i + 2) for i in place)
    return Clicks((Click("inside", box, np.ones([s.stop - s.start for s in box], bool)),), shape)


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def shown(model):
    return model.inside_on(whole_box(model.clicks.shape))


CASES = [
    ((48, 64, 64), (1.0, 1.0, 1.0), 1.0),
    ((24, 64, 60), (2.0, 1.0, 1.0), 1.0),
    ((48, 64, 64), (1.0, 1.0, 1.0), -3.0),
]


@pytest.mark.parametrize(("shape", "spacing", "sign"), CASES)
def test_a_tube_is_followed_to_both_ends_whatever_its_sign(shape, spacing, sign):
    truth, place = tube(shape, np.array(spacing))
    noise = np.random.default_rng(0).normal(0.0, 0.2, shape)
    image = (sign * (ndimage.gaussian_filter(truth.astype(float), 0.5) + noise)).astype(np.float32)
    scene, clicks = Scene((image,), spacing), click(place, shape)
    likeliest, alike = click_model(scene, clicks), click_model(scene, clicks, answer=OF_ALIKE)
    assert dice(shown(alike), truth) > 0.9 and alike.count >= likeliest.count
    taken = alike.answers[0]
    assert (taken.number, taken.level) == (OF_ALIKE, None)
    assert taken.volume_mm3 == pytest.approx(alike.count * np.prod(spacing), rel=0.02)
    assert sorted(answer.number for answer in alike.answers) == sorted(
        a.number for a in likeliest.answers
    )
    # The sign of F is that of the object, and there is no second piece.
    assert np.array_equal(alike.field < 0, alike.inside) and ndimage.label(shown(alike))[1] == 1


def test_a_brighter_gap_ends_it_and_what_is_closed_stays_out():
    shape = (48, 64, 64)
    truth, place = tube(shape, np.ones(3))
    image = ndimage.gaussian_filter(truth.astype(np.float32), 0.5)
    image[32:35] = 3.0
    clicks = click(place, shape)
    assert not shown(click_model(Scene((image,), (1.0, 1.0, 1.0)), clicks, answer=OF_ALIKE))[
        32:
    ].any()
    image[32:35] = 0.0
    image += ndimage.gaussian_filter(truth.astype(np.float32), 0.5) * (image == 0.0)
    may = np.ones(shape, bool)
    may[:, :30] = False
    closed = click_model(Scene((image,), (1.0, 1.0, 1.0), may), clicks, answer=OF_ALIKE)
    seeded = clicks.clicks[0].mask_on(whole_box(shape))
    assert not (shown(closed) & ~may & ~seeded).any()


def test_channels_and_units_of_values_do_not_matter():
    shape = (40, 48, 48)
    truth, place = tube(shape, np.ones(3))
    image = truth + np.random.default_rng(1).normal(0.0, 0.1, shape)
    clicks = click(place, shape)
    usual = click_model(
        Scene((image.astype(np.float32),), (1.0, 1.0, 1.0)), clicks, answer=OF_ALIKE
    )
    scaled = (np.float32(64.0) * image.astype(np.float32) + np.float32(128.0)).astype(np.float32)
    other = click_model(Scene((scaled,), (1.0, 1.0, 1.0)), clicks, answer=OF_ALIKE)
    assert dice(shown(usual), shown(other)) > 0.99
    flat = np.random.default_rng(2).normal(0.0, 0.1, shape).astype(np.float32)
    two = click_model(
        Scene((flat, image.astype(np.float32)), (1.0, 1.0, 1.0)), clicks, answer=OF_ALIKE
    )
    assert dice(shown(two), truth) > 0.85


def test_a_part_of_a_larger_image_asks_for_more():
    shape, spacing = (48, 64, 200), (1.0, 1.0, 1.0)
    image = np.zeros(shape, np.float32)
    image[20:27, 28:35, 20:] = 1.0  # a rod that leaves the image on one side
    place = (23, 31, 60)
    whole = click_model(Scene((image,), spacing), click(place, shape), answer=OF_ALIKE)
    assert dice(shown(whole), image > 0.5) > 0.97
    box = (slice(0, 48), slice(0, 64), slice(0, 150))
    part = Scene((image[box],), spacing, None, Window(Geometry(shape, spacing), box))
    click_model(part, click(place, (48, 64, 150)))  # the likeliest answer is in it
    with pytest.raises(LeavesWindow):
        click_model(part, click(place, (48, 64, 150)), answer=OF_ALIKE)


def test_a_box_says_about_how_large_the_object_is():
    image, part, whole = part_and_whole()
    found = {}
    for name, mask in (("part", part), ("whole", whole)):
        box = (
            ",".join(
                str(n)
                for side in (0, 1)
                for n in ((s.start, s.stop - 1)[side] for s in bounding_box(mask)[::-1])
            )
            + "vox"
        )
        found[name] = segment(image, inside=CLICK, box=box).labels > 0
        assert dice(found[name], mask) > 0.8, name
    assert found["whole"].sum() > 1.3 * found["part"].sum()
    # A stated size says more.
    small = segment(image, inside=CLICK, box=box, size="1ml").labels > 0
    assert 500 < small.sum() * image.geometry.voxel_volume < 2000


@pytest.mark.parametrize(
    ("sizes", "wanted"), [(None, 1.0), ((0.5, 2.0), 1.0), ((0.1, 0.5), 0.5), ((3.0, 9.0), 3.0)]
)
def test_the_likeliest_answer_is_as_large_as_it_may_be(sizes, wanted):
    shape = (40, 40, 40)
    z, y, x = np.indices(shape) - 19.5
    far = np.sqrt(z**2 + y**2 + x**2)
    image = (1.0 / (1.0 + np.exp((far - 9.0) / 3.0))).astype(np.float32)  # no edge, but all levels
    clicks, free = click((19, 19, 19), shape), Scene((image,), (1.0, 1.0, 1.0))

    def on_blocks(scene):
        return first_blocks(scene, seed_of(clicks.clicks[0], scene)).answers[0].volume_mm3

    volume = on_blocks(free)
    scene = free if sizes is None else free._replace(sizes=(sizes[0] * volume, sizes[1] * volume))
    assert on_blocks(scene) == pytest.approx(wanted * volume)
