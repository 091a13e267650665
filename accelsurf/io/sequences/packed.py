"""Sequences whose voxels are packed as a whole: unpacked once, into a temporary file; then any frame is read by itself.

Unpacking from the start for each frame would take a time that grows with the square of their number, and backwards
there is no other way. The file has no name that lasts: it goes with the sequence.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import weakref
from dataclasses import replace
from pathlib import Path
from typing import IO

from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.io.channels import read_volumes
from accelsurf.io.files import file_version, refuse_changed
from accelsurf.io.formats.deflate import inflate
from accelsurf.io.formats.raw_header import RawHeader
from accelsurf.io.headers import FrameTimes
from accelsurf.io.sequences.sources import FileFrames, with_time
from accelsurf.settings.reading import ReadOptions


class PackedFrames(FileFrames):
    """Frames of a file that is perhaps packed.

    A few volumes of a NIfTI of which nothing is said are time points here, where `read` takes channels.
    """

    header: RawHeader
    _unpacked: IO[bytes] | None = None

    def __init__(self, path: Path, options: ReadOptions, memory_bytes: int | None) -> None:
        super().__init__(path, options, memory_bytes)
        self._version = file_version(self.header.data)
        if self.header.are_channels_guessed:
            self.place(self.geometry, FrameTimes.regular(self.header.channels, None))

    def unpacked_header(self) -> RawHeader:
        """The header of the voxels as they are, in a temporary file where the file itself is packed."""
        refuse_changed(self.header.data, self._version)
        if self.header.encoding != "deflate":
            return self.header
        if self._unpacked is None:
            self._unpacked = self._unpack()
        return replace(
            self.header, data=Path(self._unpacked.name), offset=0, encoding="raw", stored_bytes=None
        )

    def _unpack(self) -> IO[bytes]:
        """Unpack the voxels, which are all there then."""
        header = self.header
        file: IO[bytes] = tempfile.NamedTemporaryFile(prefix="accelsurf-")
        weakref.finalize(self, file.close)
        free = shutil.disk_usage(Path(file.name).parent).free
        if header.claimed_bytes > free:
            raise InputError(
                f"unpacked it has {header.claimed_bytes / 1e9:.2f} GB, in {Path(file.name).parent} "
                f"{free / 1e9:.2f} GB are free",
                "name another folder by the variable TMPDIR, or save the sequence uncompressed",
            )
        with header.data.open("rb") as packed:
            packed.seek(header.offset)
            header.check_present(
                sum(map(file.write, inflate(packed, header.stored_bytes, header.claimed_bytes)))
            )
        file.flush()
        return file

    @property
    def frame_values(self) -> int:
        """Number of values of a frame."""
        return (
            math.prod(self.geometry.shape)
            if self.header.are_channels_guessed
            else super().frame_values
        )

    def read(self, number: int) -> list[Volume]:
        """Read the channels of a frame."""
        header = self.unpacked_header()
        if self.header.are_channels_guessed:
            header = replace(header, asked=replace(header.asked, channel_index=number))
        return read_volumes(self.path, self.form, with_time(header, number), self.memory)
