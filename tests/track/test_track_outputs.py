import csv
import hashlib
import io as text_io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from accelsurf import io
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.settings.track_fields import TRACK_FORMATS, TrackFormat
from accelsurf.track.output import outputs as track_outputs
from accelsurf.track.output.document import TrackRun
from accelsurf.track.output.files import TrackFiles
from accelsurf.track.output.outputs import TRACK_WRITERS, TrackOutputs
from accelsurf.track.records import TrackedMesh
from tests.support.trackings import dividing_cells, flat_cells

PLAIN = TrackFiles(labels="nrrd", per_frame=True)
EVERY = TrackFiles(labels="nrrd", per_frame=True, mesh=("ply", "obj"), also=("ctc", "geff"))


def written(folder, made, files=PLAIN, order=1, name="cells", **more):
    with TrackOutputs(folder, name, made.sequence, files, **more) as outputs:
        for result in made.results[::order]:
            outputs.add(result)
        return outputs.finish(made.lineage)


def contents(folder: Path) -> dict[str, str]:
    """Checksum of every file but the report, which has durations; no hidden one may lie there."""
    files = sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not path.name.endswith("_report.json")
    )
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def lines_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(text_io.StringIO(path.read_text())))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("tracks")
    run = TrackRun({"frame": 0}, "frame = 0\n", ["accelsurf", "track"])
    written(out, dividing_cells(), EVERY, run=run)
    return out


@pytest.mark.slow
def test_frames_in_any_order_give_the_same_bytes(folder, tmp_path):
    written(tmp_path, dividing_cells(), EVERY, order=-1, run=TrackRun(toml="frame = 0\n"))
    assert contents(tmp_path) == contents(folder)
    assert len(contents(folder)) > 30


def test_tracks_have_a_line_for_each_object_in_each_frame(folder):
    lines = lines_of(folder / "cells_tracks.csv")
    assert [(int(line["frame"]), int(line["id"])) for line in lines] == [
        (0, 1),
        (0, 2),
        (1, 1),
        (1, 2),
        (2, 1),
        (2, 2),
        (3, 1),
        (3, 3),
        (3, 4),
        (4, 1),
        (4, 3),
        (4, 4),
    ]
    assert [line["parent"] for line in lines] == [
        "",
        "",
        "",
        "",
        "",
        "",
        "",
        "2",
        "2",
        "",
        "2",
        "2",
    ]
    assert [line["seen"] for line in lines] == ["1"] * 4 + ["0"] + ["1"] * 7
    moved = lines[6]
    assert (moved["time"], moved["time_unit"], moved["vx"], moved["vy"]) == (
        "1.5",
        "s",
        "2.0",
        "0.0",
    )
    # x: origin 5 + 11 voxels of 1 mm; z: origin 10 + 4 voxels of 2 mm
    assert [float(moved[key]) for key in ("x_mm", "y_mm", "z_mm")] == [16.0, 2.0, 18.0]
    assert float(moved["volume_ml"]) == pytest.approx(4e-3 / 3 * np.pi * 3.5**3, rel=1e-12)


def test_curves_have_a_gap_where_an_object_is_not_seen(folder):
    lines = lines_of(folder / "cells_curves.csv")
    assert [line["time_s"] for line in lines] == ["0.0", "0.5", "1.0", "1.5", "2.0"]
    assert [line["object_1_ml"] != "" for line in lines] == [True, True, False, True, True]
    assert [line["object_3_ml"] != "" for line in lines] == [False, False, False, True, True]


def test_label_maps_have_the_objects_that_a_frame_shows(folder):
    made = dividing_cells()
    for result in made.results:
        found = io.read_labels(folder / f"cells_labels_t{result.frame:03d}.nrrd")
        np.testing.assert_array_equal(found.array, result.labels())
        assert found.geometry.matches(made.sequence.geometry)
    assert set(np.unique(io.read_labels(folder / "cells_labels_t002.nrrd").array)) == {0, 2}


@pytest.mark.parametrize("labels", ["nii.gz", "tif", "ome.zarr"])
def test_label_maps_in_one_file_with_time(tmp_path, labels):
    made = dividing_cells()
    written(tmp_path, made, TrackFiles(labels=labels), order=-1)
    found = io.read_sequence(tmp_path / f"cells_labels.{labels}")
    assert (found.times, found.time_unit) == (made.sequence.times, "s")
    for result in made.results:
        np.testing.assert_array_equal(found.frame(result.frame).array, result.labels())


def test_one_object_with_id_1_is_1_in_every_format(tmp_path):
    made = flat_cells()
    alone = made._replace(
        results=tuple(replace(one, objects=one.objects[:1]) for one in made.results[:2])
    )
    for labels, per_frame, name in (("png", True, "a"), ("tif", True, "b"), ("tif", False, "c")):
        written(tmp_path, alone, TrackFiles(labels=labels, per_frame=per_frame), name=name)
    found = [
        io.read(tmp_path / f"{name}_labels_t000.{end}").array
        for name, end in (("a", "png"), ("b", "tif"))
    ]
    found.append(io.read_sequence(tmp_path / "c_labels.tif").frame(0).array)
    assert [set(np.unique(one).tolist()) for one in found] == [{0, 1}] * 3
    with pytest.raises(UsageError, match="one file of it holds no time"):
        written(tmp_path, alone, TrackFiles(labels="png"), name="d")


def test_meshes_are_those_of_the_surfaces(folder):
    names = sorted(path.name for path in folder.glob("*.ply"))
    assert names == [
        *(f"cells_surface_1_t{n:03d}.ply" for n in (0, 1, 3, 4)),
        *(f"cells_surface_2_t{n:03d}.ply" for n in range(3)),
        *(f"cells_surface_{own}_t{n:03d}.ply" for own in (3, 4) for n in (3, 4)),
    ]
    mesh = trimesh.load(folder / "cells_surface_1_t003.ply")
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 3.5**3, rel=0.02)
    np.testing.assert_allclose(mesh.center_mass, [16.0, 2.0, 18.0], atol=0.02)


def test_carried_vertices_stay_in_their_order(tmp_path):
    made = dividing_cells()
    shape = trimesh.creation.icosphere(subdivisions=1, radius=3.5)
    results = []
    for result in made.results:
        one = result.objects[0]
        mesh = TrackedMesh(
            shape.vertices + np.asarray(one.centroid), np.asarray(shape.faces, np.int64), 0
        )
        object.__setattr__(one, "mesh", mesh)
        results.append(mesh)
    written(tmp_path, made, TrackFiles(labels="nrrd", per_frame=True, mesh=("ply", "obj")))
    for number in (0, 3):
        for kind in ("ply", "obj"):
            found = trimesh.load(tmp_path / f"cells_surface_1_t{number:03d}.{kind}", process=False)
            np.testing.assert_allclose(found.vertices, results[number].vertices, atol=1e-5)
            np.testing.assert_array_equal(found.faces, shape.faces)


def test_contours_of_frames_of_one_slice(tmp_path):
    written(
        tmp_path, flat_cells(), TrackFiles(labels="png", per_frame=True, mesh=("csv",)), name="flat"
    )
    lines = lines_of(tmp_path / "flat_contour_1_t001.csv")
    places = np.array([[float(line["x_lps_mm"]), float(line["y_lps_mm"])] for line in lines])
    np.testing.assert_allclose(np.linalg.norm(places - [4.5, 6.0], axis=1), 2.0, atol=0.03)
    assert lines_of(tmp_path / "flat_tracks.csv")[-1]["parent"] == "1;2"
    alone = io.read(
        tmp_path / "flat_labels_t003.png"
    ).array  # ids as they are: no 255 for a map of 0 and 1
    assert set(np.unique(alone)) == {0, 3}
    with pytest.raises(
        UsageError, match="mesh: stl was given for frames of one slice, expected vtp, csv"
    ):
        written(tmp_path, flat_cells(), TrackFiles(mesh=("stl",)))


def test_report_says_how_objects_fared(folder):
    document = json.loads((folder / "cells_report.json").read_text())
    assert (document["status"], document["exit_code"], document["config"]) == (
        "ok",
        0,
        {"frame": 0},
    )
    assert document["input"]["times"] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert [
        (one["id"], one["first"], one["last"], one["gaps"], one["end"])
        for one in document["tracks"]
    ] == [
        (1, 0, 4, [2], "end of sequence"),
        (2, 0, 2, [], "divided"),
        (3, 3, 4, [], "end of sequence"),
        (4, 3, 4, [], "end of sequence"),
    ]
    assert document["tracks"][1]["children"] == [3, 4]
    assert document["links"][0] == {"parent": 2, "child": 3, "frame": 3, "kind": "division"}
    assert document["frames"][2]["not_seen"] == [1]
    listed = {Path(one["path"]).name for one in document["outputs"]}
    assert listed == {path.name for path in folder.iterdir()} - {"cells_report.json"}
    assert all(
        one["sha256"] == io.sha256(folder / Path(one["path"]).name) for one in document["outputs"]
    )


def test_files_are_all_new_or_all_old(tmp_path, monkeypatch):
    written(tmp_path, dividing_cells())
    before = contents(tmp_path)

    def fail(tracks, path):
        path.write_text("half")
        raise OutputError("the disk is full")

    monkeypatch.setitem(TRACK_FORMATS, "failing", TrackFormat("failing", "fails", "failing.txt"))
    monkeypatch.setitem(TRACK_WRITERS, "failing", fail)
    with pytest.raises(OutputError, match="the disk is full"):
        written(
            tmp_path, flat_cells(), TrackFiles(per_frame=True, also=("failing",)), overwrite=True
        )
    assert contents(tmp_path) == before
    assert json.loads((tmp_path / "cells_failed_report.json").read_text())["status"] == "failed"


def test_a_new_set_takes_the_files_of_the_old_one_away(tmp_path):
    meshes = TrackFiles(labels="nrrd", per_frame=True, mesh=("ply",), also=("ctc",))
    written(tmp_path, dividing_cells(), meshes)
    with pytest.raises(OutputError, match="exists already"):
        written(tmp_path, dividing_cells(), meshes)
    (tmp_path / "cells_surface_1_t000.ply").write_bytes(b"somebody's own")
    written(tmp_path, flat_cells(), TrackFiles(labels="nrrd", per_frame=True), overwrite=True)
    own = {"cells_surface_1_t000.ply"}  # changed since: not the run's any more
    plain = {f"cells_{end}" for end in ("tracks.csv", "curves.csv", "report.json")}
    assert {path.name for path in tmp_path.iterdir() if path.suffix != ".png"} == {
        *own,
        *plain,
        *(f"cells_labels_t{number:03d}.nrrd" for number in range(4)),
    }


def test_folders_are_replaced(tmp_path):
    folders = TrackFiles(also=("ctc", "geff"))
    written(tmp_path, dividing_cells(), folders)
    written(tmp_path, flat_cells(), folders, overwrite=True)
    assert (tmp_path / "cells_RES" / "res_track.txt").read_text() == "1 0 2 0\n2 0 2 0\n3 3 3 1\n"
    assert len(list((tmp_path / "cells_RES").glob("mask*.tif"))) == 4


def test_aborted_leaves_nothing(tmp_path):
    made = dividing_cells()
    with TrackOutputs(tmp_path, "cells", made.sequence, EVERY) as outputs:
        outputs.add(made.results[0])
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError), TrackOutputs(tmp_path, "cells", made.sequence, EVERY):
        raise InputError("frame 3 cannot be read")
    document = json.loads((tmp_path / "cells_report.json").read_text())
    assert (document["status"], document["error"]["message"]) == (
        "failed",
        "frame 3 cannot be read",
    )
    assert [path.name for path in tmp_path.iterdir()] == ["cells_report.json"]


def test_a_report_that_cannot_be_written_does_not_hide_what_went_wrong(tmp_path, monkeypatch):
    def fail(path, content):
        raise OutputError("the disk is full")

    monkeypatch.setattr(track_outputs, "write_bytes", fail)
    with (
        pytest.raises(InputError, match="frame 3"),
        TrackOutputs(tmp_path, "cells", dividing_cells().sequence),
    ):
        raise InputError("frame 3 cannot be read")
    assert list(tmp_path.iterdir()) == []


def test_a_resumed_run_goes_on_from_the_frames_that_are_there(folder, tmp_path):
    made, store = dividing_cells(), tmp_path / "cells_frames"
    with TrackOutputs(tmp_path / "out", "cells", made.sequence, EVERY, store=store) as outputs:
        for result in made.results[:3]:
            outputs.add(result)
    (store / "frame_000001.npz").write_bytes(b"the machine stopped")
    more = {"store": store, "run": TrackRun(toml="frame = 0\n")}
    with TrackOutputs(tmp_path / "out", "cells", made.sequence, EVERY, **more) as outputs:
        assert outputs.frames() == [0, 2]
        for result in made.results[1:]:
            outputs.add(result)
        outputs.finish(made.lineage)
    assert contents(tmp_path / "out") == contents(folder)
    assert not store.exists()


def test_frames_of_an_earlier_run_do_not_count_where_none_is_resumed(tmp_path):
    made, store = dividing_cells(), tmp_path / "cells_frames"
    with TrackOutputs(tmp_path / "out", "cells", made.sequence, PLAIN, store=store) as outputs:
        outputs.add(made.results[0])
    with TrackOutputs(
        tmp_path / "out", "cells", made.sequence, PLAIN, store=store, resume=False
    ) as outputs:
        assert outputs.frames() == []


def test_an_interrupted_run_writes_the_frames_that_it_has_reached(tmp_path):
    made, store = dividing_cells(), tmp_path / "cells_frames"
    files = TrackFiles(labels="nii.gz", also=("ctc",))
    with TrackOutputs(tmp_path / "out", "cells", made.sequence, files, store=store) as outputs:
        for result in made.results[:2]:
            outputs.add(result)
        outputs.finish(made.lineage, status="interrupted", exit_code=130)
    document = json.loads((tmp_path / "out" / "cells_report.json").read_text())
    assert (document["status"], document["exit_code"], len(document["frames"])) == (
        "interrupted",
        130,
        2,
    )
    found = io.read_sequence(tmp_path / "out" / "cells_labels.nii.gz")
    assert [bool(found.frame(n).array.any()) for n in range(5)] == [True, True, False, False, False]
    assert store.exists()
