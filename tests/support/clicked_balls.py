"""Distances on a grid, and clicks that are balls."""

import numpy as np
from scipy import ndimage

from accelsurf.grid.clicks import Click


def distance(centre, shape, spacing):
    """Distance (mm) of each voxel to the voxel ``centre`` (z, y, x)."""
    return np.sqrt(
        sum(((i - c) * h) ** 2 for i, c, h in zip(np.indices(shape), centre, spacing, strict=True))
    )


def ball(side, centre, radius, shape, spacing):
    """A click on the voxels within ``radius`` (mm) of a voxel."""
    mask = distance(centre, shape, spacing) <= radius
    box = ndimage.find_objects(mask.astype(int))[0]
    return Click(side, box, mask[box])
