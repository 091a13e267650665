"""Claims of the header of a volume format about its voxels, and the check that they are there.

Readers return zeros or garbage for missing voxels; the size is checked before anything is read or allocated.
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
from accelsurf.io.channels import selected, single
from accelsurf.io.formats.deflate import TRUNCATED_HINT, inflate
from accelsurf.io.headers import FrameTimes
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

Encoding = Literal["raw", "deflate"]
ByteOrder = Literal["<", ">"]


@dataclass(frozen=True)
class RawHeader:
    """Claims of a header.

    Attributes
    ----------
    data : Path
        File that holds the voxels.
    offset : int
        Bytes in it before the stream of voxels, which is perhaps compressed.
    encoding : str
        "raw", or "deflate" (gzip or zlib).
    claimed_bytes : int
        Bytes expected from there on, after decompression.
    itk_name : str
        The format, as ITK names the class that reads it; empty where it does not.
    skip : int
        Bytes of the unpacked stream before the voxels.
    stored_bytes : int or None
        Bytes of compressed voxels, where the header says so: the reader will take these and no more.
    metadata : dict of str to str
        Header fields to give back on writing.
    numbers : int
        Numbers expected, all channels together.
    order : str
        Byte order of the voxels.
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
    """

    data: Path
    offset: int
    encoding: Encoding
    claimed_bytes: int
    itk_name: str = ""
    skip: int = 0
    stored_bytes: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    numbers: int = 0
    order: ByteOrder = "<"
    channels: int = 1
    time_points: int = 1
    seconds: float | None = None
    is_interleaved: bool = False
    asked: ReadOptions = AS_IT_IS
    times_text: str = ""

    @property
    def frame_times(self) -> FrameTimes | None:
        """The times of the frames; None where the file does not say them.

        Raises
        ------
        InputError
            When what it says is damaged.
        """
        if self.times_text:
            return FrameTimes.from_text(self.times_text, self.time_points)
        return None if self.seconds is None else FrameTimes.regular(self.time_points, self.seconds)

    @property
    def values(self) -> int:
        """Number of values that are read, those of all channels together."""
        return self.numbers // (self.channels * self.time_points) * len(self.selected())

    @property
    def are_channels_guessed(self) -> bool:
        """True if a few volumes are taken for channels because nothing is said of time."""
        return False

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

    def volumes(
        self, stored: np.dtype[Any], shape: tuple[int, int, int], numbers: Sequence[int]
    ) -> list[NDArray[Any]]:
        """Read some of the components or volumes; what is packed is unpacked to its end, which verifies its checksum.

        Parameters
        ----------
        stored : dtype
            Type of the values in the file.
        shape : tuple of int
            Voxels (nz, ny, nx) of a volume.
        numbers : sequence of int
            Which, in the order of the file.

        Returns
        -------
        list of ndarray (nz, ny, nx)

        Raises
        ------
        InputError
            When the file holds less than its header claims.
        """
        if not self.is_interleaved:
            first, size = min(numbers), math.prod(shape)
            several = self._values(stored, first * size, (max(numbers) + 1 - first) * size).reshape(
                -1, *shape
            )
            return [several[number - first] for number in numbers]
        # Planes, unless they are packed: then all is unpacked once.
        depth, every = 1 if self.encoding == "raw" else shape[0], self.channels * self.time_points
        found = [np.empty(shape, stored) for _ in numbers]
        size = depth * shape[1] * shape[2] * every
        for z in range(0, shape[0], depth):
            part = self._values(stored, z // depth * size, size).reshape(depth, *shape[1:], every)
            for array, number in zip(found, numbers, strict=True):
                array[z : z + depth] = part[..., number]
        return found

    def _values(self, stored: np.dtype[Any], begin: int, count: int) -> NDArray[Any]:
        """Some values in the order of the file."""
        values = np.empty(count, stored)
        raw, skip = memoryview(values.view(np.uint8).data), self.skip + begin * stored.itemsize
        with self.data.open("rb") as stream:
            if self.encoding == "raw":
                stream.seek(self.offset + skip)
                at = stream.readinto(raw)
            else:
                at, present = 0, 0
                stream.seek(self.offset)
                for piece in inflate(stream, self.stored_bytes, self.claimed_bytes):
                    some = memoryview(piece)[skip : skip + len(raw) - at]
                    raw[at : at + len(some)] = some
                    at, skip, present = (
                        at + len(some),
                        max(skip - len(piece), 0),
                        present + len(piece),
                    )
                self.check_present(present)
        if at < len(raw):
            raise InputError(
                f"{len(raw)} bytes of voxels announced, {at} read", hint=TRUNCATED_HINT
            )
        return values


@dataclass(frozen=True, kw_only=True)
class ListedHeader(RawHeader):
    """Claims of a header whose voxels are spread over several files, not packed, an equal part in each.

    Attributes
    ----------
    parts : tuple of Path
        The files in their order.
    skipped : int
        Bytes in each before its voxels; below 0 the voxels are its last bytes.
    """

    parts: tuple[Path, ...]
    skipped: int = 0

    @property
    def part_bytes(self) -> int:
        """Bytes of voxels in each file."""
        return self.claimed_bytes // len(self.parts)

    def check_claims(self) -> None:
        """Refuse a list whose files hold less than the header claims.

        Raises
        ------
        InputError
            With the first of them.
        """
        for part in self.parts:
            present = part.stat().st_size - max(self.skipped, 0)
            if present < self.part_bytes:
                raise InputError(
                    f"the header announces {self.part_bytes} bytes of voxels in {part.name}, "
                    f"it holds {max(present, 0)}",
                    hint=TRUNCATED_HINT,
                )

    def _values(self, stored: np.dtype[Any], begin: int, count: int) -> NDArray[Any]:
        values = np.empty(count, stored)
        raw, first, size = (
            memoryview(values.view(np.uint8).data),
            begin * stored.itemsize,
            self.part_bytes,
        )
        at = 0
        while at < len(raw):
            number, skip = divmod(first + at, size)
            with self.parts[number].open("rb") as stream:
                before = (
                    self.skipped if self.skipped >= 0 else self.parts[number].stat().st_size - size
                )
                stream.seek(before + skip)
                read = stream.readinto(raw[at : at + size - skip])
            if not read:
                raise InputError(
                    f"{len(raw)} bytes of voxels announced, {at} read", hint=TRUNCATED_HINT
                )
            at += read
        return values
