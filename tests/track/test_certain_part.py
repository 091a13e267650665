"""What of the distances between two frames' surfaces becomes velocity: motion, not noise."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import Workers
from accelsurf.track.boxed_surface import BoxedSurface, boxed_surface
from accelsurf.track.momentum import Gains
from accelsurf.track.momentum_models import make_momentum
from accelsurf.track.observer import certain_part
from tests.support.travelling import ball, off_ellipsoid, whole

ROOM = Geometry((32, 32, 32), (1.0, 1.0, 1.0))
MIDDLE = np.full(3, 15.5)


@pytest.fixture(scope="module")
def sphere() -> BoxedSurface:
    return boxed_surface(ball(ROOM, tuple(MIDDLE), 9.0), (0, 0, 0), ROOM, 4.0, Workers(1))


def along(on: BoxedSurface) -> np.ndarray:
    """Unit vectors from the middle to the band's closest points, z y x."""
    ways = on.closest_points() - MIDDLE
    return ways / np.linalg.norm(ways, axis=1)[:, None]


def rough(on: BoxedSurface, seed: int = 0) -> np.ndarray:
    """Noise of .4 voxel, one value where the closest points lie in one voxel."""
    noise = np.random.default_rng(seed).normal(0, 0.4, ROOM.shape)
    return noise[tuple(np.rint(on.closest_points()).astype(int).T)]


def mean_square(on: BoxedSurface, values: np.ndarray) -> float:
    area = on.surface.fraction_and_area()[1]
    return float((area * values**2).sum() / area.sum())


def test_growth_and_a_change_of_shape_pass(sphere: BoxedSurface) -> None:
    size = sphere.surface.size
    np.testing.assert_allclose(certain_part(sphere, np.full(size, 0.7)), 0.7, rtol=1e-4)
    longer = 0.5 * (3.0 * along(sphere)[:, 0] ** 2 - 1.0)
    passed = certain_part(sphere, longer)
    share = float((passed * longer).sum() / (longer**2).sum())
    assert 0.93 < share < 1.01 and mean_square(sphere, passed - longer) < 0.01 * mean_square(
        sphere, longer
    )
    assert not certain_part(sphere, np.zeros(size)).any()


def test_noise_does_not(sphere: BoxedSurface) -> None:
    for seed in range(3):
        noise = rough(sphere, seed)
        assert mean_square(sphere, certain_part(sphere, noise)) < 0.02 * mean_square(sphere, noise)


def test_of_both_together_the_motion_is_left(sphere: BoxedSurface) -> None:
    longer = 0.8 * 0.5 * (3.0 * along(sphere)[:, 0] ** 2 - 1.0)
    noise = rough(sphere)
    left = certain_part(sphere, longer + noise) - longer
    assert mean_square(sphere, left) < 0.15 * mean_square(sphere, noise)


def test_it_is_the_same_with_unequal_spacing_and_in_one_slice() -> None:
    spaced = Geometry((20, 36, 36), (1.0, 1.0, 2.0))
    z, y, x = (np.arange(n) * h for n, h in zip((20, 36, 36), (2.0, 1.0, 1.0), strict=True))
    away = np.sqrt((z[:, None, None] - 19) ** 2 + (y[:, None] - 17.5) ** 2 + (x - 17.5) ** 2)
    flat = Geometry((1, 36, 36), (1.0, 1.0, 5.0))
    disc = np.hypot(y[:, None] - 17.5, x - 17.5)[None]
    for psi, geometry in ((away - 10.0, spaced), (disc - 10.0, flat)):
        on = boxed_surface(psi.astype(np.float32), (0, 0, 0), geometry, 4.0, Workers(1))
        np.testing.assert_allclose(
            certain_part(on, np.full(on.surface.size, -0.4)), -0.4, rtol=1e-3
        )


def test_a_ball_in_noise_coasts_as_a_ball() -> None:
    """Measured surfaces of a ball that moves evenly are rough by half a voxel; then four frames show nothing.

    With what is rough, too, it is 1.9 voxels off.
    """
    momentum = make_momentum("flowable-mass")
    momentum.start(ball(ROOM, (15.5, 15.5, 9.0), 6.0), (0, 0, 0), ROOM, (0.0, 0.0, 0.0))
    random = np.random.default_rng(3)
    for frame in range(1, 5):
        momentum.predict(1.0)
        psi = ball(ROOM, (15.5, 15.5, 9.0 + frame), 6.0) + random.normal(0, 0.4, ROOM.shape).astype(
            np.float32
        )
        momentum.correct(whole(psi.astype(np.float32)), 1.0, Gains())
    for _ in range(4):
        momentum.predict(1.0)
    off = off_ellipsoid(momentum, (15.5, 15.5, 17.0), (6.0,) * 3)
    print(f"\n{off:.2f} voxels")
    assert off < 1.6
