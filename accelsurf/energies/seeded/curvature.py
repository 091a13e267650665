"""Pull of the area on an object of clicks as a whole, so that it smooths the surface and does not shrink it.

F says where the object is, F = 0 is its boundary. With a weight alpha of the area the surface rests where F = -alpha H,
inside of it wherever it is convex, the farther the more gently F rises: .3 voxels and more where no edge is near. So
F is lowered by alpha times the mean of H over the boundary: the surface rests about F = 0 then, inside where it is more
curved than in the mean, outside where less.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from accelsurf.energies.seeded.appearance import Mask, Spacing
from accelsurf.energies.seeded.coarse import block_means, coarsening
from accelsurf.grid.boxes import bounding_box

#: Parallel surfaces are so many of the smallest spacings away.
APART = 2.0
#: Larger boxes are coarsened to so many voxels.
MOST = 40_000
#: F is lowered by so much at most: on a tiny object the area would otherwise outweigh what the clicks say.
MAX_OFFSET = 0.2


def mean_curvature(inside: Mask, spacing: Spacing) -> float:
    """Mean of H, the sum of the principal curvatures, over the boundary of a mask, 1/mm; 0 without a boundary.

    Parameters
    ----------
    inside : ndarray (nz, ny, nx) of bool
    spacing : (hz, hy, hx)
        mm.

    Notes
    -----
    V(t), the volume within the parallel surface at the distance t, has V' = A and V'' = int H dA (Steiner):
    <H> = (V(t) - 2 V(0) + V(-t))/t^2 over (V(t) - V(-t))/(2 t). Of a ball of radius r this is 2/r/(1 + t^2/(3 r^2)).
    """
    box = bounding_box(inside, 0)
    if box is None or inside.all():
        return 0.0
    # Where the volume ends there is no boundary; elsewhere there is room for the outer surface.
    steps = coarsening(box, spacing, MOST)
    h = np.multiply(spacing, steps)
    axes = [axis for axis, n in enumerate(inside.shape) if n > 1]
    apart = APART * float(h[axes].min())
    margin = [int(apart / size) + 1 if axis in axes else 0 for axis, size in enumerate(h)]
    coarse = block_means(inside[box].astype(np.float32), steps) >= 0.5
    beyond = [_room(side.start, step, m) for side, step, m in zip(box, steps, margin, strict=True)]
    after = [_room(n - side.stop, step, m) for side, n, step, m in zip(box, inside.shape, steps, margin, strict=True)]
    seen = np.pad(coarse, list(zip(beyond, after, strict=True)))
    if seen.all() or not seen.any():
        return 0.0
    half = 0.5 * float(h[axes].min())
    outer = ndimage.distance_transform_edt(~seen, sampling=h) - half
    inner = ndimage.distance_transform_edt(seen, sampling=h) - half
    larger, same = np.count_nonzero(outer < apart), np.count_nonzero(seen)
    smaller = np.count_nonzero(inner >= apart)
    return float((larger - 2 * same + smaller) / apart**2 / max((larger - smaller) / (2.0 * apart), 1e-20))


def _room(voxels: int, step: int, margin: int) -> int:
    """Number of blocks that lie beyond, at most as many as are needed."""
    return min(-(-voxels // step), margin)


def offset(area_weight_mm: float, curvature: float) -> float:
    """Find what F is lowered by for a weight of the area (mm) and a mean curvature (1/mm); 0 of a hollow object.

    Examples
    --------
    >>> round(offset(0.3, 0.2), 3), offset(0.3, -0.2), offset(0.3, 4.0)
    (0.06, 0.0, 0.2)
    """
    return min(max(area_weight_mm * curvature, 0.0), MAX_OFFSET)
