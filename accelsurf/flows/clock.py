"""The clock of the accelerated flows: weight of the potential and friction at a time since rest."""

from __future__ import annotations

import math
import sys

#: The last step of a clock whose speeds are this moment's: below any step, and not 0.
NOW = sys.float_info.min


class Clock:
    """The time t of the weight w = lambda k^2 t^(k-2) and the friction gamma = (k+1)/t.

    With a constant friction a, w = lambda and gamma = a. From rest at t = 0 the first half step follows the exact
    series beta = (lambda k/2) t^(k-1) f/rho; that needs k > 1. Otherwise the clock starts at t0 > 0, from rest.

    Parameters
    ----------
    k, lambda_ : float
        Order and strength of the potential.
    friction : float, optional
        A constant friction instead of (k+1)/t.
    t0 : float, optional
        Time on the clock at rest. None: 0 for k > 1; otherwise the time in which the first step is made.
    """

    def __init__(
        self,
        k: float = 2.0,
        lambda_: float = 1.0,
        friction: float | None = None,
        t0: float | None = None,
    ) -> None:
        self.k = float(k)
        self.lambda_ = float(lambda_)
        self.friction = friction
        self._given = 0.0 if t0 is None and (k > 1 or friction is not None) else t0
        self.t0 = self._given
        self.time = self.t0 or 0.0
        #: The last time step, 0 right after a start from rest, `NOW` right after one in motion.
        self.last_dt = 0.0

    @property
    def at_rest(self) -> bool:
        """True if no step was made since the last start from rest."""
        return self.last_dt == 0.0

    def start(self) -> None:
        """Start from rest for a new run."""
        self.t0 = self._given
        self.zero_momentum()

    def zero_momentum(self) -> None:
        """Back to the time of a start from rest."""
        self.time, self.last_dt = self.t0 or 0.0, 0.0

    def start_moving(self) -> None:
        """Start with this moment's speeds, neither at rest nor half a step behind."""
        self.last_dt = NOW

    def state(self) -> tuple[float | None, float, float]:
        """Return t0, the time and the last step."""
        return self.t0, self.time, self.last_dt

    def restore(self, t0: float | None, time: float, last_dt: float) -> None:
        """Go back to a `state`."""
        self.t0 = t0
        self.time = time
        self.last_dt = last_dt

    def continue_from(self, before: Clock) -> None:
        """Continue from a clock with other settings: take its time, unless it is at rest; then keep the own t0."""
        same = (self.k, self.lambda_, self.friction, self._given) == (
            before.k,
            before.lambda_,
            before.friction,
            before._given,
        )
        if same:
            self.restore(*before.state())
        elif not before.at_rest:
            self.time, self.last_dt = before.time, before.last_dt

    def tick(self, dt: float) -> None:
        """Advance by ``dt``."""
        self.time += dt
        self.last_dt = dt

    def weight(self, t: float | None = None) -> float:
        """Weight w at time ``t``, now unless given; at 0, where it may be infinite, that of time 1."""
        t = self.time if t is None else t
        if self.friction is not None:
            return self.lambda_
        return self.lambda_ * self.k**2 * (t if t > 0 else 1.0) ** (self.k - 2.0)

    @property
    def gamma(self) -> float:
        """Friction now (time > 0)."""
        return (self.k + 1.0) / self.time if self.friction is None else self.friction

    @property
    def loss(self) -> float:
        """Part of T/w that is lost per unit of time, now: 2 gamma + w'/w = 3 k/t, or 2 a."""
        if self.friction is not None:
            return 2.0 * self.friction
        return 3.0 * self.k / self.time if self.time > 0 else 0.0

    def first_kick(self, dt: float) -> float:
        """Speed per f/rho half a step after a start from rest."""
        half = 0.5 * dt
        if self.friction is not None:
            return half * self.lambda_ / (1.0 + 0.5 * half * self.friction)
        if self.time == 0.0:
            return self.lambda_ * 0.5 * self.k * half ** (self.k - 1.0)
        return half * self.weight() / (1.0 + 0.5 * half * self.gamma)

    def kick(self, dt: float) -> tuple[float, float]:
        """Factor of V and gain per f/rho over the kick around now, exact for a constant f/rho.

        (t^(k+1) V)_t = lambda k^2 t^(2k-1) f/rho; with a constant friction a, (e^(at) V)_t = lambda e^(at) f/rho. The
        kick lasts from half the last step before now to half of ``dt`` after; from rest only the latter.
        """
        start, stop = self.time - 0.5 * self.last_dt, self.time + 0.5 * dt
        if self.friction is not None:
            a, tau = self.friction, stop - start
            return math.exp(-a * tau), self.lambda_ * (-math.expm1(-a * tau) / a if a > 0 else tau)
        k, ratio = self.k, start / stop
        return ratio ** (k + 1.0), 0.5 * self.lambda_ * k * stop ** (k - 1.0) * (
            1.0 - ratio ** (2.0 * k)
        )

    def first_dt(self, peak: float, stiffness: float, h: float, cfl: float) -> float:
        """Largest first step: CFL, beta(dt/2) dt <= cfl with f/rho = ``peak`` (voxels), and the wave bound.

        ``stiffness`` is the sum of the tensions over rho: waves run at sqrt(w stiffness).
        """
        if peak <= 0:
            return math.inf
        if self.t0 is None:
            # The step t that the constant weight w(t) allows: lambda k^2 t^(k-2) f/rho t^2/2 = cfl.
            self.t0 = self.time = (2.0 * cfl / (self.lambda_ * self.k**2 * peak)) ** (1.0 / self.k)
        if self.friction is None and self.time == 0.0:
            k = self.k
            cfl_dt = (cfl * 2.0 ** (k - 1.0) / (0.5 * k * self.lambda_ * peak)) ** (1.0 / k)
            if stiffness <= 0:
                return cfl_dt
            return min(cfl_dt, (h / (k * math.sqrt(3.0 * self.lambda_ * stiffness))) ** (2.0 / k))
        w = self.weight()
        wave = h / math.sqrt(3.0 * w * stiffness) if stiffness > 0 else math.inf
        return min(math.sqrt(2.0 * cfl / (w * peak)), wave)

    def next_weight(self) -> float:
        """Weight w at the end of a step like the last: where it grows, the step must be stable up to there."""
        return self.weight(self.time + (self.last_dt if self.k > 2 else 0.0))
