"""DICOM from the command line: a list of series, a run on one, errors in one line."""

import json
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import cli, io

pytest.importorskip("pydicom")

from tests.support.dicom_series import Series, save


def ball_series(folder, **changes):
    """A CT of a ball: 300 inside, 0 outside, oblique, 24 slices."""
    series = Series(
        rows=28, columns=30, spacing=(1.0, 1.0), orientation=(0.6, 0.8, 0, 0, 0, -1), **changes
    )
    series.stacked(24, 1.5)
    middle = series.points(series.positions[12])[14, 15]
    for number in range(24):
        one = series.dataset(number)
        far = np.linalg.norm(series.points(series.positions[number]) - middle, axis=-1)
        one.PixelData = np.where(far < 9, 300, 0).astype(np.int16).tobytes()
        save(one, folder / f"IM{number:04d}")
    return middle


def test_info_lists_the_volumes_of_a_folder(tmp_path, capsys):
    ball_series(tmp_path / "study" / "a")
    gap = Series(
        uid="1.2.3.8", changes={"SeriesNumber": 7, "SeriesDescription": "with a gap"}
    ).stacked(5)
    del gap.positions[2]
    gap.write(tmp_path / "study" / "b")
    assert cli.execute(["info", str(tmp_path / "study")]) == 0
    said = capsys.readouterr().out
    assert (
        "1  CT phantom\n   30 x 28 x 24 voxels of 1 x 1 x 1.5 mm, oblique, near sagittal, HU"
        in said
    )
    assert (
        "2  CT with a gap" in said
        and "warning: 1 slice missing: 4 mm between b/001.dcm, b/002.dcm" in said
    )
    assert cli.execute(["info", "--json", str(tmp_path / "study")]) == 0
    volumes = json.loads(capsys.readouterr().out)["volumes"]
    assert [one["number"] for one in volumes] == [1, 2] and volumes[0]["size"] == [30, 28, 24]
    assert cli.execute(["info", str(tmp_path / "study"), "--series", "1"]) == 0
    assert "size" in capsys.readouterr().out


def test_a_series_is_segmented_where_it_lies(tmp_path, capsys):
    middle = ball_series(tmp_path / "study" / "a")
    Series(uid="1.2.3.8").stacked(5).write(tmp_path / "study" / "b")
    place = ",".join(f"{part:.3f}" for part in middle)
    words = [
        "segment",
        str(tmp_path / "study"),
        "-o",
        str(tmp_path / "out"),
        "--inside",
        f"ball:{place},3",
    ]
    assert cli.execute(words) == 3
    assert "2 volumes are in it" in capsys.readouterr().err
    assert cli.execute([*words, "--series", "1.2.3.4.5", "--threads", "1"]) == 0
    labels = io.read_labels(tmp_path / "out" / "study_seg.nii.gz")
    centre = labels.geometry.index_to_world(np.argwhere(labels.array).mean(axis=0))
    assert np.linalg.norm(centre - middle) < 0.4
    volume = json.loads((tmp_path / "out" / "study_report.json").read_text())["volume_mm3"]
    assert volume == pytest.approx(4 / 3 * np.pi * 9**3, rel=0.1)


def test_a_gap_ends_with_code_3(tmp_path, capsys):
    ball_series(tmp_path / "scan")
    (tmp_path / "scan" / "IM0003").unlink()
    words = ["look", str(tmp_path / "scan"), "-o", str(tmp_path / "look.png")]
    assert cli.execute(words) == 3
    assert "1 slice missing: 3 mm between IM0002, IM0004" in capsys.readouterr().err


def test_an_option_that_a_format_has_not_is_refused(tmp_path, capsys):
    ball_series(tmp_path / "scan")
    assert (
        cli.execute(
            ["look", str(tmp_path / "scan"), "-o", str(tmp_path / "a.png"), "--time-index", "1"]
        )
        == 2
    )
    assert capsys.readouterr().err.startswith("error: ")


def test_without_the_package_one_line_names_the_extra(tmp_path):
    ball_series(tmp_path / "scan")
    code = (
        "import sys; sys.modules['pydicom'] = None\n"
        "from accelsurf import cli\n"
        f"sys.exit(cli.execute(['look', {str(tmp_path / 'scan')!r}, '-o', {str(tmp_path / 'a.png')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 3 and 'pip install "accelsurf[dicom]"' in done.stderr


@pytest.mark.slow
def test_the_result_goes_back_as_dicom_the_same_bytes_twice(tmp_path):
    highdicom = pytest.importorskip("highdicom")
    import pydicom

    middle = ball_series(tmp_path / "scan")
    place = ",".join(f"{part:.3f}" for part in middle)
    for out in ("one", "two"):
        words = [
            "segment",
            str(tmp_path / "scan"),
            "-o",
            str(tmp_path / out),
            "--inside",
            f"ball:{place},3",
        ]
        words += [
            "--threads",
            "1",
            "--name",
            "ball",
            "--also",
            "dicom-seg,dicom-labelmap,rtstruct,seg.nrrd",
        ]
        assert cli.execute(words) == 0
    names = [f"scan_{name}.dcm" for name in ("segmentation", "labelmap", "rtstruct")]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    labels = io.read_labels(tmp_path / "one" / "scan_seg.nii.gz")
    for name in names[:2]:
        found = highdicom.seg.segread(tmp_path / "one" / name).get_volume(combine_segments=True)
        index = np.argwhere(found.array > 0)
        world = (found.affine @ np.c_[index, np.ones(len(index))].T)[:3].T
        own = np.rint(labels.geometry.world_to_index(world)).astype(int)
        assert len(own) == int(labels.array.sum()) and (labels.array[tuple(own.T)] > 0).all()
    structure = pydicom.dcmread(tmp_path / "one" / "scan_rtstruct.dcm")
    assert structure.StructureSetROISequence[0].ROIName == "ball"
    assert (tmp_path / "one" / "scan_statistics.csv").read_text().splitlines()[0].count("_hu") >= 5
