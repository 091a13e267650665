"""The share of a surface under which the image has no edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import bounding_box, slabs
from accelsurf.grid.geometry import axis_steps
from accelsurf.grid.smoothing import gaussian_mm

#: A gradient is an edge if it is above this percentile of the gradients inside the object, at least so many voxels from
#: its surface, and above this fraction of the image's range over the scale that gradients are computed at.
INTERIOR_PERCENTILE, INTERIOR_DEPTH, MIN_EDGE = 75.0, 3, 0.005
#: Gradients inside the object are sampled at about so many voxels.
GRADIENT_SAMPLES = 1 << 18
#: A slab has at least so many planes for each plane around it that is needed besides.
MIN_SLAB_HALOS = 4


def no_edge_fraction(
    inside: NDArray[np.bool_], image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> float:
    """Share of the voxels next to the surface, on its inside, where the smoothed image has no edge."""
    scale = max(axis_steps(inside.shape, spacing))
    halo = INTERIOR_DEPTH + 5 * int(np.ceil(scale / spacing[0])) + 1
    box = bounding_box(inside, INTERIOR_DEPTH + 5 * int(np.ceil(scale / min(spacing))) + 1)
    if box is None:
        return 0.0
    inside, image = inside[box], image[box]
    on_surface: list[NDArray[np.float32]] = []
    within: list[NDArray[np.float32]] = []
    every = max(1, inside.size // GRADIENT_SAMPLES)
    for planes in slabs(inside.shape, at_least=MIN_SLAB_HALOS * halo):
        low, high = max(planes.start - halo, 0), min(planes.stop + halo, inside.shape[0])
        smooth = gaussian_mm(image[low:high], spacing, scale)
        before, after = planes.start - low, planes.stop - low
        part = inside[low:high]
        within_rim = ndimage.binary_erosion(part, border_value=1)
        deep = ndimage.binary_erosion(within_rim, iterations=INTERIOR_DEPTH - 1, border_value=1)
        for mask, found, each in ((part & ~within_rim, on_surface, 1), (deep, within, every)):
            own = mask[before:after]
            found.append(gradients(smooth, spacing, np.flatnonzero(own)[::each] + before * own[0].size))
    surface, own = np.concatenate(on_surface), np.concatenate(within)
    if surface.size == 0:
        return 0.0
    # A thin object has no inside to compare with.
    usual = float(np.percentile(own, INTERIOR_PERCENTILE)) if own.size else 0.0
    return float((surface <= max(usual, MIN_EDGE / scale)).mean())


def gradients(
    smooth: NDArray[np.float32], spacing: tuple[float, float, float], cells: NDArray[np.int64]
) -> NDArray[np.float32]:
    """|grad I| at raveled voxels (n,) of a smoothed image: centred differences, one-sided on the border."""
    flat, total, step = smooth.reshape(-1), np.zeros(cells.size, np.float32), smooth.size
    for n, h in zip(smooth.shape, spacing, strict=True):
        step //= n
        if n > 1:
            index = cells // step % n
            low, high = (index > 0).astype(np.int64), (index < n - 1).astype(np.int64)
            total += ((flat[cells + high * step] - flat[cells - low * step]) / (np.float32(h) * (low + high))) ** 2
    return np.sqrt(total)
