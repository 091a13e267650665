"""Parallel slices through an image: planes in world mm, along the voxels or straight along the world's axes.

A place in a slice is (right, up, across) in mm. With the unit vectors F = (right, up, across) and the origin o:

    world = o + F (right, up, across)

Slices along the voxels are the case in which F are the grid's axes and each pixel is a voxel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation

#: Pixels along a voxel where a slice that cuts voxels aslant shows each by itself.
FINE = 2
#: Part of a slice's thickness that is rounding.
ROUNDING = 1e-6
#: World axes (x, y, z), with their signs, that are right, up and across of the axial, coronal and sagittal slice.
_STRAIGHT = (
    ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
)

#: Corners of a box, 0 for the first end along z, y, x and 1 for the last; and its edges, from corner to corner.
_BITS = np.array(list(product((0, 1), repeat=3)))
_EDGES = [
    (a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_BITS[a] - _BITS[b]).sum() == 1
]

Extent = tuple[float, float, float, float]


class Patch(NamedTuple):
    """Pixels of a slice.

    Attributes
    ----------
    rows, columns : slice
        Of the picture, the first row at the lower edge.
    places : tuple of ndarray
        Index z, y, x of the image at each pixel, (rows, columns); may lie beyond the image.
    """

    rows: slice
    columns: slice
    places: tuple[Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class SliceStack:
    """Slices of an image in one direction; made by `along_voxels` or `straight`.

    Attributes
    ----------
    geometry : Geometry
        Of the image.
    axis : int
        Array axis of the image that is nearest to across.
    is_straight : bool
        Whether the slices follow the world's axes, and not the voxels.
    name : str
        Of the coordinate across: z, y or x, with a prime where it is not the world's.
    frame : ndarray (3, 3)
        Columns are the unit vectors right, up, across, in the world.
    origin : ndarray (3,)
        World mm of the place (0, 0, 0).
    extent : (float, float, float, float)
        Left, right, bottom, top of the image in the plane, mm: outer faces of voxels.
    pitch : (float, float)
        From pixel to pixel to the right and up, mm.
    first, step : float
        Coordinate across of the slice 0, and from one slice to the next; along voxels below 0 where the array runs so.
    count : int
        How many slices there are.
    """

    geometry: Geometry
    axis: int
    is_straight: bool
    name: str
    frame: Floats
    origin: Floats
    extent: Extent
    pitch: tuple[float, float]
    first: float
    step: float
    count: int

    @classmethod
    def along_voxels(cls, geometry: Geometry, plane: int) -> SliceStack:
        """Slices of the grid; ``plane`` is 0 for axial, 1 coronal, 2 sagittal, by the nearest grid axis."""
        up, (vertical, horizontal) = DisplayOrientation.of(geometry), IN_PLANE[plane]
        axes = (horizontal, vertical, plane)
        # The front is at the top of an axial slice.
        turn = np.array([1.0, -1.0 if plane == 0 else 1.0, 1.0])
        signs = np.array([-1.0 if up.flips[axis] else 1.0 for axis in axes]) * turn
        frame = (
            np.stack([geometry.direction[:, 2 - up.order[axis]] for axis in axes], axis=1) * signs
        )
        corner = np.zeros(3)
        for axis in axes:
            corner[up.order[axis]] = geometry.shape[up.order[axis]] - 1 if up.flips[axis] else 0
        first = np.array([up.first[axis] for axis in axes]) * turn
        ends = []
        for axis, sign in zip((horizontal, vertical), turn, strict=False):
            last = geometry.shape[up.order[axis]] - 0.5
            ends.append(sorted(sign * up.coordinate(axis, index) for index in (-0.5, last)))
        n, h = geometry.shape[up.order[plane]], up.spacing[plane]
        return cls(
            geometry,
            up.order[plane],
            False,
            up.names[plane],
            frame,
            geometry.index_to_world(corner) - frame @ first,
            (*ends[0], *ends[1]),
            (up.spacing[horizontal], up.spacing[vertical]),
            up.coordinate(plane, n - 1 if up.flips[plane] else 0),
            -h if up.flips[plane] else h,
            n,
        )

    @classmethod
    def straight(cls, geometry: Geometry, plane: int) -> SliceStack:
        """Slices along the world's axes; ``plane`` is 0 for axial, 1 coronal, 2 sagittal."""
        frame = np.array(_STRAIGHT[plane]).T
        axis = DisplayOrientation.of(geometry).order[plane]
        ends = np.array([[-0.5] * 3, np.array(geometry.shape) - 0.5])
        faces = geometry.index_to_world(ends[_BITS, np.arange(3)]) @ frame
        low, high = faces.min(axis=0), faces.max(axis=0)
        pitch = min(geometry.steps)
        half = 0.5 * pitch * np.ceil((high - low) / pitch - ROUNDING)
        middle, step = 0.5 * (low + high), geometry.spacing[axis]
        # Slices through voxels' centres, so that the cursor can be in each.
        centers = geometry.corners_world() @ frame[:, 2]
        count = int(np.ptp(centers) / step + ROUNDING) + 1
        extent = (
            middle[0] - half[0],
            middle[0] + half[0],
            middle[1] - half[1],
            middle[1] + half[1],
        )
        first = float(middle[2] - 0.5 * (count - 1) * step)
        return cls(
            geometry,
            axis,
            True,
            "zyx"[plane],
            frame,
            np.zeros(3),
            extent,
            (pitch, pitch),
            first,
            step,
            count,
        )

    # -- places -------------------------------------------------------------------------------------------

    @cached_property
    def _to_place(self) -> tuple[Floats, Floats]:
        """Matrix and offset from an index (z, y, x) to a place."""
        ends = self.geometry.index_to_world(np.vstack([np.zeros((1, 3)), np.eye(3)])) - self.origin
        places = np.linalg.solve(self.frame, ends.T).T
        return places[1:].T - places[0][:, None], places[0]

    @cached_property
    def _to_index(self) -> Floats:
        return np.asarray(np.linalg.inv(self._to_place[0]))

    def to_place(self, index: ArrayLike) -> Floats:
        """Places (right, up, across), mm, of indices (z, y, x) of the image, (..., 3)."""
        matrix, offset = self._to_place
        return np.asarray(np.asarray(index, float) @ matrix.T + offset)

    def to_index(self, place: ArrayLike) -> Floats:
        """Indices (z, y, x) of the image of places (right, up, across), mm, (..., 3); not clipped to the image."""
        return np.asarray((np.asarray(place, float) - self._to_place[1]) @ self._to_index.T)

    def across(self, number: float) -> float:
        """Coordinate across, mm, of a slice."""
        return self.first + number * self.step

    def place_number(self, index: ArrayLike) -> Floats:
        """Number of the slice, with its fraction, of indices (z, y, x) of the image, (..., 3)."""
        return np.round((self.to_place(index)[..., 2] - self.first) / self.step, 6)

    def nearest_number(self, index: ArrayLike) -> int:
        """Number of the slice that is nearest to an index (z, y, x) of the image."""
        return int(np.clip(round(float(self.place_number(index))), 0, self.count - 1))

    def contains(self, index: Floats) -> bool:
        """Test if an index (z, y, x) lies in a voxel of the image."""
        return bool(
            (
                (index >= -0.5 - ROUNDING)
                & (index <= np.array(self.geometry.shape) - 0.5 + ROUNDING)
            ).all()
        )

    def go_to(self, index: Floats, number: int) -> Floats:
        """Move an index (z, y, x) across, to a slice; beside the image there, to where the image begins."""
        across = self.across(min(max(number, 0), self.count - 1))
        start = self.to_index([*self.to_place(index)[:2], across])
        last = np.array(self.geometry.shape) - 1.0
        if ((start >= -ROUNDING) & (start <= last + ROUNDING)).all():
            return np.clip(start, 0.0, last)
        outline = self.outline(across, np.full(3, 0.5), last - 0.5)
        end = self.to_index(
            [*(outline.mean(axis=0) if len(outline) else self.to_place(0.5 * last)[:2]), across]
        )
        way = end - start
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(
                start < 0, -start / way, np.where(start > last, (last - start) / way, 0.0)
            )
        return np.clip(
            start + float(np.clip(np.nan_to_num(shares), 0.0, 1.0).max()) * way, 0.0, last
        )

    def cuts(self, number: int, low: ArrayLike, high: ArrayLike) -> bool:
        """Test if a slice cuts the box of the voxels ``low`` to ``high``, (z, y, x)."""
        away = self._corners(low, high)[:, 2] - self.across(number)
        return bool(away.min() < 0 < away.max())

    def _corners(self, low: ArrayLike, high: ArrayLike) -> Floats:
        """Places (8, 3) of the corners of a box, at the outer faces of its first and last voxel."""
        ends = np.stack([np.asarray(low, float) - 0.5, np.asarray(high, float) + 0.5])
        return self.to_place(ends[_BITS, np.arange(3)])

    def outline(self, across: float, low: ArrayLike, high: ArrayLike) -> Floats:
        """Corners (n, 2), mm, of the section of a box by a plane, around; none beside it.

        Parameters
        ----------
        across : float
            Of the plane, mm.
        low, high : (z, y, x)
            First and last voxel of the box, which ends at their outer faces.
        """
        corners = self._corners(low, high)
        away = corners[:, 2] - across
        cuts = [corners[np.abs(away) <= ROUNDING * abs(self.step)]]
        for a, b in _EDGES:
            if away[a] * away[b] < 0:
                share = away[a] / (away[a] - away[b])
                cuts.append((corners[a] + share * (corners[b] - corners[a]))[None])
        found = np.unique(np.round(np.concatenate(cuts)[:, :2], 9), axis=0)
        around = found - found.mean(axis=0) if len(found) else found
        return np.asarray(found[np.argsort(np.arctan2(around[:, 1], around[:, 0]))])

    # -- pixels -------------------------------------------------------------------------------------------

    @property
    def fine(self) -> int:
        """Pixels along a voxel where each is to be told from the next."""
        return FINE if self.is_straight else 1

    def size(self, fine: int = 1) -> tuple[int, int]:
        """Rows and columns of a picture with ``fine`` pixels along the pitch."""
        left, right, bottom, top = self.extent
        return round((top - bottom) / self.pitch[1]) * fine, round(
            (right - left) / self.pitch[0]
        ) * fine

    def patch(self, number: int, low: ArrayLike = (), high: ArrayLike = (), fine: int = 1) -> Patch:
        """Pixels of a slice within the box of the voxels ``low`` to ``high``, (z, y, x); all of them unless given."""
        left, _, bottom, _ = self.extent
        right, up = (pitch / fine for pitch in self.pitch)
        rows, columns = self.size(fine)
        ends = np.array([[0, 0], [columns, rows]])
        if np.size(low):
            places = self._corners(low, high)[:, :2]
            within = (np.stack([places.min(axis=0), places.max(axis=0)]) - [left, bottom]) / [
                right,
                up,
            ]
            first, last = np.floor(within[0] + ROUNDING), np.ceil(within[1] - ROUNDING)
            ends = np.clip(np.stack([first, last]).astype(int), 0, [columns, rows])
        across = slice(int(ends[0, 0]), max(int(ends[1, 0]), int(ends[0, 0])))
        down = slice(int(ends[0, 1]), max(int(ends[1, 1]), int(ends[0, 1])))
        x = left + right * (np.arange(across.start, across.stop) + 0.5)
        y = bottom + up * (np.arange(down.start, down.stop) + 0.5)
        start, matrix = self.to_index([0.0, 0.0, self.across(number)]), self._to_index
        z, row, column = (
            start[axis] + matrix[axis, 1] * y[:, None] + matrix[axis, 0] * x[None, :]
            for axis in range(3)
        )
        return Patch(down, across, (z, row, column))

    def values(self, array: NDArray[Any], number: int, smooth: bool = True) -> NDArray[Any]:
        """Values of an array of the image at the pixels of a slice, (rows, columns), its first row lowest.

        Parameters
        ----------
        array : ndarray (nz, ny, nx)
        number : int
        smooth : bool, optional
            Linear between voxels where the pixels are not voxels; else of the nearest voxel, at `FINE` pixels.
        """
        if not self.is_straight:
            return self.hung(array.take(number, axis=self.axis))
        if smooth:
            return linear(array, self.patch(number).places)
        places = self.patch(number, fine=FINE).places
        nearest = tuple(
            np.clip(place + 0.5, 0.0, n - 0.5).astype(np.intp)
            for place, n in zip(places, array.shape, strict=True)
        )
        return np.asarray(array[nearest])

    def hung(self, plane: NDArray[Any]) -> NDArray[Any]:
        """A plane of the array across `axis` as the picture of a slice along voxels, its first row lowest."""
        rows = int(np.argmax(np.abs(self._to_index[:, 1])))
        columns = 3 - rows - self.axis
        turned = plane if rows < columns else plane.T
        return turned[
            :: 1 if self._to_index[rows, 1] > 0 else -1,
            :: 1 if self._to_index[columns, 0] > 0 else -1,
        ]


def linear(
    array: NDArray[Any], index: Sequence[Floats], largest: float | None = None
) -> NDArray[np.float32]:
    """Values between voxels, linear along each axis; beyond the array the border's values.

    Parameters
    ----------
    array : ndarray (nz, ny, nx)
    index : sequence of ndarray
        z, y, x of each place.
    largest : float, optional
        Values above are as this one; for arrays with inf.

    Examples
    --------
    >>> linear(np.arange(8.0).reshape(2, 2, 2), (np.array([0.5]), np.array([0.0]), np.array([0.25])))
    array([2.25], dtype=float32)
    """
    shape = np.broadcast_shapes(*(place.shape for place in index))
    low, shares = np.zeros(shape, np.intp), []
    steps = [0, 0, 0]
    for axis, n in enumerate(array.shape):
        stride = int(np.prod(array.shape[axis + 1 :], dtype=np.int64))
        place = np.clip(index[axis], 0.0, n - 1.0)
        whole = np.minimum(place.astype(np.intp), max(n - 2, 0))
        low = low + whole * stride
        shares.append((place - whole).astype(np.float32))
        steps[axis] = stride if n > 1 else 0
    flat = array.reshape(-1)

    def between(axis: int, corner: int) -> NDArray[np.float32]:
        """Along the axes from ``axis`` on, from a corner of the cell."""
        if axis == 3:
            values = flat.take(low + corner).astype(np.float32)
            return values if largest is None else np.minimum(values, np.float32(largest))
        low_end, high_end = between(axis + 1, corner), between(axis + 1, corner + steps[axis])
        return np.asarray(low_end + shares[axis] * (high_end - low_end))

    return between(0, 0)
