"""A tool: what a drag of the left button does in the scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.scene.picking import Picked

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.workplace import Workplace


class Tool:
    """What a drag of the left button does.

    Parameters
    ----------
    workplace : Workplace

    Attributes
    ----------
    name : str
        In requests.
    key, text, tip : str
        Its key, what is written on its button, and what it does.
    """

    name = key = text = tip = ""

    def __init__(self, workplace: Workplace) -> None:
        self.workplace = workplace

    def press(self, at: Picked) -> None:
        """The button goes down at a place in a slice or on a surface."""

    def move(self, at: Picked) -> None:
        """The mouse is at another place of the tile in which it was pressed."""

    def release(self) -> None:
        """The button goes up."""

    def cancel(self) -> None:
        """What the press has begun is not meant: all is as before it, and the button is up."""
        self.leave()

    def resize(self) -> None:
        """The radius has changed."""

    def leave(self) -> None:
        """Another tool is used from now on."""

    @property
    def radius(self) -> float:
        """Of click, ball and brush, mm."""
        return self.workplace.radius


def ball_text(center: NDArray[np.float64], radius: float) -> str:
    """Return a ball as settings have it, ``ball:X,Y,Z,R``."""
    return f"ball:{numbers_text((*center, radius))}"


def numbers_text(numbers: Iterable[float]) -> str:
    """Return numbers as settings have them.

    Examples
    --------
    >>> numbers_text((1.0, -2.5, 1 / 3))
    '1,-2.5,0.333333'
    """
    return ",".join(f"{value:.6g}" for value in numbers)


def finest(geometry: Geometry) -> float:
    """Return the smallest spacing of an image, mm, along axes of more than one voxel."""
    return min((h for h, n in zip(geometry.spacing, geometry.shape, strict=True) if n > 1), default=1.0)


def first_radius(geometry: Geometry) -> float:
    """Return the radius of click, ball and brush at first, mm."""
    sides = (h * n for h, n in zip(geometry.spacing, geometry.shape, strict=True) if n > 1)
    return max(0.012 * min(sides, default=1.0), 2.0 * finest(geometry))
