"""First surfaces of many objects in an image that is not in memory: where each lies is known, and some are made."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import io
from accelsurf.errors import GeometryError, UsageError
from accelsurf.grid.boxes import Box, as_corner, box_at, corner_of, slabs, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.io import LazyVolume
from accelsurf.starts import ObjectStart, psi_of_mask, separated
from accelsurf.text.object_clicks import has_sides
from accelsurf.text.objects import ball_box, ball_start, check_found, read_balls, whole_numbers
from accelsurf.text.starts import parse_start

Some = TypeVar("Some", bound="ManyStarts")
_HINT = "give a table of balls (id,x,y,z,r), or a label map of first voxels"


class ManyStarts(Protocol):
    """First surfaces of objects with ids.

    Attributes
    ----------
    ids : ndarray (n,) of int64
        Ascending.
    low, high : ndarray (n, 3) of int64
        First voxel of the box of each, and the one after its last.
    """

    ids: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]

    def made(self, places: Sequence[int]) -> list[ObjectStart]:
        """The starts at ascending positions in ``ids``, on the whole grid.

        The box of none of them may meet that of another object that is left out.

        Raises
        ------
        InputError
            When one lies entirely within others.
        """
        ...

    def only(self, places: Sequence[int]) -> ManyStarts:
        """The starts at some positions alone, for another process, which reads the files itself."""
        ...


class BallTable:
    """Balls of a table; all balls of an id are one object.

    Parameters
    ----------
    file : str
    geometry : Geometry
        The whole grid.
    margin : int
        Voxels around each object, where the grid has them.

    Raises
    ------
    InputError
        As `accelsurf.text.objects.read_objects`; UsageError when it is a table of clicks.
    """

    def __init__(self, file: str, geometry: Geometry, margin: int) -> None:
        if has_sides(file):
            raise UsageError(
                f"objects {file}: it has a column side, and the image is read in parts: clicks count everywhere",
                _HINT,
            )
        self._file = file
        self._geometry = geometry
        self._margin = margin
        self._balls = read_balls(file, geometry)
        boxes = [ball_box(file, id, rows, geometry, margin) for id, rows in self._balls.items()]
        self.ids = np.array(list(self._balls), np.int64)
        self.low, self.high = _ends(boxes)

    def only(self, places: Sequence[int]) -> BallTable:
        """See `ManyStarts`."""
        part = _at(self, places)
        vars(part)["_balls"] = {id: self._balls[id] for id in part.ids.tolist()}
        return part

    def made(self, places: Sequence[int]) -> list[ObjectStart]:
        """See `ManyStarts`."""
        ids = [int(self.ids[place]) for place in places]
        found = [
            ball_start(self._file, id, self._balls[id], self._geometry, self._margin) for id in ids
        ]
        return separated(found, self._file)


class LabelMap:
    """Labels of a map that is read in parts.

    Parameters
    ----------
    name : str
        For messages.
    labels : LazyVolume
    geometry : Geometry
        The image's grid.
    margin : int
        Voxels around each object, where the grid has them.
    ids : sequence of (first, last), optional
        Those that count; none for all.

    Raises
    ------
    InputError
        As `accelsurf.text.objects.read_objects`; GeometryError when it lies on another grid.
    """

    def __init__(
        self,
        name: str,
        labels: LazyVolume,
        geometry: Geometry,
        margin: int,
        ids: Sequence[tuple[int, int]] = (),
    ) -> None:
        if not labels.geometry.matches(geometry):
            raise GeometryError(
                f"objects {name}: on another grid than the image: {labels.geometry.difference(geometry)}",
                "resample it to the image's grid first",
            )
        self._name, self._labels, self._geometry, self._wanted = name, labels, geometry, tuple(ids)
        self.ids, self.low, self.high = self._scanned(margin)

    def only(self, places: Sequence[int]) -> LabelMap:
        """See `ManyStarts`."""
        return _at(self, places)

    def _scanned(
        self, margin: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The ids and their boxes, by one pass over the map."""
        boxes: dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
        shape = self._geometry.shape
        for planes in slabs(shape):
            labels = self._read((planes, slice(0, shape[1]), slice(0, shape[2])))
            found = np.unique(labels[labels > 0])
            places = np.where(labels > 0, np.searchsorted(found, labels) + 1, 0).astype(np.int32)
            for label, box in zip(found.tolist(), ndimage.find_objects(places), strict=True):
                low = np.array([box[0].start + planes.start, box[1].start, box[2].start])
                high = np.array([box[0].stop + planes.start, box[1].stop, box[2].stop])
                if label in boxes:
                    low, high = np.minimum(boxes[label][0], low), np.maximum(boxes[label][1], high)
                boxes[label] = low, high
        ids = np.array(sorted(boxes), np.int64)
        check_found(self._name, ids)
        around = [widened(_box(*boxes[id]), shape, (margin, margin, margin)) for id in ids.tolist()]
        return ids, *_ends(around)

    def _read(self, box: Box) -> NDArray[np.integer]:
        return whole_numbers(self._name, self._labels.read(box), self._wanted, corner_of(box))

    def made(self, places: Sequence[int]) -> list[ObjectStart]:
        """See `ManyStarts`."""
        out = []
        for place in places:
            box = _box(self.low[place], self.high[place])
            psi = psi_of_mask(self._read(box) == self.ids[place], self._geometry)
            out.append(ObjectStart(int(self.ids[place]), corner_of(box), psi))
        return out


def opened(objects: str, geometry: Geometry, margin: int) -> ManyStarts:
    """Return the first surfaces that ``--objects`` names.

    Parameters
    ----------
    objects : str
        Table of balls (.csv), or label map on the image's grid that can be read in parts (``FILE@2,5-9``).
    geometry : Geometry
        The whole grid.
    margin : int
        Voxels around each object, where the grid has them.

    Raises
    ------
    UsageError, InputError
        As of `BallTable` and `LabelMap`, and when a map cannot be read in parts.
    """
    if objects.lower().endswith(".csv"):
        return BallTable(objects, geometry, margin)
    start = parse_start(f"label:{objects}")
    return LabelMap(objects, io.open_volume(start.file), geometry, margin, start.ids)


def _at(starts: Some, places: Sequence[int]) -> Some:
    part, here = copy.copy(starts), list(places)
    vars(part).update(ids=starts.ids[here], low=starts.low[here], high=starts.high[here])
    return part


def _ends(boxes: Sequence[Box]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First voxels (n, 3) of boxes, and those after the last."""
    low = np.array([[side.start for side in box] for box in boxes], np.int64)
    return low, np.array([[side.stop for side in box] for box in boxes], np.int64)


def _box(low: NDArray[np.int64], high: NDArray[np.int64]) -> Box:
    return box_at(as_corner(low), (high - low).tolist())
