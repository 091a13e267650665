"""Windows of blocks: how a click is read, what a window holds, channels in one."""

import numpy as np
import pytest

from accelsurf.clicks.model.windows import SCALES, Scene, seed_of, window_around
from accelsurf.grid.boxes import bounding_box, box_at
from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import LeavesWindow, Window

SHAPE = (30, 40, 50)


def scene(spacing=(1.0, 1.0, 1.0), shape=SHAPE, **more):
    return Scene((np.zeros(shape, np.float32),), spacing, **more)


def ball(middle, radius, spacing=(1.0, 1.0, 1.0), shape=SHAPE, side="inside"):
    squares = (
        ((np.arange(n) - m) * h) ** 2 for n, m, h in zip(shape, middle, spacing, strict=True)
    )
    z, y, x = np.meshgrid(*squares, indexing="ij", sparse=True)
    mask = z + y + x <= radius**2
    box = bounding_box(mask)
    return Click(side, box, mask[box].copy())


@pytest.mark.parametrize("radius", [1.0, 2.0, 3.5, 6.0])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.25, 0.25, 0.25)])
def test_a_ball_has_its_middle_and_radius(radius, spacing):
    seed = seed_of(ball((15, 20, 25), radius * spacing[0], spacing), scene(spacing))
    assert seed.core[0].tolist() == [15, 20, 25]
    assert seed.radius == pytest.approx(radius * spacing[0], rel=0.2) and not seed.is_limited


def test_a_ball_that_the_image_cuts_off_is_as_wide_as_a_whole_one():
    whole, cut = (seed_of(ball((z, 20, 25), 6.0), scene()) for z in (15, 0))
    assert cut.radius == pytest.approx(whole.radius, rel=0.05) and cut.core[0].tolist() == [
        0,
        20,
        25,
    ]


def test_large_clicks_and_points_are_limited():
    assert seed_of(ball((15, 20, 25), 8.0), scene()).is_limited
    assert seed_of(ball((15, 20, 25), 0.0), scene()).is_limited


def test_a_stroke_has_a_line_and_the_width_of_its_pen():
    mask = np.zeros(SHAPE, bool)
    for x in range(10, 40):
        z, y, x_ = np.ogrid[:30, :40, :50]
        mask |= (z - 15) ** 2 + (y - 20) ** 2 + (x_ - x) ** 2 <= 9.0
    box = bounding_box(mask)
    seed = seed_of(Click("inside", box, mask[box].copy()), scene())
    assert 2.5 <= seed.radius <= 3.7
    assert np.ptp(seed.core[:, 2]) >= 25 and (seed.core[:, :2] == [15, 20]).all()
    window = window_around(scene(), [seed], SCALES[0])
    far = window.distance_to(seed)
    assert far[window.mine].max() <= seed.radius + window.width


def test_in_one_slice_a_disc():
    flat = scene(shape=(1, 40, 50), spacing=(9.0, 1.0, 1.0))
    seed = seed_of(ball((0, 20, 25), 5.0, flat.spacing, (1, 40, 50)), flat)
    assert seed.radius == pytest.approx(5.0, rel=0.1)
    window = window_around(flat, [seed], SCALES[0])
    assert window.values.shape[0] == 1
    assert window.count_of_ball == pytest.approx(np.pi * 100 / window.size[1] ** 2, rel=0.1)
    assert not window.faces[:, 1:-1, 1:-1].any()


def test_all_of_an_image_may_be_clicked():
    seed = seed_of(
        Click("inside", box_at((0, 0, 0), (4, 5, 6)), np.ones((4, 5, 6), bool)),
        scene(shape=(4, 5, 6)),
    )
    assert seed.radius > 0 and len(seed.core)


def test_faces_are_open_where_the_image_goes_on_and_blocks_are_closed_where_nothing_may_be():
    may = np.ones(SHAPE, bool)
    may[:, :, 30:] = False
    seed = seed_of(ball((3, 20, 25), 2.0), scene())
    window = window_around(scene(open=may), [seed], SCALES[0])
    assert not window.faces[0, 1:-1, 1:-1].any() and window.faces[-1].all()
    assert window.closed[:, :, -1].all() and not window.closed[:, :, 0].any()


def test_a_part_of_an_image_has_the_windows_of_the_whole_or_says_that_it_is_too_small():
    random = np.random.default_rng(0)
    image = random.normal(size=(60, 70, 80)).astype(np.float32)
    geometry = Geometry(image.shape, (1.0, 1.0, 1.0))
    click = ball((30, 35, 41), 2.0, shape=image.shape)
    whole_scene = Scene((image,), geometry.spacing)
    whole = window_around(whole_scene, [seed_of(click, whole_scene)], SCALES[0])
    for low, high, fits in ((0, 60, True), (20, 42, False), (1, 60, True)):
        box = slice(low, high), slice(0, 70), slice(0, 80)
        part = Scene((image[box],), geometry.spacing, None, Window(geometry, box))
        moved = click._replace(
            box=(slice(click.box[0].start - low, click.box[0].stop - low), *click.box[1:])
        )
        if not fits:
            with pytest.raises(LeavesWindow):
                window_around(part, [seed_of(moved, part)], SCALES[0])
            continue
        found = window_around(part, [seed_of(moved, part)], SCALES[0])
        for name in ("values", "mine", "faces"):
            assert np.array_equal(getattr(found, name), getattr(whole, name))


def test_channels_are_combined_to_what_tells_the_click_apart():
    random = np.random.default_rng(0)
    inside = np.zeros(SHAPE, bool)
    inside[10:20, 14:26, 18:32] = True
    noise, told = random.normal(size=SHAPE), inside + 0.3 * random.normal(size=SHAPE)
    images = tuple(image.astype(np.float32) for image in (noise, told, -2.0 * told))
    both = Scene(images[:2], (1.0, 1.0, 1.0))
    window = window_around(both, [seed_of(ball((15, 20, 25), 3.0), both)], SCALES[1])
    assert abs(window.weights[1]) > 3 * abs(window.weights[0])
    assert np.array_equal(
        window.image_on(box_at((1, 2, 3), (4, 4, 4))),
        sum(
            np.float32(w) * image[1:5, 2:6, 3:7]
            for w, image in zip(window.weights, images, strict=False)
        ),
    )
