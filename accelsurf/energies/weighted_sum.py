"""Weighted sums of energies, also of two frames' at a time between them, and the terms without an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from accelsurf.energies.energy import Energy
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
        self._weighted = [(float(weight), energy) for weight, energy in terms]
        self.alpha = sum(weight * energy.alpha for weight, energy in self._terms)
        assert all(weight > 0 or energy.alpha == 0 for weight, energy in self._terms)

    @property
    def _terms(self) -> list[tuple[float, Energy]]:
        """The energies that count now, each with its weight."""
        return self._weighted

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

    def state(self) -> Any:
        """Return the states of the terms, in their order; None for a term without state."""
        return [energy.state() for _, energy in self._terms]

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        for (_, energy), term_state in zip(self._terms, state, strict=True):
            energy.restore(surface, term_state)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface."""
        return sum(weight * energy.value(surface, fraction, area) for weight, energy in self._terms)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front."""
        force = np.zeros(surface.size, np.float32)
        for weight, energy in self._terms:
            force += np.float32(weight) * energy.force(surface, front, curvature)
        return force


class Balloon(Energy):
    """U = Vol, f = 1: with a weight above 0 the surface shrinks everywhere, below 0 it grows."""

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """Volume, mm3."""
        return surface.volume(fraction)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """1 at the front."""
        return front.astype(np.float32)


class Area(Energy):
    """U = A, f = H: the area of the surface as a term."""

    alpha = 1.0

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """Area, mm2."""
        return float(area.sum())

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """The curvature."""
        return curvature.astype(np.float32)


class BetweenFrames(WeightedSum):
    """U = (1 - s) U_i + s U_(i+1), f likewise, s = (t - t_i)/(t_(i+1) - t_i); before the first frame and after the last
    the energy is theirs.

    For energies whose force is linear in the image, like `RegionField`, or `ChanVese` with fixed means, it is the
    energy of the image that lies between the two. That image is meaningful while an edge moves by less than its own
    width from frame to frame.

    Parameters
    ----------
    times : sequence of float
        Flow time of each frame, rising.
    energies : sequence of Energy
        Of each frame, on one grid. Only the two frames around the present time are followed.

    Raises
    ------
    ValueError
        When there are not as many times as energies, at least one, or the times do not rise.
    """

    def __init__(self, times: Sequence[float], energies: Sequence[Energy]) -> None:
        if len(times) != len(energies) or not len(times) or not (np.diff(times) > 0).all():
            raise ValueError(
                f"{len(energies)} energies at the times {list(times)}: as many rising times expected"
            )
        self._times, self._energies = np.asarray(times, np.float64), list(energies)
        self._first, self._share = 0, 0.0
        self.alpha = max(energy.alpha for energy in energies)

    @property
    def _terms(self) -> list[tuple[float, Energy]]:
        """The frames that are followed, each with its weight."""
        both = self._energies[self._first : self._first + 2]
        return list(zip((1.0 - self._share, self._share), both, strict=False))

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Go to a time; a frame that comes in is started on the surface."""
        times, last = self._times, max(len(self._energies) - 2, 0)
        first = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), last)
        before = {id(energy) for _, energy in self._terms}
        self._first, self._share = first, 0.0
        if len(times) > 1:
            self._share = float(
                np.clip((time - times[first]) / (times[first + 1] - times[first]), 0.0, 1.0)
            )
        for _, energy in self._terms:
            if id(energy) not in before:
                energy.start(surface)
            energy.set_time(surface, time)

    def state(self) -> Any:
        """Return the present frame, the part of the way to the next, and the states of both."""
        return self._first, self._share, super().state()

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface."""
        self._first, self._share, states = state
        super().restore(surface, states)
