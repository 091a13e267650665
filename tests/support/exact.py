"""Where surfaces of constant density must be: solutions of ordinary differential equations, closed forms, tables.

A sphere (or circle) under a force that depends on its radius stays one, and the paper's system becomes

    r'' = -(d - 1)/2 r'^2/r - gamma r' - w f(r)/rho,    w = lambda k^2 t^(k-2), gamma = (k + 1)/t
                                                        (constant friction a: w = lambda, gamma = a)

with d = 3 (or 2), from rest at t = 0 by the series r = r0 - (lambda/2) t^k f(r0)/rho. With mass that is conserved and
flows along the surface, the density stays uniform, rho (r0/r)^(d-1), and there is no term r'^2/r:

    r'' = -gamma r' - w f(r) (r/r0)^(d-1)/rho

Solved here by DOP853 to
rtol 1e-12, which knows nothing of grids. `TABLES` holds numbers computed independently of this file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import j1


@dataclass(frozen=True)
class Case:
    """A sphere or circle of radius ``r0`` at rest under the force ``force(r)`` (> 0 shrinks).

    ``alpha`` is the part of the force that is alpha H, ``force`` is all of it. ``transport`` is the factor of the
    term r'^2/r: 1 is right, -1 is what its wrong sign would give, 0 leaves it out. ``flowable`` is the conserved
    mass. ``t0`` is the time on the clock of w and gamma when the surface starts at rest.
    """

    name: str
    r0: float
    force: Callable[[float], float]
    alpha: float = 0.0
    t_end: float = 2.0
    dim: int = 3
    k: float = 2.0
    lambda_: float = 1.0
    rho: float = 1.0
    friction: float | None = None
    transport: float = 1.0
    flowable: bool = False
    t0: float = 0.0


def shrinking(r: float) -> float:
    """Only the area, weight 0.05."""
    return 0.1 / r


def well(r: float) -> float:
    """Pulls to the radius 0.6."""
    return 0.5 * (r * r - 0.36) / r


def soft_ball(r: float) -> float:
    """Chan-Vese of the image (1 - tanh((r - 0.5)/0.1))/2 with c1 = 1, c2 = 0, and 0.02 times the area."""
    return math.tanh((r - 0.5) / 0.1) + 0.04 / r


def soft_disc(r: float) -> float:
    """As `soft_ball` in 2D, where the curvature is 1/r."""
    return math.tanh((r - 0.5) / 0.1) + 0.02 / r


def flowable_well(r: float) -> float:
    """Pulls to the radius 0.6 so that a flowable sphere swings about it as a spring would."""
    return (r - 0.6) / (r * r)


def flowable_circle_well(r: float) -> float:
    """The same for a flowable circle."""
    return (r - 0.6) / r


A = Case("A", 1.0, shrinking, alpha=0.05, t_end=2.5)
B = Case("B", 1.0, well)
C = Case("C", 0.9, soft_ball, alpha=0.02)
F = Case("F", 0.9, soft_disc, alpha=0.02, dim=2)
G = Case("G", 0.9, soft_ball, alpha=0.02, friction=2.0)
H = Case("H", 0.9, soft_ball, alpha=0.02, k=3.0, t_end=1.5)
D = Case("D", 1.0, flowable_well, flowable=True)
E = Case("E", 0.9, soft_ball, alpha=0.02, flowable=True)
J = Case("J", 1.0, flowable_circle_well, dim=2, flowable=True)
K = Case("K", 0.9, soft_ball, alpha=0.02, k=4.0, t_end=1.2)
L = Case("L", 0.9, soft_ball, alpha=0.02, k=1.0, t0=0.3, t_end=1.0)
M = Case("M", 0.9, soft_ball, alpha=0.02, k=0.6, t0=0.3, flowable=True)
CASES = {case.name: case for case in (A, B, C, D, E, F, G, H, J, K, L, M)}


class Path:
    """r(t) and beta(t) = -r'(t) of a case, for 0 <= t <= t_end."""

    def __init__(self, case: Case) -> None:
        self.case = case
        # With gamma = (k + 1)/t the series takes over below this time; its own error is of order t^(2k).
        at_rest = case.friction is not None or case.t0 > 0
        self._first = 0.0 if at_rest else 1e-3
        start = (case.r0, 0.0) if at_rest else self._series(self._first)
        solved = solve_ivp(
            self._rates,
            (self._first, case.t_end),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
        )
        assert solved.success, solved.message
        self._solution = solved.sol

    def _series(self, t: float) -> tuple[float, float]:
        c = self.case
        pull = c.lambda_ * c.force(c.r0) / c.rho
        return c.r0 - 0.5 * t**c.k * pull, -0.5 * c.k * t ** (c.k - 1.0) * pull

    def _rates(self, t: float, state: np.ndarray) -> tuple[float, float]:
        c = self.case
        r, speed = state
        t = t + c.t0
        if c.friction is None:
            w, gamma = c.lambda_ * c.k**2 * t ** (c.k - 2.0), (c.k + 1.0) / t
        else:
            w, gamma = c.lambda_, c.friction
        bend = c.transport * 0.5 * (c.dim - 1) * speed * speed / r
        if c.flowable:
            return speed, -gamma * speed - w * c.force(r) * (r / c.r0) ** (c.dim - 1) / c.rho
        return speed, -bend - gamma * speed - w * c.force(r) / c.rho

    def __call__(self, t: float) -> float:
        """Radius at time t."""
        return self._series(t)[0] if t < self._first else float(self._solution(t)[0])

    def beta(self, t: float) -> float:
        """Speed inward at time t."""
        return -self._series(t)[1] if t < self._first else -float(self._solution(t)[1])


@lru_cache(maxsize=64)
def path(case: Case) -> Path:
    """The solution of a case, solved once."""
    return Path(case)


@lru_cache(maxsize=8)
def descent(case: Case) -> Callable[[float], float]:
    """Radius of a case under the gradient flow, r' = -f(r)."""
    solved = solve_ivp(
        lambda _, r: [-case.force(r[0])],
        (0.0, case.t_end),
        [case.r0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        dense_output=True,
    )
    return lambda t: float(solved.sol(t)[0])


# ------------------------------------------------------------------------------------------------ closed forms


def jinc(x: float) -> float:
    """2 J1(x)/x."""
    return 1.0 if x == 0 else 2.0 * float(j1(x)) / x


def shrinking_sphere(t: float, r0: float = 1.0, alpha: float = 0.05, k: float = 2.0) -> float:
    """Accelerated mean curvature flow: r = sqrt(r0^2 - 2 alpha t^k)."""
    return math.sqrt(r0 * r0 - 2.0 * alpha * t**k)


def sphere_in_well(t: float, k: float = 2.0) -> float:
    """Case B: r^2 = R^2 + (r0^2 - R^2) jinc(omega t^(k/2)), omega^2 = 8 c = 4."""
    return math.sqrt(0.36 + 0.64 * jinc(2.0 * t ** (0.5 * k)))


def damped_sphere_in_well(t: float, friction: float) -> float:
    """Case B with a constant friction a < 2: jinc replaced by e^(-at/2) (cos nu t + a/(2 nu) sin nu t)."""
    nu = math.sqrt(1.0 - 0.25 * friction * friction)
    fade = math.exp(-0.5 * friction * t) * (
        math.cos(nu * t) + 0.5 * friction / nu * math.sin(nu * t)
    )
    return math.sqrt(0.36 + 0.64 * fade)


def circle_in_well(t: float) -> float:
    """Circle, f = c (r^1.5 - R^1.5)/sqrt(r) with c = 1, R = 0.6, r0 = 1: omega^2 = 6 c."""
    end = 0.6**1.5
    return (end + (1.0 - end) * jinc(math.sqrt(6.0) * t)) ** (2.0 / 3.0)


def circle_well(r: float) -> float:
    """The force of `circle_in_well`."""
    return (r**1.5 - 0.6**1.5) / math.sqrt(r)


def flowable_sphere(t: float) -> float:
    """Case D: r = R + (r0 - R) jinc(omega t), omega^2 = 16 pi c/M = 4."""
    return 0.6 + 0.4 * jinc(2.0 * t)


def flowable_circle(t: float) -> float:
    """Case J: the same with omega^2 = 8 pi c/M = 4 (M = 2 pi)."""
    return 0.6 + 0.4 * jinc(2.0 * t)


def plane(t: float, force: float, k: float = 2.0, lambda_: float = 1.0, rho: float = 1.0) -> float:
    """Distance that a plane front at rest has moved under a constant force: (lambda/2) t^k f/rho."""
    return 0.5 * lambda_ * t**k * force / rho


def shrinking_by_descent(t: float, r0: float = 1.0, alpha: float = 0.05) -> float:
    """Mean curvature flow of a sphere: r = sqrt(r0^2 - 4 alpha t)."""
    return math.sqrt(r0 * r0 - 4.0 * alpha * t)


# ------------------------------------------------------------------------------------------------------ tables

#: Radius at times, from another solver run (DOP853, rtol 1e-12); eight digits.
TABLES: dict[str, dict[float, float]] = {
    "A": {0.5: 0.98742088, 1.0: 0.94868330, 1.5: 0.88034084, 2.0: 0.77459667, 2.5: 0.61237244},
    "B": {0.25: 0.99005417, 0.5: 0.96086667, 1.0: 0.85387580, 1.5: 0.71039789, 2.0: 0.58212210},
    "C": {
        0.25: 0.86716700,
        0.5: 0.76579395,
        0.75: 0.58674465,
        1.0: 0.39546571,
        1.5: 0.49001547,
        2.0: 0.49311263,
    },
    "D": {0.25: 0.98762953, 0.5: 0.95204047, 1.0: 0.83068992, 1.5: 0.69041572, 2.0: 0.58679133},
    "E": {0.25: 0.86814281, 0.5: 0.78104067, 1.0: 0.53734245, 1.5: 0.42357764, 2.0: 0.45572679},
    "F": {
        0.25: 0.86797675,
        0.5: 0.77064985,
        0.75: 0.60565651,
        1.0: 0.43238200,
        1.5: 0.50958826,
        2.0: 0.48797996,
    },
    "G": {0.25: 0.87192149, 0.5: 0.80065610, 1.0: 0.57103055, 1.5: 0.36258799, 2.0: 0.37341077},
    "H": {0.5: 0.83387976, 1.0: 0.39546571, 1.5: 0.53180316},
}
#: beta at times of the same.
SPEEDS: dict[str, dict[float, float]] = {
    "A": {0.5: 0.05063697, 1.5: 0.17038855, 2.5: 0.40824829},
    "B": {0.5: 0.15306646, 1.0: 0.26445741, 2.0: 0.20016592},
    "C": {0.5: 0.55331027, 1.0: 0.44730016, 1.5: -0.41025517},
    "D": {0.5: 0.18384558, 1.0: 0.28226722, 2.0: 0.14565126},
    "E": {0.5: 0.43303699, 1.0: 0.43834880, 2.0: -0.13415630},
    "F": {0.5: 0.52419015, 1.0: 0.41828691, 1.5: -0.31495245},
    "G": {0.5: 0.35314664, 1.0: 0.54060014, 2.0: -0.16775890},
}
#: Radius of case C under the gradient flow.
DESCENT_C = {0.25: 0.64247012, 0.5: 0.50848780, 0.75: 0.49328441, 1.0: 0.49197410}


@dataclass(frozen=True)
class Spheroid:
    """One line of the table of case X."""

    equator: float
    pole: float
    area: float
    volume: float
    kinetic: float
    potential: float


#: Case X: spheroid with half axes 0.8 (equator) and 1.0 (pole) at rest under the field of case B, alpha = 0, k = 2:
#: from an axisymmetric spectral solver whose resolutions 48, 64 and 96 agree to 7 digits.
SPHEROID: dict[float, Spheroid] = {
    0.5: Spheroid(0.7787514, 0.9607211, 8.8122524, 2.4323225, 0.0516256, -0.0170633),
    1.0: Spheroid(0.7223313, 0.8518227, 7.3067388, 1.8445222, 0.1204853, -0.1243526),
    1.5: Spheroid(0.6511540, 0.7032334, 5.5971054, 1.2432243, 0.1002058, -0.1916579),
    2.0: Spheroid(0.5928672, 0.5735066, 4.3658664, 0.8575681, 0.0311067, -0.2032800),
}


def with_wrong_transport(case: Case) -> Case:
    """The case with the sign of the 1/2 beta^2 H term turned, as the paper prints it for surfaces."""
    return replace(case, name=f"{case.name}, wrong transport", transport=-1.0)


def with_wrong_force(case: Case) -> Case:
    """The case as the paper's printed pair of signs moves it: outward under an inward force, r'' = +w f + r'^2/r."""

    def outward(r: float) -> float:
        return -case.force(r)

    return replace(case, name=f"{case.name}, printed signs", force=outward, transport=-1.0)
