"""Sequences of images: a file with a time axis, a folder of frames. Frames are read when they are asked for."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.errors import InputError, UsageError
from accelsurf.image.sequence import ImageSequence
from accelsurf.io import headers
from accelsurf.io.files import naming
from accelsurf.io.format_functions import functions_of
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

if TYPE_CHECKING:
    from accelsurf.io.sequences.sources import FileSequence

#: A step between frames that can be meant, seconds.
_SHORTEST = 1e-15
_LONGEST = 1e12


def read_sequence(
    path: str | os.PathLike[str],
    *,
    frame_time: float | None = None,
    frames_from_slices: bool = False,
    options: ReadOptions = AS_IT_IS,
    memory_bytes: int | None = None,
) -> ImageSequence:
    """Open a sequence of images: its headers are read now, a frame when it is asked for.

    Parameters
    ----------
    path : path-like
        A NIfTI, NRRD or MetaImage with a fourth axis, an OME-Zarr or TIFF with an axis T, an .npy (t, z, y, x), a
        folder of frames or a pattern of their names (``frames/*.tif``; in the order of the numbers in them).
    frame_time : float, optional
        Seconds from one frame to the next; by default from the file. Where it says nothing the frames are counted.
    frames_from_slices : bool
        Whether the slices of one volume are the frames, as of a stack in TIFF that does not name its axis.
    options : ReadOptions, optional
        As for `accelsurf.io.read`.
    memory_bytes : int, optional
        Memory to plan with; by default the available memory when a frame is read.

    Returns
    -------
    ImageSequence
        ``notes`` has warnings for the user, as on gaps in the numbers of files.

    Raises
    ------
    InputError
        As `accelsurf.io.read`, and when there is no sequence, or the frames lie on several grids.
    UsageError
        When the format does not have a requested option, or ``frame_time`` is no positive number.
    """
    found = open_sequence(
        path,
        frame_time=frame_time,
        frames_from_slices=frames_from_slices,
        options=options,
        memory_bytes=memory_bytes,
    )
    if len(found) < 2:
        raise InputError(
            f"{path}: one image given, a sequence expected",
            "give a file with a time axis, a folder of frames, or a pattern, as 'frames/*.tif'; where the slices are "
            "the frames, add --frames-from-slices (frames_from_slices=True)",
        )
    return found


def is_sequence(path: Path, options: ReadOptions) -> bool:
    """Test if a path has several images in time: a file with time points, or a folder of volumes.

    A folder or pattern of slices is an image: only tracks tell that its slices are frames.

    Parameters
    ----------
    path : Path
    options : ReadOptions
        Time points that are asked for as channels are none.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    if headers.is_pattern(path):
        return False
    if path.is_dir() and not headers.is_stored(path):
        try:
            headers.format_of(path)
        except InputError:  # no image by itself
            return any(headers.split_name(entry)[1] for entry in path.iterdir())
        return False
    with naming(path):
        form = headers.format_of(path)
        if "time_index" not in form.options or options.channels_from_time:
            return False
        return (
            headers.header_counts(path, replace(options.restricted_to(form.options), level=0))[1]
            > 1
        )


def open_sequence(
    path: str | os.PathLike[str],
    *,
    frame_time: float | None = None,
    frames_from_slices: bool = False,
    options: ReadOptions = AS_IT_IS,
    memory_bytes: int | None = None,
) -> FileSequence:
    """Open a sequence as `read_sequence` does, also where there is one frame only."""
    # Not before it is needed: this loads ITK, and the reader of stacks.
    from accelsurf.io.sequences.sources import FileFrames, FrameFolder, SliceFrames, holds_frames

    path = Path(path)
    if frame_time is not None and not _SHORTEST <= frame_time <= _LONGEST:
        raise UsageError(f"frame time {frame_time:g} given, a positive number of seconds expected")
    if options.time_index is not None or options.channels_from_time:
        raise UsageError(
            "a sequence is all time points: time-index and channels-from-time do not go with it"
        )
    with naming(path):
        found: FileSequence
        if frames_from_slices:
            found = SliceFrames(path, options, memory_bytes)
        elif holds_frames(path):
            found = FrameFolder(path, options, memory_bytes)
        else:
            form = headers.format_of(path)
            kind = functions_of(form).sequence or FileFrames
            found = kind(path, options, memory_bytes)
        if frame_time is not None:
            found.set_step(frame_time)
    return found
