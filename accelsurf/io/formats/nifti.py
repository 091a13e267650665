"""NIfTI-1 and NIfTI-2 files: their headers with the extensions, and their voxels.

ITK repairs, guesses and forgets: it reads a file without voxels as zeros, takes a negative pixdim as a mirrored axis,
falls back on the qform when the sform is sheared, and writes both codes as 1. So the header is read here first,
and the fields that place the grid are put back after writing. nibabel takes the header apart; its own checks, which
repair too, are not used. It is imported without pydicom, which takes longer to import than nibabel itself.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from accelsurf.errors import GeometryError, InputError
from accelsurf.io.channels import MAX_CHANNELS
from accelsurf.io.formats.deflate import GZIP_START, first_bytes
from accelsurf.io.formats.nifti_grid import NiftiGrid, is_finite
from accelsurf.io.formats.raw_header import Encoding, RawHeader
from accelsurf.io.headers import (
    FRAME_KEY,
    NIFTI_KEY,
    TIMES_KEY,
    UNIT_KEY,
    check_data_file,
    single_precision,
    split_name,
    with_warnings,
)
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions, check_readable

HEADER_BYTES = {1: 348, 2: 540}
"""Length of the header by the version of the format; a file begins with it."""
COMMENT_CODE = 6
"""The code of an extension of the header with a text."""
_BEGINNINGS = {
    struct.pack(order + "i", count): (version, order)
    for version, count in HEADER_BYTES.items()
    for order in "<>"
}
_MAGIC = {1: (344, b"n+1\0"), 2: (4, b"n+2\0\r\n\x1a\n")}
_PAIR_MAGIC = {1: (344, b"ni1\0"), 2: (4, b"ni2\0\r\n\x1a\n")}
#: Endings of the two files of a pair, each also packed.
_HEADER = ".hdr"
_VOXELS = ".img"
_PACKED = ".gz"
_QFORM = ("quatern_b", "quatern_c", "quatern_d", "qoffset_x", "qoffset_y", "qoffset_z")
#: Bytes before the voxels that are searched for times.
_MAX_EXTENSION = 1 << 24
_REAL = (
    2,
    4,
    8,
    16,
    64,
    256,
    512,
    768,
    1024,
    1280,
)  # type codes: integers of 1 to 8 bytes, floats of 4 and 8
#: Intents of components: matrices, vectors, colours.
_VECTORS = frozenset((1004, 1005, 1006, 1007, 2003, 2004))
#: Seconds of the units of time; the other units of the fourth axis are of spectra.
_SECONDS = {8: 1.0, 16: 1e-3, 24: 1e-6}
#: A slope this near to 1 is 1, rounded by who wrote it: two steps of single precision.
_SLOPE_ROUNDING = 3e-7
#: The code of a unit of length in a header.
_MICRON = 3
_NOT_REAL = {
    32: "complex",
    1792: "complex",
    2048: "complex",
    128: "colour (RGB)",
    2304: "colour (RGBA)",
}


def import_nibabel_for(path: Path) -> None:
    """Import nibabel for a NIfTI as if pydicom were not installed; nothing where either is loaded already.

    nibabel uses pydicom for data sets in DICOM that the header of a NIfTI may carry, which accelsurf does not look at.
    Where it is installed nibabel imports it at once, and with it requests and urllib3. A later import of pydicom
    finds it. For the program alone: who imports accelsurf has nibabel with all.

    Parameters
    ----------
    path : Path
        The image to read.
    """
    is_nifti = path.is_file() and split_name(path)[1].startswith(".nii")
    if is_nifti and not {"nibabel", "pydicom"} & sys.modules.keys():
        sys.modules["pydicom"] = None  # type: ignore[assignment]  # Python's own word for: there is none
        try:
            import nibabel  # noqa: F401
        finally:
            del sys.modules["pydicom"]


@dataclass(frozen=True)
class NiftiHeader:
    """The fields of a NIfTI header that decide where its voxels are, in the file and in the world.

    Attributes
    ----------
    version : int
        1 or 2.
    size : tuple of int
        Voxels along each axis, as many as ``dim[0]`` says, trailing ones dropped down to three.
    voxel_type : numpy.dtype
        Of the voxels in the file, with its byte order.
    data_offset : int
        Bytes before the first voxel.
    slope, intercept : float
        A stored value v stands for slope * v + intercept; 1 and 0 where the header gives none.
    grid : NiftiGrid
        The fields that place the grid.
    is_vector : bool
        Whether its intent says that its volumes are components.
    seconds : float or None
        From one time point to the next.
    says_time : bool
        Whether it gives the fourth axis a unit of time, or a step other than 1, or the times themselves.
    """

    version: int
    size: tuple[int, ...]
    voxel_type: np.dtype[Any]
    data_offset: int
    slope: float
    intercept: float
    grid: NiftiGrid
    is_vector: bool = False
    seconds: float | None = None
    says_time: bool = False

    @property
    def volumes(self) -> int:
        """Number of volumes that follow one another."""
        return math.prod(self.size[3:])

    @property
    def time_points(self) -> int:
        """Number of time points: volumes along the fourth axis, unless they are channels."""
        if len(self.size) < 4 or (
            len(self.size) == 4 and (self.is_vector or self.are_channels_guessed)
        ):
            return 1
        return self.size[3]

    @property
    def channels(self) -> int:
        """Number of channels at a time point."""
        return self.volumes // self.time_points

    @property
    def are_channels_guessed(self) -> bool:
        """True if a few volumes are taken for channels because nothing is said of time."""
        guessed = len(self.size) == 4 and not self.is_vector and not self.says_time
        return guessed and self.size[3] <= MAX_CHANNELS


@dataclass(frozen=True, kw_only=True)
class NiftiFile(RawHeader):
    """Claims of the header of a NIfTI file.

    Attributes
    ----------
    nifti : NiftiHeader
        The header.
    parts : tuple of Path
        Both files of a pair; none of a single file.
    """

    nifti: NiftiHeader
    parts: tuple[Path, ...] = ()

    @property
    def volume_metadata(self) -> dict[str, str]:
        """The fields of the header, and a warning when qform and sform disagree."""
        fields, notes = self.nifti, [self.nifti.grid.check_agreement(self.geometry)]
        if self.are_channels_guessed and self.asked.channel_index is None:
            notes.append(
                f"the {fields.volumes} volumes of the file are taken for channels: its header says nothing of time or "
                "vectors; --channel-index N takes one of them"
            )
        said = with_warnings(self.metadata, *notes)
        if fields.grid.units & 7 == _MICRON:
            said[UNIT_KEY] = "um"
        if self.time_points > 1 and self.seconds:
            said[FRAME_KEY] = repr(self.seconds)
        return said

    def _number(self, time: int, channel: int) -> int:
        return channel * self.nifti.time_points + time


def read_header(path: Path, options: ReadOptions = AS_IT_IS) -> NiftiFile:
    """Read the header of a file.

    Parameters
    ----------
    path : Path
        The file; the voxels of one that ends in .gz are packed.
    options : ReadOptions
        Which channel and time point is read.

    Raises
    ------
    InputError
        When it is no NIfTI file of real numbers, or packed against its suffix; GeometryError when it has no grid of
        perpendicular axes.
    """
    compressed = path.suffix.lower() == _PACKED
    with path.open("rb") as file:
        start = file.read(max(HEADER_BYTES.values()))
        zipped = start[:2] == GZIP_START
        if zipped and not compressed:
            raise InputError(
                "the file is gzip-compressed, against its suffix",
                hint="rename it to end in .nii.gz",
            )
        if compressed and not zipped:
            if start[:4] in _BEGINNINGS:
                raise InputError(
                    "the file is not compressed, against its suffix",
                    hint="rename it to end in .nii",
                )
            raise InputError(
                "this is not a NIfTI image: it is not gzip-compressed", hint="is it the right file?"
            )
        if compressed:
            file.seek(0)
            start = first_bytes(file, max(HEADER_BYTES.values()))
        header = parse_header(start)
        times_text = (
            _times_text_in(_extensions(file, header, compressed)) if len(header.size) > 3 else ""
        )
    encoding: Encoding = "deflate" if compressed else "raw"
    return _file_of(header, path, encoding, times_text, options)


def _file_of(
    header: NiftiHeader,
    voxels: Path,
    encoding: Encoding,
    times_text: str,
    options: ReadOptions,
    parts: tuple[Path, ...] = (),
) -> NiftiFile:
    """Return a NIfTI as it is read: by its header, where its voxels are, and the times in an extension."""
    if times_text:  # frames that are counted have no unit, but times
        header = replace(header, says_time=True)
    header.grid.check_forms()
    return NiftiFile(
        data=voxels,
        geometry=header.grid.geometry(),
        stored=header.voxel_type,
        encoding=encoding,
        skip=header.data_offset,
        metadata={NIFTI_KEY: header.grid.fields},
        channels=header.channels,
        time_points=header.time_points,
        seconds=header.seconds,
        asked=options,
        nifti=header,
        times_text=times_text,
        are_channels_guessed=header.are_channels_guessed,
        slope=header.slope,
        intercept=header.intercept,
        parts=parts,
    )


def read_pair_header(path: Path, options: ReadOptions = AS_IT_IS) -> NiftiFile:
    """Read the header of a NIfTI in two files.

    Parameters
    ----------
    path : Path
        Either of the files; each may be packed.
    options : ReadOptions
        Which channel and time point is read.

    Raises
    ------
    InputError
        As `read_header`, when one of the files is missing, and for Analyze 7.5.
    """
    about, voxels = _files_of_pair(path)
    for part in (about, voxels):
        if part != path:
            check_data_file(path, part)
            check_readable(part, f"{part.name}: ")
    with about.open("rb") as file:
        is_packed = file.read(2) == GZIP_START
        file.seek(0)
        raw = first_bytes(file, _MAX_EXTENSION) if is_packed else file.read(_MAX_EXTENSION)
    with voxels.open("rb") as file:
        encoding: Encoding = "deflate" if file.read(2) == GZIP_START else "raw"
    if (encoding == "deflate") != (voxels.suffix.lower() == _PACKED):
        is_named = "compressed" if encoding == "deflate" else "not compressed"
        raise InputError(f"{voxels.name} is {is_named}, against its suffix", "rename both files")
    header = parse_header(raw, is_pair=True)
    extensions = list(
        _extensions_in(raw[HEADER_BYTES[header.version] + 4 :], _BEGINNINGS[raw[:4]][1])
    )
    times_text = _times_text_in(extensions) if len(header.size) > 3 else ""
    return _file_of(header, voxels, encoding, times_text, options, (about, voxels))


def is_of_pair(path: Path) -> bool:
    """Test if a file has the voxels of a pair, by its name and the header beside it."""
    name = path.name.lower().removesuffix(_PACKED)
    return name.endswith(_VOXELS) and _files_of_pair(path)[0].is_file()


def _files_of_pair(path: Path) -> tuple[Path, Path]:
    """Header and voxels of a pair; of each the file that is there, packed or not."""
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() == _PACKED else path.name
    given = name[-len(_HEADER) :]
    stem, is_upper = name[: -len(_HEADER)], given.isupper()

    def found(suffix: str) -> Path:
        if given.lower() == suffix:
            return path
        plain = path.with_name(f"{stem}{suffix.upper() if is_upper else suffix}")
        packed = plain.with_name(plain.name + _PACKED)
        return packed if packed.is_file() and not plain.is_file() else plain

    return found(_HEADER), found(_VOXELS)


def extensions_of(path: Path) -> list[tuple[int, str]]:
    """Code and text of each extension of a file's header.

    Raises
    ------
    InputError
        As `read_header`.
    """
    found = read_header(path)
    with path.open("rb") as file:
        return _extensions(file, found.nifti, found.encoding == "deflate")


def _extensions(file: BinaryIO, header: NiftiHeader, compressed: bool) -> list[tuple[int, str]]:
    """The extensions between the header with its flags and the voxels; none where they are very long."""
    begin, end = HEADER_BYTES[header.version] + 4, header.data_offset
    if not begin < end <= _MAX_EXTENSION:
        return []
    file.seek(0)
    raw = first_bytes(file, end) if compressed else file.read(end)
    return list(_extensions_in(raw[begin:], _BEGINNINGS[raw[:4]][1]))


def _extensions_in(raw: bytes, order: str) -> Iterator[tuple[int, str]]:
    """Code and text of each extension of a NIfTI.

    Parameters
    ----------
    raw : bytes
        Bytes between the header with its four flags and the voxels.
    order : str
        Byte order of the header.
    """
    at = 0
    while at + 8 <= len(raw):
        size, code = struct.unpack_from(f"{order}2i", raw, at)
        if size < 16 or at + size > len(raw):
            break
        yield code, raw[at + 8 : at + size].rstrip(b"\0").decode("utf-8", errors="replace")
        at += size


def _times_text_in(extensions: Iterable[tuple[int, str]]) -> str:
    """The line with the times among the extensions of a NIfTI; empty where none has it."""
    begin = f"{TIMES_KEY}: "
    found = (
        text.removeprefix(begin)
        for code, text in extensions
        if code == COMMENT_CODE and text.startswith(begin)
    )
    return next(found, "")


def parse_header(raw: bytes, is_pair: bool = False) -> NiftiHeader:
    """Read a header, in either byte order, and refuse one that no 3D image of real numbers can have.

    Several volumes one after the other are accepted; see `NiftiFile.single`.

    Parameters
    ----------
    raw : bytes
    is_pair : bool, optional
        Whether the voxels are in another file.

    Raises
    ------
    InputError
        When it is not a NIfTI header, is cut off, or announces another sort of image.
    GeometryError
        When a voxel size is zero, negative or not finite.
    """
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    version, order = _BEGINNINGS.get(raw[:4], (1, ""))
    if len(raw) < HEADER_BYTES[version]:
        raise InputError(
            f"the file has only {len(raw)} bytes, a NIfTI header alone has {HEADER_BYTES[version]}",
            hint="the file is truncated or is not an image: copy or export it again",
        )
    magics = (_PAIR_MAGIC, _MAGIC) if is_pair else (_MAGIC, _PAIR_MAGIC)
    (at, magic), (_, other) = (kinds[version] for kinds in magics)
    if order and raw[at : at + len(magic)] != magic:
        _refuse_other(raw[at : at + len(magic)] == other, is_pair, version)
    if not order or raw[at : at + len(magic)] != magic:
        raise InputError(
            "this is not a NIfTI image: its header lacks the NIfTI marks",
            hint="is it the right file?",
        )
    kind = Nifti1Header if version == 1 else Nifti2Header
    header = kind(raw[: HEADER_BYTES[version]], order, check=False)

    def number(key: str) -> float:
        return float(header[key])

    dim = tuple(header["dim"].tolist())
    vox_offset = number("vox_offset")
    codes = int(header["qform_code"]), int(header["sform_code"])
    if (
        not 1 <= dim[0] <= 7
        or any(n < 1 for n in dim[1 : dim[0] + 1])
        or not 0 <= vox_offset < 2**31
    ):
        raise InputError(
            f"the NIfTI header is damaged: dim = {dim}", hint="copy or export the file again"
        )
    if not all(-(2**15) <= code < 2**15 for code in codes):
        raise InputError(
            f"the NIfTI header is damaged: form codes {codes}", hint="copy or export the file again"
        )
    size = _real_size(dim[1 : dim[0] + 1], int(header["datatype"]))
    p0, p1, p2, p3 = header["pixdim"][:4].tolist()
    if not is_finite((p1, p2, p3)) or min(p1, p2, p3) <= 0:
        raise GeometryError(
            f"the header gives spacing (x,y,z) = ({p1:g}, {p2:g}, {p3:g}), three positive numbers expected",
            hint="correct pixdim[1..3] in the header",
        )
    # Some writers leave zero in vox_offset; the voxels of a single file cannot start before its header ends.
    offset = int(vox_offset) if is_pair else max(int(vox_offset), HEADER_BYTES[version] + 4)
    grid = NiftiGrid(
        shape=(size[2], size[1], size[0]),
        pixdim=(p0, p1, p2, p3),
        units=int(header["xyzt_units"]) & 0xFF,
        qform_code=codes[0],
        sform_code=codes[1],
        qform=tuple(number(key) for key in _QFORM),
        sform=tuple(
            np.concatenate([header[key] for key in ("srow_x", "srow_y", "srow_z")]).tolist()
        ),
    )
    place = size, header.get_data_dtype(), offset
    is_vector = int(header["intent_code"]) in _VECTORS
    return NiftiHeader(version, *place, *_scaling(header), grid, is_vector, *_time_step(header))


def _refuse_other(is_other: bool, is_pair: bool, version: int) -> None:
    """Refuse the header of a file that should be a pair, of a pair that should be a file, and that of Analyze 7.5."""
    if is_other and is_pair:
        raise InputError(
            "the header says that the voxels follow it in the same file", "rename it to end in .nii"
        )
    if is_other:
        raise InputError(
            "the header says that the voxels are in another file",
            "rename the pair to .hdr and .img",
        )
    if is_pair and version == 1:
        raise InputError(
            "an Analyze 7.5 header given, which does not say where left and right are",
            "convert it to NIfTI with the program that wrote it, and compare the sides",
        )


def _scaling(header: Any) -> tuple[float, float]:
    """Slope and intercept. A slope of 0 is none, as the standard has it, and so is NaN, which nibabel writes: then the
    intercept does not count either.
    """
    slope, intercept = (float(header[key]) for key in ("scl_slope", "scl_inter"))
    if slope == 0 or not math.isfinite(slope):
        return 1.0, 0.0
    if not math.isfinite(intercept):
        raise InputError(
            f"the header scales by slope {slope:g} and intercept {intercept:g}, a finite intercept expected",
            "correct scl_inter in the header",
        )
    # Whole numbers stay whole.
    is_rounded = intercept == 0 and abs(slope - 1) < _SLOPE_ROUNDING
    return (1.0 if is_rounded else slope), intercept


def _time_step(header: Any) -> tuple[float | None, bool]:
    """Seconds from one volume to the next, and whether anything is said of time."""
    step = (
        single_precision(float(header["pixdim"][4]))
        if math.isfinite(header["pixdim"][4])
        else math.nan
    )
    unit = _SECONDS.get(int(header["xyzt_units"]) & 0x38, 0.0)
    seconds = step * unit if unit and math.isfinite(step) and step > 0 else None
    return seconds, unit > 0 or step not in (0.0, 1.0)


def _real_size(size: tuple[int, ...], datatype: int) -> tuple[int, ...]:
    """The size without trailing axes of one voxel; images of two axes or of other than real numbers are refused."""
    while len(size) > 3 and size[-1] == 1:
        size = size[:-1]
    if len(size) > 5:
        text = " x ".join(map(str, size))
        raise InputError(
            f"a {len(size)}D image ({text}) given, 3D expected", "extract a part first"
        )
    if len(size) < 3:
        raise InputError(
            f"a {len(size)}D image ({' x '.join(map(str, size))}) given, 3D expected",
            hint="add a slice axis of size 1, or use Volume.from_array in Python",
        )
    budgets.AXIS.check(max(size), "an axis of the image")
    if datatype in _NOT_REAL:
        raise InputError(
            f"a {_NOT_REAL[datatype]} image given, one real number per voxel expected",
            hint="extract one channel or the magnitude first",
        )
    if datatype not in _REAL:
        raise InputError(
            f"NIfTI type code {datatype} is not supported",
            hint="convert the image to float32 first",
        )
    return size
