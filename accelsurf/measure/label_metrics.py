"""Agreement of two label maps, label by label, each in a box around it.

A label is compared with the same label of the other map. For the definitions see `metrics` and `surface_dice`. A
label that one map alone has is missed or made up: Dice, Jaccard index (IoU) and surface Dice are 0, the distances
undefined, since there is no surface to measure to. One that neither has is undefined in all, and a mean over cases
leaves it out, as nnU-Net does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from accelsurf.errors import InputError
from accelsurf.grid.arrays import Mask
from accelsurf.grid.boxes import Box, enclosing, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import Metrics, agreement, check_same_grid, surface_dice
from accelsurf.settings.labels import IdRanges, holds

#: Ids up to this are looked for in a list; larger ones are sorted, this number of voxels at a time.
_MAX_LISTED = 65_535
_SORTED_VOXELS = 1 << 21


@dataclass(frozen=True)
class LabelAgreement:
    """Agreement of two maps in one label.

    Attributes
    ----------
    label : int or None
        None where several labels counted as one object.
    metrics : Metrics
    surface_dice : dict of float to float
        By tolerance in mm; NaN where there is no surface.
    in_pred, in_ref : tuple of int
        The labels of either map that were compared; empty where a map has none.
    """

    label: int | None
    metrics: Metrics
    surface_dice: dict[float, float]
    in_pred: tuple[int, ...]
    in_ref: tuple[int, ...]

    def values(self) -> dict[str, float | None]:
        """All numbers by name, ready for JSON and CSV; None where undefined.

        Names end in the unit. ``surface_dice_1.5mm`` is that at a tolerance of 1.5 mm; ml are a thousandth of the mm3.
        """
        found = self.metrics.to_dict()
        for name in ("volume_pred", "volume_ref", "volume_difference"):
            found[f"{name}_ml"] = getattr(self.metrics, f"{name}_mm3") / 1000
        for tolerance, value in self.surface_dice.items():
            found[f"surface_dice_{tolerance:g}mm"] = None if math.isnan(value) else value
        return found


@dataclass(frozen=True)
class LabelMap:
    """A label map, and which of its labels count.

    Attributes
    ----------
    volume : Volume
        Label map of whole numbers.
    ids : tuple of (int, int)
        First and last of each range of labels that count; all above 0 if empty.
    boxes : dict of int to Box
        Of the labels that count and that are there.
    """

    volume: Volume
    ids: IdRanges = ()
    boxes: dict[int, Box] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        found = label_boxes(self.volume.array, self.volume.source)
        counted = {
            label: box for label, box in found.items() if not self.ids or holds(self.ids, label)
        }
        object.__setattr__(self, "boxes", counted)

    @property
    def absent(self) -> list[str]:
        """The ids and ranges that count and of which no voxel is there, as a person writes them."""
        return [
            str(low) if low == high else f"{low}-{high}"
            for low, high in self.ids
            if not any(low <= label <= high for label in self.boxes)
        ]

    def mask(self, label: int | None, box: Box) -> Mask:
        """Return the voxels of a box that have a label, or any that counts."""
        values = self.volume.array[box]
        if label is not None:
            return (
                np.asarray(values == label) if label in self.boxes else np.zeros(values.shape, bool)
            )
        if not self.ids:
            return np.asarray(values > 0)
        return reduce(
            np.logical_or, ((values >= max(low, 1)) & (values <= high) for low, high in self.ids)
        )


def evaluate_labels(
    pred: LabelMap, ref: LabelMap, labels: IdRanges = (), tolerances: Sequence[float] = ()
) -> list[LabelAgreement]:
    """Compare two label maps on the same grid, label by label.

    Parameters
    ----------
    pred, ref : LabelMap
        The map to judge, and the reference.
    labels : tuple of (int, int), optional
        Ranges of labels. Without any, all labels of either map; with some, the labels in them that either map has,
        and labels named one by one in any case.
    tolerances : sequence of float, optional
        Of surface Dice, in mm.

    Returns
    -------
    list of LabelAgreement
        One for each label, ascending.

    Raises
    ------
    GeometryError
        When the grids differ.

    Examples
    --------
    >>> a, b = np.zeros((2, 9, 9, 9), np.uint8)
    >>> a[2:5, 2:5, 2:5], b[2:5, 2:5, 2:5], b[6:, 6:, 6:] = 1, 1, 2
    >>> found = evaluate_labels(LabelMap(Volume.from_array(a)), LabelMap(Volume.from_array(b)))
    >>> [(one.label, one.metrics.dice) for one in found]
    [(1, 1.0), (2, 0.0)]
    """
    check_same_grid(pred.volume, ref.volume)
    found = {*pred.boxes, *ref.boxes}
    if labels:
        named = {first for first, last in labels if first == last and first > 0}
        found = named | {label for label in found if holds(labels, label)}
    return [_compare(pred, ref, label, tolerances) for label in sorted(found)]


def evaluate_object(
    pred: LabelMap, ref: LabelMap, tolerances: Sequence[float] = ()
) -> LabelAgreement:
    """Compare two label maps on the same grid; all labels that count are one object.

    For parameters and errors see `evaluate_labels`.
    """
    check_same_grid(pred.volume, ref.volume)
    return _compare(pred, ref, None, tolerances)


def _compare(
    pred: LabelMap, ref: LabelMap, label: int | None, tolerances: Sequence[float]
) -> LabelAgreement:
    there = [
        [found for found in side.boxes if label is None or found == label] for side in (pred, ref)
    ]
    boxes = [
        side.boxes[found] for side, ids in zip((pred, ref), there, strict=True) for found in ids
    ]
    geometry: Geometry = pred.volume.geometry
    # One more voxel on each side: an axis of one voxel would mean an image of one slice.
    box = (
        widened(reduce(enclosing, boxes), geometry.shape, (1, 1, 1))
        if boxes
        else (slice(0, 0),) * 3
    )
    a, b = pred.mask(label, box), ref.mask(label, box)
    return LabelAgreement(
        label,
        agreement(a, b, geometry.spacing),
        dict(zip(tolerances, surface_dice(a, b, geometry.spacing, tolerances), strict=True))
        if tolerances
        else {},
        *(tuple(sorted(ids)) for ids in there),
    )


def label_boxes(labels: NDArray[Any], source: object = None) -> dict[int, Box]:
    """Bounding box of each label above 0.

    Parameters
    ----------
    labels : ndarray of int, shape (nz, ny, nx)
    source : Path or str, optional
        Its file, for the message.

    Raises
    ------
    InputError
        When the labels are no integers.

    Examples
    --------
    >>> label_boxes(np.array([[[0, 7, 7]]]))
    {7: (slice(0, 1, None), slice(0, 1, None), slice(1, 3, None))}
    """
    if labels.dtype == bool:
        labels = labels.view(np.uint8)
    if labels.dtype.kind not in "iu":
        name = f"{source}: " if source else ""
        raise InputError(
            f"{name}labels of type {labels.dtype} given, whole numbers expected",
            "read_labels reads them",
        )
    if not labels.size:
        return {}
    if int(labels.max()) <= _MAX_LISTED:
        return {label: box for label, box in enumerate(find_objects(labels), 1) if box is not None}
    found: dict[int, Box] = {}
    step = max(_SORTED_VOXELS // (labels.shape[1] * labels.shape[2]), 1)
    for first in range(0, len(labels), step):
        slab = labels[first : first + step]
        ids, places = np.unique(slab, return_inverse=True)
        for label, box in zip(
            ids.tolist(), find_objects(places.reshape(slab.shape) + 1), strict=True
        ):
            here = (slice(box[0].start + first, box[0].stop + first), box[1], box[2])
            if label > 0:
                found[label] = enclosing(found[label], here) if label in found else here
    return dict(sorted(found.items()))


def over_cases(values: Sequence[dict[str, float | None]]) -> dict[str, dict[str, float | None]]:
    """Mean, median and count of each number over the cases in which it is defined.

    Examples
    --------
    >>> over_cases([{"dice": 0.5}, {"dice": 1.0}, {"dice": None}])
    {'mean': {'dice': 0.75}, 'median': {'dice': 0.75}, 'count': {'dice': 2}}
    """
    names = dict.fromkeys(name for case in values for name in case)
    defined = {
        name: [value for case in values if (value := case.get(name)) is not None] for name in names
    }
    return {
        "mean": {name: fmean(some) if some else None for name, some in defined.items()},
        "median": {name: median(some) if some else None for name, some in defined.items()},
        "count": {name: len(some) for name, some in defined.items()},
    }
