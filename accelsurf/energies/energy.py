"""Protocol that every energy follows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.flows import Flow
from accelsurf.levelset import NO_CELLS, BandChange, LevelSet


class Energy(ABC):
    """The protocol of energies. A subclass gives `value` and `force`; all other methods have a default.

    The loop calls `start` once; then, in each step, `set_time`, `value` and `force`, `project` after the surface has
    moved, and `follow` after it was redistanced. Results of `value` for the surface may be stored for the `force`
    that follows. An energy with a state that goes from step to step returns it from `state` and sets it in `restore`.

    Attributes
    ----------
    alpha : float
        The largest factor of the curvature H in the force (0 when there is none): the weight of the surface's area.
        The time step is bounded by it. A class attribute, an attribute or a property.
    """

    alpha: float = 0.0

    def start(self, surface: LevelSet) -> None:  # noqa: B027
        """Read a first surface in full, at the cost of its volume. By default nothing is read."""

    def follow(self, surface: LevelSet, change: BandChange) -> None:  # noqa: B027
        """Update by the change of the last redistancing, in O(band). By default nothing is updated."""

    def set_time(self, surface: LevelSet, time: float) -> None:  # noqa: B027
        """Become the energy of the flow time ``time``, that of the surface. By default it is the same at all times.

        The kick of a step is centred there: it takes the speeds from half a step before to half a step after.
        """

    def project(self, surface: LevelSet) -> None:  # noqa: B027
        """Bring psi back to where the energy is finite; called before redistancing. By default psi stays."""

    def state(self) -> Any:
        """Return the state that goes from step to step; it must not be changed later. By default None: no state."""
        return None

    def restore(self, surface: LevelSet, state: Any) -> None:
        """Set the state that `state` returned on this surface. By default the energy starts on it again."""
        self.start(surface)

    @property
    def held_cells(self) -> NDArray[np.int64]:
        """Raveled cells, in rising order, whose side must not change; small components with one are not removed."""
        return NO_CELLS

    def reaction(self, surface: LevelSet, flow: Flow) -> np.ndarray | None:
        """Return the change (n,) of the normal velocity by which a constraint stops it; None for no change."""
        return None

    @property
    def is_disturbed(self) -> bool:
        """True if more than the energy moves the surface, like objects beside it; then a rise of U is no error."""
        return False

    @abstractmethod
    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        """Return U of the present surface.

        Parameters
        ----------
        surface : LevelSet
        fraction : ndarray (n,), float64
            Share of each band voxel that is inside.
        area : ndarray (n,), float64
            Area of the surface in each band voxel, mm2.
        """

    @abstractmethod
    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        """Return the force f (n,) at the front: dU = -int f (dS.N) dA with N inward, so f > 0 shrinks.

        Parameters
        ----------
        surface : LevelSet
        front : ndarray (n,) of bool
            Band cells that need a force; the others do not count.
        curvature : ndarray (n,), float32
            H at the front, 1/mm, positive on a sphere: the first variation of the area within the volume, see
            `LevelSet.area_variation`. At the volume's border it differs from the flow's curvature.
        """
