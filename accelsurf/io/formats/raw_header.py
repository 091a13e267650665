"""Claims of the header of a volume format about its voxels, and the check that they are there.

Readers return zeros or garbage for missing voxels; the size is checked before anything is read or allocated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.io.channels import selected
from accelsurf.io.formats.deflate import TRUNCATED_HINT, inflate
from accelsurf.io.headers import FrameTimes
from accelsurf.settings import budgets
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

Encoding = Literal["raw", "deflate", "text", "other"]
ByteOrder = Literal["<", ">", ""]
_CHUNK = 1 << 20


def _at_blank(text: bytes, is_last: bool) -> tuple[bytes, bytes]:
    """Text up to its last blank, and what follows: the beginning of a word that goes on."""
    end = len(text) if is_last else max(text.rfind(blank) for blank in (b" ", b"\n", b"\t", b"\r")) + 1
    return text[:end], text[end:]


@dataclass(frozen=True)
class RawHeader:
    """Claims of a header.

    Attributes
    ----------
    data : Path
        File that holds the voxels.
    offset : int
        Bytes in it before the (possibly compressed) voxels.
    encoding : str
        "raw", "deflate" (gzip or zlib), "text" (numbers), or "other" (skipped or hexadecimal: the reader checks).
    itk_name : str
        The format, as ITK names the class that reads it.
    claimed_bytes : int
        Bytes expected from there on, after decompression.
    stored_bytes : int or None
        Bytes of compressed voxels, where the header says so: the reader will take these and no more.
    metadata : dict of str to str
        Header fields to give back on writing.
    numbers : int or None
        Numbers expected, all channels together, where all of ``claimed_bytes`` are voxels.
    position : int or None
        Byte of the data file at which raw voxels begin, -1 for its last bytes; None where that is not known, or they
        are not raw.
    order : str
        Byte order of the voxels: "<", ">", or empty where the header does not say.
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
    itk_name: str
    claimed_bytes: int
    stored_bytes: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    numbers: int | None = None
    position: int | None = None
    order: ByteOrder = ""
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
        """Number of values that are read, those of all channels together; of one byte each where that is not known."""
        numbers = self.claimed_bytes if self.numbers is None else self.numbers
        every = self.channels * self.time_points
        return numbers if every == 1 else numbers // every * len(self.selected())

    def selected(self) -> list[int]:
        """Numbers of the components or volumes that are read as channels.

        Raises
        ------
        InputError
            As `accelsurf.io.channels.selected`.
        """
        places = selected(self.channels, self.time_points, self.asked)
        return [time * self.channels + channel for time, channel in places]

    def check_claims(self) -> None:
        """Refuse a header that claims more than its file can hold, before anything is done that often.

        Raises
        ------
        InputError
            With both numbers.
        """
        budgets.AXIS.check(self.channels * self.time_points, "the channels and time points of the image")
        present = max(self.data.stat().st_size - self.offset, 0)
        if self.encoding == "raw":
            self.check_present(present)
        elif self.encoding == "text":
            self._check_count(-(-present // 2))
        else:
            budgets.DEFLATE.check(self.claimed_bytes, "the header announces voxels", present)

    def check_complete(self) -> None:
        """Refuse a file that holds fewer voxels than its header claims, as far as `check_claims` could not count them.

        Compressed voxels are decompressed once, chunk by chunk, which also verifies their checksum. Raw voxels are
        counted by `check_claims`, others than deflated ones and texts by who reads them.

        Raises
        ------
        InputError
            With both numbers of bytes.
        """
        if self.encoding == "text":
            self._check_numbers()
        elif self.encoding == "deflate":
            present = max(self.data.stat().st_size - self.offset, 0)
            if present < (self.stored_bytes or 0):
                raise InputError(
                    f"the header announces {self.stored_bytes} bytes of compressed voxels, the file holds {present}",
                    hint=TRUNCATED_HINT,
                )
            with self.data.open("rb") as file:
                file.seek(self.offset)
                self.check_present(sum(map(len, inflate(file, self.stored_bytes, self.claimed_bytes))))

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

    def check_text(self, read: NDArray[Any]) -> None:
        """Refuse text of which a reader has made other numbers: those that the type of the voxels does not hold.

        Parameters
        ----------
        read : ndarray (n,)
            What it has made, in the order of the file.

        Raises
        ------
        InputError
            With the first number that differs.
        """
        begin, rest = 0, b""
        with self.data.open("rb") as file:
            file.seek(self.offset)
            while begin < len(read) and (piece := file.read(_CHUNK)):
                whole, rest = _at_blank(rest + piece, len(piece) < _CHUNK)
                words = whole.split()[: len(read) - begin]
                self._check_words(words, read[begin : begin + len(words)])
                begin += len(words)

    def _check_words(self, words: Sequence[bytes], read: NDArray[Any]) -> None:
        try:
            said = np.array(words, dtype="S").astype(np.float64)
        except ValueError:
            raise InputError("the voxels of the text are not all numbers", TRUNCATED_HINT) from None
        found = read.astype(np.float64)
        wrong = ~np.isclose(found, said, rtol=1e-6, atol=0.0, equal_nan=True)
        if wrong.any():
            first = int(np.argmax(wrong))
            raise InputError(
                f"the voxel {words[first][:40].decode(errors='replace')} of the text is none of {read.dtype} values",
                "correct the type of the voxels in the header, or the text",
            )

    def _check_numbers(self) -> None:
        """Refuse text with fewer numbers than announced."""
        found, inside = 0, False
        with self.data.open("rb") as file:
            file.seek(self.offset)
            while piece := file.read(_CHUNK):
                # A word that goes on from the piece before was counted there.
                found += len(piece.split()) - (inside and not piece[:1].isspace())
                inside = not piece[-1:].isspace()
        self._check_count(found)

    def _check_count(self, found: int) -> None:
        if found < (self.numbers or 0):
            raise InputError(
                f"the header announces {self.numbers} numbers, the file holds {found}", hint=TRUNCATED_HINT
            )
