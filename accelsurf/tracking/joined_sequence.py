"""Several sequences of one scene as the channels of one."""

from __future__ import annotations

from collections.abc import Sequence

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.sequence import ImageSequence
from accelsurf.grid.volume import Volume


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
        for one in others:
            if len(one) != len(first):
                raise InputError(f"channel {one.source}: it has {len(one)} frames, {len(first)} expected")
            if difference := first.geometry.difference(one.geometry):
                raise GeometryError(f"channel {one.source}: on another grid than the first: {difference}")

    def _channels(self, number: int) -> list[Volume]:
        return [volume for one in self._sequences for volume in one.channels(number)]
