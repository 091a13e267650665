"""Pictures as arrays: what a window shows."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkWindowToImageFilter


def grab(window: vtkRenderWindow) -> NDArray[np.uint8]:
    """Return what a rendered window shows, (height, width, 3)."""
    filter_ = vtkWindowToImageFilter()
    filter_.SetInput(window)
    filter_.ReadFrontBufferOff()
    filter_.ShouldRerenderOff()
    filter_.Update()
    image = pv.wrap(filter_.GetOutput())
    width, height, _ = image.dimensions
    return np.asarray(image.point_data.active_scalars).reshape(height, width, -1)[::-1, :, :3].copy()
