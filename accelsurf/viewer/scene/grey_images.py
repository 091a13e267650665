"""Pictures as arrays: the image in grey values, what a window shows, PNG."""

from __future__ import annotations

import io

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image
from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkWindowToImageFilter

from accelsurf.grid.volume import Volume

#: Percentiles of the image that are drawn black and white.
GREY_PERCENTILES = (1.0, 99.0)


def grey_values(volume: Volume) -> NDArray[np.uint8]:
    """Return the image as grey values (nz, ny, nx); plane by plane, so that no second volume of floats is needed."""
    sample = volume.array[tuple(slice(None, None, max(1, n // 128)) for n in volume.array.shape)]
    sample = sample[np.isfinite(sample)] if sample.dtype.kind == "f" else sample
    low, high = np.percentile(sample, GREY_PERCENTILES) if sample.size else (0.0, 1.0)
    if not high > low:
        low, high = (float(sample.min()), float(sample.max())) if sample.size else (0.0, 1.0)
    scale = 255.0 / (high - low) if high > low else 0.0
    out = np.empty(volume.array.shape, np.uint8)
    for plane, shown in zip(volume.array, out, strict=True):
        shown[:] = np.clip((np.nan_to_num(plane.astype(np.float32)) - low) * scale, 0, 255)
    return out


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
