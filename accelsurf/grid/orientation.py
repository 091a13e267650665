"""Reorientation of arrays to the nearest world axes, for display.

Slices then look as radiologists hang them: the patient's left at the right, front at the top (axial) or head at the top
(coronal, sagittal).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry

#: Vertical and horizontal axis of a slice across z, y, x.
IN_PLANE = ((1, 2), (0, 2), (0, 1))
#: Names of the slices across z, y, x of a patient.
PLANES = ("Axial", "Coronal", "Sagittal")
#: A grid is parallel to the world's axes with cosines above this, and where the scales of a picture then err by no more
#: than this part of a voxel at any corner: a place that is read off them is the voxel that was seen.
_PARALLEL = 1 - 1e-6
_OFF = 0.1
#: Low and high end of the world's x, y, z axes of a patient, in LPS.
LETTERS = (("R", "L"), ("A", "P"), ("I", "S"))


@dataclass(frozen=True, eq=False)
class DisplayOrientation:
    """Permutation and flips that bring the axes of an array to the nearest world axes, in the order (z, y, x).

    Attributes
    ----------
    order : (int, int, int)
        Array axis that becomes z, y, x.
    flips : (bool, bool, bool)
        Whether each new axis is reversed.
    spacing : (float, float, float)
        Voxel size along the new axes, mm.
    first : (float, float, float)
        Coordinate of the first voxel along the new axes, mm: the world's where the grid is parallel to it, else 0, or
        of a part of a larger grid its place in that.
    names : (str, str, str)
        Names of the new axes: z, y, x, with a prime where the grid is not parallel to the world axes.
    """

    order: tuple[int, int, int]
    flips: tuple[bool, bool, bool]
    spacing: tuple[float, float, float]
    first: tuple[float, float, float]
    names: tuple[str, str, str]

    @classmethod
    def of(cls, geometry: Geometry) -> DisplayOrientation:
        """Assign each world axis the nearest grid axis, each grid axis once, the closest pairs first."""
        direction = np.asarray(geometry.direction)
        cosines = np.abs(direction)
        nearest: dict[int, int] = {}  # world axis (x, y, z) -> grid axis (x, y, z)
        for flat in np.argsort(-cosines, axis=None, kind="stable"):
            world, axis = (int(i) for i in np.unravel_index(flat, (3, 3)))
            if world not in nearest and axis not in nearest.values():
                nearest[world] = axis
        order = tuple(2 - nearest[world] for world in (2, 1, 0))
        flips = tuple(bool(direction[world, nearest[world]] < 0) for world in (2, 1, 0))
        spacing = tuple(geometry.spacing[axis] for axis in order)
        parallel = geometry.zero is None and _is_parallel(geometry, nearest)
        ends = [geometry.shape[axis] - 1 if flips[order.index(axis)] else 0 for axis in range(3)]
        if parallel:
            first = tuple(geometry.index_to_world(ends)[::-1])
        elif geometry.zero is None:
            first = (0.0, 0.0, 0.0)
        else:
            away = np.subtract(ends, geometry.world_to_index(geometry.zero)).tolist()
            lengths = [away[axis] * geometry.spacing[axis] for axis in order]
            first = tuple(-mm if flip else mm for mm, flip in zip(lengths, flips, strict=True))
        names = ("z", "y", "x") if parallel else ("z'", "y'", "x'")
        return cls(order, flips, spacing, first, names)  # type: ignore[arg-type]

    @property
    def is_parallel(self) -> bool:
        """Test if the grid is parallel to the world axes."""
        return self.names == ("z", "y", "x")

    def reorient(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array with the new axes; a view."""
        permuted = array.transpose(self.order)
        return permuted[
            tuple(slice(None, None, -1) if flip else slice(None) for flip in self.flips)
        ]

    def coordinate(self, axis: int, index: float) -> float:
        """Coordinate, mm, of an index along a new axis."""
        return self.first[axis] + index * self.spacing[axis]


def _is_parallel(geometry: Geometry, nearest: dict[int, int]) -> bool:
    """Test if scales along the axes of a grid are the world's, by the grid axis of each world axis (x, y, z)."""
    direction, steps = np.asarray(geometry.direction), np.asarray(geometry.spacing_xyz)
    if any(abs(direction[world, axis]) <= _PARALLEL for world, axis in nearest.items()):
        return False
    lengths = (np.asarray(geometry.size) - 1) * steps
    for world, axis in nearest.items():
        off = np.abs(direction[world])
        off[axis] = 1.0 - off[axis]
        if off @ lengths > _OFF * steps[axis]:
            return False
    return True


def scales_of(geometry: Geometry, index: Sequence[float]) -> tuple[float, float, float]:
    """Return the place of a (continuous) index (z, y, x) on the scales of pictures, (x, y, z) in mm.

    Examples
    --------
    >>> scales_of(Geometry((4, 5, 6), (3.0, 2.0, 1.0), (10.0, 20.0, 30.0)), (1, 1, 1))
    (11.0, 22.0, 33.0)
    """
    up = DisplayOrientation.of(geometry)
    place = []
    for new, (axis, flip) in enumerate(zip(up.order, up.flips, strict=True)):
        shown = geometry.shape[axis] - 1 - index[axis] if flip else index[axis]
        place.append(float(up.coordinate(new, shown)))
    z, y, x = place
    return x, y, z


def index_of_scales(geometry: Geometry, xyz: Sequence[float]) -> tuple[float, float, float]:
    """Return the (continuous) index (z, y, x) of a place on the scales of pictures; the inverse of `scales_of`.

    Examples
    --------
    >>> index_of_scales(Geometry((4, 5, 6), (3.0, 2.0, 1.0), (10.0, 20.0, 30.0)), (11.0, 22.0, 33.0))
    (1.0, 1.0, 1.0)
    """
    up, index = DisplayOrientation.of(geometry), [0.0, 0.0, 0.0]
    for new, (axis, flip) in enumerate(zip(up.order, up.flips, strict=True)):
        at = (xyz[2 - new] - up.first[new]) / up.spacing[new]
        index[axis] = float(geometry.shape[axis] - 1 - at if flip else at)
    return index[0], index[1], index[2]


def part_of(
    geometry: Geometry,
    shape: tuple[int, int, int],
    origin: Sequence[float],
    spacing: Sequence[float] | None = None,
) -> Geometry:
    """Return a grid along the axes of another, with the scales of that.

    Parameters
    ----------
    geometry : Geometry
    shape : (nz, ny, nx)
    origin : (x, y, z)
        World position of its first voxel, mm.
    spacing : (hz, hy, hx), optional
        Of the other unless given, mm.
    """
    zero = geometry.zero
    if zero is None and not DisplayOrientation.of(geometry).is_parallel:
        x, y, z = geometry.index_to_world(index_of_scales(geometry, (0.0, 0.0, 0.0))).tolist()
        zero = (x, y, z)
    corner = (float(origin[0]), float(origin[1]), float(origin[2]))
    hz, hy, hx = spacing or geometry.spacing
    return Geometry(shape, (hz, hy, hx), corner, geometry.direction, geometry.unit, zero)
