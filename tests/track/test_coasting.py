"""Surfaces that move by their own velocity alone, against exact solutions (numerics of tracking, docs/explanation)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import Workers
from accelsurf.track.boxed_surface import BoxedSurface, boxed_surface
from accelsurf.track.momentum_models import coast, make_momentum
from tests.support.travelling import CUBE, ball, ellipsoid, off_ellipsoid

NO_POINTS = np.zeros((0, 3))
LONG = Geometry((20, 20, 56), (1.0, 1.0, 1.0))
AXES = (4.0, 5.0, 6.5)
#: Strain and rotation.
AFFINE = np.array([[0.03, 0.05, 0.0], [0.0, -0.02, 0.06], [-0.04, 0.0, 0.04]])


def test_an_ellipsoid_coasts_through_ten_empty_frames() -> None:
    """Flowable mass within .1 h (measured .01)."""
    off = {}
    for model in ("flowable-mass", "last-displacement", "none"):
        momentum = make_momentum(model)
        momentum.start(ellipsoid(LONG, (9.6, 9.8, 9.3), AXES), (0, 0, 0), LONG, (3.37, 0.1, 0.0))
        for _ in range(10):
            momentum.predict(1.0)
        off[model] = off_ellipsoid(momentum, (9.6, 10.8, 43.0), AXES)
    print(f"\n10 empty frames, h: {off}")
    assert off["flowable-mass"] < 0.03 and off["last-displacement"] < 0.03
    assert off["none"] > 10.0


def affine_misfit(n: int, duration: float = 4.0) -> tuple[float, float]:
    """A ball whose points go to (I + t A) X: the largest distance from there, and relative error of rho, n voxels."""
    h = 24.0 / n
    geometry = Geometry((n, n, n), (h, h, h))
    centre, radius = np.full(3, 0.5 * (n - 1) * h), 6.0
    on = boxed_surface(ball(geometry, tuple(centre), radius), (0, 0, 0), geometry, 4.0, Workers(1))
    velocity = (on.closest_points() - centre) @ AFFINE.T
    fields = [np.asarray(f, np.float32) for f in (*velocity.T, np.ones(on.surface.size))]
    on, fields, _ = coast(on, fields, duration, NO_POINTS)
    front = on.surface.front(1.0)
    now, matrix = on.closest_points()[front] - centre, np.eye(3) + duration * AFFINE
    start = now @ np.linalg.inv(matrix).T
    radii = np.linalg.norm(start, axis=1)
    slope = np.linalg.norm((start / radii[:, None]) @ np.linalg.inv(matrix), axis=1)
    stretch = abs(np.linalg.det(matrix)) * slope
    off = float((np.abs(radii - radius) / slope).max()) / h
    return off, float(np.abs(fields[3][front] * stretch - 1.0).max())


def test_affine_motion_and_its_density() -> None:
    """X = (I + t A) X_0 and rho = rho_0/J."""
    off, density = affine_misfit(24)
    print(f"\naffine: {off:.4f} h, rho {density:.4f}")
    assert off < 0.03 and density < 0.03


@pytest.mark.slow
def test_affine_motion_converges() -> None:
    found = [affine_misfit(n) for n in (24, 36, 48)]
    off = [one[0] / n for one, n in zip(found, (24, 36, 48), strict=True)]
    order = -np.polyfit(np.log([24, 36, 48]), np.log(off), 1)[0]
    print(f"\naffine: {found}, order {order:.2f}")
    assert order > 1.5 and found[-1][1] < found[0][1]


def test_friction_takes_what_differs_from_the_mean() -> None:
    """The ball travels at c all the same, and its own change ends at (1 - exp(-a t))/a of the free way."""
    geometry, friction = CUBE, 0.5
    momentum = make_momentum("flowable-mass", friction)
    momentum.start(ball(geometry, (11.5, 11.5, 9.0), 5.0), (0, 0, 0), geometry, (1.0, 0.0, 0.0))
    away = momentum.boxed.closest_points() - np.array([11.5, 11.5, 9.0])
    *velocity, density = momentum.fields
    momentum.fields = [np.float32(f + 0.2 * a) for f, a in zip(velocity, away.T, strict=True)] + [
        density
    ]
    for _ in range(3):
        momentum.predict(1.0)
    grown = 5.0 * (1.0 + 0.2 * (1.0 - math.exp(-1.5)) / 0.5)
    assert off_ellipsoid(momentum, (11.5, 11.5, 12.0), (grown, grown, grown)) < 0.05
    assert momentum.mean_velocity()[0] == pytest.approx(1.0, abs=0.005)


def test_a_step_back_undoes_a_step() -> None:
    momentum = make_momentum("flowable-mass")
    momentum.start(
        ellipsoid(CUBE, (11.5, 11.7, 9.0), (4.0, 5.0, 5.5)), (0, 0, 0), CUBE, (1.3, 0.2, 0.0)
    )
    momentum.predict(2.0)
    moved = off_ellipsoid(momentum, (11.5, 11.7, 9.0), (4.0, 5.0, 5.5))
    momentum.predict(-2.0)
    back = off_ellipsoid(momentum, (11.5, 11.7, 9.0), (4.0, 5.0, 5.5))
    assert moved > 2.0 and back < 0.02


def test_a_surface_leaves_the_grid() -> None:
    """Half out, then gone; inside the grid it is as if the grid went on."""
    momentum = make_momentum("flowable-mass")
    momentum.start(ball(CUBE, (11.5, 11.5, 16.0), 5.0), (0, 0, 0), CUBE, (4.0, 0.0, 0.0))
    piece = momentum.predict(2.0)
    on_grid = np.full(CUBE.shape, 9.0)
    on_grid[piece.box] = piece.psi
    inside = ball(CUBE, (11.5, 11.5, 24.0), 5.0) < 0
    assert ((on_grid < 0) == inside).mean() > 0.999 and inside.any()
    piece = momentum.predict(3.0)
    assert not (piece.psi < 0).any()


def test_a_surface_that_the_border_cuts_comes_in_straight() -> None:
    psi = np.hypot(*(np.indices((24, 24))[[0, 1]] - np.array([11.5, 0.0])[:, None, None])) - 6.0
    flat = Geometry((1, 24, 24), (1.0, 1.0, 1.0))
    momentum = make_momentum("flowable-mass")
    momentum.start(psi[None].astype(np.float32), (0, 0, 0), flat, (4.0, 0.0, 0.0))
    piece = momentum.predict(1.0)
    labels = np.zeros(flat.shape, bool)
    labels[piece.box] = piece.psi < 0
    assert labels[0, 6:18, 0:7].all() and labels[0, 11, 9] and not labels[0, 11, 11]


def test_a_single_slice_of_other_thickness_and_oblique_axes() -> None:
    """2D: the velocity is that of the world; across the slice there is none."""
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    flat = Geometry((1, 30, 30), (7.0, 1.0, 0.5), direction=turned)
    momentum = make_momentum("flowable-mass")
    momentum.start(
        ellipsoid(flat, (0.0, 14.0, 7.0), (1.0, 5.0, 4.0)), (0, 0, 0), flat, (1.5, 0.5, 0.0)
    )
    before = momentum.centroid()
    momentum.predict(2.0)
    after = momentum.centroid()
    assert np.subtract(after, before) == pytest.approx((3.0, 1.0, 0.0), abs=0.01)
    # The world's x is the grid's -y, its y the grid's x.
    assert off_ellipsoid(momentum, (0.0, 11.0, 8.0), (1.0, 5.0, 4.0)) < 0.02
    assert momentum.volume() == pytest.approx(7.0 * math.pi * 20.0, rel=0.005)


def test_the_box_follows_the_surface() -> None:
    """A small object in a large frame costs what it is."""
    large = Geometry((200, 200, 200), (1.0, 1.0, 1.0))
    momentum = make_momentum("flowable-mass")
    small = Geometry((20, 20, 20), (1.0, 1.0, 1.0))
    momentum.start(ball(small, (9.5, 9.5, 9.5), 4.0), (30, 30, 30), large, (9.0, 9.0, 9.0))
    for _ in range(15):
        momentum.predict(1.0)
    assert isinstance(momentum.boxed, BoxedSurface) and max(momentum.boxed.surface.shape) < 32
    assert momentum.centroid() == pytest.approx((174.5, 174.5, 174.5), abs=0.01)


def test_a_surface_goes_on_with_voxels_twice_as_large_and_back() -> None:
    """It keeps place, velocity and size, from a state too; with one of the frames' grid it becomes one."""
    geometry = Geometry((25, 24, 40), (1.0, 1.0, 1.0), (3.0, -2.0, 5.0))
    start, axes = (12.2, 11.6, 10.7), (6.0, 7.0, 8.0)
    momentum, again, other = (make_momentum("flowable-mass") for _ in range(3))
    momentum.start(ellipsoid(geometry, start, axes), (0, 0, 0), geometry, (3.3, 0.2, 0.0))
    other.start(ball(geometry, (12.0, 12.0, 34.0), 4.0), (0, 0, 0), geometry)
    volumes, before, halved = (
        momentum.volume() + other.volume(),
        momentum.centroid(),
        momentum.boxed.surface.size,
    )
    momentum.halve()
    momentum.halve()
    assert momentum.boxed.surface.size < 0.35 * halved
    assert momentum.centroid() == pytest.approx(before, abs=0.02)
    again.restore(momentum.state(), geometry)
    for moved in (momentum, again):
        piece = moved.predict(2.0)
        truth = ellipsoid(geometry, (12.2, 12.0, 17.3), axes)[piece.box]
        assert np.abs(piece.psi - truth)[np.abs(truth) < 1.0].max() < 0.15
    np.testing.assert_array_equal(momentum.piece.psi, again.piece.psi)
    union = momentum.merged([other])
    assert union.volume() == pytest.approx(volumes, rel=0.02)
    assert momentum.boxed.geometry is geometry and momentum.mean_velocity()[0] == pytest.approx(
        3.3, abs=0.02
    )
