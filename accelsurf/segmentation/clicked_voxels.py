"""The voxels that a person clicked, on an object's part of the image's grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, corner_of, shared
from accelsurf.grid.clicks import SIDES, Clicks


def clicked_voxels(clicks: Clicks | None, own: int, first: Corner, box: Box) -> NDArray[np.bool_] | None:
    """Voxels that are clicked inside or outside of an object; None without clicks.

    Parameters
    ----------
    clicks : Clicks or None
        On the grid of the region of interest.
    own : int
        The object's id.
    first : (z, y, x)
        First voxel of that region in the image.
    box : tuple of slice
        The object's part of the image's grid.
    """
    if clicks is None:
        return None
    marked = np.zeros(tuple(s.stop - s.start for s in box), np.bool_)
    both = clicks.mask(SIDES[0], own) | clicks.mask(SIDES[1], own)
    mine, theirs = shared(corner_of(box), marked.shape, first, both.shape)
    marked[mine] = both[theirs]
    return marked
