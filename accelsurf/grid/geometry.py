"""Shape, spacing, origin, direction of a grid, and the only code that goes between voxel index and world.

Indices are (z, y, x), as arrays; world coordinates are (x, y, z) in mm, LPS, as in ITK. With the direction matrix
D (columns: world directions of the x, y, z index axes), spacing s and origin o:

    world = o + D diag(s_x, s_y, s_z) (x, y, z)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from accelsurf.errors import GeometryError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import Box, slabs

ORTHONORMAL_TOLERANCE = 1e-4
"""Largest accepted entry of |D^T D - 1|: float32 headers stay below 1e-6, a shear of 0.01 degree does not."""

SPACING_RANGE = (1e-9, 1e9)
MAX_ORIGIN = 1e12
"""mm: beyond these, volumes and squares of lengths leave the numbers that the solver has."""


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """Geometry of a grid of voxels in the world.

    Parameters
    ----------
    shape : tuple of int
        (nz, ny, nx), each at least 1.
    spacing : tuple of float
        (hz, hy, hx) in mm, array order, each positive.
    origin : tuple of float, optional
        World position (x, y, z), mm LPS, of the centre of voxel (0, 0, 0).
    direction : array_like, shape (3, 3), optional
        Columns are the world directions of the x, y, z index axes (ITK's ``GetDirection`` reshaped to 3x3).
        Orthonormal to 1e-4; left-handed is allowed.
    unit : {"mm", "um", "nm"}, optional
        In which people read its lengths: that of the file, or as given. All numbers here are mm.
    zero : tuple of float, optional
        World position (x, y, z), mm, from which scales along its axes count, where it is a part of an oblique grid;
        see `accelsurf.grid.orientation`.

    Raises
    ------
    GeometryError
        When one of these does not hold.

    Examples
    --------
    >>> grid = Geometry((5, 4, 3), (2.0, 1.0, 0.5), origin=(10.0, 20.0, 30.0))
    >>> grid.index_to_world((4, 3, 2))
    array([11., 23., 38.])
    >>> grid.world_to_index((11.0, 23.0, 38.0))
    array([4., 3., 2.])
    >>> grid.size, grid.spacing_xyz, grid.voxel_volume
    ((3, 4, 5), (0.5, 1.0, 2.0), 1.0)
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: Floats = field(default_factory=lambda: np.eye(3))
    unit: str = "mm"
    zero: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        shape = _three(self.shape, "shape (nz, ny, nx)")
        if any(n != int(n) or n < 1 for n in shape):
            raise GeometryError(
                f"shape {_short(shape)} given, three whole numbers from 1 on expected",
                "give z, y, x",
            )
        spacing = _three(self.spacing, "spacing (hz, hy, hx)")
        if any(h <= 0.0 for h in spacing):
            raise GeometryError(
                f"spacing (hz, hy, hx) = {_short(spacing)} mm given, three positive numbers expected",
                hint="correct the voxel size in the header, or give the array with spacing=, in the order of its axes",
            )
        low, high = SPACING_RANGE
        if not low <= min(spacing) <= max(spacing) <= high:
            raise GeometryError(
                f"spacing (hz, hy, hx) = {_short(spacing)} mm given, {low:g} to {high:g} mm expected",
                hint="correct the voxel size in the header; is the unit right?",
            )
        origin = _three(self.origin, "origin (x, y, z)")
        if max(map(abs, origin)) > MAX_ORIGIN:
            raise GeometryError(
                f"origin (x, y, z) = {_short(origin)} mm given, at most {MAX_ORIGIN:g} mm from 0 expected",
                hint="correct the position in the header",
            )
        # Frozen outside, normalised once inside: whatever sequence came in, plain tuples and a locked matrix stay.
        object.__setattr__(self, "shape", tuple(int(n) for n in shape))
        object.__setattr__(self, "spacing", spacing)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "direction", _checked_direction(self.direction))

    def __eq__(self, other: object) -> bool:
        """Test if all numbers are the same; `matches` allows the rounding of file formats."""
        if not isinstance(other, Geometry):
            return NotImplemented
        return self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[tuple[float, ...], ...]:
        return self.shape, self.spacing, self.origin, tuple(self.direction.ravel().tolist())

    def __repr__(self) -> str:
        direction = ""
        if not np.array_equal(self.direction, np.eye(3)):
            direction = f", direction={self.direction.round(6).tolist()}"
        return (
            f"Geometry(shape={self.shape}, spacing={self.spacing}, origin={self.origin}{direction})"
        )

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels along (x, y, z), as ITK's ``GetSize``."""
        return self.shape[2], self.shape[1], self.shape[0]

    @property
    def spacing_xyz(self) -> tuple[float, float, float]:
        """Voxel size along (x, y, z) in mm, as ITK's ``GetSpacing``."""
        return self.spacing[2], self.spacing[1], self.spacing[0]

    @property
    def slice_axis(self) -> int | None:
        """Array axis along which a 2D image has its one voxel; None for a volume, or a line of voxels."""
        flat = [axis for axis, n in enumerate(self.shape) if n == 1]
        return flat[0] if len(flat) == 1 else None

    @property
    def steps(self) -> tuple[float, ...]:
        """Spacing along the axes with more than one voxel, mm; see `axis_steps`."""
        return axis_steps(self.shape, self.spacing)

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel, mm3."""
        return self.spacing[0] * self.spacing[1] * self.spacing[2]

    @property
    def extent_mm(self) -> tuple[float, float, float]:
        """Edge lengths of the box along (z, y, x), mm, between the outer faces of the border voxels."""
        nz, ny, nx = self.shape
        hz, hy, hx = self.spacing
        return nz * hz, ny * hy, nx * hx

    @cached_property
    def _index_matrix(self) -> Floats:
        """D diag(s): an (x, y, z) index step to a world step in mm."""
        return np.asarray(self.direction * np.asarray(self.spacing_xyz), dtype=np.float64)

    @cached_property
    def _world_matrix(self) -> Floats:
        # The true inverse, not diag(1/s) D^T: D is orthonormal only to the tolerance, and the way back must be exact.
        return np.asarray(np.linalg.inv(self._index_matrix), dtype=np.float64)

    def index_to_world(self, zyx: ArrayLike) -> Floats:
        """World position of (continuous) voxel indices.

        Parameters
        ----------
        zyx : array_like, shape (..., 3)
            Indices in array order; whole numbers are voxel centres.

        Returns
        -------
        ndarray, shape (..., 3), float64
            (x, y, z) in mm, LPS.
        """
        xyz = _points(zyx)[..., ::-1]
        return np.asarray(xyz @ self._index_matrix.T + np.asarray(self.origin), dtype=np.float64)

    def world_to_index(self, xyz: ArrayLike) -> Floats:
        """Continuous voxel index of world positions; the inverse of `index_to_world`.

        Parameters
        ----------
        xyz : array_like, shape (..., 3)
            World positions in mm, LPS.

        Returns
        -------
        ndarray, shape (..., 3), float64
            Indices in array order (z, y, x), not clipped to the grid.
        """
        offset = _points(xyz) - np.asarray(self.origin)
        return np.ascontiguousarray((offset @ self._world_matrix.T)[..., ::-1])

    def center_world(self) -> Floats:
        """World position (x, y, z), mm, of the middle of the grid."""
        return self.index_to_world([(n - 1) / 2 for n in self.shape])

    def corners_world(self) -> Floats:
        """Centres of the eight corner voxels, (8, 3), mm; the order is that of the index axes z, y, x."""
        return self.index_to_world(list(product(*((0, n - 1) for n in self.shape))))

    def matches(self, other: Geometry, tolerance_mm: float | None = None) -> bool:
        """Test if two grids have the same shape and lie at the same place.

        Comparing positions, not header entries, accepts the rounding of file formats: the distance between
        corresponding voxels counts.

        Parameters
        ----------
        other : Geometry
            The grid to compare with.
        tolerance_mm : float, optional
            Largest accepted distance between corresponding corners; a thousandth of the smallest spacing by default.
        """
        if self.shape != other.shape:
            return False
        tolerance = (
            1e-3 * min(*self.spacing, *other.spacing) if tolerance_mm is None else tolerance_mm
        )
        return self._corner_distance(other) <= tolerance and self._axes_agree(other, tolerance)

    def difference(self, other: Geometry) -> str:
        """One line with the differences between two grids; empty when there are none.

        Examples
        --------
        >>> a = Geometry((5, 4, 3), (1.0, 1.0, 1.0))
        >>> a.difference(Geometry((5, 4, 3), (2.0, 1.0, 1.0)))
        'spacing (z,y,x) (1, 1, 1) against (2, 1, 1) mm; corners up to 4 mm apart'
        >>> a.difference(a)
        ''
        """
        if self.shape != other.shape:
            return f"size (x,y,z) {_short(self.size)} against {_short(other.size)}"
        if self.matches(other):
            return ""
        parts = []
        if not np.allclose(self.spacing, other.spacing, rtol=1e-5, atol=0.0):
            parts.append(
                f"spacing (z,y,x) {_short(self.spacing)} against {_short(other.spacing)} mm"
            )
        if not np.allclose(self.origin, other.origin, rtol=0.0, atol=1e-3 * min(self.spacing)):
            parts.append(f"origin (x,y,z) {_short(self.origin)} against {_short(other.origin)} mm")
        angle = _angle_degrees(self.direction, other.direction)
        if angle > 1e-3:
            parts.append(f"direction by {angle:.3g} degrees")
        parts.append(f"corners up to {self._corner_distance(other):.4g} mm apart")
        return "; ".join(parts)

    def _corner_distance(self, other: Geometry) -> float:
        return float(np.linalg.norm(self.corners_world() - other.corners_world(), axis=1).max())

    def _axes_agree(self, other: Geometry, tolerance: float) -> bool:
        # Along an axis of one voxel the corners say nothing about spacing or direction: compare one step as well.
        return (
            float(np.linalg.norm(self._index_matrix - other._index_matrix, axis=0).max())
            <= tolerance
        )


def axis_steps(shape: Sequence[int], spacing: Sequence[float]) -> tuple[float, ...]:
    """Return the spacings along the axes with more than one voxel, mm; of a single voxel, all three.

    Nothing happens along an axis of one voxel: its spacing is a thickness, not a step.

    Examples
    --------
    >>> axis_steps((1, 20, 30), (5.0, 1.0, 0.5))
    (1.0, 0.5)
    """
    every = tuple(float(h) for h in spacing)
    return tuple(h for n, h in zip(shape, every, strict=True) if n > 1) or every


def orthonormal_deviation(matrix: ArrayLike) -> float:
    """Largest entry of |M^T M - 1|: 0 for orthonormal columns.

    Examples
    --------
    >>> orthonormal_deviation([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    0.0
    """
    m = np.asarray(matrix, dtype=np.float64)
    return float(np.abs(m.T @ m - np.eye(m.shape[1])).max())


def _checked_direction(direction: Any) -> Floats:
    try:
        matrix = np.array(direction, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise GeometryError(
            "the direction matrix given is not one, 3 x 3 finite numbers expected",
            hint="correct it in the header",
        )
    deviation = orthonormal_deviation(np.clip(matrix, -1e6, 1e6))
    if deviation > ORTHONORMAL_TOLERANCE:
        raise GeometryError(
            f"the direction matrix is not orthonormal: it is off by {deviation:.3g}, at most "
            f"{ORTHONORMAL_TOLERANCE:g} expected (sheared or scaled axes)",
            hint="resample the image to a grid with perpendicular axes first",
        )
    matrix.setflags(write=False)
    return matrix


def _three(values: Any, name: str) -> tuple[float, float, float]:
    try:
        numbers = tuple(float(v) for v in values)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise GeometryError(
            f"{name} = {values!r} given, three finite numbers expected", hint="correct the header"
        )
    return numbers[0], numbers[1], numbers[2]


def _points(values: ArrayLike) -> Floats:
    points = np.asarray(values, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise GeometryError(f"points of shape {points.shape} given, (..., 3) expected")
    return points


def _short(values: tuple[float, ...] | tuple[int, ...]) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"


def _angle_degrees(a: Floats, b: Floats) -> float:
    """Largest angle between corresponding axes; by arctan2, since arccos loses angles below 1e-6."""
    sines = np.linalg.norm(np.cross(a, b, axis=0), axis=0)
    return float(np.degrees(np.arctan2(sines, np.sum(a * b, axis=0))).max())


def ball_distance(
    box: Box,
    spacing: Sequence[float],
    centre: Sequence[float] | NDArray[np.float64],
    radius: float,
    precision: DTypeLike = np.float64,
) -> NDArray[np.float32]:
    """Signed distance from a ball at the voxel centres of a box, mm, negative inside.

    Parameters
    ----------
    box : (slice, slice, slice)
        Voxels of the grid.
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    centre : sequence of 3 floats or ndarray (3,)
        Voxel index (z, y, x) of the ball's centre.
    radius : float
        mm.
    precision : dtype, optional
        Of the sum of the three squares and its root; float32 takes half the time, which counts on whole volumes.

    Returns
    -------
    ndarray, shape of the box, float32

    Examples
    --------
    >>> ball_distance((slice(0, 1), slice(0, 1), slice(2, 5)), (1.0, 1.0, 2.0), (0, 0, 3), 1.5)
    array([[[ 0.5, -1.5,  0.5]]], dtype=float32)
    """
    axes = (np.arange(s.start, s.stop, dtype=np.float64) for s in box)
    z, y, x = (((axis - c) * h) ** 2 for axis, c, h in zip(axes, centre, spacing, strict=True))
    z = z.astype(precision)[:, None, None]
    y = y.astype(precision)[:, None]
    x = x.astype(precision)
    out = np.empty((z.size, y.size, x.size), np.float32)
    for planes in slabs(out.shape):
        distance = z[planes] + y + x
        np.sqrt(distance, out=distance)
        distance -= distance.dtype.type(radius)
        out[planes] = distance
    return out


def farthest(psi: NDArray[np.float32]) -> float:
    """Largest finite |psi|, mm, of psi (nz, ny, nx); 0 where none is. Plane by plane: all at once takes two copies.

    Examples
    --------
    >>> farthest(np.array([[[1.0]], [[-3.0]], [[np.inf]]], np.float32))
    3.0
    """
    most = 0.0
    for plane in map(np.abs, psi):
        most = max(most, float(np.max(plane, where=np.isfinite(plane), initial=0.0)))
    return most
