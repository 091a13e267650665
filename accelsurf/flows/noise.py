"""Random acceleration: a seeded process, white in time and smooth in space."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from accelsurf.kernels import waves
from accelsurf.levelset import LevelSet

#: Plane waves per draw: its distribution is nearly normal, see benchmarks/notes/flows.md, "random plane waves".
WAVES = 64
#: Correlation length unless one is given, in voxels of the largest spacing.
LENGTH = 4.0


class Noise:
    """tau xi(x, t): over a step dt each velocity component gets tau sqrt(dt) xi(x).

    xi is a stationary random field of unit variance with correlation exp(-|x|^2/(2 length^2)), a sum of `WAVES` plane
    waves with normally distributed wave vectors, drawn anew at each step and independently for each component. It
    is defined in mm, so it depends neither on the grid nor on the band; sqrt(dt) makes the variance of the velocity
    tau^2 t whatever the steps. There is none along an axis with one slice.

    Parameters
    ----------
    strength : float
        tau, mm per unit time^1.5.
    length : float or None
        Correlation length, mm; None is `LENGTH` voxels.
    seed : int
    until : float or None
        Flow time at which the noise ends; None is when momentum is first set to zero.
    """

    def __init__(
        self,
        strength: float,
        length: float | None = None,
        seed: int = 0,
        until: float | None = None,
    ) -> None:
        self.strength = float(strength)
        self.length = length
        self.seed = seed
        self.until = until
        self.start()

    def start(self) -> None:
        """Start the same sequence again."""
        self._random = np.random.default_rng(self.seed)
        self._elapsed = 0.0
        self._momentum_was_reset = False

    def state(self) -> tuple[dict[str, Any], float, bool]:
        """Position in the sequence."""
        return (
            copy.deepcopy(dict(self._random.bit_generator.state)),
            self._elapsed,
            self._momentum_was_reset,
        )

    def restore(self, generator: dict[str, Any], elapsed: float, momentum_was_reset: bool) -> None:
        """Set the position in the sequence, from a `state`."""
        self._random.bit_generator.state = copy.deepcopy(generator)
        self._elapsed, self._momentum_was_reset = elapsed, momentum_was_reset

    def zero_momentum(self) -> None:
        """Note that the momentum was set to zero, which may end the noise."""
        self._momentum_was_reset = True

    @property
    def acts(self) -> bool:
        """True if there is noise at present."""
        over = self._momentum_was_reset if self.until is None else self._elapsed >= self.until
        return self.strength > 0 and not over

    def longest_dt(self, surface: LevelSet, cfl: float) -> float:
        """Step in which the noise alone moves the surface by cfl voxels: tau dt^1.5 = cfl h."""
        return (cfl * surface.smallest_spacing / self.strength) ** (2.0 / 3.0)

    def kicks(self, surface: LevelSet, front: np.ndarray, dt: float, components: int) -> np.ndarray:
        """Velocity (n, components) that the noise adds in ``dt`` at the closest points of the front; advances time."""
        length = self.length if self.length is not None else LENGTH * surface.largest_spacing
        extended = np.array(surface.shape) > 1
        out = np.zeros((surface.size, components), np.float32)
        for c in range(components):
            vectors = self._random.normal(size=(WAVES, 3)) * extended / length
            phases = self._random.uniform(0.0, 2.0 * math.pi, WAVES)
            if components == 3 and not extended[c]:
                continue
            xi = np.empty(surface.size, np.float32)
            surface.workers.parallel(
                waves.sum_of_waves,
                surface.size,
                surface.grid,
                surface.band,
                front,
                vectors,
                phases,
                xi,
            )
            out[:, c] = np.float32(self.strength * math.sqrt(dt)) * xi
        self._elapsed += dt
        return out
