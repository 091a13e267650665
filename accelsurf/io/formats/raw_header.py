"""Volumes whose voxels lie in a file one after the other, plain or packed as a whole: NIfTI, NRRD, MetaImage, MGH, npy.

A header claims where they are; that they are there is checked before anything is read or allocated. numpy takes plain
voxels, zlib unpacks the others to their end, which verifies their checksum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.channels import selected, single
from accelsurf.io.formats.deflate import TRUNCATED_HINT, inflate
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels, native
from accelsurf.io.headers import FRAME_KEY, FrameTimes
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import check_memory
from accelsurf.io.scaling import scaled, scaled_type
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

Encoding = Literal["raw", "deflate"]


@dataclass(frozen=True, kw_only=True)
class RawHeader:
    """Claims of a header.

    Attributes
    ----------
    data : Path
        File that holds the voxels.
    geometry : Geometry
        The grid of a volume.
    stored : numpy.dtype
        Of the values in the file, with its byte order.
    offset : int
        Bytes in the file before the stream of voxels, which is perhaps compressed.
    encoding : str
        "raw", or "deflate" (gzip or zlib).
    skip : int
        Bytes of the unpacked stream before the voxels.
    stored_bytes : int or None
        Bytes of compressed voxels, where the header says so: no more are read.
    metadata : dict of str to str
        Header fields to give back on writing.
    channels, time_points : int
        How many of them there are.
    seconds : float or None
        From one time point to the next.
    is_interleaved : bool
        Whether all values of a voxel lie together.
    asked : ReadOptions
        Which channel and time point is read.
    times_text : str
        A line of our own with the times; empty where there is none.
    are_channels_guessed : bool
        Whether a few volumes are taken for channels because nothing is said of time.
    slope, intercept : float
        A stored number v stands for slope * v + intercept.
    """

    data: Path
    geometry: Geometry
    stored: np.dtype[Any]
    offset: int = 0
    encoding: Encoding = "raw"
    skip: int = 0
    stored_bytes: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    channels: int = 1
    time_points: int = 1
    seconds: float | None = None
    is_interleaved: bool = False
    asked: ReadOptions = AS_IT_IS
    times_text: str = ""
    are_channels_guessed: bool = False
    slope: float = 1.0
    intercept: float = 0.0

    @property
    def claimed_bytes(self) -> int:
        """Bytes of the unpacked stream from its start to the end of the voxels."""
        numbers = math.prod(self.geometry.shape) * self.channels * self.time_points
        return self.skip + numbers * self.stored.itemsize

    @property
    def frame_times(self) -> FrameTimes | None:
        """The times of the frames; None where the file does not say them.

        Raises
        ------
        InputError
            When the text of the times is damaged.
        """
        if self.times_text:
            return FrameTimes.from_text(self.times_text, self.time_points)
        return None if self.seconds is None else FrameTimes.regular(self.time_points, self.seconds)

    @property
    def volume_metadata(self) -> dict[str, str]:
        """Metadata of a volume that is read."""
        seconds = {} if self.seconds is None else {FRAME_KEY: repr(self.seconds)}
        return self.metadata | seconds

    @property
    def has_boxes(self) -> bool:
        """True if any box of a volume can be read by itself."""
        return self.encoding == "raw" and not self.is_interleaved

    @property
    def is_scaled(self) -> bool:
        """True if stored numbers stand for others."""
        return (self.slope, self.intercept) != (1.0, 0.0)

    def scaled(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return the values that stored numbers stand for, in this machine's byte order.

        Scaled whole numbers are a float that holds them.
        """
        if not self.is_scaled:
            return native(stored)
        dtype = scaled_type(self.slope, self.intercept)
        if stored.dtype.kind == "f":
            dtype = np.promote_types(stored.dtype.newbyteorder("="), dtype)
        return scaled(stored, self.slope, self.intercept, dtype)

    def selected(self) -> list[int]:
        """Numbers of the components or volumes that are read as channels.

        Raises
        ------
        InputError
            As `accelsurf.io.channels.selected`.
        """
        return [
            self._number(*place) for place in selected(self.channels, self.time_points, self.asked)
        ]

    def single(self) -> int:
        """The number of the component or volume that is read as an image of one channel.

        Raises
        ------
        InputError
            As `accelsurf.io.channels.single`.
        """
        return self._number(*single(self.channels, self.time_points, self.asked))

    def _number(self, time: int, channel: int) -> int:
        return time * self.channels + channel

    def check_claims(self) -> None:
        """Refuse a header that claims more than its file can hold, before anything is done that often.

        Raises
        ------
        InputError
            With both numbers.
        """
        budgets.AXIS.check(max(self.geometry.shape), "an axis of the image")
        budgets.AXIS.check(
            self.channels * self.time_points, "the channels and time points of the image"
        )
        present = max(self.data.stat().st_size - self.offset, 0)
        if self.encoding == "raw":
            self.check_present(present)
        else:
            budgets.DEFLATE.check(self.claimed_bytes, "the header announces voxels", present)

    def check_present(self, present: int) -> None:
        """Refuse fewer bytes of voxels than the header claims.

        Raises
        ------
        InputError
            With both numbers.
        """
        if present < self.claimed_bytes:
            raise InputError(
                f"the header announces {self.claimed_bytes} bytes of voxels, the file holds {present}",
                hint=TRUNCATED_HINT,
            )

    def volumes(self, numbers: Sequence[int]) -> list[NDArray[Any]]:
        """Read some of the components or volumes, as they are stored.

        Parameters
        ----------
        numbers : sequence of int
            Which, in the order of the file.

        Returns
        -------
        list of ndarray (nz, ny, nx)

        Raises
        ------
        InputError
            When the file holds less than its header claims, or is damaged.
        """
        shape, size = self.geometry.shape, math.prod(self.geometry.shape)
        if self.is_interleaved:
            each = self.channels * self.time_points
            every = self._values(0, size * each).reshape(*shape, each)
            return [every[..., number] for number in numbers]
        first = min(numbers)
        several = self._values(first * size, (max(numbers) + 1 - first) * size).reshape(-1, *shape)
        return [several[number - first] for number in numbers]

    def _values(self, first: int, count: int) -> NDArray[Any]:
        """Some values in the order of the file."""
        begin = self.skip + first * self.stored.itemsize
        if self.encoding == "raw":
            return values_at(self.data, self.stored, self.offset + begin, count)
        values = np.empty(count, self.stored)
        raw = memoryview(values.view(np.uint8).data)
        present = 0
        filled = 0
        with self.data.open("rb") as stream:
            stream.seek(self.offset)
            for piece in inflate(stream, self.stored_bytes, self.claimed_bytes):
                some = memoryview(piece)[max(begin - present, 0) :][: len(raw) - filled]
                raw[filled : filled + len(some)] = some
                filled += len(some)
                present += len(piece)
        self.check_present(present)
        return values


@dataclass(frozen=True, kw_only=True)
class ListedHeader(RawHeader):
    """Claims of a header whose voxels are spread over several files, not packed, an equal part in each.

    Attributes
    ----------
    parts : tuple of Path
        The files in their order.
    bytes_before : int
        Bytes in each before its voxels; below 0 the voxels are its last bytes.
    """

    parts: tuple[Path, ...]
    bytes_before: int = 0

    @property
    def has_boxes(self) -> bool:
        """False: they lie in several files."""
        return False

    def check_claims(self) -> None:
        """Refuse a list whose files hold less than the header claims.

        Raises
        ------
        InputError
            With the first of them.
        """
        part_bytes = self.claimed_bytes // len(self.parts)
        for part in self.parts:
            present = part.stat().st_size - max(self.bytes_before, 0)
            if present < part_bytes:
                raise InputError(
                    f"the header announces {part_bytes} bytes of voxels in {part.name}, "
                    f"it holds {max(present, 0)}",
                    hint=TRUNCATED_HINT,
                )

    def _values(self, first: int, count: int) -> NDArray[Any]:
        values = np.empty(self.claimed_bytes // self.stored.itemsize, self.stored)
        for target, part in zip(values.reshape(len(self.parts), -1), self.parts, strict=True):
            begin = self.bytes_before
            if begin < 0:
                begin = part.stat().st_size - target.nbytes
            target[:] = values_at(part, self.stored, begin, len(target))
        return values[first : first + count]


def values_at(path: Path, stored: np.dtype[Any], offset: int, count: int) -> NDArray[Any]:
    """Read plain values from a place in a file.

    Raises
    ------
    InputError
        When the file ends before the last of them.
    """
    values = np.fromfile(path, stored, count, offset=offset)
    if len(values) < count:
        raise InputError(
            f"{count} values expected at byte {offset}, {len(values)} read", TRUNCATED_HINT
        )
    return values


def read_raw(path: Path, header: RawHeader, available: int) -> Volume:
    """Read a volume.

    Parameters
    ----------
    path : Path
        The file.
    header : RawHeader
        Claims of its header.
    available : int
        Bytes of memory.

    Raises
    ------
    InputError
        When the file holds several volumes and none is asked for, is damaged, or larger than the memory; GeometryError
        when its header contradicts itself.
    """
    return _read(path, header, [header.single()], available)[0]


def read_raw_channels(path: Path, header: RawHeader, available: int) -> list[Volume]:
    """Read the components or volumes of a file that are read as channels; one volume of an ordinary image.

    Raises
    ------
    InputError
        As `read_raw`, and for more than `accelsurf.io.channels.MAX_CHANNELS` of them.
    """
    return _read(path, header, header.selected(), available)


def _read(path: Path, header: RawHeader, numbers: Sequence[int], available: int) -> list[Volume]:
    """Read some of the components or volumes."""
    metadata = header.volume_metadata
    every = header.channels * header.time_points
    span = every if header.is_interleaved else max(numbers) + 1 - min(numbers)
    # Voxels as they are stored and as they are given may be in memory at the same time.
    given = 8 if header.is_scaled else header.stored.itemsize
    is_changed = header.is_scaled or not header.stored.isnative or span > 1
    needed = span * header.stored.itemsize + given * is_changed * len(numbers)
    check_memory(header.geometry.size, needed, available)
    arrays = header.volumes(numbers)
    return [
        Volume(np.ascontiguousarray(header.scaled(array)), header.geometry, dict(metadata), path)
        for array in arrays
    ]


def open_raw(path: Path, header: RawHeader, opening: Opening) -> LazyVolume:
    """Open a volume whose voxels are stored as they are, to be read box by box.

    Parameters
    ----------
    path : Path
        The file.
    header : RawHeader
        Claims of its header.
    opening : Opening
        Has no more to say here.

    Raises
    ------
    InputError
        When the voxels are packed, or as `read_raw`.
    """
    number, geometry = header.single(), header.geometry
    if not header.has_boxes:
        raise InputError(
            "the voxels are packed, in several files, have several values, or run along z first: a box of them cannot "
            "be read by itself",
            "convert the image to OME-Zarr, or save it uncompressed, in C order",
        )
    before = number * math.prod(geometry.shape) * header.stored.itemsize
    begin = header.offset + header.skip + before
    voxels = RawVoxels(RawLayout(header.data, begin, header.stored, geometry.shape), header.scaled)
    layout = StoreLayout((geometry,), None, header.channels, header.time_points)
    return LazyVolume(voxels, geometry, header.volume_metadata, path, layout)
