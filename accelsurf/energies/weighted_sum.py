"""Weighted sum of energies, and the terms without an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.energy import Energy
from accelsurf.grid.boxes import Box
from accelsurf.levelset import BandChange, LevelSet


class WeightedSum(Energy):
    """U = sum of w_i U_i, f = sum of w_i f_i.

    Parameters
    ----------
    terms : sequence of (weight, Energy)
        Weights may be negative for energies without curvature in their force only.

    Attributes
    ----------
    alpha : float
        Sum of w_i alpha_i: the largest factor of H.
    """

    def __init__(self, terms: Sequence[tuple[float, Energy]]) -> None:
        self._terms = [(float(weight), energy) for weight, energy in terms]
        self.alpha = sum(weight * energy.alpha for weight, energy in self._terms)
        assert all(weight > 0 or energy.alpha == 0 for weight, energy in self._terms)

    def start(self, surface: LevelSet) -> None:
        """Start every term on a first surface."""
        for _, energy in self._terms:
            energy.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update every term."""
        for _, energy in self._terms:
            energy.follow(surface, change)

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Set the time of every term."""
        for _, energy in self._terms:
            energy.set_time(surface, time)

    def project(self, surface: LevelSet) -> None:
        """Bring psi back to where every term is finite."""
        for _, energy in self._terms:
            energy.project(surface)

    def state(self) -> list[Any]:
        """Return the states of the terms, in their order; None for a term without state."""
        return [energy.state() for _, energy in self._terms]

    def restore(self, surface: LevelSet, state: list[Any]) -> None:
        """Set the state that `state` returned on this surface."""
        for (_, energy), own in zip(self._terms, state, strict=True):
            energy.restore(surface, own)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return sum(weight * energy.value(surface, fraction, area) for weight, energy in self._terms)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front."""
        force = np.zeros(surface.size, np.float32)
        for weight, energy in self._terms:
            force += np.float32(weight) * energy.force(surface, front, curvature)
        return force

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The sum, None where one of the terms does not tell."""
        parts = [energy.image_force(surface, box) for _, energy in self._terms]
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        total = np.zeros(known[0].shape, np.float32)
        for (weight, _), part in zip(self._terms, known, strict=True):
            total += np.float32(weight) * part
        return total


class Balloon(Energy):
    """U = Vol, f = 1: with a weight above 0 the surface shrinks everywhere, below 0 it grows."""

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """Volume, mm3."""
        return surface.volume(fraction)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """1 at the front."""
        return front.astype(np.float32)

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """1 everywhere."""
        return np.ones(surface.psi[box].shape, np.float32)


class Area(Energy):
    """U = A, f = H: the area of the surface as a term."""

    alpha = 1.0

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """Area, mm2."""
        return float(area.sum())

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """The curvature."""
        return curvature.astype(np.float32)

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """0: it is all of the curvature."""
        return np.zeros(surface.psi[box].shape, np.float32)
