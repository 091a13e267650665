"""Large parts of an object that hang together by thin necks only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import bounding_box

#: A part counts from this fraction of the object's volume on; a neck is at most so many voxels to either side; so many
#: parts are examined.
LARGE_PART, NECK, MAX_PARTS = 0.05, 2, 200


def parts_beyond_necks(inside: NDArray[np.bool_]) -> int:
    """Large parts that remain of the largest component without its necks."""
    box = bounding_box(inside, 1)
    if box is None:
        return 0
    parts, count = ndimage.label(inside[box])
    if count == 0:
        return 0
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    body = parts == sizes.argmax()
    # An object that meets the border continues beyond it; a single slice has no depth across.
    padded = np.pad(body, [(NECK, NECK) if n > 1 else (0, 0) for n in inside.shape], mode="edge")
    del parts, body
    cores, count = ndimage.label(_deeper_than_neck(padded))
    if count < 2:
        return 1
    # Only so many parts can be large; numbered as bytes they need a quarter of the memory.
    sizes = np.bincount(cores.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")[: min(count, MAX_PARTS)]
    name = np.zeros(count + 1, np.uint8)
    name[order] = np.arange(1, len(order) + 1)
    reach = name[cores]
    del cores
    # Grow the cores back to the parts that they belong to.
    for _ in range(NECK + 1):
        grown = ndimage.maximum_filter(reach, 3)
        np.copyto(reach, grown, where=(reach == 0) & padded)
    volumes = np.bincount(reach.ravel())[1:]
    return max(1, int((volumes >= LARGE_PART * padded.sum()).sum()))


def _deeper_than_neck(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels of a mask with no other voxel within `NECK` voxels; beyond the array the mask continues."""
    reach = [NECK if n > 1 else 0 for n in mask.shape]
    deep = mask.copy()
    offsets = np.indices([2 * r + 1 for r in reach]).reshape(3, -1).T - reach
    for offset in offsets[(offsets**2).sum(axis=1) <= NECK**2]:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, mask.shape, strict=True))
        there = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, mask.shape, strict=True))
        deep[here] &= mask[there]
    return deep
