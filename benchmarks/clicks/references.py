"""References: from label maps, and for scans without one from thresholds; where an object may be compared.

A scan without a drawn reference has objects by a stated rule: the classes of Otsu's method, opened, and the largest
part, or the largest closed cavity. Such a reference favours methods that threshold; tables name these objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box

Mask = NDArray[np.bool_]
CLASSES = 3
#: Where a reference says something: elsewhere nothing is compared. Voxels (z, y, x).
SLABS: dict[str, Box] = {"mra_aorta": (slice(9, 24), slice(84, 178), slice(56, 95))}


@dataclass(frozen=True)
class Threshold:
    """An object of a scan by thresholds: of three classes by Otsu's method those from ``first`` to ``last``.

    They are opened ``opened`` times. ``closed``: of the parts that touch no face the largest, otherwise the largest of
    all. ``without``: another object, widened by a voxel, that is taken off before.
    """

    scan: str
    family: str
    first: int
    last: int
    opened: int = 0
    closed: bool = False
    without: Threshold | None = None

    def mask(self, values: NDArray[Any]) -> Mask:
        """Mask of the object in an image."""
        from skimage.filters import threshold_multiotsu

        limits = threshold_multiotsu(values[::2, ::2, ::2].astype(np.float32), CLASSES, nbins=64)
        found = np.digitize(values, limits)
        mask = (found >= self.first) & (found <= self.last)
        if self.without is not None:
            mask &= ~ndimage.binary_dilation(self.without.mask(values))
        if self.opened:
            mask = ndimage.binary_opening(mask, iterations=self.opened)
        return largest(mask, self.closed)


_INSERT = Threshold("ct_phantom_oblique", "other", 1, 1, opened=1)
#: Objects of the scans without a drawn reference, by name. Of the bonsai the pot alone: its wood and its soil are of
#: one class and touch.
THRESHOLDS = {
    "enamel": Threshold("ct_tooth", "bones", 2, 2, opened=1),
    "dentin": Threshold("ct_tooth", "bones", 1, 1, opened=1),
    "pulp": Threshold("ct_tooth", "other", 0, 0, closed=True),
    "pot": Threshold("ct_bonsai", "other", 2, 2, opened=2),
    "insert": _INSERT,
    "skull": Threshold("ct_phantom_oblique", "bones", 1, 2, without=_INSERT),
}


def largest(mask: Mask, closed: bool = False) -> Mask:
    """Largest part (faces) of a mask; with ``closed`` of those that touch no face of the image."""
    parts, _ = ndimage.label(mask)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    if closed:
        for axis in range(3):
            for end in (0, -1):
                sizes[np.unique(np.take(parts, end, axis=axis))] = 0
    return np.asarray(parts == np.argmax(sizes))


def part_of(mask: Mask, rank: int) -> Mask:
    """Part (faces, edges, corners) of a mask: the largest for rank 1; ties go to the lowest index.

    Examples
    --------
    >>> part_of(np.array([[[1, 0, 1, 1]]], bool), 2).tolist()
    [[[True, False, False, False]]]
    """
    parts, count = ndimage.label(mask, np.ones((3, 3, 3)))
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    return np.asarray(parts == np.argsort(-sizes, kind="stable")[rank - 1] + 1)


def labelled(reference: NDArray[Any], labels: Sequence[int], part: int = 0) -> Mask:
    """Mask of the labels of an object (none: all above 0), or of one part of it."""
    mask = np.isin(reference, labels) if labels else np.asarray(reference > 0)
    return part_of(mask, part) if part else mask


def within(mask: Mask, region: Box | None) -> Mask:
    """Mask without what lies outside of the region that is compared; None is everywhere."""
    if region is None:
        return mask
    out = np.zeros_like(mask)
    out[region] = mask[region]
    return out


def edge(values: NDArray[Any], mask: Mask) -> float:
    """Strength of an object's edge, d': difference of the means within two voxels of it over the pooled deviation.

    Examples
    --------
    >>> mask = np.zeros((9, 9, 9), bool)
    >>> mask[2:7, 2:7, 2:7] = True
    >>> edge(np.where(mask, 5.0, 1.0) + np.indices(mask.shape).sum(0) % 2, mask) > 4
    True
    """
    inner = mask & ~ndimage.binary_erosion(mask, iterations=2, border_value=1)
    outer = ndimage.binary_dilation(mask, iterations=2) & ~mask
    if not inner.any() or not outer.any():
        return 0.0
    one_side, other_side = values[inner].astype(np.float64), values[outer].astype(np.float64)
    spread = np.sqrt(0.5 * (one_side.var() + other_side.var()))
    return float(abs(one_side.mean() - other_side.mean()) / max(spread, 1e-9))
