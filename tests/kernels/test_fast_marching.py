"""The kernels of the fast march against plain forms of them."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.kernels import fast_marching, march
from accelsurf.kernels.fast_marching import ACCEPTED, insert, order_of, pop
from accelsurf.kernels.grid import Grid
from accelsurf.levelset import LevelSet
from tests.support import reference
from tests.support.fast_march import PlainMarch
from tests.support.reference import coordinates


def ball(shape, spacing, radius):
    centre = [0.5 * (n - 1) * h + 0.13 for n, h in zip(shape, spacing, strict=True)]
    return np.linalg.norm(coordinates(shape, spacing, centre), axis=0) - radius


def two_balls(shape, spacing):
    z, y, x = coordinates(shape, spacing, (5.41, 5.57, 5.5))
    return (
        np.minimum(np.sqrt(z**2 + y**2 + (x + 2.3) ** 2), np.sqrt(z**2 + y**2 + (x - 2.4) ** 2))
        - 2.0
    )


CASES = {
    "ball": (lambda: (ball((13, 13, 13), (1, 1, 1), 3.2), (1.0, 1.0, 1.0))),
    "ridge": (lambda: (two_balls((12, 12, 12), (1, 1, 1)), (1.0, 1.0, 1.0))),
    "anisotropic": (lambda: (ball((9, 13, 14), (1.5, 1, 1), 3.0), (1.5, 1.0, 1.0))),
    "flat": (lambda: (ball((1, 16, 17), (1, 1, 1), 4.3), (1.0, 1.0, 1.0))),
}


@pytest.mark.parametrize("name", CASES)
def test_distances_and_fields_are_those_of_the_plain_march(name: str) -> None:
    """Also at the ridge between two balls, where second order is left."""
    psi, spacing = CASES[name]()
    surface = LevelSet(psi, spacing, 2.0, extension="fast-marching")
    band, front = surface.band, surface.front()
    near = reference.front_cells(psi)
    field = np.where(near.ravel()[band.cells], np.sin(band.cells * 0.7), 0.0).astype(np.float32)
    start = {
        tuple(int(i) for i in np.unravel_index(c, psi.shape)): (d, f, float(v))
        for c, d, f, v in zip(band.cells, band.psi, band.to_closest, field, strict=True)
        if near.ravel()[c]
    }
    grid = surface.grid
    plain = PlainMarch(psi < 0, (grid.hz, grid.hy, grid.hx), start, surface.half_width)
    surface.extend_outwards(field, front)
    inner = 0
    for c, d, closest_point, value in zip(
        band.cells, band.psi, band.to_closest, field, strict=True
    ):
        at = tuple(int(i) for i in np.unravel_index(c, psi.shape))
        known = plain.known[at]
        assert abs(d) == pytest.approx(known[0], abs=1e-5)
        assert closest_point == pytest.approx(known[1], abs=1e-4)
        assert value == pytest.approx(known[2], abs=2e-4)
        inner += at not in start
    assert inner > 30


@pytest.mark.slow
def test_distances_agree_with_closest_points_passed_on_in_order() -> None:
    """The other ordered march of the tests, each closest point polished: both are distances, to the order of each."""
    psi = ball((24, 24, 24), (1, 1, 1), 8.0)
    surface = LevelSet(psi, (1, 1, 1), extension="fast-marching")
    band, grid = surface.band, surface.grid
    near = reference.front_cells(psi).ravel()[band.cells]
    state = np.where(near, march.FROZEN, march.OPEN).astype(np.int8)
    known = reference.march_in_order(grid, band.cells, band.to_closest, state, surface.half_width)
    on = np.array([i for i, c in enumerate(band.cells) if int(c) in known])
    closest_points = np.array([known.get(int(c), np.zeros(3)) for c in band.cells], np.float32)
    march.refine_closest_points(
        0,
        on.size,
        surface.dense.psi,
        grid,
        band.cells,
        on,
        closest_points,
        (np.zeros(closest_points.shape[0]), False),
    )
    apart = np.abs(np.linalg.norm(closest_points[on], axis=1) - np.abs(band.psi[on]))
    assert on.size > 0.95 * band.cells.size
    assert np.median(apart) < 0.005 and np.percentile(apart, 99) < 0.04


def test_the_heap_gives_distances_in_order_and_ties_by_cell() -> None:
    rng = np.random.default_rng(0)
    cells = rng.permutation(200)
    distances = rng.integers(0, 40, 200) / 4.0
    keys, slots = np.empty(200), np.empty(200, np.int64)
    for s in range(200):
        insert(keys, slots, s, distances[s], s, cells)
    got = [pop(keys, slots, 200 - k, cells) for k in range(200)]
    assert got == sorted(range(200), key=lambda s: (distances[s], cells[s]))


def test_order_is_that_of_a_stable_sort() -> None:
    rng = np.random.default_rng(1)
    distance = np.abs(rng.normal(size=3000)).astype(np.float32) ** 8
    distance[::5] = distance[0]
    assert (order_of(distance) == np.argsort(distance, kind="stable")).all()


def test_a_march_that_runs_out_of_room_goes_on() -> None:
    """With more room from time to time: the same as with enough of it."""
    psi = ball((12, 12, 12), (1, 1, 1), 3.2)
    surface = LevelSet(psi, (1, 1, 1), 2.0, extension="fast-marching")
    near = reference.front_cells(psi).ravel()[surface.band.cells]
    cells, psi_of, closest_points = (array[near] for array in surface.band)
    results = []
    for more in (5000, 7):
        dense = surface.dense._replace(slot=np.full(psi.size, -1, np.int32))
        n = cells.size
        dense.slot[cells] = np.arange(n)
        known = [
            np.concatenate([a, np.zeros((7, *a.shape[1:]), a.dtype)])
            for a in (
                cells,
                closest_points,
                psi_of.astype(np.float64),
                np.full(n, ACCEPTED, np.int8),
            )
        ]
        heap, counts, calls = [np.empty(7), np.empty(7, np.int64)], np.array([n, 0, 0]), 0
        run, where = fast_marching.march_outwards, (dense, Grid(12, 12, 12, 1.0, 1.0, 1.0))
        while not run(*where, tuple(known), tuple(heap), counts, np.arange(n), 2.0):
            known = [np.concatenate([a, np.zeros((more, *a.shape[1:]), a.dtype)]) for a in known]
            heap, calls = [np.concatenate([a, np.zeros(more, a.dtype)]) for a in heap], calls + 1
        results.append((calls, [a[: counts[0]] for a in known]))
    assert results[0][0] == 1 and results[1][0] > 10
    for one, other in zip(results[0][1], results[1][1], strict=True):
        assert (one == other).all()
