"""Base of an energy with a constraint on its surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.energy import Energy
from accelsurf.flows import Flow
from accelsurf.grid.boxes import Box
from accelsurf.levelset import BandChange, LevelSet


class ConstrainedEnergy(Energy):
    """Wraps an energy whose force is limited in places; everything else is that of the energy.

    A subclass gives `force`, and `project` if it bounds the surface.

    Parameters
    ----------
    energy : Energy
        The energy without the constraint.
    """

    def __init__(self, energy: Energy) -> None:
        self._energy = energy

    @property
    def unconstrained(self) -> Energy:
        """The energy without the constraint."""
        return self._energy

    @property
    def alpha(self) -> float:  # type: ignore[override]  # read only: it is the inner energy's
        """The energy's own."""
        return self._energy.alpha

    @property
    def held_cells(self) -> NDArray[np.int64]:
        """The energy's own."""
        return self._energy.held_cells

    def reaction(self, surface: LevelSet, flow: Flow) -> np.ndarray | None:
        """The energy's own."""
        return self._energy.reaction(surface, flow)

    @property
    def is_disturbed(self) -> bool:
        """The energy's own."""
        return self._energy.is_disturbed

    def start(self, surface: LevelSet) -> None:
        """Start the energy on a first surface."""
        self._energy.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the energy."""
        self._energy.follow(surface, change)

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Set the energy's time."""
        self._energy.set_time(surface, time)

    def project(self, surface: LevelSet) -> None:
        """Bring psi back to where the energy is finite."""
        self._energy.project(surface)

    def state(self) -> Any:
        """Return the energy's state."""
        return self._energy.state()

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        self._energy.restore(surface, state)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return self._energy.value(surface, fraction, area)

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The energy's own."""
        return self._energy.image_force(surface, box)
