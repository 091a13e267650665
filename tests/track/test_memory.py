"""The memory of a tracking is that of a few frames, however long the sequence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from accelsurf import io
from accelsurf.phantoms.motions import MovingPhantom, motion_from

pytestmark = pytest.mark.program

_RUN = """
import resource, sys
from accelsurf.io import read_sequence
from accelsurf.track.track import track
for result in track(read_sequence(sys.argv[1]), start="otsu", threads=1, levels=1):
    del result
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
SIDE = 80


def peak_kb(folder: Path, frames: int) -> int:
    """Peak memory of a process that tracks a ball from a file."""
    values = {
        "motion": "translation",
        "shape": [SIDE] * 3,
        "radius": 10.0,
        "speed": 0.5,
        "frames": frames,
    }
    phantom = MovingPhantom(motion_from({**values, "noise": 0.1}, "long"))
    path = folder / f"{frames}.nii"
    with io.SequenceWriter(
        path, phantom.geometry, phantom.times, phantom.time_unit, "float32"
    ) as writer:
        for number in range(frames):
            writer.write(number, phantom.frame(number).array)
    done = subprocess.run(
        [sys.executable, "-c", _RUN, str(path)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


@pytest.mark.slow
def test_a_long_sequence_needs_no_more_memory_than_a_short_one(tmp_path: Path) -> None:
    """27 frames more are 55 MB in the file; the peak grows by less than two frames."""
    short, long = peak_kb(tmp_path, 5), peak_kb(tmp_path, 32)
    frame = SIDE**3 * 4 / 1024
    print(f"\n{short / 1024:.0f} MB, {long / 1024:.0f} MB, a frame {frame / 1024:.1f} MB")
    assert long - short < 2 * frame
