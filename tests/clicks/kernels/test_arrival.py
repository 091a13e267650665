"""The ordered march: times as the plain reference has them, where it ends, what it may not pass."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.clicks.kernels.arrival import Appearance, Medium, Sources, bucket_width, march
from accelsurf.kernels.grid import Grid
from tests.support.arrival import plain_cost, plain_times

WEIGHTS = (0.02, 0.1, 50.0, 0.15, 2.0, 16.0)
SHAPES = {
    "3D": ((11, 12, 13), (1.0, 0.8, 1.3)),
    "thick": ((5, 14, 13), (3.0, 0.5, 0.6)),
    "slice": ((1, 17, 16), (9, 1, 1)),
}


def marched(image, spacing, seeds, **given):
    """(times, order) of a march through one channel with median 0, spread 0.5 and edges of 1 per mm."""
    grid = Grid(*image.shape, *(float(h) for h in spacing))
    appearance = Appearance(np.zeros(1), np.full(1, 0.5), np.ones(1), np.array(WEIGHTS))
    times = np.full(image.size, np.inf, np.float32)
    flat = np.array([np.ravel_multi_index(seed, image.shape) for seed in seeds])
    times[flat] = 0
    medium = Medium(image.reshape(1, -1).astype(np.float32), given.pop("passes", np.zeros(0, bool)))
    cap = given.pop("cap", np.zeros(0, np.float32))
    nobody = Sources(np.zeros(0, np.int32), np.zeros(0, np.int32))
    order = march(times, medium, appearance, grid, flat, cap, given.pop("sources", nobody))
    return times.reshape(image.shape), order


def noise(name, seed=0):
    shape, spacing = SHAPES[name]
    image = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.0)
    return (image / image.std()).astype(np.float32), spacing


@pytest.mark.nojit
@pytest.mark.parametrize("name", SHAPES)
def test_times_are_the_reference_s(name):
    image, spacing = noise(name)
    seeds = [tuple(n // 2 for n in image.shape), (0, 0, 0)]
    passes = np.ones(image.shape, bool)
    passes[:, 4, 2:] = False
    times, order = marched(image, spacing, seeds, passes=passes.ravel())
    expected = plain_times(
        plain_cost(image, spacing, 0.0, 0.5, 1.0, WEIGHTS), spacing, seeds, passes
    )
    np.testing.assert_allclose(
        times[passes],
        expected[passes],
        rtol=1e-5,
        atol=bucket_width(WEIGHTS, Grid(1, 1, 1, *spacing)),
    )
    assert np.isinf(times[~passes]).all()
    assert sorted(order) == list(np.flatnonzero(passes))


def test_a_homogeneous_region_gives_distances():
    image = np.zeros((33, 41, 37), np.float32)
    times, order = marched(image, (1.0, 0.7, 0.9), [(16, 20, 18)])
    z, y, x = (
        (i - c) * h
        for i, c, h in zip(np.indices(image.shape), (16, 20, 18), (1.0, 0.7, 0.9), strict=True)
    )
    distance = np.sqrt(z**2 + y**2 + x**2)
    np.testing.assert_allclose(times[16, 20], 0.02 * distance[16, 20], rtol=1e-5)
    assert (np.abs(times / 0.02 - distance) < 0.05 * distance + 0.8).all()
    width = bucket_width(WEIGHTS, Grid(1, 1, 1, 1.0, 0.7, 0.9))
    assert np.diff(times.ravel()[order]).min() > -width


@pytest.mark.nojit
def test_it_does_not_go_where_another_was_earlier():
    image = np.zeros((1, 1, 21), np.float32)
    cap = np.full(21, np.inf, np.float32)
    cap[14] = 0.05
    times, _ = marched(image, (1.0, 1.0, 1.0), [(0, 0, 10)], cap=cap)
    np.testing.assert_allclose(times[0, 0, 5:14], 0.02 * np.abs(np.arange(-5, 4)), rtol=1e-6)
    assert np.isinf(times[0, 0, 14:]).all()


def test_the_same_input_gives_the_same_bytes():
    image, spacing = noise("3D", 3)
    (one, first), (other, second) = (marched(image, spacing, [(5, 6, 6)]) for _ in range(2))
    assert one.tobytes() == other.tobytes()
    assert first.tobytes() == second.tobytes()


@pytest.mark.nojit
def test_between_two_seeds_both_arrive():
    image = np.zeros((1, 1, 5), np.float32)
    times, _ = marched(image, (1.0, 1.0, 1.0), [(0, 0, 1), (0, 0, 3)])
    np.testing.assert_allclose(times[0, 0], [0.02, 0, 0.02, 0, 0.02], rtol=1e-6)


def test_more_waiting_voxels_than_the_queue_begins_with():
    image = np.zeros((3, 70, 70), np.float32)
    seeds = [(1, y, x) for y in range(70) for x in range(70)]
    times, order = marched(image, (1.0, 1.0, 1.0), seeds)
    np.testing.assert_allclose(times[[0, 2]], 0.02, rtol=1e-6)
    assert len(order) == image.size


@pytest.mark.nojit
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (5.0, 1.0, 1.0)])
def test_fronts_of_two_owners_meet_halfway_in_a_homogeneous_region(spacing):
    """Exactly: first-order times beside a point are up to a fifth too late, more along one direction than another."""
    shape, seeds = (5, 9, 9), [(0, 1, 2), (4, 7, 5), (2, 8, 0)]
    owner = np.full(shape, -1, np.int32)
    for number, seed in enumerate(seeds):
        owner[seed] = number
    origin = np.empty(owner.size, np.int32)
    times, _ = marched(
        np.zeros(shape, np.float32), spacing, seeds, sources=Sources(origin, owner.ravel())
    )
    at = np.indices(shape).transpose(1, 2, 3, 0)
    distances = np.stack([np.linalg.norm((at - s) * np.array(spacing), axis=3) for s in seeds])
    own = np.take_along_axis(distances, owner.ravel()[origin].reshape(shape)[None], 0)[0]
    np.testing.assert_allclose(own, distances.min(axis=0), rtol=1e-5)
    np.testing.assert_allclose(times / 0.02, own, rtol=2e-3)
