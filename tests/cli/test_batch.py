"""``accelsurf batch``: the files of each case, tables, resume, shards, failures, Ctrl-C.

Most tests run the cases in this process, one after another; a few with real workers say what only those can.
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.batch import pool as pools
from accelsurf.cases import case
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.output.pictures import preview
from accelsurf.run.checkpoint import read_checkpoint
from tests.support.batch_jobs import InlinePool

SIZE = 16
START = ("--start", "ball:0,0,0,4", "--threads", "1")


@pytest.fixture
def inline(monkeypatch):
    """Cases run in this process, and their pictures are not drawn; the list of those that did."""
    monkeypatch.setattr(preview, "preview_png", lambda content: b"a picture")
    monkeypatch.setattr(pools, "LocalPool", InlinePool)
    monkeypatch.setattr(InlinePool, "ran", [])
    return InlinePool


def image(path, radius=7.0, seed=0):
    middle = 0.5 * (SIZE - 1)
    z, y, x = np.indices((SIZE,) * 3) - middle
    ball = 100.0 * (x**2 + y**2 + z**2 < radius**2)
    noisy = ball + np.random.default_rng(seed).normal(0, 5, ball.shape)
    grid = Geometry(ball.shape, (1.0, 1.0, 1.0), origin=(-middle,) * 3)
    path.parent.mkdir(parents=True, exist_ok=True)
    io.write(Volume(noisy.astype(np.float32), grid), path)
    io.write_labels(
        Volume((ball > 0).astype(np.uint8), grid), path.parent.parent / "truth" / path.name
    )


@pytest.fixture(scope="session")
def scans(tmp_path_factory):
    """Three balls, their truths beside them, and a table of them."""
    folder = tmp_path_factory.mktemp("cases") / "scans"
    (folder.parent / "truth").mkdir()
    for number, name in enumerate(("a", "b", "c")):
        image(folder / f"{name}.nii.gz", 4.5 + number, number)
    rows = [f"scans/{name}.nii.gz,case-{name},truth/{name}.nii.gz" for name in "abc"]
    (folder.parent / "cases.csv").write_text("\n".join(["image,id,reference", *rows, ""]))
    return folder


@pytest.fixture(scope="session")
def done(scans, tmp_path_factory):
    """The outputs of one batch by the table, with two real workers."""
    out = tmp_path_factory.mktemp("done") / "out"
    assert run(scans.parent / "cases.csv", "-o", out, *START, "--jobs", "2", "--quiet") == 0
    return out


def run(*words):
    return cli.execute(["batch", *map(str, words)])


def table(out, name="batch.csv"):
    return {row["id"]: row for row in csv.DictReader((out / name).read_text().splitlines())}


def report(out, name="batch_report.json"):
    return json.loads((out / name).read_text())


def contents(folder):
    """The bytes of a case's files, without what the work took, and without the report and record."""
    found = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".json":
            continue
        found[path.name] = path.read_bytes()
        if path.suffix == ".csv":
            rows = list(csv.DictReader(path.read_text().splitlines()))
            effort = ("seconds", "cells_visited")
            found[path.name] = [
                {key: value for key, value in row.items() if key not in effort} for row in rows
            ]
    return found


# --------------------------------------------------------------------------------------------------- what is written


@pytest.mark.pictures
def test_the_files_are_those_of_one_segment_for_each_case(done, scans, tmp_path):
    for name in "abc":
        link = tmp_path / f"case-{name}.nii.gz"  # outputs are named by the id
        os.link(scans / f"{name}.nii.gz", link)
        words = [
            "segment",
            link,
            "-o",
            tmp_path / f"case-{name}",
            *START,
            "--reproducible",
            "--quiet",
        ]
        assert cli.execute([str(word) for word in words]) == 0
        mine, alone = contents(done / f"case-{name}"), contents(tmp_path / f"case-{name}")
        assert set(alone) >= {
            f"case-{name}_{kind}"
            for kind in ("seg.nii.gz", "surface.ply", "trace.csv", "preview.png")
        }
        assert mine == alone


def test_the_table_has_a_row_for_each_case(done, scans):
    rows = table(done)
    assert list(rows) == ["case-a", "case-b", "case-c"]
    for name, row in rows.items():
        one = json.loads((done / name / f"{name}_report.json").read_text())
        assert (row["status"], row["reason"], row["folder"]) == ("ok", "converged", name)
        assert (
            float(row["ml"]) == pytest.approx(one["estimates"]["volume_mm3"] / 1000, rel=1e-3)
            and int(row["steps"]) == one["stop"]["steps"]
        )
        assert float(row["probability"]) == pytest.approx(one["quality"]["probability"], rel=1e-3)
        assert float(row["seconds"]) == pytest.approx(one["seconds"]["total"], rel=1e-3)
        labels = io.read_labels(done / name / f"{name}_seg.nii.gz").array > 0
        truth = io.read_labels(scans.parent / "truth" / f"{name[-1]}.nii.gz").array > 0
        value = 2 * (labels & truth).sum() / (labels.sum() + truth.sum())
        assert float(row["dice"]) == pytest.approx(value, rel=1e-3) and value > 0.9


def test_the_report_of_a_batch(done):
    document = report(done)
    assert (document["status"], document["exit_code"], document["layout"]) == ("ok", 0, "a table")
    assert document["counts"] == {"cases": 3, "ok": 3, "failed": 0, "waiting": 0}
    assert document["jobs"] == 2 and document["threads"] == 1 and document["versions"]["accelsurf"]
    assert [case["id"] for case in document["cases"]] == ["case-a", "case-b", "case-c"]
    assert document["cases"][0]["image"].endswith("scans/a.nii.gz")


def test_nothing_else_is_left_in_the_folder(done):
    assert sorted(path.name for path in done.iterdir()) == [
        "batch.csv",
        "batch.html",
        "batch_report.json",
        "case-a",
        "case-b",
        "case-c",
    ]
    assert not list(done.rglob(".*"))


def test_failures_are_named_and_the_others_go_on(inline, scans, tmp_path, capsys):
    (tmp_path / "torn.nii.gz").write_bytes((scans / "a.nii.gz").read_bytes()[:200])
    (tmp_path / "cases.csv").write_text(
        "image,id,start,reference\n"
        f'{scans}/a.nii.gz,far,"ball:900,0,0,4",\n'
        "torn.nii.gz,torn,,\n"
        f"{scans}/b.nii.gz,good,,\n"
        f"{scans}/c.nii.gz,other grid,,small.nii\n"
    )
    small = Volume(np.ones((3, 3, 3), np.uint8), Geometry((3, 3, 3), (1.0, 1.0, 1.0)))
    io.write_labels(small, tmp_path / "small.nii")
    assert run(tmp_path / "cases.csv", "-o", tmp_path / "out", *START) == 9
    rows, said = table(tmp_path / "out"), capsys.readouterr()
    assert {name: row["status"] for name, row in rows.items()} == {
        "far": "failed",
        "torn": "failed",
        "good": "ok",
        "other grid": "failed",
    }
    assert "different grids" in rows["other grid"]["reason"] and rows["good"]["dice"] == ""
    for name in ("far", "torn", "other grid"):
        assert (
            f"failed: {name}: {rows[name]['reason']}" in said.err and len(rows[name]["reason"]) > 20
        )
        assert (
            json.loads((tmp_path / "out" / name / f"{name}_report.json").read_text())["status"]
            == "failed"
        )
    assert "4 cases: 1 ok, 3 failed" in said.out and str(tmp_path / "out" / "batch.csv") in said.out
    document = report(tmp_path / "out")
    assert (document["status"], document["exit_code"]) == ("failed", 9)
    assert [case["exit_code"] for case in document["cases"]] == [3, 3, 0, 3]


def test_a_case_of_clicks_and_settings_of_its_own(inline, scans, tmp_path):
    (tmp_path / "run.toml").write_text("max_steps = 2\nsmoothness = 0.25\n")
    (tmp_path / "cases.csv").write_text(
        "image,inside,outside,max_steps\n"
        f'{scans}/a.nii.gz,"point:0,0,0;ball:1,1,0,1","point:7,7,7",3\n'
        f"{scans}/b.nii.gz,,,\n"
    )
    words = (
        tmp_path / "cases.csv",
        "-o",
        tmp_path / "out",
        "--config",
        tmp_path / "run.toml",
        "--smoothness",
        "0.5",
    )
    assert run(*words) == 0
    first, second = (
        json.loads((tmp_path / "out" / name / f"{name}_report.json").read_text())["config"]
        for name in "ab"
    )
    assert (first["inside"], first["outside"]) == (["point:0,0,0", "ball:1,1,0,1"], ["point:7,7,7"])
    assert (first["max_steps"], first["smoothness"], first["energy"]) == (3, 0.5, "seeded")
    assert (second["max_steps"], second["smoothness"], second["energy"]) == (2, 0.5, "chan-vese")
    assert (tmp_path / "out" / "a" / "a_state.npz").exists()


def test_several_objects_have_the_least_of_their_qualities(inline, scans, tmp_path):
    (tmp_path / "seeds.csv").write_text("id,x,y,z,r\n1,-3,0,0,2\n2,4,0,0,2\n")
    assert (
        run(
            scans / "a.nii.gz",
            "-o",
            tmp_path / "out",
            "--objects",
            tmp_path / "seeds.csv",
            "--max-steps",
            3,
        )
        == 0
    )
    one = json.loads((tmp_path / "out" / "a" / "a_report.json").read_text())
    qualities = [entry["quality"]["probability"] for entry in one["objects"]]
    assert len(set(qualities)) == 2
    assert float(table(tmp_path / "out")["a"]["probability"]) == pytest.approx(
        min(qualities), rel=1e-3
    )


def test_the_page_shows_every_case_by_uncertainty_and_runs_no_script(inline, scans, tmp_path):
    names = {"a": "a&b <i>", "b": "x' y", "c": "100%"}
    if sys.platform == "win32":
        pytest.skip("no such names there")
    (tmp_path / "cases.csv").write_text(
        "image,id\n"
        + "".join(f"{scans}/{key}.nii.gz,{name}\n" for key, name in names.items() if key != "a")
        + f"absent.nii,{names['a'].replace('<i>', 'i')}\n"
    )
    assert run(tmp_path / "cases.csv", "-o", tmp_path / "out", *START) == 9
    page = (tmp_path / "out" / "batch.html").read_text()
    assert "flow:" not in page and "<th>likely to be good" in page
    assert "<script" not in page and "a&amp;b i" in page and "a&b" not in page
    rows = table(tmp_path / "out")
    by_uncertainty = sorted(("x' y", "100%"), key=lambda name: float(rows[name]["probability"]))
    places = [
        page.index(f"<h2>{text}</h2>")
        for text in ("a&amp;b i", *(n.replace("'", "&#x27;") for n in by_uncertainty))
    ]
    assert places == sorted(places)
    assert (
        'src="x%27%20y/x%27%20y_preview.png"' in page and 'src="100%25/100%25_preview.png"' in page
    )
    assert (tmp_path / "out" / "100%" / "100%_preview.png").is_file()


@pytest.mark.parametrize(
    ("error", "code", "reason"),
    [
        (ZeroDivisionError("a bug"), 1, "ZeroDivisionError: a bug"),
        (MemoryError("for 9 GB"), 3, "not enough memory for 9 GB"),
    ],
)
def test_an_error_that_nobody_expects_ends_its_case_only(
    inline, scans, tmp_path, monkeypatch, error, code, reason
):
    evolve = case.evolve

    def failing(name, *others):
        if name == "b":
            raise error
        return evolve(name, *others)

    monkeypatch.setattr(case, "evolve", failing)
    assert run(scans, "-o", tmp_path / "out", *START, "--max-steps", "1") == 9
    rows, entry = table(tmp_path / "out"), report(tmp_path / "out")["cases"][1]
    assert [row["status"] for row in rows.values()] == ["ok", "failed", "ok"] and rows["b"][
        "reason"
    ] == reason
    assert entry["exit_code"] == code and ("Traceback" in entry["details"]) == (code == 1)
    one = json.loads((tmp_path / "out" / "b" / "b_report.json").read_text())
    assert (one["status"], one["exit_code"]) == ("failed", code)


def test_strict_makes_warnings_failures(inline, scans, tmp_path):
    words = (scans / "a.nii.gz", "-o", tmp_path / "out", *START, "--max-steps", "1")
    assert run(*words) == 0 and table(tmp_path / "out")["a"]["reason"] == "max-steps"
    assert run(*words, "--strict", "--overwrite") == 9
    assert "max-steps" in table(tmp_path / "out")["a"]["reason"]
    assert report(tmp_path / "out")["cases"][0]["exit_code"] == 4


# ----------------------------------------------------------------------------------------------------- plan, progress


def test_a_bar_counts_the_cases(inline, scans, tmp_path, capsys):
    assert run(scans, "-o", tmp_path / "out", *START, "--max-steps", "1", "--progress", "bar") == 0
    assert "3/3 cases" in capsys.readouterr().err


def test_a_plan_runs_nothing(inline, scans, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(scans, "--plan", "--jobs", "2", "--max-memory", "4GB") == 0
    said = capsys.readouterr()
    assert not list(tmp_path.iterdir()) and not inline.ran
    lines = said.out.splitlines()
    assert lines[1].split()[:2] == ["a", str(SIZE**3)] and "MB" in lines[1]
    assert lines[-1].startswith("3 cases of a folder of images; 2 at once, threads of each: ")
    assert lines[-1].endswith(", memory of all: 4 GB")
    assert run(scans, "--plan", "--max-memory", "100MB") == 9
    assert "is not run" in capsys.readouterr().out


def test_progress_has_a_line_of_json_for_each_event(inline, scans, tmp_path, capsys):
    assert (
        run(
            scans,
            "-o",
            tmp_path / "out",
            *START,
            "--max-steps",
            "2",
            "--progress",
            "json",
            "--quiet",
        )
        == 0
    )
    lines = [
        json.loads(line) for line in capsys.readouterr().err.splitlines() if line.startswith("{")
    ]
    assert [(line["event"], line["case"]) for line in lines] == [
        (event, name) for name in "abc" for event in ("start", "end")
    ]
    last = lines[-1]
    assert (last["done"], last["failed"], last["cases"], last["seconds_left"]) == (3, 0, 3, 0)
    assert lines[1]["seconds_left"] > 0 and lines[1]["status"] == "ok"


# ------------------------------------------------------------------------------------------------------------- resume


def test_resume_runs_what_is_not_finished(inline, scans, tmp_path, capsys):
    out = tmp_path / "out"
    words = (scans.parent / "cases.csv", "-o", out, *START, "--max-steps", "3")
    assert run(*words) == 0
    before = {name: contents(out / f"case-{name}") for name in "abc"}
    rows = table(out)
    inline.ran.clear()
    assert run(*words) == 7 and "--resume" in capsys.readouterr().err
    assert run(*words, "--resume") == 0 and inline.ran == []
    assert "3 of 3 cases are finished already" in capsys.readouterr().err
    assert table(out) == rows
    (out / "case-b" / "case-b_seg.nii.gz").unlink()
    (out / "case-c" / "case-c_report.json").unlink()
    assert run(*words, "--resume") == 0 and inline.ran == ["case-b", "case-c"]
    assert {name: contents(out / f"case-{name}") for name in "abc"} == before
    inline.ran.clear()
    assert (
        run(*("2" if word == "1" else word for word in words), "--resume") == 0 and inline.ran == []
    )  # threads
    assert run(*words[:-1], "2", "--resume") == 0 and inline.ran == ["case-a", "case-b", "case-c"]
    inline.ran.clear()
    assert run(*words[:-1], "2", "--overwrite") == 0 and inline.ran == [
        "case-a",
        "case-b",
        "case-c",
    ]


def test_resume_looks_at_the_images_and_files_that_settings_name(inline, scans, tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.nii.gz").write_bytes((scans / f"{name}.nii.gz").read_bytes())
    mask = io.read_labels(scans.parent / "truth" / "c.nii.gz")
    io.write_labels(mask, tmp_path / "mask.nii.gz")
    (tmp_path / "cases.csv").write_text("image,mask\na.nii.gz,\nb.nii.gz,mask.nii.gz\n")
    words = (tmp_path / "cases.csv", "-o", tmp_path / "out", *START, "--max-steps", "2")
    assert run(*words) == 0 and run(*words, "--resume") == 0
    assert inline.ran == ["a", "b"]
    inline.ran.clear()
    array = mask.array.copy()
    array[0, 0, 0] = 1
    io.write_labels(mask.with_array(array), tmp_path / "mask.nii.gz")
    assert run(*words, "--resume") == 0 and inline.ran == ["b"]
    inline.ran.clear()
    (tmp_path / "a.nii.gz").write_bytes((scans / "c.nii.gz").read_bytes())
    assert run(*words, "--resume") == 0 and inline.ran == ["a"]


@pytest.mark.slow
def test_resume_leaves_a_result_that_somebody_has_corrected(inline, scans, tmp_path):
    out = tmp_path / "out"
    (tmp_path / "cases.csv").write_text(
        f"image,id,reference\n{scans}/a.nii.gz,a,{scans.parent}/truth/a.nii.gz\n"
    )
    words = (tmp_path / "cases.csv", "-o", out, "--inside", "point:0,0,0", "--quiet")
    assert run(*words) == 0
    before = table(out)["a"]
    assert cli.execute(["refine", str(out / "a"), "--outside", "ball:4,0,0,2", "--quiet"]) == 0
    corrected = contents(out / "a")
    assert run(*words, "--resume") == 0
    assert inline.ran == ["a"] and contents(out / "a") == corrected
    assert float(table(out)["a"]["dice"]) < float(before["dice"])


def test_resume_measures_dice_again_for_another_reference(inline, scans, tmp_path):
    words = ("-o", tmp_path / "out", *START, "--max-steps", "2", "--quiet")
    text = f"image,id,reference\n{scans}/a.nii.gz,a,{scans.parent}/truth/NAME.nii.gz\n"
    dice = []
    for name, more in (("a", ()), ("c", ("--resume",))):
        (tmp_path / "cases.csv").write_text(text.replace("NAME", name))
        assert run(tmp_path / "cases.csv", *words, *more) == 0
        dice.append(float(table(tmp_path / "out")["a"]["dice"]))
    assert inline.ran == ["a"] and dice[0] != dice[1]


# ------------------------------------------------------------------------------------------------------------- shards


def test_two_shards_are_one_run(inline, scans, tmp_path, monkeypatch, capsys):
    words = (scans, "-o", tmp_path / "parts", *START, "--max-steps", "3")
    assert run(*words, "--shard", "1/2") == 0
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "6")
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    monkeypatch.setenv("SLURM_ARRAY_TASK_MIN", "5")
    assert run(*words) == 0
    assert "shard 2/2, by SLURM_ARRAY_TASK_ID=6" in capsys.readouterr().err
    assert inline.ran == ["a", "c", "b"]
    assert list(table(tmp_path / "parts", "batch_1of2.csv")) == ["a", "c"]
    assert list(table(tmp_path / "parts", "batch_2of2.csv")) == ["b"]
    assert report(tmp_path / "parts", "batch_report_2of2.json")["shard"] == "2/2"
    for name in ("ID", "COUNT", "MIN"):
        monkeypatch.delenv(f"SLURM_ARRAY_TASK_{name}")
    assert run(*words, "--resume") == 0 and len(inline.ran) == 3
    assert run(scans, "-o", tmp_path / "whole", *START, "--max-steps", "3") == 0
    for name in "abc":
        assert contents(tmp_path / "parts" / name) == contents(tmp_path / "whole" / name)
    merged, whole = table(tmp_path / "parts"), table(tmp_path / "whole")
    for rows in (merged, whole):
        for line in rows.values():
            line.pop("seconds")
    assert merged == whole


# ------------------------------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("SCANS",), 2, "-o DIR"),
        (("-o", "OUT"), 2, "CASES is missing"),
        (("SCANS/absent", "-o", "OUT"), 3, "no such file or folder"),
        (("EMPTY", "-o", "OUT"), 3, "no image in this folder"),
        (("SCANS", "-o", "OUT", "--jobs", "0"), 2, "--jobs: 0 was given"),
        (("SCANS", "-o", "OUT", "--case-timeout", "-1"), 2, "--case-timeout"),
        (("SCANS", "-o", "OUT", "--case-timeout", "nan"), 2, "--case-timeout"),
        (("SCANS", "-o", "OUT", "--max-memory", "lots"), 2, "--max-memory: lots"),
        (("SCANS", "-o", "OUT", "--shard", "3/2"), 2, "--shard: 3/2"),
        (("SCANS", "-o", "OUT", "--cfl", "7"), 2, "cfl: 7 was given"),
        (("TABLE", "-o", "OUT"), 2, "row 2: cfl: 7 was given"),
        (("SCANS", "-o", "TABLE"), 7, "cannot be written to"),
    ],
)
def test_what_is_refused_is_one_line_and_a_hint(
    words, code, message, scans, tmp_path, capsys, inline
):
    (tmp_path / "empty").mkdir()
    (tmp_path / "cases.csv").write_text(f"image,cfl\n{scans}/a.nii.gz,7\n")
    places = {
        "SCANS": scans,
        "EMPTY": tmp_path / "empty",
        "TABLE": tmp_path / "cases.csv",
        "OUT": tmp_path / "out",
    }
    for name, path in places.items():
        words = [word.replace(name, str(path)) for word in words]
    assert run(*words) == code
    error, *rest = capsys.readouterr().err.splitlines()
    assert (
        error.startswith("error: ")
        and message in error
        and len(rest) == 1
        and rest[0].startswith("hint: ")
    )
    assert not (tmp_path / "out").exists() and not inline.ran


def test_a_result_of_segment_in_the_place_of_a_case_is_not_replaced(
    inline, scans, tmp_path, capsys
):
    out = tmp_path / "out"
    words = ["segment", scans / "a.nii.gz", "-o", out / "a", *START, "--max-steps", "2", "--quiet"]
    assert cli.execute([str(word) for word in words]) == 0
    assert run(scans, "-o", out, *START) == 7
    assert "a_report.json: exists already" in capsys.readouterr().err and not inline.ran


def test_settings_of_a_preset_in_a_cell_are_under_options_and_over_the_file(
    inline, scans, tmp_path
):
    from accelsurf.settings.presets import PRESETS

    name, preset = next((key, one) for key, one in PRESETS.items() if one.settings.get("presmooth"))
    (tmp_path / "run.toml").write_text("presmooth = 0.125\n")
    (tmp_path / "cases.csv").write_text(
        f"image,preset\n{scans}/a.nii.gz,{name}\n{scans}/b.nii.gz,\n"
    )
    words = (
        tmp_path / "cases.csv",
        "-o",
        tmp_path / "out",
        *START,
        "--max-steps",
        "1",
        "--energy",
        "chan-vese",
    )
    assert run(*words, "--config", tmp_path / "run.toml") in (0, 9)
    first, second = (
        json.loads((tmp_path / "out" / key / f"{key}_report.json").read_text())["config"]
        for key in "ab"
    )
    assert (first["preset"], first["energy"]) == (name, "chan-vese")
    assert first["presmooth"] == preset.settings["presmooth"] and second["presmooth"] == 0.125


# ------------------------------------------------------------------------------------------------------- real workers


def started(out, scans, *words, **more):
    command = [
        sys.executable,
        "-m",
        "accelsurf",
        "batch",
        scans,
        "-o",
        out,
        *START,
        "--progress",
        "json",
        *words,
    ]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([str(word) for word in command], text=True, **both, **more)


def read_until(program, event, name):
    for line in program.stderr:
        if line.startswith("{") and (json.loads(line)["event"], json.loads(line).get("case")) == (
            event,
            name,
        ):
            return
    pytest.fail(f"there was no {event} of {name}")


ENDLESS = ("endless", "killed", "hung")


def table_with_endless_cases(folder, *rows):
    """Write a table of images and ids; those in `ENDLESS` have a large image on one grid, with many short steps."""
    z, y, x = np.indices((160,) * 3) - 79.5
    grid = Geometry((160,) * 3, (1.0, 1.0, 1.0), origin=(-79.5,) * 3)
    large = Volume((100.0 * (z * z + y * y + x * x < 75**2)).astype(np.float32), grid)
    io.write(large, folder / "large.nii")
    slow = "1e-15,1,100000000,0.05"
    lines = [
        f"large.nii,{name},{slow}" if name in ENDLESS else f"{path}.nii.gz,{name},,,,"
        for path, name in rows
    ]
    (folder / "cases.csv").write_text(
        "\n".join(["image,id,tolerance,levels,max_steps,cfl", *lines, ""])
    )


def workers_of(pid):
    """Processes that a process has started, with their command lines."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((place / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid:
                found[int(place.name)] = (place / "cmdline").read_bytes().decode(errors="replace")
        except OSError:  # it has ended
            continue
    return found


def work_of(pid):
    """Seconds that a process has computed, which do not depend on what else the machine does."""
    times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, times)) / os.sysconf("SC_CLK_TCK")


@pytest.mark.program
def test_ctrl_c_ends_what_runs_and_says_how_to_go_on(scans, tmp_path, capsys):
    """The second case hangs; no process and no draft is left behind."""
    out = tmp_path / "out"
    table_with_endless_cases(
        tmp_path, (f"{scans}/a", "quick"), (f"{scans}/a", "endless"), (f"{scans}/b", "waits")
    )
    program = started(out, tmp_path / "cases.csv", "--jobs", "1")
    with program:
        read_until(program, "start", "endless")
        time.sleep(0.5)
        children = workers_of(program.pid)
        assert children
        program.send_signal(signal.SIGINT)
        rest = program.stderr.read()
    assert program.returncode == 130
    assert (
        "1 of 3 cases are finished; to go on: accelsurf batch " in rest and "Traceback" not in rest
    )
    end = time.monotonic() + 20
    while any(_alive(child) for child in children) and time.monotonic() < end:
        time.sleep(0.02)
    assert not any(_alive(child) for child in children)
    assert not list(out.rglob(".*"))
    assert {name: row["status"] for name, row in table(out).items()} == {
        "quick": "ok",
        "endless": "waiting",
        "waits": "waiting",
    }
    assert report(out)["status"] == "interrupted" and report(out)["exit_code"] == 130


@pytest.mark.parametrize(
    ("number", "send"), [(signal.SIGINT, os.kill), (signal.SIGTERM, os.killpg)]
)
@pytest.mark.usefixtures("inline")
@pytest.mark.program
def test_a_case_that_was_interrupted_goes_on_to_the_same_bytes(tmp_path, number, send, monkeypatch):
    """The signal comes to the program alone, or as from a cluster to all its processes.

    Only the interrupted batch is a program: it goes on in this process, and to the bytes of one here.
    """
    out = tmp_path / "out"
    # Large, and with noise: it goes on for many seconds.
    monkeypatch.setattr(sys.modules[__name__], "SIZE", 64)
    (tmp_path / "truth").mkdir()
    image(tmp_path / "scans" / "a.nii.gz", 24.0)
    noise = "--noise", "0.05", "--seed", "7", "--tolerance", "1e-6"
    words = (tmp_path / "scans" / "a.nii.gz", *noise, "--levels", "1", "--max-steps")
    program = started(out, *words, "100000000", start_new_session=True)
    with program:
        read_until(program, "start", "a")
        while program.poll() is None and not list(out.glob("a/.*")):
            time.sleep(0.01)
        (worker,) = (pid for pid, words in workers_of(program.pid).items() if "spawn_main" in words)
        begun = work_of(worker)
        while program.poll() is None and work_of(worker) < begun + 1:
            time.sleep(0.01)
        send(program.pid, number)
        rest = program.stderr.read()
    assert (
        program.returncode == 128 + number
        and "keep their state (" in rest
        and "Traceback" not in rest
    )
    assert {path.name for path in (out / "a").iterdir()} == {"a_report.json", "a_checkpoint.npz"}
    assert json.loads((out / "a" / "a_report.json").read_text())["status"] == "interrupted"
    assert table(out)["a"]["status"] == "waiting"
    steps = read_checkpoint(out / "a" / "a_checkpoint.npz")[1].step + 20
    assert run(*words, steps, "-o", out, *START, "--resume") == 0
    assert run(*words, steps, "-o", tmp_path / "whole", *START) == 0
    assert table(out)["a"]["steps"] == str(steps)
    assert contents(out / "a") == contents(tmp_path / "whole" / "a")


def _alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.usefixtures("done")  # all is compiled by then: that would take its time
@pytest.mark.program
def test_a_hung_and_a_killed_case_are_named_and_the_others_are_done(scans, tmp_path):
    out = tmp_path / "out"
    table_with_endless_cases(
        tmp_path, (f"{scans}/a", "killed"), (f"{scans}/a", "hung"), (f"{scans}/b", "good")
    )
    with started(out, tmp_path / "cases.csv", "--jobs", "1", "--case-timeout", "4") as program:
        read_until(program, "start", "killed")
        while not (
            found := [
                pid for pid, words in workers_of(program.pid).items() if "spawn_main" in words
            ]
        ):
            time.sleep(0.02)
        os.kill(found[0], signal.SIGKILL)
        program.stderr.read()
    assert program.returncode == 9
    rows = table(out)
    assert {name: row["status"] for name, row in rows.items()} == {
        "killed": "failed",
        "hung": "failed",
        "good": "ok",
    }
    assert "SIGKILL" in rows["killed"]["reason"] and "within 4 s" in rows["hung"]["reason"]
    for name in ("killed", "hung"):
        one = json.loads((out / name / f"{name}_report.json").read_text())
        assert one["status"] == "failed" and one["error"]["message"] == rows[name]["reason"]
    assert not list(out.rglob(".*"))


UNSAFE = [
    "a:b",
    "-x",
    "a ",
    "tab\there",
    "x" * 170,
    os.fsdecode(b"bad\xff"),
    'quote"s',
    "a<b>",
    "a\\b",
]


def test_files_with_unsafe_names_are_refused_alone(inline, tmp_path, capsys):
    scans = tmp_path / "scans"
    scans.mkdir()
    io.write(
        Volume.from_array(np.pad(np.full((4, 4, 4), 100.0, np.float32), 3)), scans / "good.nii"
    )
    for name in (*UNSAFE, "batch"):  # only batch.csv and its like are names of tables
        shutil.copyfile(scans / "good.nii", scans / f"{name}.nii")
    words = [
        "batch",
        str(scans),
        "-o",
        str(tmp_path / "out"),
        "--jobs",
        "1",
        "--max-steps",
        "2",
        "--progress",
        "none",
    ]
    assert cli.execute(words) == 9
    said = capsys.readouterr()
    assert "Traceback" not in said.err + said.out
    cases = json.loads((tmp_path / "out" / "batch_report.json").read_text())["cases"]
    assert {case["id"] for case in cases if case["status"] == "ok"} == {"good", "batch"}
    refused = [case for case in cases if case["status"] != "ok"]
    assert len(refused) == len(UNSAFE)
    for line in refused:
        assert "the id" in line["reason"] and line["exit_code"] == 3 and "table" in line["hint"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_dir()) == [
        "batch",
        "good",
    ]
