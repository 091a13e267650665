"""Weight of the area that suits an object of clicks, and the offset that keeps its size under that weight.

With a weight alpha of the area the surface comes to lie where F = -alpha H, inside of F = 0 wherever it is convex. So
F is lowered by alpha times the mean of H over the boundary: the area smooths the object and does not shrink it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import bounding_box
from accelsurf.image.blocks import block_means, coarsening
from accelsurf.image.noise import SECOND_DIFFERENCE

#: Distance from the boundary, in voxels along each axis, within which noise and contrast are measured.
REACH = 4
#: Weight of the area, of the smallest spacing, without noise; and the increase by noise of the contrast's size. More
#: noise adds no more.
AREA = 0.1
NOISY_AREA = 0.2
#: Distance of the parallel surfaces, in the smallest spacings; most voxels of a box, larger ones are restricted.
APART = 2.0
MOST = 40_000
#: F is lowered by this at most: on a tiny object the area would otherwise outweigh the clicks.
MAX_OFFSET = 0.2


def area_weight(
    images: Sequence[Singles], spacing: Spacing, inside: Mask, open: Mask | None = None
) -> float:
    """Weight of the area (mm) that suits the noise: more, the more noise there is for the contrast of the boundary.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels; that with the least noise for its contrast counts.
    spacing : (hz, hy, hx)
        mm.
    inside : ndarray (nz, ny, nx) of bool
        The object; its boundary's contrast is the difference of the medians on both sides.
    open : ndarray (nz, ny, nx) of bool, optional
        Elsewhere nothing is looked at.
    """
    box, share = bounding_box(inside, 2 * REACH), 1.0
    if box is not None:
        near = _widened(inside[box]) & _widened(~inside[box])
        near = near if open is None else near & open[box]
        for image in images:
            share = min(share, _noise_share(image[box], inside[box], near))
    return (AREA + NOISY_AREA * share) * min(spacing)


def _widened(mask: Mask) -> Mask:
    """Voxels that have one of a mask within `REACH` along each axis, in a cube."""
    out = mask.copy()
    for axis in range(3):
        for shift in (1, 1, 2):  # 4 in all
            along = np.moveaxis(out, axis, 0)
            before = along.copy()
            along[shift:] |= before[:-shift]
            along[:-shift] |= before[shift:]
    return out


def _noise_share(image: Singles, inside: Mask, near: Mask) -> float:
    """Noise in parts of the contrast near a boundary, at most 1."""
    within, beyond = near & inside, near & ~inside
    if not (within.any() and beyond.any()):
        return 1.0
    contrast = abs(float(np.median(image[within])) - float(np.median(image[beyond])))
    found = []
    for axis in (i for i in range(3) if image.shape[i] > 2):
        before, at, after = ((slice(None),) * axis + (slice(k, k - 2 or None),) for k in range(3))
        here, value = near[at], image[at][near[at]]
        second = np.abs((image[after][here] - value) - (value - image[before][here]))
        if second.size:
            found.append(float(np.median(second)) / SECOND_DIFFERENCE)
    return min(min(found, default=0.0) / max(contrast, 1e-20), 1.0)


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
    steps = coarsening([s.stop - s.start for s in box], spacing, MOST)
    h = np.multiply(spacing, steps)
    axes = [axis for axis, n in enumerate(inside.shape) if n > 1]
    apart = APART * float(h[axes].min())
    margin = [int(apart / size) + 1 if axis in axes else 0 for axis, size in enumerate(h)]
    coarse = block_means(inside[box].astype(np.float32), steps) >= 0.5
    beyond = [_room(side.start, step, m) for side, step, m in zip(box, steps, margin, strict=True)]
    after = [
        _room(n - side.stop, step, m)
        for side, n, step, m in zip(box, inside.shape, steps, margin, strict=True)
    ]
    seen = np.pad(coarse, list(zip(beyond, after, strict=True)))
    if seen.all() or not seen.any():
        return 0.0
    half = 0.5 * float(h[axes].min())
    outer = ndimage.distance_transform_edt(~seen, sampling=h) - half
    inner = ndimage.distance_transform_edt(seen, sampling=h) - half
    larger, same = np.count_nonzero(outer < apart), np.count_nonzero(seen)
    smaller = np.count_nonzero(inner >= apart)
    return float(
        (larger - 2 * same + smaller) / apart**2 / max((larger - smaller) / (2.0 * apart), 1e-20)
    )


def _room(voxels: int, step: int, margin: int) -> int:
    """Number of blocks that lie beyond, at most as many as are needed."""
    return min(-(-voxels // step), margin)


def surface_offset(area_weight_mm: float, curvature: float) -> float:
    """Return the decrease of F for a weight of the area (mm) and a mean curvature (1/mm); 0 of a hollow object.

    Examples
    --------
    >>> round(surface_offset(0.3, 0.2), 3), surface_offset(0.3, -0.2), surface_offset(0.3, 4.0)
    (0.06, 0.0, 0.2)
    """
    return min(max(area_weight_mm * curvature, 0.0), MAX_OFFSET)
