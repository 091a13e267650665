"""Objects that appear: parts of a frame that look like those that are tracked, and lie apart from all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from accelsurf.grid.boxes import corner_of, widened
from accelsurf.grid.smoothing import gaussian_mm
from accelsurf.grid.volume import Volume
from accelsurf.tracking.evidence import FACTOR, Profile
from accelsurf.tracking.followed import lies_on_border
from accelsurf.tracking.records import BAND, SurfacePiece

#: What is nearer to a tracked object than so many voxels is no object of its own.
APART = 2
#: Of an object that the border of the grid cuts at least so many voxels must be there.
MIN_CUT = 8


def appearing(
    image: Volume, surfaces: Sequence[SurfacePiece], like: Profile, volumes: tuple[float, float]
) -> list[SurfacePiece]:
    """First surfaces of objects that appear in a frame, the largest first.

    They are what is nearer to the values inside ``like`` than to those outside, after a Gaussian of one voxel, does not
    come near any of the ``surfaces``, and is about as large as these, or is cut by the border of the grid.

    Parameters
    ----------
    image : Volume
        The frame.
    surfaces : sequence of SurfacePiece
        Objects that are there.
    like : Profile
        Values across the surface of a tracked object.
    volumes : (float, float)
        Of the smallest and the largest tracked object, mm3: what appears lies within a factor of two of them. What the
        border cuts may be smaller, down to `MIN_CUT` voxels: it has only begun to come in.
    """
    inner, outer, geometry = like.inner, like.outer, image.geometry
    if not (np.isfinite(inner) and np.isfinite(outer)) or inner == outer:
        return []
    smooth = gaussian_mm(image.as_float32(), geometry.spacing, min(geometry.steps))
    edge = 0.5 * (inner + outer)
    inside = smooth > edge if inner > outer else smooth < edge
    taken = np.zeros(geometry.shape, np.bool_)
    for one in surfaces:
        taken[one.box] |= one.psi < 0
    if taken.any():
        taken = ndimage.binary_dilation(taken, iterations=APART)
    labels, count = ndimage.label(inside | taken)
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * geometry.voxel_volume
    low, high = volumes[0] / FACTOR, volumes[1] * FACTOR
    cut_low = min(MIN_CUT * geometry.voxel_volume, low)
    near = set(np.unique(labels[taken]).tolist()) | {0}
    found = [number for number in np.argsort(-sizes, kind="stable").tolist()
             if number not in near and cut_low <= sizes[number] <= high]
    half, boxes = np.float32(0.5 * min(geometry.steps)), ndimage.find_objects(labels) if found else []
    out = []
    for number in found:
        box = widened(boxes[number - 1], labels.shape, (BAND, BAND, BAND))
        piece = SurfacePiece(corner_of(box), np.where(labels[box] == number, -half, half))
        if sizes[number] >= low or lies_on_border(piece, geometry):
            out.append(piece)
    return out
