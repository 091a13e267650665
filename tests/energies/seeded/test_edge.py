"""The local edge: halfway between both sides, on the right side, unheard between equals, the same for any unit."""

from functools import partial

import numpy as np
import pytest

from accelsurf import segment
from accelsurf.energies.seeded import seeded_model
from accelsurf.energies.seeded.appearance import count_of, even_radius, learn, radius_of
from accelsurf.energies.seeded.edge import AREA, NOISY_AREA, area_weight, at_edges, edge_balance
from accelsurf.energies.seeded.shown import Shown
from accelsurf.grid.boxes import box_at, whole_box
from accelsurf.grid.clicks import Clicks
from tests.support import clicked_balls

SHAPE, SPACING = (24, 26, 28), (1.0, 1.0, 1.0)


distance = partial(clicked_balls.distance, shape=SHAPE, spacing=SPACING)
click = partial(clicked_balls.ball, shape=SHAPE, spacing=SPACING)


def slope(place, low=0.0, high=1.0, shape=SHAPE):
    """A plane edge across x at ``place``, 1.6 voxels wide."""
    x = np.indices(shape)[2]
    return (low + (high - low) * np.clip(0.5 + (x - place) / 1.6, 0, 1)).astype(np.float32)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (3.0, 0.8, 0.8)])
@pytest.mark.parametrize("low, high", [(0.0, 1.0), (900.0, -300.0)])
def test_it_crosses_zero_halfway_and_is_below_zero_inside(low, high, spacing):
    image, inside = slope(13.3, low, high), np.indices(SHAPE)[2] <= 12
    balance, weight = edge_balance([image], spacing, inside, None)
    row, sure = balance[12, 13], weight[12, 13]
    assert np.all(row[:13] <= 0) and np.all(row[15:] >= 0)
    crossing = 13 + row[13] / (row[13] - row[14])
    assert crossing == pytest.approx(13.3, abs=0.02)
    assert np.all(sure[12:14] > 0.95) and sure[[11, 14]] == pytest.approx([0.5, 0.5], abs=0.02)
    assert not sure[:11].any() and not sure[15:].any()


def test_between_equals_it_counts_nothing():
    noise = np.random.default_rng(3).normal(0, 1, SHAPE).astype(np.float32)
    inside = distance((12, 13, 14)) < 8
    for image in (noise, np.zeros(SHAPE, np.float32)):
        balance, weight = edge_balance([image], SPACING, inside, None)
        assert np.isfinite(balance).all() and weight.max() < 0.05


def test_a_channel_with_contrast_outweighs_one_without():
    noise = np.random.default_rng(4).normal(0, 1, SHAPE).astype(np.float32)
    image, inside = slope(13.3), np.indices(SHAPE)[2] <= 12
    balance, weight = edge_balance([noise, image], SPACING, inside, None)
    assert np.all(weight[:, :, 12:14] > 0.9)
    assert np.all(balance[:, :, 12] < 0) and np.all(balance[:, :, 14] > 0)


def test_what_is_not_open_is_neither_seen_nor_changed():
    image, inside = slope(13.3), np.indices(SHAPE)[2] <= 12
    open = np.indices(SHAPE)[1] < 20
    wild = np.where(open, image, 1e4).astype(np.float32)
    here = edge_balance([wild], SPACING, inside, open)
    plain = edge_balance([image], SPACING, inside, open)
    assert not here[1][~open].any()
    np.testing.assert_allclose((here[0] * here[1])[open], (plain[0] * plain[1])[open], atol=0.02)


def test_a_field_that_is_a_voxel_off_is_put_right():
    image = np.clip(0.5 + (8.3 - distance((12, 13, 14))), 0, 1).astype(np.float32)
    clicks = Clicks((click("inside", (12, 13, 14), 3.0),), SHAPE)
    for radius in (7.2, 9.4):
        force = np.clip(0.1 * (distance((12, 13, 14)) - radius), -1, 1).astype(np.float32)
        force[clicks.mask("inside")] = -3.0
        given = force.copy()
        shown = Shown(whole_box(SHAPE), force, force < 0)
        box, found, inside = at_edges(shown, [image], [image], SPACING, clicks, None)
        np.testing.assert_array_equal(force, given)
        np.testing.assert_array_equal(inside, image > 0.5)
        assert box == whole_box(SHAPE) and np.all(found[clicks.mask("inside")] == -3.0)
        far = np.abs(distance((12, 13, 14)) - 8.3) > 5
        np.testing.assert_array_equal(found[far], given[far])


def test_a_stated_size_is_kept_where_edges_move_the_surface():
    """A plate, its one side a voxel from an edge, its other in the middle of what is as bright: the other gives way."""
    x = np.indices(SHAPE)[2]
    image, inside = np.clip(x - 4.3, 0.0, 1.0).astype(np.float32), (x >= 6) & (x < 20)
    force = np.clip(0.1 * np.maximum(5.5 - x, x - 19.5), -1, 1).astype(np.float32)
    clicks = Clicks((click("inside", (12, 13, 12), 3.0),), SHAPE)
    force[clicks.mask("inside")] = -3.0
    given = force.copy()
    size = float(inside.sum())
    for stated, ends in ((None, 20), (size, 19), (0.5 * size, 19), (15.0 / 14.0 * size, 20)):
        shown = Shown(whole_box(SHAPE), force, inside)
        _, found, moved = at_edges(shown, [image], [image], SPACING, clicks, None, stated_mm3=stated)
        assert np.all(moved[:, :, 5]) and not np.any(moved[:, :, 4])
        assert moved.sum() == pytest.approx((ends - 5) / 14 * size, rel=0.002)
        assert np.all(found[clicks.mask("inside")] == -3.0)
        np.testing.assert_array_equal(force, given)


def test_an_outside_click_on_the_boundary_stays_outside():
    image = np.clip(0.5 + (8.3 - distance((12, 13, 14))), 0, 1).astype(np.float32)
    clicks = Clicks((click("inside", (12, 13, 14), 3.0), click("outside", (12, 13, 21), 1.0)), SHAPE)
    model = seeded_model([image], SPACING, clicks)
    out = clicks.mask("outside")
    assert np.all(model.field[out] == 3.0) and not model.start[out].any()
    assert (model.start & (image > 0.5)).sum() > 0.9 * (image > 0.5).sum()


def test_a_box_of_the_grid_gives_the_same_bytes():
    """The answer's box says where F may change; what is looked at is the grid around the object."""
    rng = np.random.default_rng(5)
    image = (np.clip(0.5 + (6.3 - distance((12, 13, 14))), 0, 1) + rng.normal(0, 0.1, SHAPE)).astype(np.float32)
    force = np.clip(0.1 * (distance((12, 13, 14)) - 6.0), -1, 1).astype(np.float32)
    clicks, box = Clicks((click("inside", (12, 13, 14), 3.0),), SHAPE), box_at((4, 5, 6), (17, 17, 17))
    whole = at_edges(Shown(whole_box(SHAPE), force, force < 0), [image], [image], SPACING, clicks, None)
    part = at_edges(Shown(box, force[box], force[box] < 0), [image], [image], SPACING, clicks, None)
    np.testing.assert_array_equal(whole[1][box], part[1])
    np.testing.assert_array_equal(whole[2][box], part[2])


def test_the_surface_begins_and_ends_between_voxels():
    """A cube, its faces 0.3 of a voxel beyond voxel centres: along the faces of voxels it is 7 % too large."""
    part = [np.clip(0.5 + (8.3 - np.abs(np.arange(26) - 13.0)) / 1.6, 0, 1) for _ in range(3)]
    image = (part[0][:, None, None] * part[1][None, :, None] * part[2]).astype(np.float32)
    found = segment(image, inside=[(13.0, 13.0, 13.0)], size="4500mm3", levels=1).objects[0].history
    assert found[0].volume_mm3 == pytest.approx(16.6**3, rel=0.02)
    assert found[-1].volume_mm3 == pytest.approx(16.6**3, rel=0.02)


def test_the_area_weight_follows_the_noise():
    inside = distance((12, 13, 14)) < 8
    noise = np.random.default_rng(6).normal(0, 1, SHAPE)
    found = [area_weight([(inside + part * noise).astype(np.float32)], SPACING, inside) for part in (0, 0.5, 5)]
    assert found[0] == pytest.approx(AREA)
    assert found[1] == pytest.approx(AREA + 0.5 * NOISY_AREA, rel=0.1)
    assert found[2] == pytest.approx(AREA + NOISY_AREA)
    clean = inside.astype(np.float32)
    assert area_weight([(5 * noise).astype(np.float32), clean], (4.0, 2.0, 2.0), inside) == pytest.approx(2 * AREA)


def test_the_even_tissue_of_a_click_in_a_slice_is_a_disk():
    shape, spacing = (1, 80, 80), (0.3, 1.0, 1.0)
    image = (distance((0, 40, 40), shape=shape, spacing=spacing) < 18).astype(np.float32)
    one = click("inside", (0, 40, 40), 3.0, shape=shape, spacing=spacing)
    radius = even_radius([image], spacing, one, learn([image], spacing, one))
    assert radius == pytest.approx(18, abs=1.1)
    assert count_of(radius, spacing, True) == pytest.approx(image.sum(), rel=0.15)
    for flat in (True, False):
        assert radius_of(count_of(7.5, (3.0, 1.5, 1.2), flat), (3.0, 1.5, 1.2), flat) == pytest.approx(7.5)


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [(26, 26, 28), (1, 60, 60)])
@pytest.mark.parametrize("slope", [0.05, 0.1, 0.14, 0.2])
@pytest.mark.parametrize("part", [0.75, 0.89, 1.1, 1.3])
def test_an_object_with_edges_all_around_keeps_them_whatever_size_was_stated(shape, slope, part):
    """Nothing is free to give way: what would be taken for the size lies deep inside, and cuts off the rim."""
    flat = shape[0] == 1
    centre, true = [n // 2 for n in shape], 20.3 if flat else 8.3
    near = clicked_balls.distance(centre, shape, SPACING)
    image = np.clip(0.5 + true - near, 0, 1).astype(np.float32)
    clicks = Clicks((clicked_balls.ball("inside", centre, 3.0, shape, SPACING),), shape)
    radius = true * part ** (1 / 2 if flat else 1 / 3)
    force = np.clip(slope * (near - radius), -1, 1).astype(np.float32)
    force[clicks.mask("inside")] = -3.0
    shown = Shown(whole_box(shape), force, force < 0)
    free = at_edges(shown, [image], [image], SPACING, clicks, None)
    _, found, moved = at_edges(shown, [image], [image], SPACING, clicks, None, stated_mm3=float(shown.inside.sum()))
    # Edges are found within two voxels, and again within two.
    assert abs(moved.sum() - shown.inside.sum()) <= abs(free.inside.sum() - shown.inside.sum())
    assert np.count_nonzero(moved & (image > 0.5)) >= 0.9 * min(np.count_nonzero(image > 0.5), shown.inside.sum())
    np.testing.assert_array_equal(moved, found < 0)
