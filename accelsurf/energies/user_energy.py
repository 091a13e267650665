"""An energy of the user's own with checks: mistakes are reported in one line, before a kernel fails."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from accelsurf.energies.energy import Energy
from accelsurf.errors import InputError, UsageError
from accelsurf.levelset import BandChange, LevelSet

METHODS = ("start", "follow", "value", "force")


class CheckedEnergy(Energy):
    """Wraps an energy and checks its value and force before they are used.

    Parameters
    ----------
    energy : object
        With ``alpha`` and the methods `METHODS` of `Energy`; it need not derive from it. ``set_time``,
        ``project``, ``state`` and ``restore`` are called where it has them. Only this class tests whether a method
        exists.

    Attributes
    ----------
    name : str
        ``custom: ClassName``, as reports have it.

    Raises
    ------
    UsageError
        When a method is missing or alpha is no number of at least 0.
    """

    def __init__(self, energy: Any) -> None:
        kind = type(energy).__name__
        self._energy: Any = energy
        missing = [name for name in METHODS if not self._has(name)]
        if missing:
            raise UsageError(
                f"energy: a {kind} was given, which has no {', '.join(missing)}",
                "an energy has alpha, start, follow, value and force: see accelsurf.energies.Energy; "
                "accelsurf.energies.ImageEnergy has start and follow already",
            )
        self._kind = kind
        self.name = f"custom: {kind}"
        self._alpha()

    @property
    def alpha(self) -> float:  # type: ignore[override]  # read only: it is the inner energy's
        """The energy's own."""
        return self._alpha()

    def _alpha(self) -> float:
        alpha: Any = getattr(self._energy, "alpha", None)
        if not _is_number(alpha) or not 0 <= alpha < math.inf:
            raise UsageError(
                f"energy: alpha of {self._kind} is {alpha!r}, expected a number at least 0",
                "alpha is the largest factor of the curvature in the force; 0 when there is none",
            )
        return float(alpha)

    def start(self, surface: LevelSet) -> None:
        """Start the energy on a first surface."""
        self._energy.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        """Update the energy."""
        self._energy.follow(surface, change)

    def set_time(self, surface: LevelSet, time: float) -> None:
        """Set the energy's time, if it has the method."""
        if self._has("set_time"):
            self._energy.set_time(surface, time)

    def project(self, surface: LevelSet) -> None:
        """Bring psi back to where the energy is finite, if it is infinite anywhere."""
        if self._has("project"):
            self._energy.project(surface)

    def state(self) -> Any:
        """Return the energy's state, if it has the method."""
        return self._energy.state() if self._has("state") else None

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set a state; an energy without the method starts again."""
        if self._has("restore"):
            self._energy.restore(surface, state)
        else:
            self._energy.start(surface)

    def _has(self, method: str) -> bool:
        return callable(getattr(self._energy, method, None))

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """U of the present surface; NaN and infinity pass, they end the run as ``diverged``.

        Raises
        ------
        InputError
            When it is not one number.
        """
        value = self._energy.value(surface, fraction, area)
        if not _is_number(value):
            raise InputError(
                f"{self._kind}.value returned {_described(value)}, expected one number",
                "return float(...)",
            )
        return float(value)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Force f (n,), float32; values off the front do not count and become 0.

        Raises
        ------
        InputError
            When it is not one finite number for each front cell.
        """
        force = self._energy.force(surface, front, curvature)
        if (
            not isinstance(force, np.ndarray)
            or force.shape != front.shape
            or force.dtype.kind not in "fiu"
        ):
            raise InputError(
                f"{self._kind}.force returned {_described(force)}, expected an array of numbers of shape {front.shape}",
                "one number for each band cell, in the order of the arrays front and curvature",
            )
        with np.errstate(over="ignore"):
            checked = np.where(front, force, 0).astype(np.float32)
        bad = ~np.isfinite(checked)
        if bad.any():
            first = int(bad.argmax())
            z, y, x = (int(i) for i in np.unravel_index(surface.band.cells[first], surface.shape))
            raise InputError(
                f"{self._kind}.force returned {int(bad.sum())} values on the front that are not finite, "
                f"the first {force[first]} at index x={x}, y={y}, z={z}",
                "look for a division by 0 or a logarithm of 0 there",
            )
        return checked


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _described(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {value.shape}"
    return f"a {type(value).__name__}"
