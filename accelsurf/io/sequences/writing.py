"""Sequences written frame by frame, in any order: one file with a time axis, or a file for each frame."""

from __future__ import annotations

import os
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import SPACE_HINT, StagedOutput
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import FrameTimes
from accelsurf.io.writing import stored_grid, write_labels
from accelsurf.io.writing import write as write_volume
from accelsurf.settings.file_formats import IMAGE_FORMATS, ImageFormat, image_format

#: Digits of the numbers of files, at least.
_DIGITS = 4
#: Types of values that all formats of volumes hold.
_TYPES = (
    *(f"{kind}{bits}" for kind in ("uint", "int") for bits in (8, 16, 32, 64)),
    "float32",
    "float64",
)


@dataclass(frozen=True, eq=False)
class FrameStack:
    """Frames that lie in a file one after the other, as they are, until all are there.

    Attributes
    ----------
    path : Path
        The file.
    geometry : Geometry
        Of every frame.
    times : FrameTimes
    dtype : numpy.dtype
        Of the values; in the file in little-endian order.
    """

    path: Path
    geometry: Geometry
    times: FrameTimes
    dtype: np.dtype[Any]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.times.values)

    @property
    def stored(self) -> np.dtype[Any]:
        """Type of the values in the file."""
        return self.dtype.newbyteorder("<")

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        return int(np.prod(self.geometry.shape, dtype=np.int64)) * self.dtype.itemsize

    def put(self, number: int, array: NDArray[Any]) -> None:
        """Write a frame in its place."""
        with self.path.open("r+b") as file:
            file.seek(number * self.frame_bytes)
            file.write(np.ascontiguousarray(array, self.stored).tobytes())

    def frame(self, number: int) -> NDArray[Any]:
        """The values of a frame, of the shape of the grid; in the type of the file."""
        with self.path.open("rb") as file:
            file.seek(number * self.frame_bytes)
            count = self.frame_bytes // self.dtype.itemsize
            return np.fromfile(file, self.stored, count).reshape(self.geometry.shape)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """The frames in the order of their times."""
        return (self.frame(number) for number in range(len(self)))


class SequenceWriter(StagedOutput):
    """A sequence that is being written. It appears when all frames are there, whole, or not at all.

    Used with ``with``, it is committed at the end, and aborted where an error ends the block. The bytes do not depend
    on the order in which the frames come.

    Parameters
    ----------
    path : path-like
        One file that keeps times: a NIfTI, OME-Zarr or TIFF (OME). Or a file for each frame: a name
        with a star, for which the number of the frame is put: ``masks/mask*.tif``; of any format that is written.
    geometry : Geometry
        Of every frame.
    times : sequence of float
        One for each frame, rising.
    time_unit : {"s", "frame"}
    dtype : dtype
        Of the values.

    Notes
    -----
    Files for each frame are numbered from 0 where the unit is "s", and have no times; where it is "frame", a time that
    is a whole number is the number of the file.

    Raises
    ------
    UsageError
        When the suffix or the type is none that can be written.
    OutputError
        When nothing can be written there.

    Examples
    --------
    >>> import tempfile
    >>> from accelsurf import io
    >>> grid = Geometry((4, 5, 6), (1.0, 1.0, 1.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with SequenceWriter(f"{folder}/cells.nii", grid, (0.0, 0.5), "s", np.uint8) as writer:
    ...         for number in (1, 0):
    ...             writer.write(number, np.full((4, 5, 6), number, np.uint8))
    ...     read = io.read_sequence(f"{folder}/cells.nii")
    ...     read.times, read.time_unit, int(read.frame(1).array.max())
    ((0.0, 0.5), 's', 1)
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        geometry: Geometry,
        times: Sequence[float],
        time_unit: str,
        dtype: Any,
    ) -> None:
        self.geometry = geometry
        self.times = FrameTimes.checked(times, time_unit)
        self.dtype = np.dtype(dtype).newbyteorder("=")
        self._form = _written_form(Path(path), self.dtype, geometry)
        self._sums: dict[int, int] = {}
        super().__init__(Path(path), self._form.folder_marks)
        with self._aborted_on_failure():
            scratch = self._files.staging.parent / "frames.raw"
            self._frames = FrameStack(scratch, geometry, self.times, self.dtype)
            with scratch.open("wb") as file:  # sparse where the system can
                file.truncate(len(self._frames) * self._frames.frame_bytes)

    def write(self, number: int, array: NDArray[Any]) -> None:
        """Write the frame ``number``, from 0; one that was there is replaced.

        Raises
        ------
        UsageError
            When the frame does not exist, or the array has another shape or type.
        OutputError
            When the disk is full or gone; nothing is left behind then.
        """
        if not 0 <= number < len(self._frames):
            raise UsageError(f"frame {number} given, expected 0 to {len(self._frames) - 1}")
        if array.shape != self.geometry.shape or array.dtype != self.dtype:
            raise UsageError(
                f"a frame {array.shape} of {array.dtype} given, {self.geometry.shape} of {self.dtype} expected"
            )
        with self._aborted_on_failure():
            self._frames.put(number, array)
        self._sums[number] = _checksum(array)

    @property
    def missing(self) -> tuple[int, ...]:
        """Numbers of the frames that were not written yet."""
        return tuple(number for number in range(len(self._frames)) if number not in self._sums)

    def commit(self) -> tuple[Path, ...]:
        """Put the sequence in its place; the files, in the order of the frames.

        Raises
        ------
        UsageError
            When a frame is missing.
        OutputError
            When it cannot be written; nothing is left behind then.
        """
        if self.missing:
            raise UsageError(f"frame {self.missing[0]} of {len(self._frames)} was not written")
        with self._aborted_on_failure():
            if "*" in self.path.name:
                names = self._write_each()
            else:
                names = [self.path.name]
                write_frames = functions_of(self._form).write_frames
                assert write_frames is not None
                write_frames(self._files.staging / self.path.name, self._frames)
                self._check()
            self._frames.path.unlink()
            self._files.commit(last=self.path.name if self.path.name in names else None)
        self.abort()
        return tuple(self.path.with_name(name) for name in names)

    def _write_each(self) -> list[str]:
        """Write a file for each frame; their names."""
        numbers = list(range(len(self._frames)))
        if self.times.unit == "frame" and all(t == int(t) and t >= 0 for t in self.times.values):
            numbers = [int(t) for t in self.times.values]
        digits = max(_DIGITS, len(str(numbers[-1])))
        names = [self.path.name.replace("*", str(number).zfill(digits)) for number in numbers]
        write = write_labels if self.dtype.kind == "u" else write_volume
        for name, array in zip(names, self._frames, strict=True):
            write(
                Volume(array.astype(self.dtype, copy=False), self.geometry),
                self._files.staging / name,
            )
        return names

    def _check(self) -> None:
        """Read the staging file back, and refuse one that does not hold the frames."""
        from accelsurf.io.sequences.reading import open_sequence

        try:
            found = open_sequence(self._files.staging / self.path.name, memory_bytes=sys.maxsize)
            difference = stored_grid(self.geometry, headers.split_name(self.path)[1]).difference(
                found.geometry
            )
            if not difference and FrameTimes.checked(found.times, found.time_unit) != self.times:
                difference = "other times are read than were written"
            for number in range(len(self._frames)) if not difference else ():
                array = found.frame(number).array
                if array.dtype != self.dtype or _checksum(array) != self._sums[number]:
                    difference = f"other voxels of frame {number} are read than were written"
                    break
        except InputError as error:
            difference = f"what was written is damaged: {error.message}"
        if difference:
            raise OutputError(f"{self.path}: cannot be written ({difference})", SPACE_HINT)


def sequence_suffixes() -> tuple[str, ...]:
    """Endings of the files that a sequence with its times is written to.

    Examples
    --------
    >>> ".nii" in sequence_suffixes(), ".nrrd" in sequence_suffixes()
    (True, False)
    """
    return tuple(
        suffix
        for form in IMAGE_FORMATS.values()
        if functions_of(form).write_frames is not None
        for suffix in form.suffixes
    )


def _written_form(path: Path, dtype: np.dtype[Any], geometry: Geometry) -> ImageFormat:
    """The format of a path; an error where it cannot hold the frames."""
    headers.check_name(path)
    suffix = headers.split_name(path)[1]
    form = image_format(suffix)
    each = "*" in path.name
    if form is None or not (form.is_written if each else functions_of(form).write_frames):
        raise UsageError(
            f"{path}: a sequence cannot be written to it, one of {', '.join(sequence_suffixes())} expected",
            "or give a name with a star, for a file for each frame: frame*.tif",
        )
    if each and path.name.count("*") > 1:
        raise UsageError(f"{path}: one star expected, for the number of the frame")
    if dtype.name not in (form.types or _TYPES):
        raise UsageError(
            f"values of type {dtype} given, which a sequence in {suffix} does not hold",
            "convert them",
        )
    if form.only_2d and geometry.shape[0] > 1:
        raise UsageError(f"frames of {geometry.shape[0]} slices given, a {suffix} holds one")
    return form


def _checksum(array: NDArray[Any]) -> int:
    """Checksum of the values in their order."""
    return zlib.crc32(
        np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1).view(np.uint8).data
    )
