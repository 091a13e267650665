"""What the header of a volume format claims about its voxels, and whether they are there.

Readers return zeros or garbage for missing voxels; the size is checked before anything is read or allocated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from accelsurf.errors import InputError
from accelsurf.io.formats.deflate import TRUNCATED_HINT, inflate

Encoding = Literal["raw", "deflate", "other"]


@dataclass(frozen=True)
class RawHeader:
    """What a header claims.

    Attributes
    ----------
    data : Path
        File that holds the voxels.
    offset : int
        Bytes in it before the (possibly compressed) voxels.
    encoding : str
        "raw", "deflate" (gzip or zlib) or "other" (text, bzip2: left to the reader to check).
    itk_name : str
        The format, as ITK names the class that reads it.
    claimed_bytes : int
        Bytes expected from there on, after decompression.
    stored_bytes : int or None
        Bytes of compressed voxels, where the header says so: the reader will take these and no more.
    metadata : dict of str to str
        Header fields to give back on writing.
    """

    data: Path
    offset: int
    encoding: Encoding
    itk_name: str
    claimed_bytes: int
    stored_bytes: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def check_complete(self) -> None:
        """Refuse a file that holds fewer voxels than its header claims.

        Compressed voxels are decompressed once, chunk by chunk, which also verifies their checksum.

        Raises
        ------
        InputError
            With both numbers of bytes.
        """
        if self.encoding == "other":
            return
        present = self.data.stat().st_size - self.offset
        if self.encoding == "deflate":
            if present < (self.stored_bytes or 0):
                raise InputError(
                    f"the header announces {self.stored_bytes} bytes of compressed voxels, the file holds {present}",
                    hint=TRUNCATED_HINT,
                )
            with self.data.open("rb") as file:
                file.seek(self.offset)
                present = sum(map(len, inflate(file, self.stored_bytes)))
        if present < self.claimed_bytes:
            raise InputError(
                f"the header announces {self.claimed_bytes} bytes of voxels, the file holds {max(present, 0)}",
                hint=TRUNCATED_HINT,
            )
