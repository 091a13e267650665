"""How many cases run at once, by cores and memory; what a header says about memory."""

import numpy as np
import pytest

from accelsurf import io
from accelsurf.batch.admission import Admission, Need, admit, need_of, plan_rows
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.channels import count_values
from accelsurf.run.memory import PROCESS_BYTES, memory_of

GB = 10**9


@pytest.mark.parametrize("suffix", ["nii", "nii.gz", "nrrd", "mha", "mhd", "tif"])
def test_values_are_counted_by_the_header_alone(suffix, tmp_path):
    path = tmp_path / f"a.{suffix}"
    io.write(Volume(np.zeros((4, 5, 6), np.uint16), Geometry((4, 5, 6), (1.0, 1.0, 1.0))), path)
    assert count_values(path) == 120
    if suffix == "nii":  # a claim without its voxels counts for nothing
        path.write_bytes(path.read_bytes()[:360])
        with pytest.raises(InputError, match="announces 592 bytes of voxels, the file holds 360"):
            count_values(path)


def test_a_png_has_its_pixels(tmp_path):
    io.write(
        Volume(np.zeros((1, 5, 6), np.uint8), Geometry((1, 5, 6), (1.0, 1.0, 1.0))),
        tmp_path / "a.png",
    )
    assert count_values(tmp_path / "a.png") == 30


def test_channels_and_clicks_need_more(tmp_path):
    path = tmp_path / "a.nii"
    io.write(
        Volume(np.zeros((40, 50, 60), np.uint8), Geometry((40, 50, 60), (1.0, 1.0, 1.0))), path
    )
    one, two, clicks = need_of(path), need_of(path, [path]), need_of(path, clicks=True)
    assert (
        need_of(path, flow="region-mass").bytes > one.bytes == need_of(path, flow="sobolev").bytes
    )
    assert (one.values, two.values) == (120_000, 240_000)
    assert two.bytes - PROCESS_BYTES == 2 * (one.bytes - PROCESS_BYTES)
    assert clicks.bytes > one.bytes > PROCESS_BYTES


def test_a_header_that_cannot_be_read_is_a_problem_and_no_error(tmp_path):
    (tmp_path / "a.nii").write_bytes(b"no image")
    assert need_of(tmp_path / "a.nii").values is None and need_of(tmp_path / "a.nii").problem
    assert "no such file" in need_of(tmp_path / "absent.nii").problem


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (dict(), (8, 1)),  # a case on each core
        (dict(count=3), (3, 2)),  # no more than there are
        (dict(free=4 * GB), (3, 2)),  # 3.2 GB hold three
        (dict(free=GB // 2), (1, 8)),  # none fits: one at a time
        (dict(jobs=5), (5, 1)),
        (dict(jobs=20), (20, 1)),
        (dict(threads=4), (2, 4)),
        (dict(jobs=3, threads=7), (3, 7)),
        (dict(memory=2 * GB), (2, 4)),
    ],
)
def test_jobs_times_threads_are_the_cores(given, expected):
    settings = {"cores": 8, "free": 100 * GB, "count": 20, **given}
    needs = [Need(1, GB)] * settings.pop("count")
    found = admit(needs, settings.pop("cores"), settings.pop("free"), **settings)
    assert (found.jobs, found.threads) == expected


def test_one_large_case_does_not_slow_the_others_down():
    needs = [*[Need(1, GB)] * 9, Need(1, 50 * GB)]
    assert admit(needs, 8, 100 * GB).jobs == 8
    assert admit(needs, 8, 100 * GB).bytes == 80 * GB


@pytest.mark.parametrize("text", ["", "4 apples", "-1GB", "0", "1e9", "100kB", "4GB."])
def test_sizes_that_are_none(text):
    with pytest.raises(UsageError, match="--max-memory"):
        memory_of(text)


def test_the_plan_says_what_waits_and_what_cannot_run():
    needs = {
        "a": Need(8, GB),
        "b": Need(8, 3 * GB),
        "c": Need(8, 9 * GB),
        "d": Need(None, 0, "no image"),
    }
    rows = {line[0]: line[1:] for line in plan_rows(needs, Admission(2, 1, 4 * GB))}
    assert rows["a"] == ("8", "1 GB", "")
    assert rows["b"] == ("8", "3 GB", "waits for room")
    assert "is not run" in rows["c"][2] and rows["d"] == ("-", "-", "no image")
