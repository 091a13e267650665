"""What lies under a pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray


class Picked(NamedTuple):
    """What lies under a pixel: the ``tile`` (space, axial, coronal, sagittal, energies), and the ``world`` point
    (x, y, z), mm, in a slice or on a surface; None beside them.
    """

    tile: str
    world: NDArray[np.float64] | None


def place_in_renderer(renderer: pv.Renderer, x: float, y: float) -> tuple[float, float] | None:
    """Place of a pixel of the window in a renderer, each coordinate from 0 to 1; None outside it."""
    width, height = renderer.GetRenderWindow().GetSize()
    left, bottom, right, top = renderer.GetViewport()
    if right <= left or top <= bottom:
        return None
    place = ((x / width - left) / (right - left), (y / height - bottom) / (top - bottom))
    return place if all(0 <= part < 1 for part in place) else None
