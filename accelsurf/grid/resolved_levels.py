"""On how many levels of a pyramid each part of an object is thick enough to be resolved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import bounding_box
from accelsurf.grid.pyramid import Level, restrict

#: Where the number of levels is chosen automatically: the smallest number of voxels along an axis that is halved, and
#: how deep each part of the start must be, voxels.
AUTO_MIN_VOXELS, AUTO_MIN_DEPTH = 24, 2.0


def min_component_depth(psi: NDArray[np.float32]) -> float:
    """Return the depth, voxels, of the thinnest component of {psi < 0}: from its innermost voxel to the outside.

    0 where nothing is inside. What lies beyond the border counts as inside.

    Examples
    --------
    >>> z, y, x = np.indices((21, 21, 21)) - 10
    >>> round(min_component_depth(np.minimum(np.sqrt(z**2 + y**2 + x**2) - 6, np.maximum(abs(z), abs(y - 9)) - 1.5)), 1)
    2.0
    """
    inside = psi < 0
    box = bounding_box(inside, 1)
    if box is None or inside.all():
        return 0.0
    # Only where the object is, and a voxel around it: the distances take much memory.
    inside = inside[box]
    parts, count = ndimage.label(inside)
    depth = ndimage.distance_transform_edt(inside)
    return float(np.min(ndimage.maximum(depth, parts, np.arange(1, count + 1))))


def count_resolved_levels(grids: Sequence[Level], psi: NDArray[np.float32]) -> int:
    """Return on how many levels, from the finest on, each part of a start is at least `AUTO_MIN_DEPTH` voxels deep."""
    count = 1
    for fine, coarse in zip(grids, grids[1:], strict=False):
        psi = restrict(psi, fine, coarse)
        if min_component_depth(psi) < AUTO_MIN_DEPTH:
            break
        count += 1
    return count
