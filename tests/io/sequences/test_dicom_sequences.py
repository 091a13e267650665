"""DICOM at several times as a sequence: cine of a heart, enhanced files, loops of pictures."""

from __future__ import annotations

import numpy as np
import pytest
from pydicom.dataset import Dataset

from accelsurf import cli, io
from accelsurf.errors import InputError
from accelsurf.settings.reading import ReadOptions
from tests.support.dicom_series import Series, enhanced, save, values_at

COUNT, TIMES = 3, 4


def cine(folder, change=lambda one, n, z: None, times=TIMES, leave_out=()):
    """Slices at ``COUNT`` places at several times, values higher by 100 n at time n; files are not in their order."""
    series = Series().stacked(COUNT)
    for n in range(times):
        for z in range(COUNT):
            if (n, z) in leave_out:
                continue
            one = series.dataset(z)
            one.SOPInstanceUID, one.InstanceNumber = f"1.2.3.4.5.{n}.{z}", 1 + z * times + n
            one.PixelData = (
                (values_at(series.points(series.positions[z])) + 100 * n).astype(np.int16).tobytes()
            )
            change(one, n, z)
            save(one, folder / f"{(7 * n + 5 * z) % 23:02d}_{n}{z}.dcm")
    return series


def trigger(one, n, z):
    """Each slice is of another beat: its times differ a little from those of the others."""
    one.TriggerTime = 40.0 * n + 0.25 * z


def check(sequence, series, times):
    assert len(sequence) == len(times)
    assert sequence.times == pytest.approx(times)
    first = values_at(np.stack([series.points(position) for position in series.positions]))
    for n in (2, 0, len(times) - 1):
        frame = sequence.frame(n)
        np.testing.assert_array_equal(frame.array, first + 100 * n)
        assert frame.geometry.spacing == pytest.approx((2.0, 0.5, 0.75))
        assert frame.geometry.origin == pytest.approx((10.0, -20.0, 30.0))


def test_a_heart_by_its_trigger_times(tmp_path):
    series = cine(tmp_path, trigger)
    sequence = io.read_sequence(tmp_path)
    assert sequence.time_unit == "s"
    check(sequence, series, [0.0, 0.04, 0.08, 0.12])


@pytest.mark.parametrize(
    ("name", "value", "times", "unit"),
    [
        ("TemporalPositionIdentifier", lambda n: n + 1, [0, 1, 2, 3], "frame"),
        ("AcquisitionTime", lambda n: f"1011{12 + 5 * n:02d}.5", [0, 5, 10, 15], "s"),
        ("ContentTime", lambda n: f"10{11 + n}00", [0, 60, 120, 180], "s"),
        (
            "SeriesDescription",
            lambda n: "phantom",
            [0, 1, 2, 3],
            "frame",
        ),  # nothing but the numbers of the files
    ],
)
def test_times_of_other_kinds(tmp_path, name, value, times, unit):
    series = cine(tmp_path, lambda one, n, z: setattr(one, name, value(n)))
    sequence = io.read_sequence(tmp_path)
    assert sequence.time_unit == unit
    check(sequence, series, times)
    assert io.read_sequence(tmp_path, frame_time=0.5).times == (0.0, 0.5, 1.0, 1.5)


def test_an_enhanced_file(tmp_path):
    series = Series().stacked(COUNT)
    series.positions = series.positions * TIMES
    one = enhanced(series)
    first = values_at(np.stack([series.points(position) for position in series.positions[:COUNT]]))
    one.PixelData = (
        np.concatenate([first + 100 * n for n in range(TIMES)]).astype(np.int16).tobytes()
    )
    for number, frame in enumerate(one.PerFrameFunctionalGroupsSequence):
        frame.FrameContentSequence[0].TemporalPositionIndex = 1 + number // COUNT
        heart = Dataset()
        heart.NominalCardiacTriggerDelayTime = 25.0 * (number // COUNT)
        frame.CardiacSynchronizationSequence = [heart]
    save(one, tmp_path / "heart.dcm")
    sequence = io.read_sequence(tmp_path / "heart.dcm")
    series.positions = series.positions[:COUNT]
    check(sequence, series, [0.0, 0.025, 0.05, 0.075])


@pytest.mark.parametrize(
    ("change", "times"),
    [
        ({"FrameTime": 30.0}, [0.0, 0.03, 0.06]),
        ({"FrameTimeVector": [0.0, 20.0, 40.0]}, [0.0, 0.02, 0.06]),
        ({"CineRate": 25}, [0.0, 0.04, 0.08]),
    ],
)
def test_a_loop_of_pictures(tmp_path, change, times):
    one = Series(changes=change).stacked(1).dataset(0)
    for name in ("ImagePositionPatient", "ImageOrientationPatient", "InstanceNumber"):
        delattr(one, name)
    one.NumberOfFrames = 3
    pixels = np.arange(3 * one.Rows * one.Columns, dtype=np.int16).reshape(3, one.Rows, one.Columns)
    one.PixelData = pixels.tobytes()
    save(one, tmp_path / "loop.dcm")
    sequence = io.read_sequence(tmp_path / "loop.dcm")
    assert sequence.times == pytest.approx(times) and sequence.time_unit == "s"
    np.testing.assert_array_equal(sequence.frame(1).array, pixels[1:2])
    assert "do not say where the pictures lie" in sequence.notes[0]


def test_what_is_incomplete_or_of_several_contrasts_is_refused(tmp_path):
    cine(tmp_path / "lost", trigger, leave_out={(2, 1)})
    with pytest.raises(InputError, match="4 times were found at one place and 3 at another"):
        io.read_sequence(tmp_path / "lost")

    def phases(one, n, z):
        trigger(one, n // 2, z)
        one.ImageType = ["ORIGINAL", "PRIMARY", "MP"[n % 2]]

    series = cine(tmp_path / "two", phases)
    with pytest.raises(InputError, match="differ in type, not in time alone"):
        io.read_sequence(tmp_path / "two")
    cine(tmp_path / "one", trigger, times=1)
    with pytest.raises(InputError, match="one image given, a sequence expected"):
        io.read_sequence(tmp_path / "one")
    assert series.uid == "1.2.3.4.5"


def test_one_of_several_series_is_chosen(tmp_path):
    series = cine(tmp_path / "a", trigger)
    cine(
        tmp_path / "b",
        lambda one, n, z: (trigger(one, n, z), setattr(one, "SeriesInstanceUID", "1.9")),
        times=2,
    )
    with pytest.raises(InputError, match="2 series at several times"):
        io.read_sequence(tmp_path)
    selected = io.read_sequence(tmp_path, options=ReadOptions(series=series.uid))
    check(selected, series, [0.0, 0.04, 0.08, 0.12])


def test_a_reader_of_one_image_names_tracking_and_tracking_reads_it(tmp_path, capsys):
    def disc(one, n, z):
        one.TemporalPositionIdentifier = n + 1
        y, x = np.indices((one.Rows, one.Columns))
        inside = np.hypot((y - 15) * 0.5, (x - 12 - n) * 0.75) < 4
        one.PixelData = (1000 * inside).astype(np.int16).tobytes()

    folder = tmp_path / "heart"
    series = Series(rows=32, columns=32).stacked(6, step=1.0)
    for n in range(3):
        for z in range(6):
            one = series.dataset(z)
            one.SOPInstanceUID = f"1.2.3.4.5.{n}.{z}"
            disc(one, n, z)
            save(one, folder / f"{n}{z}.dcm")
    with pytest.raises(InputError, match="3 volumes are in it") as caught:
        io.read(folder)
    assert "accelsurf track takes all as frames" in caught.value.hint
    command = [
        "track",
        str(folder),
        "-o",
        str(tmp_path / "out"),
        "--start",
        "otsu",
        "--threads",
        "1",
    ]
    assert cli.execute(command) == 0
    table = (tmp_path / "out/heart_tracks.csv").read_text().splitlines()
    assert len(table) == 4
