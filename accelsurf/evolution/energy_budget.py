"""The energy budget: what friction, smoothing and restarts took, and what noise added."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from accelsurf.flows import EnergyRates

#: Those columns of the trace that the flow's mass gives, and all that the budget gives.
MASS_COLUMNS = ("mass_potential", "mass", "mass_correction", "clamped_fraction")
COLUMNS = ("kinetic", "weight", "friction_work", "smoothing_work", "noise_work", *MASS_COLUMNS)


@dataclass
class EnergyBudget:
    """Adds up the energy rates of the steps, in the units of U.

    Rates are known at the times of the records, kicks happen around them: both are summed by the trapezoidal rule.

    Attributes
    ----------
    friction, smoothing, noise : float
        Work so far: taken by friction; taken by diffusion, limiter, restarts and changes; added by noise.
    last : EnergyRates
        Of the last step.
    last_dt : float
        Its length.
    """

    friction: float = 0.0
    smoothing: float = 0.0
    noise: float = 0.0
    last: EnergyRates = field(default_factory=EnergyRates)
    last_dt: float = 0.0

    def record_loss(self, energy: float) -> None:
        """A restart has taken the kinetic energy (as T/w)."""
        self.smoothing += energy - 0.5 * (self.last.smoothing - self.last.noise)
        self.last = self.last._replace(friction=0.0, smoothing=0.0, noise=0.0)

    def record_jump(self, energy: float) -> None:
        """E became less by ``energy`` at once: another grid, other settings, or another surface."""
        self.smoothing += energy

    def record_step(self, now: EnergyRates, dt: float) -> dict[str, Any]:
        """The columns of a record that begins with ``now`` and lasts ``dt``."""
        last = self.last
        self.friction += 0.5 * self.last_dt * (last.friction + now.friction)
        self.smoothing += 0.5 * (last.smoothing + now.smoothing)
        self.noise += 0.5 * (last.noise + now.noise)
        self.last, self.last_dt = now, dt
        return {
            "kinetic": now.kinetic,
            "mass_potential": now.mass_potential,
            "weight": now.weight,
            "friction_work": self.friction,
            "smoothing_work": self.smoothing,
            "noise_work": self.noise,
            "mass": now.mass,
            "mass_correction": now.mass_correction,
            "clamped_fraction": now.clamped,
        }
