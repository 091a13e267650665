"""``segment --objects`` in groups: the files of a run in memory, whatever runs the groups and whatever ends them."""

import csv
import json

import numpy as np
import pytest
from distributed import LocalCluster

from accelsurf import cli, io
from accelsurf.batch.pool import InlinePool
from accelsurf.cli import object_work
from tests.support.many_balls import BALLS, label_map, scene, write_table

WORDS = ("--threads", "1", "--quiet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The image, its starts, and in ``memory`` the result of all at once."""
    made = tmp_path_factory.mktemp("objects")
    io.write(scene(), made / "big.nii")
    io.write_labels(label_map(), made / "seeds.nii")
    write_table(made / "seeds.csv")
    assert segment(made, "memory") == 0
    return made


def segment(folder, output, *words, objects="seeds.nii", out=None, steps=12):
    where = folder if out is None else out
    return cli.execute(
        [
            "segment",
            str(folder / "big.nii"),
            "--objects",
            str(folder / objects),
            "-o",
            str(where / output),
            "--max-steps",
            str(steps),
            *WORDS,
            *words,
        ]
    )


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def assert_as_in_memory(folder, path, labels="big_seg.nii"):
    """Labels, meshes and table are those of the run in memory."""
    names = sorted(one.name for one in (folder / "memory").glob("big_surface_*"))
    assert sorted(one.name for one in path.glob("big_surface_*")) == names and len(names) == len(
        BALLS
    )
    for name in (*([labels] if labels == "big_seg.nii" else []), *names):
        assert (path / name).read_bytes() == (folder / "memory" / name).read_bytes(), name
    for one, want in zip(
        rows(path / "big_objects.csv"), rows(folder / "memory" / "big_objects.csv"), strict=True
    ):
        assert {key: one[key] for key in want} == want and (one["status"], one["failure"]) == (
            "ok",
            "",
        )
    assert sorted(one.name for one in path.iterdir()) == sorted(
        ["big_objects.csv", "big_report.json", labels, *names]
    )


def test_one_process(folder, tmp_path, capsys):
    assert segment(folder, "out", "--jobs", "1", "--progress", "json", out=tmp_path) == 0
    assert_as_in_memory(folder, tmp_path / "out")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert lines[-1]["done"] == lines[-1]["objects"] == len(BALLS) and lines[-1]["failed"] == 0
    report, want = (
        json.loads((one / "big_report.json").read_text())
        for one in (tmp_path / "out", folder / "memory")
    )
    assert report["status"] == "ok" and report["exit_code"] == 0
    for key in ("components", "touches_border", "resolved_settings"):
        assert report[key] == want[key], key
    for key in ("volume_mm3", "area_mm2"):  # sums in another order
        assert report[key] == pytest.approx(want[key], rel=1e-12)
    assert report["stop"]["reason"] == want["stop"]["reason"]
    assert {one["kind"] for one in report["outputs"]} == {"labels", "objects", "surface"}
    assert [one["id"] for one in report["objects"]] == sorted(BALLS)


@pytest.mark.slow
def test_two_processes_and_a_store_of_labels(folder, tmp_path):
    assert segment(folder, "out", "--jobs", "2", "--format", "ome.zarr", out=tmp_path) == 0
    path = tmp_path / "out" / "big_seg.ome.zarr"
    got, want = io.read(path).array, io.read(folder / "memory" / "big_seg.nii").array
    assert got.dtype == want.dtype and np.array_equal(got, want)
    assert_as_in_memory(folder, tmp_path / "out", "big_seg.ome.zarr")


@pytest.mark.slow
def test_a_cluster(folder, tmp_path):
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
    ) as cluster:
        assert segment(folder, "out", "--scheduler", cluster.scheduler_address, out=tmp_path) == 0
    assert_as_in_memory(folder, tmp_path / "out")


@pytest.fixture
def ran(monkeypatch):
    """The ids of each group that is run; the test may put an exception at the place of one."""
    done, instead = [], {}
    run_task = object_work.run_task

    def counted(task):
        ids = tuple(task.starts.ids.tolist())
        done.append(ids)
        if ids in instead:
            raise instead[ids]
        return run_task(task)

    monkeypatch.setattr(object_work, "run_task", counted)
    return done, instead


def test_what_was_done_before_an_interrupt_is_not_done_again(folder, tmp_path, ran, capsys):
    done, instead = ran
    instead[(31, 32)] = KeyboardInterrupt()
    assert segment(folder, "out", "--jobs", "1", out=tmp_path) == 130
    before = list(done)
    assert before[-1] == (31, 32) and {(9,), (20, 21, 22), (47,)} < set(before)
    assert not list((tmp_path / "out").glob("big_*"))
    instead.clear()
    done.clear()
    assert segment(folder, "out", "--jobs", "1", out=tmp_path) == 7
    assert "--resume" in capsys.readouterr().err and done == []
    (damaged,) = (tmp_path / "out" / ".big_objects").glob("group-9-*")
    (damaged / "record.npz").write_bytes(b"PK")
    assert segment(folder, "out", "--resume", "--jobs", "1", out=tmp_path) == 0
    assert done == [(9,), (31, 32)]
    assert_as_in_memory(folder, tmp_path / "out")
    done.clear()
    assert segment(folder, "out", "--resume", "--jobs", "1", out=tmp_path) == 0
    assert done == [], "it has ended"


@pytest.mark.slow
@pytest.mark.parametrize("energy", ["likelihood:model=histogram", "threshold:60%,"])
def test_what_was_done_is_found_again_with_any_energy(folder, tmp_path, ran, energy):
    done, instead = ran
    for objects in ("seeds.nii", "seeds.csv"):
        instead[(47,)] = KeyboardInterrupt()
        words = "--jobs", "1", "--energy", energy, "--resume"
        assert segment(folder, "out", *words, objects=objects, out=tmp_path, steps=3) == 130
        before = list(done)
        instead.clear()
        done.clear()
        assert segment(folder, "out", *words, objects=objects, out=tmp_path, steps=3) == 0
        assert not set(before[:-1]) & set(done) and done[0] == (47,)
        done.clear()
        (tmp_path / "out").rename(tmp_path / objects)


def test_other_settings_or_starts_begin_anew(folder, tmp_path, ran):
    done, instead = ran
    instead[(47,)] = KeyboardInterrupt()
    assert segment(folder, "out", "--jobs", "1", out=tmp_path, steps=4) == 130
    same = {(9,), (20, 21, 22), (47,)}
    assert same <= set(done)
    for words, objects in ((("--cfl", "0.4"), "seeds.nii"), ((), "seeds.csv")):
        done.clear()
        assert (
            segment(
                folder,
                "out",
                "--resume",
                "--jobs",
                "1",
                *words,
                objects=objects,
                out=tmp_path,
                steps=4,
            )
            == 130
        )
        assert same <= set(done), "nothing of the other run counts"


def test_failures_are_named_and_tried_again(folder, tmp_path, ran, capsys):
    done, instead = ran
    instead[(9,)] = RuntimeError("a kernel\nfailed")
    assert segment(folder, "out", "--jobs", "1", out=tmp_path) == 9
    assert "failed: object 9: RuntimeError: a kernel" in capsys.readouterr().err
    table = {row["id"]: row for row in rows(tmp_path / "out" / "big_objects.csv")}
    assert list(table) == [str(own) for own in sorted(BALLS)]
    assert (
        table["9"]["status"] == "failed"
        and table["9"]["failure"] == "RuntimeError: a kernel\nfailed"
    )
    assert table["9"]["volume_mm3"] == "" and table["20"]["status"] == "ok"
    labels = io.read(tmp_path / "out" / "big_seg.nii").array
    assert not (labels == 9).any() and (labels == 20).any()
    report = json.loads((tmp_path / "out" / "big_report.json").read_text())
    assert (
        report["status"] == "failed"
        and report["exit_code"] == 9
        and "object 9" in report["error"]["message"]
    )
    done.clear()
    instead.clear()
    assert segment(folder, "out", "--jobs", "1", "--resume", out=tmp_path) == 0
    assert done == [(9,)]
    assert_as_in_memory(folder, tmp_path / "out")


def test_groups_that_need_more_than_their_part_of_the_memory_run_alone(
    folder, tmp_path, monkeypatch
):
    """Half of 700 MB holds no process that runs one."""
    monkeypatch.setattr(
        "accelsurf.batch.pool.LocalPool", lambda run, jobs, prepare: InlinePool(run)
    )
    assert segment(folder, "out", "--jobs", "2", "--max-memory", "700MB", out=tmp_path) == 0
    assert_as_in_memory(folder, tmp_path / "out")


def test_an_image_that_does_not_fit_is_read_in_parts(folder, tmp_path, capsys):
    """No --jobs: the memory alone decides, and every group needs less than the image."""
    assert segment(folder, "out", "--max-memory", "480MB", out=tmp_path, steps=4) == 9
    table = {row["id"]: row for row in rows(tmp_path / "out" / "big_objects.csv")}
    assert (
        table["20"]["status"] == "failed"
        and "3 objects that may meet need a window" in table["20"]["failure"]
    )
    assert table["9"]["status"] == "ok"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--jobs", "0"), "--jobs: 0"),
        (("--jobs", "1", "--scheduler", "tcp://a:1"), "--scheduler"),
        (("--jobs", "1", "--strict"), "--strict"),
        (("--jobs", "1", "--also", "itk-snap"), "--also"),
        (("--jobs", "1", "--layout", "nnunet"), "--layout"),
        (("--jobs", "1", "--profile"), "--profile"),
        (("--jobs", "1", "--save-sdf"), "save-sdf"),
        (("--jobs", "1", "--levels", "2"), "levels"),
        (("--jobs", "1", "--format", "nrrd"), "format"),
    ],
)
def test_what_does_not_fit_is_refused(folder, tmp_path, words, named, capsys):
    assert segment(folder, "out", *words, out=tmp_path) == 2
    assert named in capsys.readouterr().err.splitlines()[0]
    assert not (tmp_path / "out" / "big_seg.nii").exists()


def test_clicks_and_single_objects_are_refused(folder, tmp_path, capsys):
    table = tmp_path / "clicks.csv"
    table.write_text("id,x_vox,y_vox,z_vox,side\n1,15,16,16,inside\n2,90,50,22,inside\n")
    assert segment(folder, "out", "--jobs", "1", objects=table, out=tmp_path) == 2
    assert "column side" in capsys.readouterr().err
    image = str(folder / "big.nii")
    assert (
        cli.execute(
            ["segment", image, "-o", str(tmp_path / "one"), "--start", "center", "--jobs", "2"]
        )
        == 2
    )
    assert "without --objects" in capsys.readouterr().err
