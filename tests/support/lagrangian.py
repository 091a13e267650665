"""Where curves and surfaces of revolution must be: the equations of the paper on moving points, by Fourier series.

A second way to the same answer, which shares nothing with the program: no grid, no level set, no distance. A closed
curve is n points X(p) at equal steps of a parameter p, derivatives are those of its Fourier series (exponentially
accurate for smooth curves), and time is solved by DOP853 to 1e-11. A surface of revolution is its meridian in the
half plane (r, z): a curve beside the axis (a torus), or one that crosses it, continued to negative r by reflection,
so that it is a smooth closed curve again. A periodic curve (a wave) continues itself after one ``period``.

With N the inward normal, s the arc length, H the sum of the principal curvatures (kappa in the plane, kappa - N_r/r for
a surface of revolution), w = lambda k^2 t^(k-2) and gamma = (k+1)/t (constant friction a: w = lambda, gamma = a), and
the force f of a region energy int f dx plus alpha H:

    constant density    X_t = beta N,   beta_t = w f/rho + 1/2 beta^2 H - gamma beta + D Lap_S beta
      the same, general X_tt = w f/rho N - (div_S V) V - grad_S q - q H N - gamma V,   V = X_t, q = 1/2 |V|^2
    flowable mass       X_tt = w f/rho N - gamma X_t,   rho J fixed for each point, J its length or area per parameter
    descent             X_t = f N

from rest at t = 0 by the first term of the series in t^k, X = X_0 + (lambda/2) t^k f/rho N.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

#: The force of a region energy at points (n, 2): (x, y) in the plane, (|r|, z) beside the axis of revolution.
Force = Callable[[np.ndarray], np.ndarray]
#: The same at a time.
MovingForce = Callable[[np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class Law:
    """One of the systems above, with its parameters; lengths mm, ``diffusion`` D mm2 per unit time.

    ``model`` is constant-density, general, flowable-mass or descent. ``t0`` is the time on the clock of w and gamma
    when the surface starts; above 0 it starts there, without the series.
    """

    model: str = "constant-density"
    k: float = 2.0
    lambda_: float = 1.0
    rho: float = 1.0
    friction: float | None = None
    alpha: float = 0.0
    diffusion: float = 0.0
    t0: float = 0.0

    def __post_init__(self) -> None:
        assert self.model in ("constant-density", "general", "flowable-mass", "descent"), self.model
        assert self.diffusion == 0.0 or self.model == "constant-density", (
            "diffusion: of constant density only"
        )

    def weight(self, t: float) -> float:
        """w at time t."""
        return (
            self.lambda_
            if self.friction is not None
            else self.lambda_ * self.k**2 * t ** (self.k - 2.0)
        )

    def gamma(self, t: float) -> float:
        """Friction at time t."""
        return self.friction if self.friction is not None else (self.k + 1.0) / t

    @property
    def is_stationary(self) -> bool:
        """Whether the motion can begin at once: nothing in the equations is infinite at the start."""
        return self.model == "descent" or self.friction is not None or self.t0 > 0


def parameter(n: int) -> np.ndarray:
    """``n`` values of the parameter, half a step off 0, so that no point of a meridian lies on the axis (n even)."""
    return 2.0 * np.pi * (np.arange(n) + 0.5) / n


def derivative(values: np.ndarray) -> np.ndarray:
    """d/dp of periodic values (n, ...); the last modes are damped (Hou & Li 2007), which stops aliasing."""
    n = len(values)
    mode = np.fft.rfftfreq(n, 1.0 / n)
    factor = 1j * mode * np.exp(-36.0 * (2.0 * mode / n) ** 36)
    spectrum = np.fft.rfft(values, axis=0)
    return np.fft.irfft(spectrum * factor.reshape(-1, *[1] * (values.ndim - 1)), n, axis=0)


def finer(values: np.ndarray, n: int) -> np.ndarray:
    """Periodic values (m, ...) at the ``n`` > m points of `parameter`."""
    spectrum = np.fft.rfft(values, axis=0)
    turn = np.exp(1j * np.arange(len(spectrum)) * (parameter(n)[0] - parameter(len(values))[0]))
    return np.fft.irfft(spectrum * turn.reshape(-1, *[1] * (values.ndim - 1)), n, axis=0) * (
        n / len(values)
    )


class Geometry(NamedTuple):
    """At each point: unit tangent T and inward normal N (n, 2), |X_p|, length or area per parameter J, curvature H,
    and the part of it in the plane of the curve."""

    tangent: np.ndarray
    normal: np.ndarray
    stretch: np.ndarray
    measure: np.ndarray
    curvature: np.ndarray
    bend: np.ndarray


@dataclass(frozen=True)
class Curve:
    """A curve or meridian, anticlockwise (inside to its left), with what it carries.

    ``points`` (n, 2) mm; ``revolved``: (r, z), else (x, y); ``velocity`` (n, 2) mm per unit time, 0 unless given;
    ``density`` (n,) mass per length or area, the law's rho unless given; ``period`` (2,) mm, by which the points
    advance in one period of the parameter: 0 for a closed curve.
    """

    points: np.ndarray
    revolved: bool = False
    velocity: np.ndarray | None = None
    density: np.ndarray | None = None
    period: tuple[float, float] = (0.0, 0.0)

    @property
    def _slope(self) -> np.ndarray:
        """Mean X_p: what is not periodic in X."""
        return np.asarray(self.period) / (2.0 * np.pi)

    def derivative(self) -> np.ndarray:
        """X_p."""
        return (
            derivative(self.points - self._slope * parameter(len(self.points))[:, None])
            + self._slope
        )

    def geometry(self) -> Geometry:
        """Tangents, normals and curvatures."""
        first = self.derivative()
        second = derivative(first)
        stretch = np.hypot(*first.T)
        tangent = first / stretch[:, None]
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / stretch**3
        if not self.revolved:
            return Geometry(tangent, normal, stretch, stretch, curvature, curvature)
        r = self.points[:, 0]
        return Geometry(
            tangent, normal, stretch, stretch * np.abs(r), curvature - normal[:, 0] / r, curvature
        )

    def resampled(self, n: int = 4096) -> Curve:
        """The same curve by ``n`` points."""
        straight, new = (self._slope * parameter(m)[:, None] for m in (len(self.points), n))
        velocity = None if self.velocity is None else finer(self.velocity, n)
        density = None if self.density is None else finer(self.density, n)
        return Curve(
            finer(self.points - straight, n) + new, self.revolved, velocity, density, self.period
        )

    def integral(self, values: np.ndarray) -> float:
        """int values dp over the curve (n,), to the accuracy of the series.

        Over half the period, from pole to pole, for a meridian that crosses the axis: there ``values`` are odd.
        """
        n = len(values)
        if not self.revolved or self.points[:, 0].min() > 0:
            return float(values.sum()) * 2.0 * np.pi / n
        mode = np.arange(1, n // 2)
        spectrum = np.fft.rfft(values)[1 : n // 2] / n * np.exp(-1j * mode * np.pi / n)
        return float(
            (4.0 * spectrum.real * np.sin(0.5 * np.pi * mode) / mode).sum() + np.pi * values.mean()
        )

    def surface_integral(self, values: np.ndarray | float = 1.0) -> float:
        """int values dA (mm2 times unit), or int values ds of a plane curve; ``values`` (n,)."""
        at = self.geometry()
        if not self.revolved:
            return self.integral(values * at.stretch)
        return 2.0 * np.pi * self.integral(values * self.points[:, 0] * at.stretch)

    @property
    def size(self) -> float:
        """Length (mm) of a plane curve, area (mm2) of a surface of revolution."""
        return self.surface_integral()

    @property
    def content(self) -> float:
        """Area (mm2) inside a closed plane curve, volume (mm3) inside a surface of revolution."""
        rise = self.derivative()[:, 1]
        if not self.revolved:
            return self.integral(self.points[:, 0] * rise)
        return np.pi * self.integral(self.points[:, 0] ** 2 * rise)

    @property
    def mass(self) -> float:
        """int rho dA."""
        assert self.density is not None
        return self.surface_integral(self.density)

    def speed(self) -> np.ndarray:
        """beta = V . N (n,)."""
        assert self.velocity is not None
        return np.asarray((self.velocity * self.geometry().normal).sum(axis=1))


def ellipse(
    a: float,
    b: float,
    n: int = 128,
    centre: tuple[float, float] = (0.0, 0.0),
    revolved: bool = False,
) -> Curve:
    """Half axes ``a`` along x (r) and ``b`` along y (z)."""
    p = parameter(n)
    return Curve(np.stack([a * np.cos(p), b * np.sin(p)], axis=1) + centre, revolved)


def star(radius: Callable[[np.ndarray], np.ndarray], n: int = 128, revolved: bool = False) -> Curve:
    """The curve at ``radius(angle)`` from the origin; the angle is from the x (r) axis."""
    p = parameter(n)
    return Curve(radius(p)[:, None] * np.stack([np.cos(p), np.sin(p)], axis=1), revolved)


class _Rates:
    """The right hand side of a law for the points of one start."""

    def __init__(
        self, start: Curve, force: Force, law: Law, moving: MovingForce | None = None
    ) -> None:
        self.start, self.force, self.law, self.moving = start, force, law, moving
        self.density = law.rho if start.density is None else start.density
        #: Mass per parameter.
        self.mass = self.density * start.geometry().measure

    def curve(self, points: np.ndarray) -> Curve:
        return Curve(points, self.start.revolved, period=self.start.period)

    def pull(self, curve: Curve, at: Geometry) -> np.ndarray:
        """f (n,), the area's part with it."""
        where = curve.points.copy()
        if curve.revolved:
            where[:, 0] = np.abs(where[:, 0])
        return np.asarray(self.force(where) + self.law.alpha * at.curvature)

    def diffusion(self, curve: Curve, at: Geometry, beta: np.ndarray) -> np.ndarray:
        """D Lap_S beta = D (J beta_s)_p/J, with the length's J_s = 1 in the plane."""
        if self.law.diffusion == 0.0:
            return np.zeros_like(beta)
        along = derivative(beta) / at.stretch
        if not curve.revolved:
            return np.asarray(self.law.diffusion * derivative(along) / at.stretch)
        r = curve.points[:, 0]
        return np.asarray(self.law.diffusion * derivative(r * along) / (r * at.stretch))

    def first(self, t: float) -> np.ndarray:
        """State (4 n,) at a small time after rest."""
        at, law = self.start.geometry(), self.law
        pull = (law.lambda_ * self.pull(self.start, at) / self.density)[:, None] * at.normal
        return np.concatenate(
            [self.start.points + 0.5 * t**law.k * pull, 0.5 * law.k * t ** (law.k - 1.0) * pull]
        )

    def __call__(self, t: float, state: np.ndarray) -> np.ndarray:
        law, moving = self.law, self.moving
        if moving is not None:
            now = t
            self.force = lambda points: moving(points, now)
        t = t + law.t0
        points, velocity = state.reshape(2, -1, 2)
        curve = self.curve(points)
        at = curve.geometry()
        pull = self.pull(curve, at)
        if law.model == "descent":
            return np.concatenate([pull[:, None] * at.normal, np.zeros_like(points)]).ravel()
        w, gamma = law.weight(t), law.gamma(t)
        if law.model == "flowable-mass":
            change = (w * pull * at.measure / self.mass)[:, None] * at.normal - gamma * velocity
        elif law.model == "general":
            change = (
                self.general(curve, at, velocity)
                + (w / law.rho * pull)[:, None] * at.normal
                - gamma * velocity
            )
        else:
            # V = beta N: V_t = beta_t N + beta N_t, and N_t = -beta_s T for a point that moves along N.
            beta = (velocity * at.normal).sum(axis=1)
            rate = w / law.rho * pull + 0.5 * beta**2 * at.curvature - gamma * beta
            rate += self.diffusion(curve, at, beta)
            turn = -beta * derivative(beta) / at.stretch
            velocity = beta[:, None] * at.normal
            change = rate[:, None] * at.normal + turn[:, None] * at.tangent
        return np.concatenate([velocity, change]).ravel()

    @staticmethod
    def general(curve: Curve, at: Geometry, velocity: np.ndarray) -> np.ndarray:
        """-(div_S V) V - grad_S q - q H N."""
        divergence = (derivative(velocity) * at.tangent).sum(axis=1) / at.stretch
        if curve.revolved:
            divergence += velocity[:, 0] / curve.points[:, 0]
        q = 0.5 * (velocity**2).sum(axis=1)
        along = (derivative(q) / at.stretch)[:, None] * at.tangent
        return np.asarray(
            -divergence[:, None] * velocity - along - (q * at.curvature)[:, None] * at.normal
        )


def solve(
    start: Curve,
    force: Force,
    law: Law,
    times: Sequence[float],
    tolerance: float = 1e-11,
    moving: MovingForce | None = None,
) -> list[Curve]:
    """The curve at each of ``times`` (ascending, above 0), started at rest unless ``start`` has a velocity.

    ``moving`` is a force that depends on time, instead of ``force``.
    """
    rates = _Rates(start, force, law, moving)
    velocity = np.zeros_like(start.points) if start.velocity is None else start.velocity
    first, state = 0.0, np.concatenate([start.points, velocity])
    if not law.is_stationary:
        assert start.velocity is None, "from rest, unless the friction is constant"
        # The series errs by t^(2 k).
        first = min(1e-6 ** (1.0 / law.k), 0.5 * times[0])
        state = rates.first(first)
    solved = solve_ivp(
        rates,
        (first, times[-1]),
        state.ravel(),
        method="DOP853",
        t_eval=times,
        rtol=tolerance,
        atol=0.01 * tolerance,
    )
    assert solved.success, solved.message
    curves = []
    for one in solved.y.T:
        points, velocity = one.reshape(2, -1, 2)
        curve = rates.curve(points)
        density = np.full(len(points), law.rho)
        if law.model == "flowable-mass":
            density = rates.mass / curve.geometry().measure
        curves.append(Curve(points, start.revolved, velocity, density, start.period))
    return curves
