"""Pictures as arrays: what a window shows, PNG."""

from __future__ import annotations

import io

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image
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


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture (height, width, 3) as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="png", optimize=True)
    return stream.getvalue()
