"""The values of slices: plain ones by pydicom, compressed ones by ITK, scaled slice by slice."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io import itk
from accelsurf.io.channels import to_grey
from accelsurf.io.dicom.frames import Frame
from accelsurf.io.dicom.sources import HEADER_HINT, damage_of, dicom_library, read_dataset
from accelsurf.io.dicom.writing_tools import data_set, file_bytes, filled
from accelsurf.io.scaling import scaled, scaled_type

_SECONDARY_CAPTURE = "1.2.840.10008.5.1.4.1.1.7"
_COLOURS = 3
#: Markers of the frame headers of JPEG and JPEG-LS.
_FRAME_HEADERS = {*range(0xC0, 0xD0), 0xF7} - {0xC4, 0xC8, 0xCC}
#: End mark of a packed image, in all kinds of JPEG, and the number of bytes that may follow it.
_END_OF_IMAGE = b"\xff\xd9"
_TAIL = 1024
#: The elements that describe pixels.
_DESCRIBING = (
    "Rows",
    "Columns",
    "BitsAllocated",
    "BitsStored",
    "HighBit",
    "PixelRepresentation",
    "SamplesPerPixel",
    "PhotometricInterpretation",
    "PlanarConfiguration",
)


def value_type(frames: Sequence[Frame]) -> np.dtype[Any]:
    """The type of a volume's values: whole numbers where slices are scaled by 1 and whole offsets, else floats.

    Parameters
    ----------
    frames : sequence of Frame
    """
    fractions = np.result_type(*(scaled_type(frame.slope, frame.intercept) for frame in frames))
    if any(_is_fraction(frame) for frame in frames):
        return fractions
    lows, highs = [], []
    for frame in frames:
        bits = frame.pixel.bits
        if frame.pixel.allocated > 32 or not 1 <= bits <= 32:
            return fractions
        low = -(1 << (bits - 1)) if frame.pixel.is_signed else 0
        lows.append(low + frame.intercept)
        highs.append(low + (1 << bits) - 1 + frame.intercept)
    for name in ("uint8", "int8", "uint16", "int16", "uint32", "int32"):
        if np.iinfo(name).min <= min(lows) and max(highs) <= np.iinfo(name).max:
            return np.dtype(name)
    return fractions


def _is_fraction(frame: Frame) -> bool:
    """Test if the values of a slice may have fractions, or any size."""
    return (
        frame.pixel.samples == _COLOURS
        or frame.has_table
        or frame.slope != 1.0
        or bool(frame.intercept % 1.0)
    )


def read_values(frames: Sequence[Frame]) -> tuple[NDArray[Any], str]:
    """Read slices in their order.

    Parameters
    ----------
    frames : sequence of Frame
        All of one size.

    Returns
    -------
    ndarray, shape (n, rows, columns), and str
        The values, and a note on them for the user.

    Raises
    ------
    InputError
        When a file is damaged, or its values are of a kind that is no image in grey.
    """
    dtype = value_type(frames)
    out = np.empty((len(frames), frames[0].rows, frames[0].columns), dtype)
    padding = np.zeros(out.shape, np.bool_) if any(frame.padding for frame in frames) else None
    notes: dict[str, None] = {}
    by_file: dict[Path, list[int]] = {}
    for place, frame in enumerate(frames):
        by_file.setdefault(frame.path, []).append(place)
    for path, places in by_file.items():
        dataset = read_dataset(path)
        for place in places:
            frame = frames[place]
            array = stored_values(path, dataset, frame)
            stored, note = _grey(array, frame)
            if note:
                notes[note] = None
            if stored.shape != out.shape[1:]:
                raise InputError(
                    f"{path.name}: {stored.shape} pixels, {out.shape[1:]} announced",
                    "copy it again",
                )
            if frame.padding is not None and padding is not None and array.ndim == 2:
                padding[place] = (stored >= frame.padding[0]) & (stored <= frame.padding[1])
            values = _scaled(stored, dataset, frame, dtype)
            _check_fits(values, dtype, frame)
            out[place] = values
    if padding is not None and padding.any():
        notes[_fill(out, padding, any(frame.pixel.colour == "MONOCHROME1" for frame in frames))] = (
            None
        )
    return _narrowed(out), "; ".join(notes)


def _check_fits(values: NDArray[Any], dtype: np.dtype[Any], frame: Frame) -> None:
    """Refuse values that the type does not hold, which follows from the bits that are announced."""
    if dtype.kind not in "iu":
        return
    low = values.min()
    high = values.max()
    known = np.iinfo(dtype)
    if low < known.min or high > known.max:
        raise InputError(
            f"{frame.path.name}: values of {low:g} to {high:g}, {frame.pixel.bits} bits announced",
            HEADER_HINT,
        )


def _scaled(stored: NDArray[Any], dataset: Any, frame: Frame, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The values of stored numbers: by a table, or by slope and intercept."""
    if frame.has_table:
        with damage_of(frame.path, "its table of values cannot be read"):
            first = dataset.ModalityLUTSequence[0].LUTDescriptor[1]
            if first > np.iinfo(stored.dtype).max:
                raise InputError(
                    f"{frame.path.name}: its table of values begins at {first}, beyond its pixels",
                    "export it again",
                )
            # Of 64 bits: it looks up differences, and compares with the length of the table.
            return np.asarray(
                dicom_library("pydicom.pixels").apply_modality_lut(stored.astype(np.int64), dataset)
            )
    if frame.slope == 1.0 and frame.intercept == 0.0:
        return stored
    if dtype.kind == "f":
        try:
            return scaled(stored, frame.slope, frame.intercept, dtype)
        except InputError as error:
            raise InputError(f"{frame.path.name}: {error.message}", error.hint) from None
    return stored * frame.slope + frame.intercept


def _fill(values: NDArray[Any], padding: NDArray[np.bool_], is_inverse: bool) -> str:
    """Give padding, where there is no image, the image's darkest value, in place; return a note on the change."""
    count = int(padding.sum())
    if count == padding.size:
        raise InputError("every voxel is padding: there is no image", "is it the right series?")
    first = values[np.unravel_index(np.argmin(padding), padding.shape)]
    darkest = (values.max if is_inverse else values.min)(where=~padding, initial=first)
    was = values[padding]
    low, high = was.min(), was.max()
    values[padding] = darkest
    text = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    return f"{count} voxels of padding ({text}), where there is no image, got its darkest value, {darkest:g}"


def _narrowed(values: NDArray[Any]) -> NDArray[Any]:
    """The same values in 16 bits where they fit: a CT of 16 bits with an offset rarely needs more."""
    if values.dtype.kind in "iu" and values.dtype.itemsize == 4:
        low, high = int(values.min()), int(values.max())
        for name in ("int16", "uint16"):
            if np.iinfo(name).min <= low and high <= np.iinfo(name).max:
                return values.astype(name)
    return values


def _grey(stored: NDArray[Any], frame: Frame) -> tuple[NDArray[Any], str]:
    kind = frame.pixel.colour
    if kind == "PALETTE COLOR":
        raise InputError(
            f"{frame.path.name}: a picture in the colours of a palette given, values expected",
            "give the scan that it was made of",
        )
    if stored.ndim == 3:
        return to_grey(stored.astype(np.uint8) if stored.dtype.itemsize == 1 else stored)
    inverse = "MONOCHROME1: larger values were meant to be shown darker"
    return stored, inverse if kind == "MONOCHROME1" else ""


def stored_values(path: Path, dataset: Any, frame: Frame) -> NDArray[Any]:
    """Read the stored values of a slice, before they are scaled.

    Parameters
    ----------
    path : Path
    dataset : pydicom.Dataset
        All of the file.
    frame : Frame

    Raises
    ------
    InputError
        When they cannot be read.
    """
    pydicom = dicom_library()
    meta = getattr(dataset, "file_meta", None)
    syntax = None if meta is None else meta.get("TransferSyntaxUID")
    with damage_of(path, "its pixels cannot be read"):
        if syntax is None:
            meta = pydicom.dataset.FileMetaDataset() if meta is None else meta
            implicit, little = dataset.original_encoding
            uid = pydicom.uid
            meta.TransferSyntaxUID = syntax = (
                uid.ImplicitVRLittleEndian
                if implicit
                else uid.ExplicitVRLittleEndian
                if little
                else uid.ExplicitVRBigEndian
            )
            dataset.file_meta = meta
        if syntax.is_encapsulated and syntax != pydicom.uid.RLELossless:
            array = _by_itk(dataset, frame)
        elif frame.pixel.allocated == 1 and syntax.is_little_endian and not syntax.is_encapsulated:
            array = _bits(dataset.PixelData, frame)
        else:
            array = pydicom.pixels.pixel_array(
                dataset, index=frame.number if frame.frames > 1 else None
            )
    return np.asarray(array)


def _bits(content: bytes, frame: Frame) -> NDArray[np.uint8]:
    """A slice of one bit a pixel: frames follow one another without a gap, which pydicom expects to find."""
    size = frame.rows * frame.columns
    first = frame.number * size
    packed = np.frombuffer(content, np.uint8, (first + size + 7) // 8 - first // 8, first // 8)
    return np.unpackbits(packed, bitorder="little")[first % 8 :][:size].reshape(
        frame.rows, frame.columns
    )


def _by_itk(dataset: Any, frame: Frame) -> NDArray[Any]:
    """A compressed slice, unpacked by ITK from a file that has it alone, without scales and places."""
    pydicom = dicom_library()
    packed = pydicom.encaps.get_frame(
        dataset.PixelData, frame.number, number_of_frames=frame.frames
    )
    if _END_OF_IMAGE not in packed[-_TAIL:]:  # its decoders fill the missing part with grey
        raise InputError(
            f"{frame.path.name}: its compressed pixels have no end mark; cut short?",
            "copy it again",
        )
    _check_packed(packed, frame, (int(dataset.Rows), int(dataset.Columns)))
    syntax = dataset.file_meta.TransferSyntaxUID
    meta = filled(pydicom.dataset.FileMetaDataset(), TransferSyntaxUID=syntax)
    alone = data_set(
        **{name: dataset[name].value for name in _DESCRIBING if name in dataset},
        SOPClassUID=_SECONDARY_CAPTURE,
        SOPInstanceUID="1.2.3",
        PixelData=pydicom.encaps.encapsulate([packed]),
        file_meta=meta,
    )
    filled(alone["PixelData"], is_undefined_length=True)
    with _as_file(file_bytes(alone)) as path:
        try:
            return itk.array_of(path, "GDCMImageIO")[0]
        except RuntimeError:  # of many lines
            what = f"{frame.path.name}: its pixels cannot be unpacked as {syntax.name}"
            raise InputError(what, "export it again") from None


def _check_packed(packed: bytes, frame: Frame, size: tuple[int, int]) -> None:
    """Refuse packed values that have more rows or bits than the header announces, or a sign: decoders cut them off."""
    found = dicom_library("pydicom.pixels.utils").get_j2k_parameters(
        packed
    )  # empty for other kinds
    bits, *packed_size = (found["precision"], *size) if found else _header_of_jpeg(packed)
    if all(packed_size) and tuple(packed_size) != size:
        text = " x ".join(map(str, packed_size[::-1]))
        raise InputError(
            f"{frame.path.name}: {size[1]} x {size[0]} pixels announced, {text} packed",
            "export it again",
        )
    has_sign = bool(found.get("is_signed"))
    form = frame.pixel
    if bits > min(form.allocated, -(-form.bits // 8) * 8) or (has_sign and not form.is_signed):
        raise InputError(
            f"{frame.path.name}: the header announces {'' if form.is_signed else 'un'}signed values of "
            f"{form.bits} bits, the compressed pixels have {'' if has_sign else 'un'}signed ones of {bits} bits",
            "export it again",
        )


def _header_of_jpeg(packed: bytes) -> tuple[int, int, int]:
    """Bits of a value, rows and columns as the frame header of a JPEG or JPEG-LS says them; 0 where it does not."""
    place = 2
    while place + 4 < len(packed) and packed[place] == 0xFF:
        if packed[place + 1] in _FRAME_HEADERS:
            sides = packed[place + 5 : place + 9]
            return (
                packed[place + 4],
                int.from_bytes(sides[:2], "big"),
                int.from_bytes(sides[2:], "big"),
            )
        place += 2 + int.from_bytes(packed[place + 2 : place + 4], "big")
    return 0, 0, 0


@contextmanager
def _as_file(content: bytes) -> Iterator[Path]:
    """A file for a moment, in memory where the system can: nothing of a patient stays after a kill."""
    if hasattr(os, "memfd_create"):
        with open(os.memfd_create("slice.dcm"), "wb") as file:
            file.write(content)
            file.flush()
            yield Path(f"/proc/self/fd/{file.fileno()}")
        return
    with tempfile.TemporaryDirectory(prefix="accelsurf-dicom-") as folder:
        path = Path(folder, "slice.dcm")
        path.write_bytes(content)
        yield path
