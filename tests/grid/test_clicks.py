"""Clicks as values, and the bounds of psi that they set on every level."""

import numpy as np
import pytest

from accelsurf.grid import pyramid
from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.click_bounds import click_bounds
from accelsurf.grid.clicks import Click, Clicks


def click(side, mask, id=1):
    box = bounding_box(mask)
    return Click(side, box, mask[box], id)


def some(shape, *voxels):
    mask = np.zeros(shape, bool)
    for voxel in voxels:
        mask[voxel] = True
    return mask


def grids(shape, spacing, count):
    return pyramid.levels(shape, spacing, count, min_voxels=2)


def test_an_object_sees_the_inside_clicks_of_others_as_outside():
    shape = (2, 3, 4)
    own, other = some(shape, (0, 0, 0)), some(shape, (1, 2, 3))
    none, beside = some(shape, (0, 2, 0)), some(shape, (1, 0, 1))
    clicks = Clicks(
        (
            click("inside", own, 4),
            click("inside", other, 9),
            click("inside", none, 0),
            click("outside", beside, 9),
        ),
        shape,
    )
    seen = clicks.of(4)
    np.testing.assert_array_equal(seen.mask("inside"), own)
    np.testing.assert_array_equal(seen.mask("outside"), other | none)
    np.testing.assert_array_equal(clicks.of(9).mask("outside"), own | none | beside)
    assert clicks.ids() == (0, 4, 9)
    assert [one.id for one in seen.clicks] == [1, 1, 1]


def test_on_a_box_clicks_are_cut():
    shape = (6, 6, 6)
    mask = np.zeros(shape, bool)
    mask[1:5, 2:4, 0:6] = True
    clicks = Clicks((click("inside", mask), click("outside", some(shape, (0, 0, 0)))), shape)
    box = (slice(3, 6), slice(0, 3), slice(2, 6))
    part = clicks.on_box(box)
    np.testing.assert_array_equal(part.mask("inside"), mask[box])
    assert len(part) == 1 and part.shape == (3, 3, 4)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (5.0, 1.0, 0.8)])
def test_bounds_are_the_signed_distances(spacing):
    shape = (7, 12, 13)
    inside, outside = some(shape, (2, 3, 3), (2, 3, 4)), some(shape, (4, 8, 9))
    clicks = Clicks((click("inside", inside), click("outside", outside)), shape)
    bounds = click_bounds(clicks, grids(shape, spacing, 1)[0])
    index = np.argwhere(np.ones(shape, bool)).reshape(*shape, 3)

    def distance(mask):
        to = np.linalg.norm(
            (index[..., None, :] - np.argwhere(mask)) * np.array(spacing), axis=-1
        ).min(axis=-1)
        return to - 0.5 * min(spacing)

    high, low = bounds.high, bounds.low
    got, bounded = distance(inside).ravel()[bounds.cells], np.isfinite(high)
    np.testing.assert_allclose(high[bounded], got[bounded], rtol=1e-5)
    got, bounded = -distance(outside).ravel()[bounds.cells], np.isfinite(low)
    np.testing.assert_allclose(low[bounded], got[bounded], rtol=1e-5)
    assert (low <= high).all()
    assert set(bounds.held) == set(np.flatnonzero(inside | outside))


@pytest.mark.parametrize("shape", [(16, 16, 16), (15, 17, 16), (1, 20, 21)])
def test_on_coarse_levels_a_voxel_is_on_the_side_of_the_clicks_in_it(shape):
    rng = np.random.default_rng(3)
    voxels = [tuple(int(rng.integers(n)) for n in shape) for _ in range(12)]
    inside, outside = some(shape, *voxels[:6]), some(shape, *voxels[6:])
    outside &= ~inside
    clicks = Clicks((click("inside", inside), click("outside", outside)), shape)
    for level in grids(shape, (1.0, 1.0, 1.0), 3)[1:]:
        bounds = click_bounds(clicks, level)
        psi = np.zeros(level.shape, np.float32)
        bounds.apply(psi)

        def cells(mask, level=level):
            # The voxel of the level whose centre is nearest along each axis.
            out = set()
            for voxel in np.argwhere(mask):
                place = (voxel - np.array(level.first)) / level.factors
                near = np.clip(np.floor(place + 0.5), 0, np.array(level.shape) - 1).astype(int)
                assert (abs(near - place) <= 0.5).all()
                out.add(tuple(near))
            return out

        one, other = cells(inside), cells(outside)
        assert {tuple(cell) for cell in np.argwhere(psi < 0)} == one - other
        assert other - one <= {tuple(cell) for cell in np.argwhere(psi > 0)}
        assert all(psi[cell] >= 0 for cell in one & other)
        assert {tuple(np.unravel_index(cell, level.shape)) for cell in bounds.held} == one ^ other


def test_bounds_on_a_box_are_those_of_the_whole():
    shape = (12, 12, 12)
    clicks = Clicks(
        (click("inside", some(shape, (5, 5, 5))), click("outside", some(shape, (5, 8, 5)))), shape
    )
    bounds = click_bounds(clicks, grids(shape, (1.0, 2.0, 1.0), 1)[0])
    psi = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    whole, part = psi.copy(), psi[3:9, 4:12, 2:7].copy()
    bounds.apply(whole)
    bounds.on_box((3, 4, 2), part.shape).apply(part)
    np.testing.assert_array_equal(part, whole[3:9, 4:12, 2:7])
    assert bounds.is_met_by(whole) and not bounds.is_met_by(np.ones(shape, np.float32))
    low, high = bounds.extent()
    assert tuple(low) == (5, 5, 5) and tuple(high) == (6, 6, 6)


def test_later_clicks_take_what_they_contradict_and_nothing_else():
    """Against the rule voxel by voxel: the last click that speaks of a voxel and an object decides."""
    shape, rng = (3, 6, 7), np.random.default_rng(8)
    for _ in range(60):
        several = bool(rng.random() < 0.5)
        given = [
            click(
                rng.choice(["inside", "outside"]),
                rng.random(shape) < 0.2,
                int(rng.integers(0, 3)) if several else 1,
            )
            for _ in range(int(rng.integers(1, 6)))
        ]
        clicks = Clicks((), shape)
        want = {id: np.zeros(shape, np.int8) for id in (0, 1, 2)}
        for one in given:
            clicks = clicks.with_later([one])
            mask = one.mask_on((slice(0, 3), slice(0, 6), slice(0, 7)))
            if one.side == "inside":
                for id in want:
                    # What was outside of another object stays so; what was inside of it is not any more.
                    want[id][mask] = (
                        1 if id == one.id else np.where(want[id][mask] == 1, 0, want[id][mask])
                    )
            else:
                want[one.id][mask] = -1
        for id, sides in want.items():
            np.testing.assert_array_equal(clicks.mask("inside", id), sides == 1)
            np.testing.assert_array_equal(clicks.mask("outside", id), sides == -1)
            seen = clicks.of(id)
            assert not (seen.mask("inside") & seen.mask("outside")).any()
        assert all(
            one.mask.any() and bounding_box(one.mask) == tuple(slice(0, n) for n in one.mask.shape)
            for one in clicks.clicks
        )


def test_clicks_that_nothing_is_taken_from_stay_the_same_objects():
    shape = (1, 4, 5)
    first, second = (
        click("inside", some(shape, (0, 0, 0))),
        click("inside", some(shape, (0, 3, 4), (0, 3, 3))),
    )
    clicks = Clicks((first, second), shape)
    later = clicks.with_later([click("outside", some(shape, (0, 3, 4)))])
    assert (
        later.clicks[0] is first and later.clicks[1] is not second and not later.starts_with(clicks)
    )
    assert clicks.with_later([click("outside", some(shape, (0, 2, 2)))]).starts_with(clicks)
    assert clicks.with_later([click("outside", some(shape, (0, 0, 0)))]).clicks[0] is second
