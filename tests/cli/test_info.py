"""What ``accelsurf info IMAGE`` says."""

import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

GRID = Geometry(
    (70, 75, 150), (2.0, 0.5, 0.25), (-12.5, 4.0, 100.25), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
)


#: Fine axes are halved until the voxels are cubic, then all, until one chunk has all of a level.
LEVELS = [[150, 75, 70], [75, 75, 70], [38, 38, 70], [19, 19, 70], [10, 10, 35]]


@pytest.mark.parametrize(
    ("suffix", "by_boxes"),
    [(".ome.zarr", True), (".nii", True), (".nii.gz", False), (".nrrd", False)],
)
def test_an_image_is_described(tmp_path, capsys, suffix, by_boxes):
    path = tmp_path / f"a{suffix}"
    io.write(Volume(np.zeros(GRID.shape, np.int16), GRID), path)
    assert cli.execute(["info", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (
        said["size"] == [150, 75, 70]
        and said["spacing"] == [0.25, 0.5, 2.0]
        and said["type"] == "int16"
    )
    assert said["origin"] == pytest.approx([-12.5, 4.0, 100.25]) and said["megabytes"] == 1.575
    assert (
        said["format"] == suffix[1:] and said["read_by_boxes"] is by_boxes and said["channels"] == 1
    )
    assert said["chunks"] == ([64, 64, 64] if suffix == ".ome.zarr" else None)
    assert [level["size"] for level in said["levels"]] == (
        LEVELS if suffix == ".ome.zarr" else LEVELS[:1]
    )
    assert cli.execute(["info", str(path)]) == 0
    assert "level 0: size [150, 75, 70]" in capsys.readouterr().out


def test_a_damaged_image_is_an_error(tmp_path, capsys):
    (tmp_path / "a.zarr").mkdir()
    assert cli.execute(["info", str(tmp_path / "a.zarr")]) == 3
    assert "a.zarr: this folder is no Zarr" in capsys.readouterr().err
    assert cli.execute(["info", str(tmp_path / "absent.nii")]) == 3
    assert "absent.nii: there is no such file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("times", "unit", "points", "is_said"),
    [
        ((0.0, 1.0, 2.0), "s", 3, True),
        ((0.0, 1.0, 5.0), "frame", 3, True),
        ((0.0, 1.0, 2.0), "frame", 1, False),
    ],
)
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_frames_of_a_nifti_are_time_points_where_it_says_time_and_else_named_as_both(
    tmp_path, capsys, times, unit, points, is_said, suffix
):
    path = tmp_path / f"a{suffix}"
    with io.SequenceWriter(
        path, Geometry((2, 3, 4), (1.0, 1.0, 1.0)), times, unit, np.float32
    ) as writer:
        for number in range(3):
            writer.write(number, np.full((2, 3, 4), number, np.float32))
    assert cli.execute(["info", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["channels"], said["time_points"]) == (3 // points, points)
    assert is_said is (said["warning"] is None)
    assert is_said or said["warning"].endswith(
        "3 volumes, which segment reads as channels and track as frames"
    )
    sequence = io.read_sequence(path)
    assert (sequence.times, sequence.time_unit, sequence.frame_values) == (times, unit, 24)


def test_a_folder_of_results_is_summed_up(tmp_path, capsys):
    said = {
        "input": {"path": "scan.nii"},
        "stop": {"message": "it moved"},
        "volume_mm3": 1307.7147,
        "quality": {"probability": 0.93, "warnings": ["doubt: a\x1b[2J b"]},
    }
    (tmp_path / "scan_report.json").write_text(json.dumps(said))
    (tmp_path / "odd_report.json").write_text('["no report", 1]')
    (tmp_path / "stopped_report.json").write_text(
        '{"stop": null, "error": {"message": "by Ctrl-C", "hint": "wait"}}'
    )
    (tmp_path / "worse_report.json").write_text(
        '{"input": 3, "quality": {"probability": "x", "warnings": {}}}'
    )
    assert cli.execute(["info", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    odd = "  report  is not of a run\n"
    assert text.startswith(f"odd\n{odd}scan\n") and text.endswith(
        f"stopped\n  ended  by Ctrl-C\nworse\n{odd}"
    )
    assert (
        all(said in text for said in ("scan.nii", "it moved", "1308 mm3", "likely to be good  93%"))
        and "\x1b" not in text
    )
    assert cli.execute(["info", str(tmp_path), "--json"]) == 0
    assert said in json.loads(capsys.readouterr().out)["results"]
