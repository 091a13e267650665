"""Grids of NIfTI headers, which give two of them, qform and sform, in a unit of the file."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from accelsurf.errors import GeometryError
from accelsurf.grid.arrays import Floats
from accelsurf.grid.geometry import ORTHONORMAL_TOLERANCE, Geometry, orthonormal_deviation

_MM_PER_UNIT = {
    1: 1000.0,
    3: 0.001,
}  # metre, micrometre; 2 is mm, and 0 (unknown) is taken as mm by everyone
_GRID = struct.Struct("<4fB2h18f")
# (offset in the header of a NIfTI-1 file, length) of the pieces that _GRID packs one after the other
_GRID_PLACES = ((76, 16), (123, 1), (252, 76))
_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class NiftiGrid:
    """The fields of a NIfTI header that place the grid.

    Attributes
    ----------
    shape : tuple of int
        Voxels (nz, ny, nx).
    pixdim : tuple of float
        qfac and the three voxel sizes, in the header's unit.
    units : int
        The byte ``xyzt_units``.
    qform_code, sform_code : int
        Code of the world that each of the two transforms refers to; 0 where it is not set.
    qform : tuple of float
        Quaternion b, c, d and offset x, y, z.
    sform : tuple of float
        The three rows of the affine, 12 numbers.
    """

    shape: tuple[int, int, int]
    pixdim: tuple[float, float, float, float]
    units: int
    qform_code: int
    sform_code: int
    qform: tuple[float, ...]
    sform: tuple[float, ...]

    @property
    def fields(self) -> str:
        """The fields that place the grid as hexadecimal text, for `Volume.metadata`."""
        codes = (self.qform_code, self.sform_code)
        with np.errstate(over="ignore"):  # NIfTI-2 has doubles
            floats = (
                np.array([*self.pixdim, *self.qform, *self.sform], np.float64)
                .astype(np.float32)
                .tolist()
            )
        return _GRID.pack(*floats[:4], self.units, *codes, *floats[4:]).hex()

    def geometry(self) -> Geometry:
        """The grid by the rule of ITK: voxel sizes by pixdim, place by the sform where it counts or agrees, else qform.

        Where both agree the sform is the more precise: near half a turn a quaternion in single precision is not. With
        neither, the image starts at the world's origin, along its axes.
        """
        _, hx, hy, hz = (h * self._unit for h in self.pixdim)
        sform = self.sform_geometry() if self._has_sform_grid else None
        qform = self.qform_geometry() if self.qform_code > 0 else None
        if sform and (self.sform_code == 1 or qform is None or _near(sform, qform)):
            place = sform
        elif qform:
            place = qform
        else:
            return Geometry(self.shape, (hz, hy, hx))
        return Geometry(self.shape, (hz, hy, hx), place.origin, place.direction)

    def qform_geometry(self) -> Geometry:
        """The grid that quaternion, offset and pixdim describe."""
        from nibabel.quaternions import quat2mat

        b, c, d = self.qform[:3]
        rotation = quat2mat([math.sqrt(max(0.0, 1.0 - b * b - c * c - d * d)), b, c, d])
        if self.pixdim[0] < 0:  # qfac: the z axis is mirrored
            rotation[:, 2] *= -1
        return self._geometry(rotation, np.array(self.pixdim[1:]), np.array(self.qform[3:]))

    def sform_geometry(self) -> Geometry:
        """The grid that the affine describes; GeometryError when it is no grid."""
        matrix, spacing = self._sform_parts()
        return self._geometry(matrix / spacing, spacing, np.array(self.sform).reshape(3, 4)[:, 3])

    def sform_deviation(self) -> float:
        """Largest cosine between two axes of the affine: 0 where they are perpendicular."""
        matrix, spacing = self._sform_parts()
        return orthonormal_deviation(matrix / spacing)

    def _sform_parts(self) -> tuple[Floats, Floats]:
        matrix = np.array(self.sform, dtype=np.float64).reshape(3, 4)[:, :3]
        if not is_finite(self.sform) or not (spacing := np.linalg.norm(matrix, axis=0)).all():
            raise GeometryError(
                f"the sform of the header is no transform: {list(self.sform)}",
                hint="correct or clear the sform in the header",
            )
        return matrix, spacing

    @property
    def _unit(self) -> float:
        return _MM_PER_UNIT.get(self.units & 7, 1.0)

    def _geometry(self, direction: Floats, spacing: Floats, offset: Floats) -> Geometry:
        x, y, z = (float(v) for v in _RAS_TO_LPS @ offset * self._unit)
        hx, hy, hz = (float(h) * self._unit for h in spacing)
        return Geometry(self.shape, (hz, hy, hx), (x, y, z), _RAS_TO_LPS @ direction)

    def check_forms(self) -> None:
        """Refuse forms that are no transforms, and a sheared sform where the sform counts.

        With a qform of another kind beside it (a scanner qform and an atlas sform), the qform places the image and the
        sform is only given back on writing.

        Raises
        ------
        GeometryError
            With the numbers, or the size of the deviation.
        """
        if self.qform_code > 0 and not is_finite(self.qform):
            raise GeometryError(
                f"the qform of the header is no transform: {list(self.qform)}",
                hint="correct or clear the qform in the header",
            )
        deviation = self.sform_deviation() if self.sform_code > 0 else 0.0
        if self._sform_counts and deviation > ORTHONORMAL_TOLERANCE:
            raise GeometryError(
                f"the axes of the NIfTI sform are not perpendicular: off by {deviation:.3g} "
                f"({math.degrees(math.asin(min(1.0, deviation))):.3g} degrees), "
                f"at most {ORTHONORMAL_TOLERANCE:g} expected",
                hint="resample the image to a grid with perpendicular axes (it carries a shear, e.g. from an affine "
                "registration or a tilted gantry)",
            )

    def check_agreement(self, geometry: Geometry) -> str:
        """Compare the grid that was read with the two grids that the header states.

        Parameters
        ----------
        geometry : Geometry
            The grid that was made of it.

        Returns
        -------
        str
            A warning when qform and sform place the image differently; empty otherwise.

        Raises
        ------
        GeometryError
            When neither the qform nor the sform describes the grid that was read, e.g. when pixdim and the lengths of
            the sform's axes disagree, so that the size of a voxel is unknown.
        """
        sform = self.sform_geometry() if self._has_sform_grid else None
        qform = self.qform_geometry() if self.qform_code > 0 else None
        stated = [g for g in (sform, qform) if g is not None]
        contradicted = stated and not any(_near(g, geometry) for g in stated)
        # Voxel sizes alone as well: ITK measures by pixdim, and by the qform beside it, others by the sform.
        if sform and self._sform_counts:
            contradicted = contradicted or not np.allclose(
                sform.spacing, geometry.spacing, rtol=1e-3, atol=0
            )
        if contradicted:
            raise GeometryError(
                f"the NIfTI header contradicts itself: {stated[0].difference(geometry)} "
                f"({'sform' if sform else 'qform'} against pixdim)",
                hint="correct the header so that pixdim, qform and sform agree",
            )
        if sform is None or qform is None or _near(sform, qform):
            return ""
        used = "sform" if _near(sform, geometry) else "qform"
        return (
            f"NIfTI qform and sform place the image differently ({sform.difference(qform)}); "
            f"the {used} is used, as ITK does, and both are written back"
        )

    @property
    def _sform_counts(self) -> bool:
        if self.sform_code <= 0:
            return False
        return self.qform_code <= 0 or self.sform_code in (1, self.qform_code)

    @property
    def _has_sform_grid(self) -> bool:
        return self.sform_code > 0 and self.sform_deviation() <= ORTHONORMAL_TOLERANCE


def is_finite(values: Sequence[float]) -> bool:
    """Test if all are numbers of single precision, which NIfTI-1 has; NIfTI-2 has doubles, whose squares overflow."""
    return bool((np.abs(values) <= np.finfo(np.float32).max).all())


def put_grid(header: bytes, grid_fields: str) -> bytes:
    """Return a little-endian NIfTI-1 header with the fields that place the grid replaced."""
    placed, packed = bytearray(header), bytes.fromhex(grid_fields)
    for offset, length in _GRID_PLACES:
        placed[offset : offset + length] = packed[:length]
        packed = packed[length:]
    return bytes(placed)


def _near(a: Geometry, b: Geometry) -> bool:
    # Half a voxel at the far corner: float32 quaternions near half a turn, and rounded pixdims, are that bad;
    # contradictions that matter are far larger.
    return a.matches(b, 0.5 * min(*a.spacing, *b.spacing))
