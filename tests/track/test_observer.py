"""The correction of a predicted surface by a measured one, and what a momentum is made of and into."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import Workers
from accelsurf.track.momentum import Gains, SurfaceMomentum
from accelsurf.track.momentum_models import MODELS, FlowableMomentum, make_momentum
from tests.support.travelling import CUBE, ball, ellipsoid, off_ellipsoid, whole

ROOM = Geometry((20, 22, 36), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("gain", [0.5, 0.3])
def test_the_error_falls_by_one_minus_the_gain(gain: float) -> None:
    """A ball that rests, and a prediction 4 voxels off and a voxel too small: (1 - K)^n."""
    momentum = make_momentum("flowable-mass")
    momentum.start(ball(CUBE, (11.5, 11.5, 8.0), 4.0), (0, 0, 0), CUBE)
    target = whole(ball(CUBE, (11.5, 11.5, 12.0), 5.0))
    for n in range(1, 6):
        momentum.correct(target, 1.0, Gains(gain, 0.0))
        left = (1.0 - gain) ** n
        radius, x = 5.0 - left, 12.0 - 4.0 * left
        assert off_ellipsoid(momentum, (11.5, 11.5, x), (radius,) * 3) < 0.02
    momentum.correct(target, 1.0, Gains(1.0, 0.0))
    assert off_ellipsoid(momentum, (11.5, 11.5, 12.0), (5.0,) * 3) < 0.01


def prediction_error(
    momentum: SurfaceMomentum, gains: Gains, speed: float = 1.7, frames: int = 4
) -> float:
    """How far the last of some predictions is from an ellipsoid that moves along its long axis, voxels."""
    axes = (4.0, 4.5, 6.0)
    momentum.start(ellipsoid(ROOM, (9.5, 10.5, 9.0), axes), (0, 0, 0), ROOM)
    for frame in range(1, frames + 1):
        momentum.predict(1.0)
        off = off_ellipsoid(momentum, (9.5, 10.5, 9.0 + speed * frame), axes)
        momentum.correct(whole(ellipsoid(ROOM, (9.5, 10.5, 9.0 + speed * frame), axes)), 1.0, gains)
    return off


def test_the_velocity_is_learned_by_its_gain() -> None:
    """With K_psi = 1 what is missing of the velocity falls by 1 - K_V from frame to frame."""
    momentum = FlowableMomentum()
    prediction_error(momentum, Gains(1.0, 0.5))
    assert momentum.mean_velocity()[0] == pytest.approx(1.7 * (1.0 - 0.5**4), abs=0.01)


def test_baselines_report_the_motion_of_the_centroid() -> None:
    for model in ("last-displacement", "none"):
        momentum = make_momentum(model)
        off = prediction_error(momentum, Gains())
        assert momentum.mean_velocity()[0] == pytest.approx(1.7, abs=0.02)
        assert off < 0.03 if model == "last-displacement" else 1.6 < off < 2.2


def test_new_surface_gets_the_velocity_around_and_the_first_density() -> None:
    momentum = make_momentum("flowable-mass")
    momentum.start(ball(ROOM, (9.5, 10.5, 9.0), 5.0), (0, 0, 0), ROOM, (1.0, 0.0, 0.0))
    momentum.fields[3] = 2.0 * momentum.fields[3]
    both = np.minimum(ball(ROOM, (9.5, 10.5, 9.0), 5.0), ball(ROOM, (9.5, 10.5, 27.0), 4.0))
    momentum.correct(whole(both), 1.0, Gains(1.0, 0.0))
    far = momentum.boxed.closest_points()[:, 2] > 20.0
    assert far.any() and momentum.fields[2] == pytest.approx(1.0, abs=1e-5)
    assert momentum.fields[3][far] == pytest.approx(1.0) and momentum.fields[3][
        ~far
    ] == pytest.approx(2.0, rel=1e-4)


def test_a_division_and_a_merging_share_the_velocities() -> None:
    """Two that fly apart become two momenta; together again each side has its own velocity."""
    left, right = ball(ROOM, (9.5, 10.5, 9.0), 4.0), ball(ROOM, (9.5, 10.5, 20.0), 4.0)
    parent = make_momentum("flowable-mass")
    parent.start(np.minimum(left, right), (0, 0, 0), ROOM)
    parent.fields[2] = np.where(parent.boxed.closest_points()[:, 2] < 14.5, -1.0, 2.0).astype(
        np.float32
    )
    first, second = parent.split([whole(left), whole(right)])
    assert first.mean_velocity()[0] == pytest.approx(-1.0, abs=0.01)
    assert second.mean_velocity()[0] == pytest.approx(2.0, abs=0.01)
    union = first.merged([second])
    assert union.volume() == pytest.approx(parent.volume(), rel=1e-3)
    assert union.mean_velocity()[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("model", MODELS)
def test_points_move_with_the_surface(model: str) -> None:
    """Vertices stay on the surface through coasting and correction; the identity of each is its place in the list."""
    momentum = make_momentum(model)
    momentum.start(ball(ROOM, (9.5, 10.5, 9.0), 5.0), (0, 0, 0), ROOM, (1.5, 0.0, 0.0))
    ways = np.array([[5.0, 0, 0], [-5.0, 0, 0], [0, 5.0, 0], [0, 0, -5.0], [3.0, 4.0, 0]])
    momentum.attach_points(np.array([9.0, 10.5, 9.5]) + ways)
    momentum.predict(1.0)
    momentum.correct(whole(ball(ROOM, (9.5, 10.5, 11.0), 5.0)), 1.0, Gains())
    centre = np.array([11.0, 10.5, 9.5])
    assert np.linalg.norm(momentum.points - centre, axis=1) == pytest.approx(5.0, abs=0.02)
    assert np.abs(momentum.points - centre - ways).max() < 0.05


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.threads
def test_a_restored_state_gives_the_same_bytes_on_any_threads(model: str) -> None:
    momentum = make_momentum(model, 0.1)
    psi = ellipsoid(ROOM, (9.5, 10.5, 9.0), (4.0, 5.0, 6.0))
    before = psi.copy()
    momentum.start(psi, (0, 0, 0), ROOM, (1.5, 0.2, 0.1))
    momentum.attach_points(np.array([[14.0, 10.5, 9.5]]))
    momentum.predict(1.0)
    saved = momentum.state()
    with Workers(2) as two:
        again = make_momentum(model, 0.1, two)
        again.restore(saved, ROOM)
        ends: list[Any] = []
        for one in (momentum, again):
            one.correct(
                whole(ellipsoid(ROOM, (9.5, 10.5, 11.0), (4.0, 5.0, 5.5))), 1.0, Gains(0.6, 0.5)
            )
            piece = one.predict(1.0)
            ends.append(
                (
                    piece.corner,
                    piece.psi.tobytes(),
                    one.points.tobytes(),
                    one.mean_velocity(),
                    one.centroid(),
                )
            )
    assert ends[0] == ends[1]
    np.testing.assert_array_equal(psi, before)
