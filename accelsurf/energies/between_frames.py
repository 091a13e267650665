"""An energy that depends on time: between two frames it goes linearly from that of the one to that of the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.energy import Energy
from accelsurf.grid.boxes import Box
from accelsurf.levelset import BandChange, LevelSet


class BetweenFrames(Energy):
    """U = (1 - s) U_i + s U_(i+1), f likewise, s = (t - t_i)/(t_(i+1) - t_i); before the first frame and after the last
    the energy is theirs.

    For energies whose force is linear in the image, such as `RegionField`, or `ChanVese` with fixed means, it is the
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
            raise ValueError(f"{len(energies)} energies at the times {list(times)}: as many rising times expected")
        self._times, self._energies = np.asarray(times, np.float64), list(energies)
        self._first, self._share = 0, 0.0
        self.alpha = max(energy.alpha for energy in energies)

    def _pair(self) -> list[tuple[float, Energy]]:
        """The frames that are followed, each with its weight."""
        both = self._energies[self._first : self._first + 2]
        return list(zip((1.0 - self._share, self._share), both, strict=False))

    def start(self, surface: LevelSet) -> None:
        """Start the energies of the present frames on a surface."""
        for _, energy in self._pair():
            energy.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the energies of the present frames."""
        for _, energy in self._pair():
            energy.follow(surface, change)

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Go to a time; a frame that comes in is started on the surface."""
        times, last = self._times, max(len(self._energies) - 2, 0)
        first = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), last)
        before = {id(energy) for _, energy in self._pair()}
        self._first, self._share = first, 0.0
        if len(times) > 1:
            self._share = float(np.clip((time - times[first]) / (times[first + 1] - times[first]), 0.0, 1.0))
        for _, energy in self._pair():
            if id(energy) not in before:
                energy.start(surface)
            energy.set_time(surface, time)

    def project(self, surface: LevelSet) -> None:
        """Bring psi back to where both energies are finite."""
        for _, energy in self._pair():
            energy.project(surface)

    def state(self) -> tuple[int, float, list[Any]]:
        """Return the present frame, the part of the way to the next, and the states of both."""
        return self._first, self._share, [energy.state() for _, energy in self._pair()]

    def restore(self, surface: LevelSet, state: tuple[int, float, list[Any]]) -> None:
        """Set the state that `state` returned on this surface."""
        self._first, self._share, states = state
        for (_, energy), own in zip(self._pair(), states, strict=True):
            energy.restore(surface, own)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface at the present time."""
        return sum(share * energy.value(surface, fraction, area) for share, energy in self._pair())

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,) at the front at the present time."""
        force = np.zeros(surface.size, np.float32)
        for share, energy in self._pair():
            force += np.float32(share) * energy.force(surface, front, curvature)
        return force

    def image_force(self, surface: LevelSet, box: Box) -> NDArray[np.float32] | None:
        """The one between those of the two frames, None where one of them does not tell."""
        total = np.zeros(surface.psi[box].shape, np.float32)
        for share, energy in self._pair():
            field = energy.image_force(surface, box)
            if field is None:
                return None
            total += np.float32(share) * field
        return total
