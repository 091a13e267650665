"""Which channels and time points of a file are the image."""

from __future__ import annotations

from accelsurf.errors import InputError, UsageError
from accelsurf.settings.reading import ReadOptions

#: More volumes than this are no channels.
MAX_CHANNELS = 16


def selected(channels: int, time_points: int, options: ReadOptions) -> list[tuple[int, int]]:
    """The (time point, channel) of each volume that is read as a channel of the image.

    Parameters
    ----------
    channels, time_points : int
        How many of them the file has.
    options : ReadOptions
        What was asked for.

    Raises
    ------
    InputError
        For a sequence of which no time point was named, and for more than `MAX_CHANNELS` channels.
    UsageError
        When there is no such channel or time point.

    Examples
    --------
    >>> selected(2, 3, ReadOptions(time_index=1)), selected(1, 3, ReadOptions(channels_from_time=True))
    ([(1, 0), (1, 1)], [(0, 0), (1, 0), (2, 0)])
    """
    if options.channels_from_time and options.time_index is not None:
        raise UsageError("channels-from-time and time-index exclude each other", "leave one of them out")
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
        hint = f"say which: --channel-index 0 to {channels - 1} (channel_index=0)" if channels > 1 else "extract one"
        raise InputError(f"an image of {len(found)} channels given, one expected", hint)
    return found[0]


def check_channels(count: int) -> None:
    """Refuse an image of too many channels.

    Raises
    ------
    InputError
        For more than `MAX_CHANNELS`.
    """
    if count > MAX_CHANNELS:
        raise InputError(
            f"{count} channels or time points, expected at most {MAX_CHANNELS}", "extract one of them first"
        )


def check_index(name: str, plural: str, n: int, asked: int | None) -> None:
    """Refuse an index beyond an axis.

    Raises
    ------
    UsageError
    """
    if asked is not None and not 0 <= asked < n:
        raise UsageError(f"{name} {asked} asked for, the image has {n} {plural}", f"give 0 to {n - 1}")
