"""The Lagrangian reference itself: against closed forms, tables, its own second formulation, and conservation laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp
from scipy.special import i1

from tests.support import exact
from tests.support.exact import jinc
from tests.support.lagrangian import Curve, Law, derivative, ellipse, parameter, solve, star
from tests.support.lagrangian_cases import lopsided, uneven

TIMES = (0.5, 1.0, 1.5)


def well(points: np.ndarray) -> np.ndarray:
    """Case B's and X's 0.5 (r^2 - 0.36)/r."""
    r = np.hypot(*points.T)
    return np.asarray(0.5 * (r**2 - 0.36) / r)


def lopsided_energy(curve: Curve) -> float:
    """int of `lopsided` inside, as the integral of its primitive along the curve."""
    x, y = curve.points.T
    primitive = 0.6 * (x**3 / 3 + 1.6 * x * y**2 - 0.15 * x**2 * y + x**4 / 8 - 0.35 * x)
    return float((primitive * curve.derivative()[:, 1]).sum() * 2 * np.pi / len(x))


def law_of(case: exact.Case, model: str) -> Law:
    return Law(model, case.k, case.lambda_, case.rho, case.friction, case.alpha, t0=case.t0)


@pytest.mark.parametrize("name", exact.CASES)
def test_circles_and_spheres_follow_their_equation(name: str) -> None:
    """Which `exact` solves to the closed forms; the general form of constant density too, in the plane and
    with constant friction."""
    case = exact.CASES[name]
    h = (case.dim - 1) * case.alpha

    def force(points: np.ndarray) -> np.ndarray:
        # All points are alike.
        r = float(np.hypot(*points[0]))
        return np.full(len(points), case.force(r) - h / r)

    path, times = exact.path(case), np.linspace(0.2, case.t_end, 6)
    start = ellipse(case.r0, case.r0, 16, revolved=case.dim == 3)
    models = ("constant-density", "general") if name in "FG" else ("constant-density",)
    for model in ("flowable-mass",) if case.flowable else models:
        for t, curve in zip(times, solve(start, force, law_of(case, model), times), strict=True):
            np.testing.assert_allclose(np.hypot(*curve.points.T), path(t), atol=1e-9)
            np.testing.assert_allclose(curve.speed(), path.beta(t), atol=1e-9)
            if case.flowable:
                np.testing.assert_allclose(
                    curve.density, (case.r0 / path(t)) ** (case.dim - 1) * case.rho, rtol=1e-8
                )


def test_descent_of_circle_and_sphere() -> None:
    """r^2 = r0^2 - 2 (d - 1) alpha t, and case C's table."""
    for revolved in (False, True):
        start = ellipse(1.0, 1.0, 32, revolved=revolved)
        law = Law("descent", alpha=0.05)
        for t, curve in zip(
            TIMES, solve(start, lambda p: np.zeros(len(p)), law, TIMES), strict=True
        ):
            r = math.sqrt(1.0 - 2.0 * (2 if revolved else 1) * 0.05 * t)
            np.testing.assert_allclose(np.hypot(*curve.points.T), r, atol=1e-9)


def test_spheroid_of_constant_density_against_the_table() -> None:
    """Case X, from another program: seven digits."""
    times = sorted(exact.SPHEROID)
    for model in ("constant-density", "general"):
        curves = solve(ellipse(0.8, 1.0, 64, revolved=True), well, Law(model), times)
        for t, curve in zip(times, curves, strict=True):
            true, fine = exact.SPHEROID[t], curve.resampled(16384)
            kinetic = 0.5 * curve.surface_integral(curve.speed() ** 2)
            assert fine.points.max(axis=0) == pytest.approx((true.equator, true.pole), abs=2e-7)
            assert curve.content == pytest.approx(true.volume, abs=2e-7)
            assert curve.size == pytest.approx(true.area, abs=5e-7)
            assert kinetic == pytest.approx(true.kinetic, abs=5e-7)


def test_flowable_spheroid_under_a_constant_force_stays_one() -> None:
    """d_i'' + (3/t) d_i' = -(4 pi w f/M) d1 d2 d3/d_i with rho uniform on the sphere of labels."""
    a, c, mass, force = 0.8, 1.0, 4.0 * math.pi, 0.2
    p = parameter(64)
    density = mass / (4 * math.pi * a * a * c * np.hypot(np.cos(p) / a, np.sin(p) / c))
    start = ellipse(a, c, 64, revolved=True)
    start = Curve(start.points, True, density=density)
    curve = solve(start, lambda points: np.full(len(points), force), Law("flowable-mass"), (1.0,))[
        0
    ]

    def rates(t: float, d: np.ndarray) -> np.ndarray:
        product = d[0] ** 2 * d[1]
        return np.concatenate(
            [d[2:], -3.0 / t * d[2:] - 4.0 * force * product / d[:2] * 4.0 * math.pi / mass]
        )

    pull = -force * a * a * c / np.array([a, c]) * 4.0 * math.pi / mass
    first = np.concatenate([(a, c) + 0.5 * pull * 1e-6, pull * 1e-3])
    axes = solve_ivp(rates, (1e-3, 1.0), first, method="DOP853", rtol=1e-12, atol=1e-14).y[:2, -1]
    assert abs(axes[0] - a) > 0.05
    np.testing.assert_allclose(
        curve.points, axes * np.stack([np.cos(p), np.sin(p)], axis=1), atol=1e-8
    )
    assert curve.mass == pytest.approx(start.mass, rel=1e-9)


def test_flowable_mass_without_area_weight_is_ill_posed() -> None:
    """Under a constant force the system is linear, z_tt + (3/t) z_t = i c z_p with z = x + i y, c = w f/(rho |z_p|).

    Half of the modes exp(i m p) swing, as 2 J1(x)/x with x^2 = 4 |f m| t^2; the others grow, as 2 I1(x)/x: the faster
    the shorter the wave. Where f < 0 those with m > 0 grow, where f > 0 those with m < 0. An area weight bounds the
    rate: by |f| sqrt(w/(alpha rho)), about, for the shortest waves.
    """
    p, small, f, t, m = parameter(128), 1e-9, -0.5, 2.0, 25
    circle, wave, opposite_wave = (
        np.stack([np.cos(i * p), np.sin(i * p)], axis=1) for i in (1, m, -m)
    )
    start = Curve(circle + small * (wave + opposite_wave))
    start = Curve(start.points, density=1.0 / start.geometry().stretch)
    modes = {}
    for alpha in (0.0, 0.2):
        curve = solve(start, lambda x: np.full(len(x), f), Law("flowable-mass", alpha=alpha), (t,))[
            0
        ]
        spectrum = np.fft.fft(curve.points @ (1.0, 1j)) / 128
        modes[alpha] = (spectrum * np.exp(-1j * np.fft.fftfreq(128, 1 / 128) * np.pi / 128))[
            [1, m, -m]
        ]
    x = math.sqrt(4.0 * abs(f)) * t
    grown = 2.0 * i1(x * math.sqrt(m)) / (x * math.sqrt(m))
    assert modes[0.0][0] == pytest.approx(2.0 * i1(x) / x, abs=1e-8)
    assert modes[0.0][1] / small == pytest.approx(grown, rel=1e-3) and grown > 1e4
    assert modes[0.0][2] / small == pytest.approx(jinc(x * math.sqrt(m)), abs=1e-2)
    assert abs(modes[0.2][1]) < 0.01 * grown * small


@pytest.mark.parametrize("revolved", [False, True])
@pytest.mark.parametrize("friction", [None, 0.7])
def test_both_forms_of_constant_density_agree(revolved: bool, friction: float | None) -> None:
    """On a shape and under a force without symmetry; from rest the motion stays normal."""
    start = star(
        lambda angle: 0.75 + (0.05 * np.sin(angle) if revolved else 0.06 * np.cos(3 * angle)),
        192,
        revolved,
    )
    normal, general = (
        solve(
            start,
            uneven if revolved else lopsided,
            Law(model, friction=friction, alpha=0.03),
            TIMES,
        )
        for model in ("constant-density", "general")
    )
    for one, other in zip(normal, general, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-8)
        assert other.velocity is not None
        along = (other.velocity * other.geometry().tangent).sum(axis=1)
        assert np.abs(along).max() < 1e-7 < 1e-2 < np.abs(other.speed()).max()


@pytest.mark.parametrize("model", ["constant-density", "flowable-mass", "descent"])
def test_twice_the_points_give_the_same_curve(model: str) -> None:
    law = Law(model, alpha=0.03, diffusion=0.02 if model == "constant-density" else 0.0)
    curves = [solve(ellipse(0.9, 0.75, n, (0.05, -0.05)), lopsided, law, TIMES) for n in (96, 192)]
    for one, other in zip(*curves, strict=True):
        assert np.abs(one.resampled(512).points - other.resampled(512).points).max() < 1e-6


@pytest.mark.parametrize(
    ("k", "lambda_", "rho"), [(1.5, 1.0, 1.0), (2.0, 2.0, 0.5), (3.0, 1.0, 2.0)]
)
@pytest.mark.parametrize("model", ["constant-density", "flowable-mass"])
def test_energy_is_lost_to_friction_only(model: str, k: float, lambda_: float, rho: float) -> None:
    """d(T/w + U)/dt = -(3 k/t) T/w for a force without symmetry and an area weight; the total mass stays."""
    times = np.linspace(0.4, 1.0, 61)
    law = Law(model, k, lambda_, rho, alpha=0.03)
    curves = solve(ellipse(0.9, 0.75, 128, (0.05, -0.05)), lopsided, law, tuple(times))
    kinetic, total = [], []
    for t, curve in zip(times, curves, strict=True):
        assert curve.velocity is not None and curve.density is not None
        energy = curve.surface_integral(0.5 * curve.density * (curve.velocity**2).sum(axis=1))
        kinetic.append(energy / law.weight(t))
        total.append(kinetic[-1] + lopsided_energy(curve) + law.alpha * curve.size)
    lost = simpson(3.0 * k / times * np.array(kinetic), x=times)
    assert lost > 0.001
    assert total[-1] - total[0] == pytest.approx(-lost, rel=1e-6)
    if model == "flowable-mass":
        assert curves[-1].mass == pytest.approx(rho * ellipse(0.9, 0.75).size, rel=1e-9)


def test_time_dilation() -> None:
    """The curve for k = 3 at t is that for k = 2 at t^1.5."""
    start = ellipse(0.9, 0.75, 128, (0.05, -0.05))
    for model in ("constant-density", "flowable-mass"):
        three = solve(start, lopsided, Law(model, 3.0), (0.9,))[0]
        two = solve(start, lopsided, Law(model, 2.0), (0.9**1.5,))[0]
        np.testing.assert_allclose(three.points, two.points, atol=1e-8)


def test_a_capillary_wave_swings_as_it_must() -> None:
    """A small wave under the area alone: a(t) = a0 2 J1(omega t)/(omega t), omega^2 = 4 lambda alpha m^2/rho."""
    p, alpha, height = parameter(64), 0.05, 1e-4
    start = Curve(np.stack([p, height * np.cos(2 * p)], axis=1), period=(2.0 * np.pi, 0.0))
    times = (1.0, 3.0, 6.0)
    for t, curve in zip(
        times, solve(start, lambda x: np.zeros(len(x)), Law(alpha=alpha), times), strict=True
    ):
        x, y = curve.points.T
        assert y @ np.cos(2 * x) / 32 == pytest.approx(
            height * jinc(math.sqrt(4 * alpha) * 2 * t), abs=1e-3 * height
        )
    assert np.abs(curve.resampled(512).points[:, 1]).max() < height


@pytest.mark.parametrize("revolved", [False, True])
def test_diffusion_has_the_rates_of_circle_and_sphere(revolved: bool) -> None:
    """Without force and friction a small speed fades as exp(-D m^2 t/r^2), exp(-D l (l + 1) t/r^2)."""
    r, d, small, t = 0.8, 0.1, 1e-5, 1.0
    start = ellipse(r, r, 64, revolved=revolved)
    at = start.geometry()
    mode = 0.5 * (3.0 * np.sin(parameter(64)) ** 2 - 1.0) if revolved else np.cos(3 * parameter(64))
    rate = d * (6.0 if revolved else 9.0) / r**2
    start = Curve(start.points, revolved, velocity=small * mode[:, None] * at.normal)
    curve = solve(start, lambda x: np.zeros(len(x)), Law(friction=0.0, diffusion=d), (t,))[0]
    np.testing.assert_allclose(curve.speed(), small * math.exp(-rate * t) * mode, atol=1e-3 * small)


def test_series_and_measures() -> None:
    p = parameter(32)
    np.testing.assert_allclose(derivative(np.sin(3 * p)), 3 * np.cos(3 * p), atol=1e-12)
    plane, ball = ellipse(0.9, 0.7, 96), ellipse(0.9, 0.9, 32, (0.0, 0.3), revolved=True)
    assert plane.content == pytest.approx(np.pi * 0.63, rel=1e-12)
    assert (ball.size, ball.content) == pytest.approx(
        (4 * np.pi * 0.81, 4 / 3 * np.pi * 0.729), rel=1e-12
    )
    fine = plane.resampled(512)
    np.testing.assert_allclose(fine.points, ellipse(0.9, 0.7, 512).points, atol=1e-12)
    torus = ellipse(0.2, 0.2, 64, (0.8, 0.0), revolved=True)
    assert (torus.size, torus.content) == pytest.approx(
        (4 * np.pi**2 * 0.16, 2 * np.pi**2 * 0.032), rel=1e-9
    )
    np.testing.assert_allclose(
        torus.geometry().curvature,
        1 / 0.2 + np.cos(parameter(64)) / (0.8 + 0.2 * np.cos(parameter(64))),
        rtol=1e-9,
    )
