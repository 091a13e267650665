"""L2 gradient descent: beta = f. The baseline, with the same step control and limiter as the others."""

from __future__ import annotations

import numpy as np

from accelsurf.flows.base import Limits, Move, diffuse, free_diffusion, hold_back, percentile, voxel_rates
from accelsurf.levelset import LevelSet


class Gradient:
    """psi_t = f |grad psi|: descent of the potential, without memory.

    Parameters
    ----------
    diffusion : float
        D (mm2 per unit time): each step's force is smoothed along the surface by D dt, with the operator and
        the bound that the accelerated flows use for their speeds. 0 is the plain gradient.
    """

    name = "gradient"
    weight = 1.0

    def __init__(self, diffusion: float = 0.0) -> None:
        self._diffusion = float(diffusion)
        self._strongest = 0.0

    @property
    def fields(self) -> list[np.ndarray]:
        """None: descent remembers nothing."""
        return []

    def start(self, surface: LevelSet) -> None:
        """Forget the forces of another run."""
        self._strongest = 0.0

    def rest(self) -> None:
        """Always at rest."""

    def take(self, fields: list[np.ndarray]) -> None:
        """Nothing to take."""

    def move(
        self,
        surface: LevelSet,
        front: np.ndarray,
        force: np.ndarray,
        curvature: np.ndarray,
        area: np.ndarray,
        alpha: float,
        limits: Limits,
    ) -> Move:
        """Step with beta = f, dt <= cfl/|f| and dt <= h^2/(4 alpha)."""
        speed = np.array(force, np.float32)
        rates = voxel_rates(surface, front, speed)
        # The strongest force so far: near the minimum forces fade, but the wells keep their steepness.
        fastest = self._strongest = max(self._strongest, percentile(rates[front], limits.percentile))
        dt = min(limits.dt_max, limits.cfl / fastest if fastest > 0 else limits.dt_max)
        if alpha > 0:
            dt = min(dt, curvature_bound(surface) / alpha)
        if not np.isfinite(dt):
            return Move(0.0, np.zeros_like(speed), 0.0, 0.0, 0.0, 0.0)
        diffusion = min(self._diffusion, free_diffusion(surface, dt))
        if diffusion > 0:
            surface.extend_outwards(speed, front)
            diffuse(surface, front, speed, diffusion * dt)
            rates = voxel_rates(surface, front, speed)
        held = hold_back(speed, rates, dt, limits.cfl)
        rate = percentile(np.abs(speed[front]), limits.percentile)
        surface.extend_outwards(speed, front)
        return Move(dt, speed, 0.0, rate, held / max(1, int(front.sum())), diffusion)


def curvature_bound(surface: LevelSet) -> float:
    """Largest alpha dt (mm2) of explicit curvature flow: 1 / (2 (1/h1^2 + 1/h2^2)), h1, h2 the finest spacings."""
    g = surface.grid
    axes = sorted(h for n, h in ((g.nz, g.hz), (g.ny, g.hy), (g.nx, g.hx)) if n > 1)
    return 0.5 / sum(1.0 / h**2 for h in axes[:2])
