"""A small picture of a volume for notebooks: its middle slice in grey, with the outline of labels on it."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation

#: Pixels of the longer edge.
SIZE = 192
#: Colour of outlines: orange of Okabe and Ito, as in the other pictures.
OUTLINE = (0xE6, 0x9F, 0x00)
#: Percentiles of the slice that become black and white.
GREY_PERCENTILES = (1.0, 99.0)


def as_html(
    text: str, image: NDArray[Any], geometry: Geometry, labels: NDArray[Any] | None = None
) -> str:
    """Return HTML of a thumbnail above a line of text.

    Parameters
    ----------
    text : str
        Plain text, e.g. a repr.
    image : ndarray (nz, ny, nx)
    geometry : Geometry
        Its grid.
    labels : ndarray (nz, ny, nx), optional
        Each label above 0 gets an outline.
    """
    return f'<img src="{data_uri(image, geometry, labels)}"/><br/><code>{html.escape(text)}</code>'


def data_uri(image: NDArray[Any], geometry: Geometry, labels: NDArray[Any] | None = None) -> str:
    """Return a PNG of the middle slice as a ``data:`` URI.

    The slice is axial (across z), of an image of one slice that slice; with labels it passes through the middle of the
    labelled voxels. It is oriented as in the preview, and its pixels are square.

    Parameters
    ----------
    image : ndarray (nz, ny, nx)
        Values that are not finite are black.
    geometry : Geometry
        Its grid.
    labels : ndarray (nz, ny, nx), optional
        Each label above 0 gets an outline.

    Examples
    --------
    >>> data_uri(np.zeros((3, 4, 5)), Geometry((3, 4, 5), (1.0, 1.0, 1.0)))[:30]
    'data:image/png;base64,iVBORw0K'
    """
    from PIL import Image

    orientation = DisplayOrientation.of(geometry)
    plane = 0 if geometry.slice_axis is None else orientation.order.index(geometry.slice_axis)
    found = None if labels is None else orientation.reorient(labels)
    values = orientation.reorient(image)
    index = values.shape[plane] // 2
    if found is not None and found.any():
        occupied = np.flatnonzero((found > 0).any(axis=IN_PLANE[plane]))
        index = int(occupied[0] + occupied[-1]) // 2
    # As in the preview: front at the top in the axial slice, head at the top in the other two.
    upward = slice(None) if plane == 0 else slice(None, None, -1)
    rgb = _grey(np.take(values, index, axis=plane)[upward])
    if found is not None:
        rgb[_outline(np.take(found, index, axis=plane)[upward])] = OUTLINE
    tall, wide = (
        n * orientation.spacing[axis]
        for n, axis in zip(rgb.shape[:2], IN_PLANE[plane], strict=True)
    )
    scale = SIZE / max(tall, wide)
    size = max(1, round(wide * scale)), max(1, round(tall * scale))
    stream = io.BytesIO()
    Image.fromarray(rgb).resize(size, Image.Resampling.NEAREST).save(stream, format="png")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _grey(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Grey values of a slice as RGB, (ny, nx, 3)."""
    numbers = values.astype(np.float64)
    finite = np.isfinite(numbers)
    low, high = np.percentile(numbers[finite], GREY_PERCENTILES) if finite.any() else (0.0, 1.0)
    share = (np.where(finite, numbers, low) - low) / (high - low if high > low else 1.0)
    return np.repeat((255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)[..., None], 3, axis=2)


def _outline(labels: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels of a label with a neighbour (of four) that has another one."""
    around = np.pad(labels, 1, mode="edge")
    neighbours = (around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:])
    edge = np.zeros(labels.shape, np.bool_)
    for other in neighbours:
        edge |= labels != other
    return np.asarray(edge & (labels > 0))
