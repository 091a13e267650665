"""Clicked voxels of the region of interest, on the image's grid: all clicks, and those of an object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, shared
from accelsurf.grid.clicks import Clicks


def on_image(clicks: Clicks | None, first: Corner, shape: tuple[int, int, int]) -> Clicks | None:
    """Clicks on the image's grid; None without any.

    Parameters
    ----------
    clicks : Clicks or None
        On the grid of the region of interest.
    first : (z, y, x)
        First voxel of that region in the image.
    shape : (nz, ny, nx)
        Of the image.
    """
    if clicks is None or not clicks.clicks:
        return None
    out = []
    for click in clicks.clicks:
        z, y, x = (a + b for a, b in zip(corner_of(click.box), first, strict=True))
        out.append(click._replace(box=box_at((z, y, x), click.mask.shape)))
    return Clicks(tuple(out), shape)


def clicked_voxels(clicks: Clicks | None, id: int, first: Corner, box: Box) -> NDArray[np.bool_] | None:
    """Voxels that are clicked inside or outside of an object; None without clicks.

    Parameters
    ----------
    clicks : Clicks or None
        On the grid of the region of interest.
    id : int
        The object's id.
    first : (z, y, x)
        First voxel of that region in the image.
    box : tuple of slice
        The object's part of the image's grid.
    """
    if clicks is None:
        return None
    marked = np.zeros(tuple(s.stop - s.start for s in box), np.bool_)
    for click in clicks.clicks:
        if click.id != id:
            continue
        z, y, x = (a + b for a, b in zip(corner_of(click.box), first, strict=True))
        mine, theirs = shared(corner_of(box), marked.shape, (z, y, x), click.mask.shape)
        if all(s.start < s.stop for s in mine):
            marked[mine] |= click.mask[theirs]
    return marked
