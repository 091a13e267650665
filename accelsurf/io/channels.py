"""Channels of images: which of a file are read, each as a volume on one grid, and colours as grey."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import with_warnings
from accelsurf.io.memory import available_memory
from accelsurf.settings.file_formats import ImageFormat
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

#: More volumes than this are no channels.
MAX_CHANNELS = 16
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Parts of red, green and blue in the brightness of a colour (ITU-R BT.709)."""


def selected(channels: int, time_points: int, options: ReadOptions) -> list[tuple[int, int]]:
    """The (time point, channel) of each volume that is read as a channel of the image.

    Parameters
    ----------
    channels, time_points : int
        How many of them the file has.
    options : ReadOptions
        The requested channel or time point.

    Raises
    ------
    InputError
        For a sequence of which no time point was named, and for more than `MAX_CHANNELS` channels.
    UsageError
        When the channel or time point does not exist.

    Examples
    --------
    >>> selected(2, 3, ReadOptions(time_index=1)), selected(1, 3, ReadOptions(channels_from_time=True))
    ([(1, 0), (1, 1)], [(0, 0), (1, 0), (2, 0)])
    """
    if options.channels_from_time and options.time_index is not None:
        raise UsageError(
            "channels-from-time and time-index exclude each other", "leave one of them out"
        )
    check_index("time", "time points", time_points, options.time_index)
    check_index("channel", "channels", channels, options.channel_index)
    several_times = options.time_index is None and time_points > 1
    if several_times and not options.channels_from_time:
        raise InputError(
            f"a sequence of {time_points} time points given, one image expected",
            f"say which: --time-index 0 to {time_points - 1}, or take them for channels: --channels-from-time",
        )
    several_channels = options.channel_index is None and channels > 1
    if several_times and several_channels:
        raise InputError(
            f"{channels} channels at {time_points} time points given, which cannot all be channels of one image",
            f"say which channel: --channel-index 0 to {channels - 1}",
        )
    check_channels((time_points if several_times else 1) * (channels if several_channels else 1))
    times = range(time_points) if several_times else [options.time_index or 0]
    which = range(channels) if several_channels else [options.channel_index or 0]
    return [(t, c) for t in times for c in which]


def single(channels: int, time_points: int, options: ReadOptions) -> tuple[int, int]:
    """The (time point, channel) of an image of one channel.

    Raises
    ------
    InputError
        As `selected`, and for several channels of which none was named.
    """
    found = selected(channels, time_points, options)
    if len(found) > 1:
        hint = (
            f"say which: --channel-index 0 to {channels - 1} (channel_index=0)"
            if channels > 1
            else "extract one"
        )
        raise InputError(f"an image of {len(found)} channels given, one expected", hint)
    return found[0]


def values_read(header: Any, options: ReadOptions) -> int:
    """Count the values of the channels of an image that are read, by its header.

    Raises
    ------
    InputError
        As `selected`.
    """
    places = selected(getattr(header, "channels", 1), getattr(header, "time_points", 1), options)
    return math.prod(header.geometry.shape) * len(places)


def count_values(path: Path, options: ReadOptions = AS_IT_IS) -> int:
    """Count the values of an image, all channels together, by its header alone.

    Raises
    ------
    InputError
        As `accelsurf.io.headers.parse`, without the name of the file.

    Examples
    --------
    >>> count_values(Path("absent.nii"))
    Traceback (most recent call last):
    ...
    accelsurf.errors.InputError: there is no such file
    hint: check the path
    """
    _, header = headers.parse_header(path, options)
    return values_read(header, options)


def check_channels(count: int) -> None:
    """Refuse an image of too many channels.

    Raises
    ------
    InputError
        For more than `MAX_CHANNELS`.
    """
    if count > MAX_CHANNELS:
        raise InputError(
            f"{count} channels or time points, expected at most {MAX_CHANNELS}",
            "extract one of them first",
        )


def check_index(name: str, plural: str, n: int, asked: int | None) -> None:
    """Refuse an index beyond an axis.

    Raises
    ------
    UsageError
    """
    if asked is not None and not 0 <= asked < n:
        raise UsageError(
            f"{name} {asked} asked for, the image has {n} {plural}", f"give 0 to {n - 1}"
        )


def to_grey(array: NDArray[Any]) -> tuple[NDArray[Any], str]:
    """Convert red, green, blue (and alpha) to one value per pixel; return also a note on this for the user.

    Parameters
    ----------
    array : ndarray, shape (..., 3) or (..., 4)
        Colours of an unsigned type; the fourth is the opacity.

    Returns
    -------
    ndarray, str
        Where the three are equal everywhere, that value, unchanged; else the luminance as float32. The note is empty
        when nothing was decided.

    Examples
    --------
    >>> import numpy as np
    >>> to_grey(np.array([[[7, 7, 7], [9, 9, 9]]], dtype=np.uint8))
    (array([[7, 9]], dtype=uint8), '')
    """
    notes = []
    red = array[..., 0]
    green = array[..., 1]
    blue = array[..., 2]
    if np.array_equal(red, green) and np.array_equal(red, blue):
        grey = np.ascontiguousarray(red)
    else:
        grey = np.zeros(red.shape, np.float32)
        for part, channel in zip(LUMINANCE, (red, green, blue), strict=True):
            grey += np.float32(part) * channel
        notes.append(
            "a colour image: its luminance (0.2126 R + 0.7152 G + 0.0722 B) is used; "
            "extract a channel first if the object differs in colour more than in brightness"
        )
    if array.shape[-1] == 4 and (array[..., 3] != np.iinfo(array.dtype).max).any():
        notes.append("the image is transparent in places, which is ignored")
    return grey, "; ".join(notes)


def read_channels(path: str | os.PathLike[str], options: ReadOptions = AS_IT_IS) -> list[Volume]:
    """Read an image of one or more channels.

    Parameters
    ----------
    path : path-like
        As for `accelsurf.io.read`; also a NIfTI of vectors or with a few volumes along its fourth axis, or an NRRD or
        MetaImage of vectors.
    options : ReadOptions, optional
        As for `accelsurf.io.read`; a channel index leaves one channel.

    Returns
    -------
    list of Volume
        The channels in their order, without constant ones; one for an ordinary image.

    Raises
    ------
    InputError
        As `accelsurf.io.read`, and for more than 16 channels.
    """
    path = Path(path)
    with naming(path):
        form, header = headers.parse_header(path, options)
        return _with_content(read_volumes(path, form, header, available_memory()))


def _with_content(channels: list[Volume]) -> list[Volume]:
    """The channels in which something is seen, with a warning that names the others; all where nothing is in any.

    A channel of one value tells nothing of an object, and has no scale.
    """
    blank = [number for number, channel in enumerate(channels) if is_blank(channel.array)]
    if not blank or len(blank) == len(channels):
        return channels
    names = ", ".join(f"{number} ({channels[number].array.flat[0]:g})" for number in blank)
    note = (
        f"{'channels' if len(blank) > 1 else 'channel'} {names} of 0 to {len(channels) - 1} "
        f"{'have' if len(blank) > 1 else 'has'} one value everywhere and {'are' if len(blank) > 1 else 'is'} left out"
    )
    first, *more = (channel for number, channel in enumerate(channels) if number not in blank)
    said = with_warnings(first.metadata, note)
    return [Volume(first.array, first.geometry, said, first.source), *more]


def is_blank(array: NDArray[Any]) -> bool:
    """Test if all voxels have the same value."""
    first = array.flat[0]
    # A look at a few voxels tells nearly all images apart from blank ones.
    return bool(
        (array.ravel()[:: max(array.size >> 10, 1)] == first).all() and (array == first).all()
    )


def read_volumes(path: Path, form: ImageFormat, header: Any, available: int) -> list[Volume]:
    """Read the channels of an image whose header was read, within a number of bytes of memory."""
    functions = functions_of(form)
    if functions.read_channels is None:
        return [functions.read(path, header, available)]
    volumes: list[Volume] = functions.read_channels(path, header, available)
    return volumes


def read_further(paths: tuple[str, ...], options: ReadOptions = AS_IT_IS) -> list[Volume]:
    """Read the files that add channels, in order.

    Parameters
    ----------
    paths : tuple of str
    options : ReadOptions, optional
        Options of the image; a file is read with the ones that its format has.

    Raises
    ------
    UsageError
        When a path is empty.
    """
    if any(not path for path in paths):
        raise UsageError("channel: nothing was given, expected a file", "write --channel FILE")
    return [
        volume
        for path in paths
        for volume in read_channels(path, options.restricted_to(headers.options_of(path)))
    ]
