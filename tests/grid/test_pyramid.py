"""Geometry of the levels: blocks lie where they should, surfaces and fields come back to where they were."""

import numpy as np
import pytest

from accelsurf.grid import boxes
from accelsurf.grid.pyramid import (
    count_resolved_levels,
    levels,
    min_component_depth,
    prolong,
    restrict,
)
from accelsurf.levelset import LevelSet
from accelsurf.levelset.transfer import transfer_fields
from tests.support.axis_orders import WAYS, permuted, restored

GRIDS = {
    "cubic": ((48, 48, 48), (1.0, 1.0, 1.0)),
    "odd": ((47, 49, 51), (1.0, 1.0, 1.0)),
    "thick slices": ((25, 61, 59), (2.5, 0.9, 1.1)),
    "one slice": ((1, 75, 80), (7.0, 1.0, 1.3)),
}


def first_centre(level, grids):
    """Centre of the first voxel, mm, that of the image's first at 0."""
    return np.array(level.first) * grids[0].spacing


def positions(level, grids):
    axes = zip(first_centre(level, grids), level.spacing, level.shape, strict=True)
    return np.meshgrid(*(o + h * np.arange(n) for o, h, n in axes), indexing="ij")


def ball(level, grids, centre, radius):
    """Distance to a sphere (or circle: axes of one slice do not count) at the voxels of a level."""
    places = positions(level, grids)
    squares = [
        (p - c) ** 2 for p, c, n in zip(places, centre, grids[0].shape, strict=True) if n > 1
    ]
    return (np.sqrt(sum(squares)) - radius).astype(np.float32)


def test_axes_of_finest_spacing_are_halved_first():
    grids = levels((30, 200, 200), (5.0, 1.0, 1.4))
    assert [g.spacing for g in grids[:4]] == [
        (5.0, 1.0, 1.4),
        (5.0, 2.0, 2.8),
        (5.0, 4.0, 5.6),
        (10.0, 8.0, 11.2),
    ]
    assert [g.shape for g in grids[:4]] == [
        (30, 200, 200),
        (30, 100, 100),
        (30, 50, 50),
        (15, 25, 25),
    ]
    assert [g.number for g in grids] == list(range(len(grids)))


def test_a_single_slice_stays_and_its_thickness_does_not_count():
    grids = levels((1, 64, 64), (0.1, 1.0, 1.0))
    assert all(g.shape[0] == 1 and g.spacing[0] == 0.1 for g in grids)
    assert grids[-1].shape == (1, 8, 8)
    assert len(levels((1, 1, 1), (1.0, 1.0, 1.0))) == 1


@pytest.mark.parametrize("grid", GRIDS)
def test_means_of_a_linear_image_are_its_values_at_the_centres(grid):
    grids = levels(*GRIDS[grid], min_voxels=4)
    assert len(grids) >= 3
    image = sum((axis + 1) * p for axis, p in enumerate(positions(grids[0], grids))).astype(
        np.float32
    )
    for fine, coarse in zip(grids, grids[1:], strict=False):
        image = restrict(image, fine, coarse)
        assert image.shape == coarse.shape and image.flags.c_contiguous
        exact = sum((axis + 1) * p for axis, p in enumerate(positions(coarse, grids)))
        # At the border too: an axis of odd size is continued linearly.
        np.testing.assert_allclose(image, exact, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("grid", GRIDS)
def test_all_grids_have_the_same_centre(grid):
    grids = levels(*GRIDS[grid], min_voxels=2)
    for level in grids:
        axes = zip(level.first, level.shape, level.factors, strict=True)
        assert [first + 0.5 * (n - 1) * width for first, n, width in axes] == [
            0.5 * (n - 1) for n in grids[0].shape
        ]
        # No voxel of the image lies outside.
        assert all(
            f <= 0.5 * (width - 1) for f, width in zip(level.first, level.factors, strict=True)
        )


def test_means_of_a_constant_image_are_that_constant():
    grids = levels((9, 12, 13), (1.0, 1.0, 1.0), min_voxels=2)
    image = np.full(grids[0].shape, 3.7, np.float32)
    for fine, coarse in zip(grids, grids[1:], strict=False):
        image = restrict(image, fine, coarse)
        assert (image == np.float32(3.7)).all()


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [(16, 17, 18), (9, 9, 9), (1, 14, 15), (19, 1, 8)])
@pytest.mark.parametrize("way", [WAYS[i] for i in (1, 6, 10, 19, 28, 37, 47)], ids=str)
def test_levels_are_the_same_in_every_order_and_direction_of_the_axes(shape, way):
    order, flips = way
    spacing = (1.0, 1.2, 0.9)
    fine, coarse = levels(shape, spacing, 2, 2)
    turned = levels(tuple(shape[i] for i in order), tuple(spacing[i] for i in order), 2, 2)
    assert turned[1].shape == tuple(coarse.shape[i] for i in order)
    rng = np.random.default_rng(7)
    image, psi = (rng.normal(size=level.shape).astype(np.float32) for level in (fine, coarse))
    for function, array, pair in ((restrict, image, (0, 1)), (prolong, psi, (1, 0))):
        one = function(array, *((fine, coarse)[i] for i in pair))
        other = restored(function(permuted(array, way), *(turned[i] for i in pair)), way)
        np.testing.assert_allclose(other, one, atol=2e-6)
        if order == (0, 1, 2):
            assert np.array_equal(other, one)


def test_means_do_not_change_the_array_that_they_are_of():
    fine, coarse = levels((9, 9, 9), (1.0, 1.0, 1.0), 2, 4)
    image = np.arange(729, dtype=np.float32).reshape(9, 9, 9)
    before = image.copy()
    restrict(image, fine, coarse)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("grid", GRIDS)
def test_a_ball_comes_back_to_where_it_was(grid):
    grids = levels(*GRIDS[grid])[:2]
    fine, coarse = grids
    centre = 0.5 * np.array(fine.spacing) * (np.array(fine.shape) - 1) + 0.3
    radius = 9.0 * max(h for n, h in zip(coarse.shape, coarse.spacing, strict=True) if n > 1) / 2
    old = LevelSet(ball(coarse, grids, centre, radius), coarse.spacing)
    new = LevelSet(prolong(old.psi, coarse, fine), fine.spacing)
    exact = ball(fine, grids, centre, radius)
    front = new.front(1.0)
    error = np.abs(new.band.psi - exact.ravel()[new.band.cells])[front]
    step = min(h for n, h in zip(coarse.shape, coarse.spacing, strict=True) if n > 1)
    assert error.max() < 0.1 * step and error.mean() < 0.02 * step
    # Far from the surface the side is right.
    far = np.abs(exact) > step
    np.testing.assert_array_equal(new.psi[far] < 0, exact[far] < 0)


def test_a_surface_that_runs_into_the_border_keeps_its_direction():
    grids = levels((32, 33, 40), (1.0, 1.0, 1.0), 2)
    fine, coarse = grids

    def plane(level):
        z, y, x = positions(level, grids)
        return ((z + y + x - 50.0) / np.sqrt(3)).astype(np.float32)

    new = LevelSet(prolong(LevelSet(plane(coarse), coarse.spacing).psi, coarse, fine), fine.spacing)
    front = new.front(1.0)
    assert np.abs(new.band.psi - plane(fine).ravel()[new.band.cells])[front].max() < 0.1 * 2


@pytest.mark.parametrize("grid", GRIDS)
def test_fields_come_back_to_where_they_were(grid):
    grids = levels(*GRIDS[grid])[:2]
    fine, coarse = grids
    centre = 0.5 * np.array(fine.spacing) * (np.array(fine.shape) - 1)
    radius = 9.0 * max(h for n, h in zip(coarse.shape, coarse.spacing, strict=True) if n > 1) / 2

    def polar(surface, level):
        """The cosine of the angle with the last axis, constant along the normals of the ball."""
        index = np.stack(np.unravel_index(surface.band.cells, surface.shape), axis=1)
        place = index * np.array(level.spacing) + first_centre(level, grids) - centre
        place[:, np.array(surface.shape) == 1] = 0.0
        return (place[:, 2] / np.maximum(np.linalg.norm(place, axis=1), 1e-9)).astype(np.float32)

    old = LevelSet(ball(coarse, grids, centre, radius), coarse.spacing)
    new = LevelSet(prolong(old.psi, coarse, fine), fine.spacing)
    fields = [polar(old, coarse), np.ones(old.size, np.float32)]
    one, two = transfer_fields(fields, [0, 0], old.dense.slot, coarse, new, fine)
    # In the middle of the ball, where its normals meet, there is no one closest point.
    assert np.abs(one - polar(new, fine))[new.front()].max() < 0.08
    np.testing.assert_allclose(two, 1.0, rtol=1e-6)
    assert one.dtype == np.float32


def test_fields_of_nothing():
    grids = levels((24, 24, 24), (1.0, 1.0, 1.0), 2)
    fine, coarse = grids
    old = LevelSet(ball(coarse, grids, (11.5,) * 3, 6.0), coarse.spacing)
    new = LevelSet(np.ones(fine.shape, np.float32), fine.spacing)
    assert new.size == 0
    ones = [np.ones(old.size, np.float32)]
    assert [f.size for f in transfer_fields(ones, [0], old.dense.slot, coarse, new, fine)] == [0]
    assert transfer_fields([], [], old.dense.slot, coarse, new, fine) == []


def test_depth_is_that_of_the_thinnest_part():
    z, y, x = np.indices((40, 40, 40)) - 19
    big = np.sqrt(z**2 + y**2 + x**2) - 8.2
    small = np.sqrt((z - 15) ** 2 + (y - 15) ** 2 + x**2) - 2.2
    assert 8 < min_component_depth(big) <= 9
    assert min_component_depth(np.minimum(big, small)) <= 3
    assert (
        min_component_depth(np.ones((4, 4, 4))) == 0
        and min_component_depth(-np.ones((4, 4, 4))) == 0
    )


def test_levels_that_resolve_a_start():
    grids = levels((96, 96, 96), (1.0, 1.0, 1.0))
    assert len(grids) == 4
    for radius, count in ((5.0, 1), (6.0, 2), (10.0, 2), (12.0, 3), (20.0, 3), (40.0, 4)):
        assert count_resolved_levels(grids, ball(grids[0], grids, (47.5,) * 3, radius)) == count


def test_the_weights_of_the_interpolation_reproduce_cubics_far_from_the_border():
    fine, coarse = levels((1, 1, 64), (1.0, 1.0, 1.0), 2)
    x = coarse.first[2] + 2.0 * np.arange(32)
    psi = (0.01 * x**2 - x).astype(np.float32).reshape(1, 1, 32)
    values = prolong(psi, coarse, fine)[0, 0]
    at = np.arange(64.0)
    np.testing.assert_allclose(values[4:-4], (0.01 * at**2 - at)[4:-4], atol=1e-4)


def test_slabs_make_no_difference(monkeypatch):
    fine, coarse = levels((33, 30, 27), (1.0, 1.1, 1.2), 2)
    psi = np.random.default_rng(5).normal(size=coarse.shape).astype(np.float32)
    whole = prolong(psi, coarse, fine)
    monkeypatch.setattr(boxes, "SLAB_VOXELS", 2 * 30 * 27)
    assert np.array_equal(prolong(psi, coarse, fine), whole)
