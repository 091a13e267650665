"""Images of several channels: each comes out as a volume of its own, all on one grid."""

from __future__ import annotations

import gzip
import os
import struct
import tempfile
from dataclasses import replace
from pathlib import Path

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.volume import Volume
from accelsurf.io.formats import nifti

#: More volumes along the fourth axis than this are a time series, not channels.
MAX_CHANNELS = 16
_DIM, _BITPIX, _OFFSET = 40, 72, 108


def read(path: str | os.PathLike[str]) -> list[Volume]:
    """Read an image of one or more channels.

    Parameters
    ----------
    path : path-like
        As for `accelsurf.io.read`; also a NIfTI of vectors or with a few volumes along its fourth axis, or an NRRD or
        MetaImage of vectors.

    Returns
    -------
    list of Volume
        The channels in their order; one for an ordinary image.

    Raises
    ------
    InputError
        As `accelsurf.io.read`, and for more than `MAX_CHANNELS` channels.
    """
    path = Path(path)
    suffix = io.split_name(path)[1]
    if suffix in (".nii", ".nii.gz") and path.is_file():
        blocks = _nifti_blocks(path)
        return [io.read(path)] if blocks is None else blocks
    if suffix in (".nrrd", ".mha", ".mhd") and path.is_file():
        parts = io.components(path)
        if len(parts) > 1:
            _check_count(path, len(parts))
            return parts
    return [io.read(path)]


def read_further(paths: tuple[str, ...]) -> list[Volume]:
    """Read the files that add channels, in order.

    Raises
    ------
    UsageError
        When a path is empty.
    """
    if any(not path for path in paths):
        raise UsageError("channel: nothing was given, expected a file", "write --channel FILE")
    return [volume for path in paths for volume in read(path)]


def _check_count(path: Path, count: int) -> None:
    if count > MAX_CHANNELS:
        raise InputError(
            f"{path}: {count} channels or time points, expected at most {MAX_CHANNELS}", "extract one of them first"
        )


def _nifti_blocks(path: Path) -> list[Volume] | None:
    """The channels of a NIfTI file, which follow one another in it; None when it has one, or its header is no good.

    Each is read as the file that it would be alone, with the same checks.
    """
    try:
        with (gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb")) as file:
            head = file.read(nifti.HEADER_BYTES + 4)
            order = nifti.FIRST_BYTES.get(head[:4])
            if order is None or len(head) < nifti.HEADER_BYTES:
                return None
            dim = struct.unpack_from(order + "8h", head, _DIM)
            if not 4 <= dim[0] <= 5 or any(n < 1 for n in dim[1 : dim[0] + 1]):
                return None
            count = dim[4] * (dim[5] if dim[0] == 5 else 1)
            if count == 1:
                return None
            _check_count(path, count)
            (bits,) = struct.unpack_from(order + "h", head, _BITPIX)
            (offset,) = struct.unpack_from(order + "f", head, _OFFSET)
            alone = bytearray(head[: nifti.HEADER_BYTES] + bytes(4))
            struct.pack_into(order + "8h", alone, _DIM, 3, *dim[1:4], 1, 1, 1, 1)
            struct.pack_into(order + "f", alone, _OFFSET, nifti.HEADER_BYTES + 4.0)
            struct.pack_into(order + "h", alone, 68, 0)  # no intent: it is no vector any more
            size = dim[1] * dim[2] * dim[3] * max(bits, 0) // 8
            file.seek(max(int(offset), nifti.HEADER_BYTES + 4))
            return [_alone(path, bytes(alone), file.read(size)) for _ in range(count)]
    except (OSError, EOFError, gzip.BadGzipFile):
        # What is wrong with the file is told by the reader of ordinary images.
        return None


def _alone(path: Path, head: bytes, voxels: bytes) -> Volume:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "channel.nii"
        file.write_bytes(head + voxels)
        try:
            volume = io.read(file)
        except InputError as error:
            raise type(error)(error.message.replace(str(file), str(path)), error.hint) from None
    return replace(volume, source=path)
