"""Sequences written as a NIfTI of four axes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.io.formats.nifti import COMMENT_CODE
from accelsurf.io.formats.nifti_volumes import extension_with, header_of, opened_nifti
from accelsurf.io.headers import TIMES_KEY, single_precision

if TYPE_CHECKING:
    from accelsurf.io.sequences.writing import FrameStack


def write_frames(path: Path, frames: FrameStack) -> None:
    """Write a sequence as a NIfTI of four axes, compressed where its name says so."""
    times = frames.times
    is_plain = times.is_count or (
        times.seconds is not None and single_precision(times.seconds) == times.seconds
    )
    extension = b"" if is_plain else extension_with(COMMENT_CODE, f"{TIMES_KEY}: {times.text}")
    with opened_nifti(path) as out:
        out.write(header_of(frames.geometry, frames.dtype, {}, extension, times))
        for array in frames:
            out.write(array.data)
