"""Sequences of images in memory."""

import numpy as np
import pytest

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence


def volume(value: float, spacing: float = 1.0) -> Volume:
    return Volume(np.full((2, 3, 4), value, np.float32), Geometry((2, 3, 4), (spacing, 1.0, 1.0)))


def test_frames_come_out_in_order_with_their_times() -> None:
    sequence = VolumeSequence([volume(0), volume(1)], times=[0.5, 2.0])
    assert len(sequence) == 2 and sequence.times == (0.5, 2.0) and sequence.time_unit == "s"
    assert [float(sequence.frame(n).array[0, 0, 0]) for n in range(2)] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("volumes", "times"),
    [
        ([], None),
        ([volume(0), volume(1, 2.0)], None),
        ([volume(0)] * 2, [1.0, 1.0]),
        ([volume(0)], [1.0, 2.0]),
    ],
)
def test_frames_that_are_no_sequence_are_refused(
    volumes: list[Volume], times: list[float] | None
) -> None:
    with pytest.raises(InputError):
        VolumeSequence(volumes, times).frame(1)


def test_a_frame_that_is_not_there_is_refused() -> None:
    with pytest.raises(UsageError, match="0 to 0"):
        VolumeSequence([volume(0)]).frame(1)
