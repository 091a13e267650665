"""Several sequences of one scene as the channels of one, as the settings of a tracking name them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from accelsurf.errors import GeometryError, InputError
from accelsurf.image.sequence import ImageSequence
from accelsurf.image.volume import Volume
from accelsurf.io import read_sequence
from accelsurf.settings.track_config import TrackConfig


class JoinedSequence(ImageSequence):
    """The channels of several sequences, frame by frame; times and grid are those of the first.

    Parameters
    ----------
    first : ImageSequence
    others : sequence of ImageSequence

    Raises
    ------
    InputError
        When they have different numbers of frames; GeometryError when grids differ.
    """

    def __init__(self, first: ImageSequence, others: Sequence[ImageSequence]) -> None:
        self._sequences = (first, *others)
        self.times, self.time_unit, self.geometry, self.source = (
            first.times, first.time_unit, first.geometry, first.source,
        )
        self.notes = tuple(dict.fromkeys(note for sequence in self._sequences for note in sequence.notes))
        for sequence in others:
            if len(sequence) != len(first):
                raise InputError(f"channel {sequence.source}: it has {len(sequence)} frames, {len(first)} expected")
            if difference := first.geometry.difference(sequence.geometry):
                raise GeometryError(f"channel {sequence.source}: on another grid than the first: {difference}")

    @property
    def frame_values(self) -> int:
        """Number of values of a frame, all channels together."""
        return sum(sequence.frame_values for sequence in self._sequences)

    def _channels(self, number: int) -> list[Volume]:
        return [volume for sequence in self._sequences for volume in sequence.channels(number)]


def open_sequence(source: Path, config: TrackConfig) -> ImageSequence:
    """Open what is tracked, with the channels that the settings add; the headers are read.

    Parameters
    ----------
    source : Path
        A file with time, a folder of frames, or a pattern of their names.
    config : TrackConfig

    Raises
    ------
    InputError, UsageError
        As `accelsurf.read_sequence`; InputError and GeometryError where channels do not fit together.
    """
    first, *others = (
        read_sequence(
            path, frame_time=config.frame_time, frames_from_slices=config.frames_from_slices,
            options=config.run.reading,
        )
        for path in (source, *(Path(file) for file in config.run.channel))
    )
    return JoinedSequence(first, others) if others else first
