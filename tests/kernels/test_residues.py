"""Residues, the limited interpolant and guesses beyond ridges, against plain references."""

import numpy as np
import pytest

from accelsurf.kernels import residues
from accelsurf.kernels.closest import guess_closest_points, guess_memory
from accelsurf.kernels.grid import BATCH
from accelsurf.kernels.interpolate import (
    LEVELS,
    MAX_CHANGE,
    enter_point,
    limited_in_vectors,
    limited_memory,
    value_and_gradient,
)
from tests.support import reference

SPACING = (1.5, 1.0, 0.8)
SHAPES = [(7, 9, 8), (1, 9, 12), (3, 2, 9)]


def limited_at(psi, grid, places):
    """Values and slopes (n, 4) of the limited interpolant at ``places`` (n, 3), at most `BATCH`, all at once."""
    memory, first = limited_memory(grid), np.zeros(BATCH, np.int64)
    for n, place in enumerate(places):
        first[n] = enter_point(np.uint64(n), grid, *place, memory)
    limited_in_vectors(len(places), psi.ravel(), grid, first, memory)
    return memory[int(LEVELS) :].reshape(4, BATCH)[:, : len(places)].T.copy()


@pytest.mark.parametrize("shape", SHAPES)
def test_smooth_psi_is_interpolated_as_without_limits(shape):
    psi = 0.02 * reference.smooth_noise(shape, 3).ravel()
    grid, rng, w = reference.grid_of(shape, SPACING), np.random.default_rng(1), np.empty(24)
    places = rng.uniform(-0.5, 0.5 + np.array(shape) - 1, (60, 3))
    want = np.array([value_and_gradient(psi, grid, *place, w) for place in places])
    np.testing.assert_allclose(limited_at(psi, grid, places), want, atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_distance_of_a_plate_is_met_beside_its_ridge(axis, sign):
    """Up to what the limits let pass; the cubic of four nodes is off by ten times that."""
    shape, w = (8, 8, 8), np.empty(24)
    at = np.moveaxis(np.broadcast_to(np.arange(8.0), shape), 2, axis)
    psi = np.float32(sign * (np.abs(at - 3.0) - 0.75)).ravel()
    grid, place = reference.grid_of(shape, (1, 1, 1)), np.array([3.4, 3.3, 3.6])
    place[axis] = 3.75
    value, *slope = limited_at(psi, grid, [place])[0]
    assert abs(value) <= MAX_CHANGE * 0.75 * 0.25 * 1.75 / 6 + 1e-6
    assert abs(value_and_gradient(psi, grid, *place, w)[0]) > 0.07
    assert slope[axis] == pytest.approx(sign, abs=0.1)


def test_slopes_are_those_of_the_value():
    """Of rough psi, where the limits hold everywhere, within a cell."""
    shape, rng = (6, 7, 8), np.random.default_rng(2)
    psi = rng.normal(0, 1, shape).astype(np.float32).ravel()
    grid, step = reference.grid_of(shape, SPACING), 1e-4
    for _ in range(40):
        place = rng.integers(0, np.array(shape) - 1) + rng.uniform(0.1, 0.9, 3)
        slope = limited_at(psi, grid, [place])[0, 1:]
        for axis in range(3):
            ends = [place + sign * step * (np.arange(3) == axis) for sign in (-1, 1)]
            low, high = limited_at(psi, grid, ends)[:, 0]
            assert (high - low) / (2 * step * SPACING[axis]) == pytest.approx(slope[axis], abs=2e-3)


@pytest.mark.sampled
@pytest.mark.parametrize("shape", [*SHAPES, (4, 7, 9), (9, 1, 6), (6, 9, 3), (2, 2, 2), (1, 1, 7)])
@pytest.mark.parametrize("roughness", [0.02, 1.0])
def test_limited_values_and_slopes_as_the_reference(shape, roughness):
    """Where few lines are limited and where most are, also beyond the borders and on thin volumes."""
    rng = np.random.default_rng(3)
    psi = (
        roughness * reference.smooth_noise(shape, 3) + roughness**3 * rng.normal(0, 1, shape)
    ).astype(np.float32)
    grid = reference.grid_of(shape, SPACING)
    places = rng.uniform(-0.5, 0.5 + np.array(shape) - 1, (BATCH - 5, 3))
    places[:8] = np.rint(places[:8])
    found = limited_at(psi, grid, places)
    for place, (value, *slope) in zip(places, found, strict=True):
        want, gradient = reference.limited_interpolant(psi, place, SPACING, MAX_CHANGE)
        np.testing.assert_allclose(value, want, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(slope, gradient, rtol=1e-12, atol=1e-12)
    # The same bits in any column, whether it is in a vector or left over.
    np.testing.assert_array_equal(limited_at(psi, grid, places[40:83]), found[40:83])


def test_limited_columns_that_are_not_asked_for_are_left_alone():
    grid = reference.grid_of((4, 5, 6), SPACING)
    memory = limited_memory(grid)
    memory[:] = -7.0
    first = np.full(BATCH, enter_point(np.uint64(0), grid, 1.5, 1.5, 1.5, memory))
    limited_in_vectors(1, np.ones(120, np.float32), grid, first, memory)
    levels = memory[int(LEVELS) :].reshape(4, BATCH)
    np.testing.assert_allclose(levels[:, 0], (1, 0, 0, 0), atol=1e-12)
    assert (levels[:, 1:] == -7.0).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_residues_are_the_interpolant_at_the_points_that_are_known(shape):
    """Less the smallest that counts; of distant cells that of the cell nearest their closest point; 0 where psi has one
    sign.
    """
    rng, size = np.random.default_rng(5), int(np.prod(shape))
    psi = reference.smooth_noise(shape, 6)
    closest_point = rng.normal(0, 0.6, (size, 3)) * SPACING
    dense, band = reference.whole_band(psi, closest_point)
    band.psi[:] = np.sign(psi.ravel()) * np.linalg.norm(band.to_closest, axis=1)
    grid, h = reference.grid_of(shape, SPACING), np.array(SPACING)
    motion = rng.normal(0, 0.3, (size, 3)).astype(np.float32), 0.7
    out = np.full(size, np.float32(np.nan))
    near = np.empty(size, np.bool_)
    residues.own_residues(0, size, dense.psi, grid, band, motion, (out, near))
    residues.distant_residues(0, size, dense.slot, grid, band, motion, (out, near))
    cells = np.stack(np.unravel_index(np.arange(size), shape), axis=1)
    place = cells + (band.to_closest + motion[1] * motion[0]) / h
    own = np.linalg.norm(band.to_closest / h, axis=1) <= residues.OWN_RESIDUE
    np.testing.assert_array_equal(near, own)
    corners = np.floor(place).astype(int)[:, None] + np.array(list(np.ndindex(2, 2, 2)))
    corners = np.clip(corners, 0, np.array(shape) - 1)
    inside = psi[tuple(np.moveaxis(corners, 2, 0))] < 0
    value, slope = reference.interpolate(psi, place)
    least, most = residues.MIN_RESIDUE * h.min(), residues.MAX_RESIDUE * h.min()
    counts = own & inside.any(axis=1) & ~inside.all(axis=1) & (np.abs(value) <= 2 * most)
    size = np.maximum(np.minimum(np.abs(value) - least, 2 * most - np.abs(value)), 0)
    want = np.where(counts, np.sign(value) * size, 0)
    clear = np.abs(np.abs(value) - most) > 1e-4
    assert counts.sum() > 1
    np.testing.assert_allclose(out[own & clear], want[own & clear], atol=2e-5)
    nearest = np.clip(np.floor(place + 0.5).astype(int), 0, np.array(shape) - 1)
    nearest = np.ravel_multi_index(nearest.T, shape)
    far = ~own
    np.testing.assert_array_equal(out[far], np.where(own[nearest], out[nearest], 0)[far])


@pytest.mark.parametrize("holes", [(), [(1, 2, 3)], [(1, 2, 3), (2, 2, 3), (4, 5, 5)]])
def test_residues_beside_what_is_removed_are_dropped(holes):
    """By the eight voxels around each closest point, also where the first of them is not in the band, and at the
    border.
    """
    rng, shape = np.random.default_rng(3), (5, 6, 7)
    closest_point = rng.uniform(-1.5, 1.5, (210, 3))
    dense, band = reference.whole_band(np.ones(shape), closest_point)
    grid, out, flipped = (
        reference.grid_of(shape, (1, 1, 1)),
        np.ones(210, np.float32),
        np.zeros(210, bool),
    )
    flipped[np.ravel_multi_index((2, 3, 4), shape)] = flipped[0] = flipped[-1] = True
    for hole in holes:
        dense.slot[np.ravel_multi_index(hole, shape)] = -1
    marked = np.zeros(210, bool)
    for start, stop in ((0, 100), (100, 210)):
        residues.mark_below(start, stop, dense.slot, grid, band.cells, flipped, marked)
    residues.drop_residues(0, 210, dense.slot, grid, band, (flipped, marked), out)
    place = np.argwhere(np.ones(shape, bool)) + band.to_closest.astype(float)
    corners = np.floor(place).astype(int)[:, None] + np.array(list(np.ndindex(2, 2, 2)))
    slots = dense.slot.reshape(shape)[
        tuple(np.moveaxis(np.clip(corners, 0, np.array(shape) - 1), 2, 0))
    ]
    want = ((slots >= 0) & flipped[slots]).any(axis=1)
    assert 3 < want.sum() < 210
    np.testing.assert_array_equal(out == 0, want)


def test_a_guess_moves_to_the_surface_beyond_a_ridge_that_has_come_closer():
    """Of an oblique plate; by its exact distance, up to rounding, and not before it is closer."""
    shape, normal, near = (9, 9, 9), np.array((1, 1, 1)) / np.sqrt(3), np.empty(6, np.int64)
    grid = reference.grid_of(shape, (1, 1, 1))
    along = np.tensordot(normal, np.indices(shape) - 4.0, 1).ravel() - 0.1
    closest_point = (np.where(along > 0, 1.0, -1.0) - along)[:, None] * normal
    dense, band = reference.whole_band((np.abs(along) - 1).reshape(shape), closest_point)
    band.psi[:] = np.abs(along) - 1
    cell = np.ravel_multi_index((4, 4, 4), shape)
    guesses, beside, offset = (
        np.empty((3, BATCH), np.float32),
        np.empty(BATCH, np.bool_),
        np.empty(BATCH, np.float32),
    )
    residue = np.linspace(0.001, 0.002, along.size, dtype=np.float32)
    for shift, moves in ((0.0, False), (0.05, False), (-0.2, True), (-0.4, True)):
        dense.psi[:] = np.abs(along - shift) - 1
        # Psi of the cell has followed the surface that was the closest.
        dense.psi[cell] = -abs(-1 - along[cell] + shift)
        scratch = near, np.empty(3), guess_memory()
        guess_closest_points(
            np.array([cell]),
            dense,
            grid,
            band,
            (np.inf, residue),
            scratch,
            (guesses, beside, offset),
        )
        assert (offset[0] != residue[cell]) == moves
        want = 1 + shift - along[cell] if moves else -abs(-1 - along[cell] + shift)
        np.testing.assert_allclose(guesses[:, 0], want * normal, atol=1e-6)
