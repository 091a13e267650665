"""A press in an object and a drag outwards: which voxels belong to it if it is so large, at once for any size.

The click's model is computed once: for each voxel the probability from which on it belongs to the object. A
drag of r mm stands for the volume of a ball of that radius (of an image of one slice: the area of a disc), which is
the level of the probability that has that volume: a level is looked up in the sorted values, and shown in a slice by
comparing the values there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from accelsurf.image.slice_stack import linear
from accelsurf.settings.wording import size_setting

#: By which factor more is looked at when a drag comes near its end, and at which part of that.
FARTHER = 4.0
NEAR_END = 0.8


@dataclass(frozen=True, eq=False)
class SizeDrag:
    """The objects of a press by their size; nothing of it changes, so that any thread may ask.

    Attributes
    ----------
    click : str
        The pressed ball, ``ball:X,Y,Z,R``: the inside click of the run that follows.
    times : ndarray (nz, ny, nx), float32
        For each voxel of a window 1 less the probability from which on it belongs to the object.
    first : (int, int, int)
        Index (z, y, x) in the image of the first voxel of ``times``.
    voxel_mm3 : float
        Volume of a voxel.
    most_mm3 : float
        Up to this size an object has room in the window.
    thickness : float or None
        Of the slice of an image of one slice, mm.
    """

    click: str
    times: NDArray[np.float32]
    first: tuple[int, int, int]
    voxel_mm3: float
    most_mm3: float
    thickness: float | None = None

    @cached_property
    def _sorted(self) -> NDArray[np.float32]:
        return np.sort(self.times, axis=None)

    def is_near_end(self, drag_mm: float) -> bool:
        """Return True if a drag is near the size of the window, and a larger window can be had."""
        return self._wanted(drag_mm) > NEAR_END * self.most_mm3

    def _wanted(self, drag_mm: float) -> float:
        """Volume of a ball or disc, mm3."""
        if self.thickness is not None:
            return math.pi * drag_mm**2 * self.thickness
        return 4.0 / 3.0 * math.pi * drag_mm**3

    def volume_of(self, drag_mm: float) -> float:
        """Volume, mm3, that a drag so far from the press stands for."""
        return float(
            np.clip(
                self._wanted(drag_mm),
                self.voxel_mm3,
                min(self.most_mm3, self.times.size * self.voxel_mm3),
            )
        )

    def level_of(self, volume_mm3: float) -> float:
        """Return the value up to which voxels belong to an object of this volume."""
        count = min(max(round(volume_mm3 / self.voxel_mm3), 1), self.times.size)
        return float(self._sorted[count - 1])

    def plane(self, axis: int, index: int, volume_mm3: float) -> NDArray[np.float32] | None:
        """Return an image, negative inside the object, of a slice, if the object has this volume.

        Parameters
        ----------
        axis : int
            Array axis that the slice cuts.
        index : int
            Voxel of the image along it.
        volume_mm3 : float

        Returns
        -------
        ndarray or None
            Of the region of interest in this slice; None beside it.
        """
        at = index - self.first[axis]
        if not 0 <= at < self.times.shape[axis]:
            return None
        return self.signed(np.asarray(self.times.take(at, axis=axis)), volume_mm3)

    def times_at(self, index: tuple[NDArray[np.float64], ...]) -> NDArray[np.float32]:
        """Values of ``times`` at any places, given by indices z, y, x of the region of interest, between voxels too."""
        z, y, x = index
        return linear(self.times, (z, y, x), 2.0)

    def signed(self, times: NDArray[np.float32], volume_mm3: float) -> NDArray[np.float32]:
        """Return values of ``times`` less their level: negative inside the object, if it has this volume."""
        return np.asarray(times - np.float32(self.level_of(volume_mm3) + 1e-6))

    def size_text(self, drag_mm: float) -> str:
        """The volume of a drag as ``size`` of a run's settings."""
        return size_setting(self.volume_of(drag_mm))


class Dragging:
    """A drag as it goes on: its objects known now, and larger ones when it comes near the end of the window.

    Parameters
    ----------
    press : callable
        `Session.press`.
    ball : str
        ``ball:X,Y,Z,R``.
    """

    def __init__(self, press: Callable[..., Future[SizeDrag]], ball: str) -> None:
        self._press, self._ball = press, ball
        self.pressed = press(ball)
        self._known: SizeDrag | None = None

    def at(self, drag_mm: float) -> SizeDrag | None:
        """Return the objects known now for a drag of this length; None while nothing is known."""
        if self.pressed.done() and self.pressed.exception() is None:
            self._known = self.pressed.result()
            if self._known.is_near_end(drag_mm):
                self.pressed = self._press(self._ball, FARTHER * self._known.most_mm3)
        return self._known
