"""A sequence of images on one grid: frames that are read when they are asked for, and their times."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume


class ImageSequence(ABC):
    """Frames on one grid. Nothing is held of a frame once it has been given out.

    Attributes
    ----------
    times : tuple of float
        Time of each frame, rising, in ``time_unit``.
    time_unit : {"s", "frame"}
        "frame" where neither the file nor the user says how long a frame is.
    geometry : Geometry
        Grid of every frame.
    source : str
        File or folder, or another source of the frames.
    notes : tuple of str
        Remarks for the user: gaps, times that were guessed.
    """

    times: tuple[float, ...]
    time_unit: str
    geometry: Geometry
    source: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.times)

    @property
    def frame_values(self) -> int:
        """Number of values of a frame, all channels together, as far as it is known before one is read."""
        return math.prod(self.geometry.shape)

    def frame(self, number: int) -> Volume:
        """The image ``number``, from 0; its first channel where it has several.

        Raises
        ------
        UsageError
            When there is no frame of that number.
        InputError
            When it cannot be read.
        """
        return self.channels(number)[0]

    def channels(self, number: int) -> list[Volume]:
        """All channels of the image ``number``; errors as `frame`."""
        if not 0 <= number < len(self):
            raise UsageError(f"frame {number} given, expected 0 to {len(self) - 1}")
        return self._channels(number)

    @abstractmethod
    def _channels(self, number: int) -> list[Volume]:
        """Read a frame that exists."""


def check_times(times: Sequence[float]) -> None:
    """Refuse times of frames that do not rise.

    Raises
    ------
    InputError
        Naming the frame.
    """
    for number in range(1, len(times)):
        if not times[number] > times[number - 1]:
            raise InputError(
                f"frame {number} is at {times[number]:g}, frame {number - 1} at {times[number - 1]:g}: rising times "
                "expected"
            )
