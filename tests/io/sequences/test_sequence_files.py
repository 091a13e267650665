"""Sequences written and read again: voxels, grid and times, in any order of frames; all of it or nothing."""

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.writing import stored_grid

TURNED = Geometry((3, 4, 5), (3.0, 0.5, 0.7), (5.5, -6.0, 7.25), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
FRAMES = np.random.default_rng(0).integers(0, 250, (4, 3, 4, 5))
SUFFIXES = (".nii", ".nii.gz", ".ome.zarr", ".tif")
TIMES = [
    ((0.0, 1.0, 2.0, 3.0), "frame"),
    ((0.0, 0.04, 0.08, 0.12), "s"),
    ((0.5, 1.25, 4.0, 1e3 / 3), "s"),
    ((0.0, 1.0, 3.0, 4.0), "frame"),
]


def write(path, order=(0, 1, 2, 3), times=TIMES[0], dtype=np.uint8, geometry=TURNED):
    with io.SequenceWriter(path, geometry, *times, dtype) as writer:
        for number in order:
            writer.write(number, FRAMES[number].astype(dtype))
    return path


def folder_contents(path):
    files = [path] if path.is_file() else sorted(one for one in path.rglob("*") if one.is_file())
    return [(one.name, one.read_bytes()) for one in files]


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("times", TIMES)
def test_what_was_written_is_read_back_exactly(tmp_path, suffix, times):
    path = write(tmp_path / f"a{suffix}", times=times)
    found = accelsurf.read_sequence(path)
    assert (found.times, found.time_unit) == times
    assert stored_grid(TURNED, suffix).difference(found.geometry) == ""
    for number in (3, 0, 2, 1):
        frame = found.frame(number)
        np.testing.assert_array_equal(frame.array, FRAMES[number].astype(np.uint8), strict=True)
        assert frame.geometry is found.geometry
    with pytest.raises(UsageError, match="frame 4 given"):
        found.frame(4)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_bytes_do_not_depend_on_the_order_of_frames(tmp_path, suffix):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
    one = write(tmp_path / "one" / f"a{suffix}", times=TIMES[2], dtype=np.int16)
    two = write(tmp_path / "two" / f"a{suffix}", (2, 3, 1, 0), times=TIMES[2], dtype=np.int16)
    assert folder_contents(one) == folder_contents(two)
