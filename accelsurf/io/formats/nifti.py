"""What a NIfTI-1 header says, read from its raw bytes.

ITK repairs, guesses and forgets: it reads a file without voxels as zeros, takes a negative pixdim as a mirrored axis,
falls back on the qform when the sform is sheared, and writes both codes as 1. So the header is looked at here first,
and the fields that place the grid are put back after writing.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import ORTHONORMAL_TOLERANCE, Floats, Geometry, orthonormal_deviation

HEADER_BYTES = 348
FIRST_BYTES = {struct.pack("<i", HEADER_BYTES): "<", struct.pack(">i", HEADER_BYTES): ">"}
"""How a NIfTI-1 file begins (with the header's size), and the byte order that tells."""

METADATA_KEY = "nifti_grid"
"""Where `Volume.metadata` keeps the fields that place the grid (hexadecimal, as `grid_fields` gives them)."""

_ITEM_BYTES = {2: 1, 4: 2, 8: 4, 16: 4, 64: 8, 256: 1, 512: 2, 768: 4, 1024: 8, 1280: 8}
_NOT_REAL = {32: "complex", 1792: "complex", 2048: "complex", 128: "colour (RGB)", 2304: "colour (RGBA)"}
_MM_PER_UNIT = {1: 1000.0, 3: 0.001}  # metre, micrometre; 2 is mm, and 0 (unknown) is taken as mm by everyone
_GRID = struct.Struct("<4fB2h18f")
# (offset in the header, length) of the pieces that _GRID packs one after the other
_GRID_PLACES = ((76, 16), (123, 1), (252, 76))
_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class NiftiHeader:
    """The fields of a NIfTI-1 header that decide where its voxels are, in the file and in the world.

    Attributes
    ----------
    size : tuple of int
        Voxels along each axis, as many as ``dim[0]`` says, trailing ones dropped down to three.
    datatype : int
        NIfTI type code.
    data_offset : int
        Bytes before the first voxel.
    pixdim : tuple of float
        qfac and the three voxel sizes, in the header's unit.
    units : int
        The byte ``xyzt_units``.
    qform_code, sform_code : int
        Which of the two transforms are set, and what world each refers to.
    qform : tuple of float
        Quaternion b, c, d and offset x, y, z.
    sform : tuple of float
        The three rows of the affine, 12 numbers.
    """

    size: tuple[int, ...]
    datatype: int
    data_offset: int
    pixdim: tuple[float, float, float, float]
    units: int
    qform_code: int
    sform_code: int
    qform: tuple[float, ...]
    sform: tuple[float, ...]

    @property
    def claimed_bytes(self) -> int:
        """Bytes from the start of the file to the end of the voxels, as the header would have it."""
        return self.data_offset + math.prod(self.size) * _ITEM_BYTES[self.datatype]

    @property
    def grid_fields(self) -> str:
        """The fields that place the grid as hexadecimal text, for `Volume.metadata`."""
        codes = (self.qform_code, self.sform_code)
        return _GRID.pack(*self.pixdim, self.units, *codes, *self.qform, *self.sform).hex()

    def qform_geometry(self) -> Geometry:
        """The grid that quaternion, offset and pixdim describe."""
        b, c, d = self.qform[:3]
        a = math.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
        a, b, c, d = np.array([a, b, c, d]) / math.sqrt(a * a + b * b + c * c + d * d)
        rotation = np.array(
            [
                [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
            ]
        )
        if self.pixdim[0] < 0:  # qfac: the z axis is mirrored
            rotation[:, 2] *= -1
        return self._geometry(rotation, np.array(self.pixdim[1:]), np.array(self.qform[3:]))

    def sform_geometry(self) -> Geometry:
        """The grid that the affine describes; GeometryError when it is no grid."""
        matrix, spacing = self._sform_parts()
        return self._geometry(matrix / spacing, spacing, np.array(self.sform).reshape(3, 4)[:, 3])

    def sform_deviation(self) -> float:
        """How far the axes of the affine are from perpendicular: the largest cosine between two of them."""
        matrix, spacing = self._sform_parts()
        return orthonormal_deviation(matrix / spacing)

    def _sform_parts(self) -> tuple[Floats, Floats]:
        matrix = np.array(self.sform, dtype=np.float64).reshape(3, 4)[:, :3]
        spacing = np.linalg.norm(matrix, axis=0)
        if not np.isfinite(matrix).all() or not (spacing > 0).all():
            raise GeometryError(f"the sform of the header is no transform: {np.array(self.sform).tolist()}")
        return matrix, spacing

    def _geometry(self, direction: Floats, spacing: Floats, offset: Floats) -> Geometry:
        unit = _MM_PER_UNIT.get(self.units & 7, 1.0)
        x, y, z = (float(v) for v in _RAS_TO_LPS @ offset * unit)
        hx, hy, hz = (float(h) * unit for h in spacing)
        return Geometry(self.size[2::-1], (hz, hy, hx), (x, y, z), _RAS_TO_LPS @ direction)  # type: ignore[arg-type]


def parse(raw: bytes) -> NiftiHeader:
    """Read a header, in either byte order, and refuse one that no 3D image of real numbers can have.

    Raises
    ------
    InputError
        When it is not a NIfTI-1 header, is cut off, or announces another sort of image.
    GeometryError
        When a voxel size is zero, negative or not finite.
    """
    if raw[:4] in (struct.pack("<i", 540), struct.pack(">i", 540)):
        raise InputError("a NIfTI-2 file, NIfTI-1 expected", hint="convert it to NIfTI-1, NRRD or MHA")
    if len(raw) < HEADER_BYTES:
        raise InputError(
            f"the file has only {len(raw)} bytes, a NIfTI header alone has {HEADER_BYTES}",
            hint="the file is truncated or is not an image: copy or export it again",
        )
    order = FIRST_BYTES.get(raw[:4])
    if order is None or raw[344:348] != b"n+1\0":
        raise InputError("this is not a NIfTI image: its header lacks the NIfTI marks", hint="is it the right file?")

    def fields(code: str, offset: int) -> tuple[float, ...]:
        return struct.unpack_from(order + code, raw, offset)

    dim = tuple(int(n) for n in fields("8h", 40))
    datatype, vox_offset = int(fields("h", 70)[0]), fields("f", 108)[0]
    if not 1 <= dim[0] <= 7 or any(n < 1 for n in dim[1 : dim[0] + 1]) or not 0 <= vox_offset < 2**31:
        raise InputError(f"the NIfTI header is damaged: dim = {dim}", hint="copy or export the file again")
    size = _check_sort(dim[1 : dim[0] + 1], datatype)
    pixdim = fields("4f", 76)
    if not all(math.isfinite(h) and h > 0 for h in pixdim[1:]):
        raise GeometryError(
            f"the header gives spacing (x,y,z) = ({', '.join(f'{h:g}' for h in pixdim[1:])}), "
            "three positive numbers expected",
            hint="correct pixdim[1..3] in the header",
        )
    q_code, s_code = (int(v) for v in fields("2h", 252))
    # Zero is what some writers leave in vox_offset; the voxels of a single file cannot start before 352.
    offset = max(int(vox_offset), HEADER_BYTES + 4)
    qform, sform = fields("6f", 256), fields("12f", 280)
    p0, p1, p2, p3 = pixdim
    return NiftiHeader(size, datatype, offset, (p0, p1, p2, p3), raw[123], q_code, s_code, qform, sform)


def _check_sort(size: tuple[int, ...], datatype: int) -> tuple[int, ...]:
    """Refuse by name what is not a 3D image of real numbers."""
    while len(size) > 3 and size[-1] == 1:
        size = size[:-1]
    text = " x ".join(map(str, size))
    if len(size) < 3:
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected",
            hint="add a slice axis of size 1, or use Volume.from_array in Python",
        )
    if len(size) > 4:
        raise InputError(
            f"a vector image ({text}: {size[4]} components per voxel) given, one number per voxel expected",
            hint="extract one channel, or the magnitude, first",
        )
    if len(size) == 4:
        raise InputError(
            f"a 4D image ({text}: {size[3]} volumes) given, 3D expected", hint="extract one time point or channel first"
        )
    if datatype in _NOT_REAL:
        raise InputError(
            f"a {_NOT_REAL[datatype]} image given, one real number per voxel expected",
            hint="extract one channel or the magnitude first",
        )
    if datatype not in _ITEM_BYTES:
        raise InputError(f"NIfTI type code {datatype} is not supported", hint="convert the image to float32 first")
    return size


def check_affines(header: NiftiHeader) -> None:
    """Refuse a sheared affine where the affine is what counts.

    With a qform of another kind beside it (a scanner qform and an atlas sform), the qform places the image and the
    sform is only carried along.

    Raises
    ------
    GeometryError
        With the size of the deviation.
    """
    if not _sform_counts(header):
        return
    deviation = header.sform_deviation()
    if deviation > ORTHONORMAL_TOLERANCE:
        raise GeometryError(
            f"the axes of the NIfTI sform are not perpendicular: off by {deviation:.3g} "
            f"({math.degrees(math.asin(min(1.0, deviation))):.3g} degrees), at most {ORTHONORMAL_TOLERANCE:g} expected",
            hint="resample the image to a grid with perpendicular axes (it carries a shear, e.g. from an affine "
            "registration or a tilted gantry)",
        )


def check_agreement(header: NiftiHeader, geometry: Geometry) -> str:
    """Compare the grid that was read with the header's own two statements.

    Parameters
    ----------
    header : NiftiHeader
        The raw header.
    geometry : Geometry
        The grid that ITK made of it.

    Returns
    -------
    str
        A warning when qform and sform place the image differently; empty otherwise.

    Raises
    ------
    GeometryError
        When neither the qform nor the sform describes the grid that was read, e.g. when pixdim and the lengths of
        the sform's axes disagree, so that no one can say how large a voxel is.
    """
    sform = header.sform_geometry() if _has_sform_grid(header) else None
    qform = header.qform_geometry() if header.qform_code > 0 else None
    said = [g for g in (sform, qform) if g is not None]
    denied = said and not any(_near(g, geometry) for g in said)
    # Voxel sizes alone as well: ITK measures by pixdim, and by the qform beside it, where others measure by the sform.
    if sform and _sform_counts(header):
        denied = denied or not np.allclose(sform.spacing, geometry.spacing, rtol=1e-3, atol=0)
    if denied:
        raise GeometryError(
            f"the NIfTI header contradicts itself: {said[0].difference(geometry)} "
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


def put_grid(path: Path, grid_fields: str) -> None:
    """Overwrite, in an uncompressed little-endian file, the header fields that place the grid."""
    packed = bytes.fromhex(grid_fields)
    with path.open("r+b") as file:
        for offset, length in _GRID_PLACES:
            file.seek(offset)
            file.write(packed[:length])
            packed = packed[length:]


def _sform_counts(header: NiftiHeader) -> bool:
    if header.sform_code <= 0:
        return False
    return header.qform_code <= 0 or header.sform_code in (1, header.qform_code)


def _has_sform_grid(header: NiftiHeader) -> bool:
    return header.sform_code > 0 and header.sform_deviation() <= ORTHONORMAL_TOLERANCE


def _near(a: Geometry, b: Geometry) -> bool:
    # Half a voxel at the far corner: float32 quaternions near half a turn, and rounded pixdims, are that bad;
    # contradictions that matter are far larger.
    return a.matches(b, 0.5 * min(*a.spacing, *b.spacing))
