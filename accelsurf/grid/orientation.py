"""Reorientation of arrays to the nearest world axes, for display.

Slices then look as radiologists hang them: the patient's left at the right, front at the top (axial) or head at the top
(coronal, sagittal).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry

#: Vertical and horizontal axis of a slice across z, y, x.
IN_PLANE = ((1, 2), (0, 2), (0, 1))
#: Names of the slices across z, y, x of a patient.
PLANES = ("Axial", "Coronal", "Sagittal")
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
        Coordinate of the first voxel along the new axes, mm: the world's where the grid is parallel to it, else 0.
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
        parallel = all(cosines[world, nearest[world]] > 1 - 1e-6 for world in range(3))
        ends = [geometry.shape[axis] - 1 if flips[order.index(axis)] else 0 for axis in range(3)]
        first = tuple(geometry.index_to_world(ends)[::-1]) if parallel else (0.0, 0.0, 0.0)
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
