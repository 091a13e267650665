"""The command line as people call it: what it writes, what it prints where, and how it ends."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.phantoms import recipes
from accelsurf.settings.catalogue import entry
from accelsurf.settings.run_config import RunConfig

START = ("--start", "ball:3,-2,1,5")
REPORT_KEYS = {
    *(
        "schema_version",
        "status",
        "exit_code",
        "error",
        "versions",
        "argv",
        "config",
        "input",
        "seed",
        "threads",
    ),
    *(
        "stop",
        "energy",
        "mass",
        "seconds",
        "peak_rss_mb",
        "volume_mm3",
        "area_mm2",
        "components",
        "touches_border",
    ),
    *("warnings", "outputs"),
}


def run(*words):
    return cli.execute([str(word) for word in words])


def command(*words, **options):
    """Start the real program."""
    return subprocess.run(
        [sys.executable, "-m", "accelsurf", *map(str, words)], capture_output=True, **options
    )


def report_of(folder, name="ball"):
    return json.loads((folder / f"{name}_report.json").read_text())


@pytest.fixture(scope="session")
def scans(tmp_path_factory):
    """A small noisy ball on an oblique, anisotropic grid, and its truth."""
    folder = tmp_path_factory.mktemp("scans")
    recipe = recipes.Recipe(
        kind="ball",
        shape=(32, 28, 20),
        spacing=(1.0, 1.0, 1.5),
        radius=9,
        noise=0.2,
        rotation=(10, 5, 20),
    )
    phantom = recipes.make(recipe)
    io.write(phantom.image, folder / "ball.nii.gz")
    io.write_labels(phantom.truth, folder / "truth.nii.gz")
    return folder


@pytest.fixture(scope="session")
def done(scans, tmp_path_factory):
    """The outputs of one good run."""
    folder = tmp_path_factory.mktemp("done") / "made" / "by the run"
    assert (
        run(
            "segment",
            scans / "ball.nii.gz",
            "-o",
            folder,
            *START,
            "--mesh",
            "ply,stl",
            "--save-sdf",
        )
        == 0
    )
    return folder


# ------------------------------------------------------------------------------------------------------- good runs


def test_segment_writes_every_output_and_nothing_else(done):
    names = (
        "seg.nii.gz",
        "sdf.nii.gz",
        "surface.ply",
        "surface.stl",
        "report.json",
        "trace.csv",
        "preview.png",
    )
    names += ("statistics.csv", "statistics.json")
    assert sorted(path.name for path in done.iterdir()) == sorted(f"ball_{name}" for name in names)


def test_labels_lie_on_the_grid_of_the_input_and_match_the_truth(done, scans, capsys):
    image, labels = io.read(scans / "ball.nii.gz"), io.read(done / "ball_seg.nii.gz")
    assert labels.array.dtype == np.uint8 and set(np.unique(labels.array)) == {0, 1}
    assert labels.geometry.difference(image.geometry) == ""
    assert run("evaluate", done / "ball_seg.nii.gz", scans / "truth.nii.gz", "--json") == 0
    assert json.loads(capsys.readouterr().out)["dice"] > 0.95


def test_sdf_agrees_with_the_labels(done):
    labels, sdf = io.read(done / "ball_seg.nii.gz"), io.read(done / "ball_sdf.nii.gz")
    assert np.array_equal(labels.array == 1, sdf.array < 0)


def test_report_tells_the_whole_run(done, scans):
    document = report_of(done)
    assert set(document) >= REPORT_KEYS
    assert (document["status"], document["exit_code"], document["error"]) == ("ok", 0, None)
    image = io.read(scans / "ball.nii.gz")
    assert document["input"]["sha256"] == io.sha256(scans / "ball.nii.gz")
    assert document["input"]["size"] == [32, 28, 20] and document["input"]["spacing"] == [
        1.0,
        1.0,
        1.5,
    ]
    assert document["input"]["origin"] == pytest.approx(image.geometry.origin)
    assert np.allclose(document["input"]["direction"], image.geometry.direction)
    assert RunConfig(**document["config"]).start == ("ball:3,-2,1,5",)
    assert document["stop"]["reason"] == "converged" and document["stop"]["message"]
    assert document["energy"]["last"] < document["energy"]["first"]
    seconds = dict(document["seconds"])
    assert seconds.pop("refine") is None  # nothing was corrected
    assert all(value >= 0 for value in seconds.values())
    parts = sum(value for part, value in seconds.items() if part != "total")
    assert 0.5 * document["seconds"]["total"] < parts <= document["seconds"]["total"]
    assert document["volume_mm3"] == pytest.approx(4 / 3 * np.pi * 9**3, rel=0.1)
    assert document["components"] == 1 and document["touches_border"] is False
    kinds = [output["kind"] for output in document["outputs"]]
    assert kinds == [
        "labels",
        "surface",
        "surface",
        "sdf",
        "trace",
        "preview",
        "statistics",
        "statistics",
    ]
    for output in document["outputs"]:
        assert io.sha256(output["path"]) == output["sha256"]


def test_trace_has_a_row_for_each_step(done):
    rows = list(csv.DictReader((done / "ball_trace.csv").read_text().splitlines()))
    document = report_of(done)
    assert [int(row["step"]) for row in rows] == list(range(document["stop"]["steps"] + 1))
    assert float(rows[0]["potential"]) == document["energy"]["first"]
    assert float(rows[-1]["potential"]) == document["energy"]["last"]
    assert all(float(row["kinetic"]) >= 0 for row in rows) and float(rows[-1]["friction_work"]) > 0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("suffix", ["nii", "nrrd", "mha", "mhd"])
def test_format_follows_the_input(suffix, scans, tmp_path):
    io.write(io.read(scans / "ball.nii.gz"), tmp_path / f"ball.{suffix}")
    out = tmp_path / "out"
    assert (
        run("segment", "-i", tmp_path / f"ball.{suffix}", "-o", out, *START, "--max-steps", 2) == 0
    )
    labels = io.read(out / f"ball_seg.{suffix}")
    assert labels.geometry.difference(io.read(tmp_path / f"ball.{suffix}").geometry) == ""


def test_format_and_mesh_space_as_told(scans, tmp_path):
    words = (
        "segment",
        scans / "ball.nii.gz",
        *START,
        "--max-steps",
        2,
        "--mesh",
        "obj",
        "--format",
        "mha",
    )
    assert run(*words, "-o", tmp_path / "lps") == 0
    assert run(*words, "-o", tmp_path / "ras", "--mesh-space", "ras") == 0
    assert (tmp_path / "lps" / "ball_seg.mha").is_file()
    meshes = []
    for space in ("lps", "ras"):
        lines = (tmp_path / space / "ball_surface.obj").read_text().splitlines()
        meshes.append(
            np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)
        )
    assert len(meshes[0]) > 100
    assert np.allclose(meshes[0] * (-1, -1, 1), meshes[1])


def test_results_go_to_stdout_and_progress_to_stderr(scans, tmp_path, capsys):
    words = (
        "segment",
        scans / "ball.nii.gz",
        *START,
        "--max-steps",
        3,
        "--overwrite",
        "-o",
        tmp_path,
    )
    assert run(*words) == 0
    plain = capsys.readouterr()
    assert "ball_seg.nii.gz" in plain.out and "volume" in plain.out
    assert "step" not in plain.err.replace("steps", "")  # stderr is no terminal here: no bar
    assert (
        "warning: ball: max-steps" in plain.err and "--max-steps" not in plain.err
    )  # more would not help

    assert run(*words, "--progress", "json", "--quiet") == 0
    json_run = capsys.readouterr()
    assert json_run.out == ""
    steps = [json.loads(line) for line in json_run.err.splitlines() if line.startswith("{")]
    assert [line["step"] for line in steps] == [0, 1, 2, 3]
    assert {"event", "run", "potential", "kinetic", "dt"} <= set(steps[0])

    assert run(*words, "--progress", "bar") == 0
    assert "3/3" in capsys.readouterr().err
    assert run(*words, "--progress", "none") == 0
    assert "{" not in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------- configuration


def test_dump_config_does_nothing_else_and_can_be_run_again(scans, tmp_path, capsys):
    words = (
        "--start",
        "ball:-1.5,2,-3,4",
        "--start",
        "box:-1,-1,-1,2,2,2",
        "--smoothness",
        0.25,
        "--friction",
        0.5,
    )
    assert (
        run("segment", scans / "absent.nii", "-o", tmp_path / "out", *words, "--dump-config") == 0
    )
    text = capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    config = RunConfig(**tomllib.loads(text))
    assert config.start == ("ball:-1.5,2,-3,4", "box:-1,-1,-1,2,2,2")
    assert (config.smoothness, config.friction) == (0.25, 0.5)
    (tmp_path / "run.toml").write_text(text)
    assert run("segment", "--config", tmp_path / "run.toml", "--dump-config") == 0
    assert capsys.readouterr().out == text


def test_options_beat_the_file_which_beats_the_defaults(tmp_path, capsys):
    (tmp_path / "run.toml").write_text('cfl = 0.25\nflow = "gradient"\nsave_sdf = true\n')
    words = ("segment", "--config", tmp_path / "run.toml", "--dump-config")
    assert run(*words, "--flow", "constant-density", "--no-save-sdf") == 0
    config = RunConfig(**tomllib.loads(capsys.readouterr().out))
    assert config == RunConfig(cfl=0.25, flow="constant-density")
    assert run(*words) == 0
    assert RunConfig(**tomllib.loads(capsys.readouterr().out)) == RunConfig(
        cfl=0.25, flow="gradient", save_sdf=True
    )


def test_every_setting_is_an_option(capsys):
    values = RunConfig(
        **dict(
            flow="flowable-mass:k=3,lam=2,rho=0.5,t0=0.1,gravity=2,noise_length=6,noise_time=2",
            start=("center", "ball:-1,2,-3,4"),
            smoothness=1.5,
            presmooth=0.5,
        ),
        **dict(
            diffusion=0.25,
            friction=2,
            restart="off",
            cfl=0.25,
            max_steps=9,
            percentile=90,
            epsilon=2,
        ),
        **dict(
            mesh="obj,vtp",
            mesh_space="ras",
            save_sdf=True,
            half_width=5,
            balance=1.5,
            format="nrrd",
        ),
        **dict(
            seed=5, threads=2, energy="geodesic", edge_scale=1.5, edge_contrast=0.2, balloon=-0.5
        ),
        **dict(
            noise=0.5, reproducible=True, levels=2, mask="m.nii", roi="1,2,3,4,5,6", max_volume=1e4
        ),
        **dict(
            foreground=("center", "ball:-1,2,-3,4"),
            background=("otsu:dark", "label:b.nii@2"),
            channel=("a", "b"),
        ),
        **dict(
            outside=("point:1,2,3", "stroke:s.csv"),
            box="0,0,0,9,9,9",
            size="250ml",
            keep_state="yes",
        ),
        **dict(stop_at_rest=True, end="present", extension="fast-marching", refine=["merge=1,3"]),
        **dict(
            level=2,
            channel_index=1,
            time_index=3,
            channels_from_time=True,
            series="4",
            spacing="1,2,3um",
        ),
        **dict(
            name=["2=liver"],
            color=["2=#102030"],
            label_table="t.csv",
            also=["tsv", "rtstruct"],
        ),
        layout="nnunet",
        label_group="cells",
        window="bone",
        edit=["step=4 flow=sobolev", "step=9 smoothness=0.5"],
    )
    words = []
    for key, value in values.model_dump().items():
        option = "--" + key.replace("_", "-")
        if value is None:
            continue
        if entry(key).repeated:
            value = (
                [str(one) for one in getattr(values, key)] if key in ("edit", "refine") else value
            )
            words += [word for text in value for word in (option, text)]
        else:
            words += (
                [option] if value is True else [option, ",".join(value) if key == "mesh" else value]
            )
    assert run("segment", "--dump-config", *words) == 0
    assert RunConfig(**tomllib.loads(capsys.readouterr().out)) == values
    # The one that does not go together with the others.
    assert "objects" in [key for key, value in values.model_dump().items() if value is None]
    assert run("segment", "--dump-config", "--objects", "o.csv") == 0
    assert tomllib.loads(capsys.readouterr().out)["objects"] == "o.csv"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--smoothness", "-1"), "smoothness: -1 was given, expected a number at least 0"),
        (("--cfl", "fast"), "cfl: fast was given"),
        (("--flow", "sobolov"), "gradient, sobolev or momentum"),
        (("--mesh", "ply,wrl"), "one or more of ply, stl, obj, vtp"),
        (("--friction", "0"), "a number greater than 0, or t"),
        (("--smothness", "1"), "Did you mean --smoothness"),
        (("--progress", "dots"), '"bar", "json", "none"'),
        (("--cfl",), "requires an argument"),
        (("--config", "absent.toml"), "absent.toml: the configuration cannot be read"),
    ],
)
def test_usage_errors_are_one_line_and_a_hint(words, message, scans, tmp_path, capsys):
    assert run("segment", scans / "ball.nii.gz", "-o", tmp_path / "out", *words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and lines[0].startswith("error: ") and lines[1].startswith("hint: ")
    assert message in lines[0]


def test_unknown_key_in_the_file_is_reported_too(scans, tmp_path, capsys):
    (tmp_path / "run.toml").write_text("smothness = 1\n")
    words = (
        "segment",
        scans / "ball.nii.gz",
        "-o",
        tmp_path / "out",
        "--config",
        tmp_path / "run.toml",
    )
    assert run(*words) == 2
    assert "did you mean smoothness?" in capsys.readouterr().err
    document = report_of(tmp_path / "out")
    assert (document["status"], document["exit_code"]) == ("failed", 2)
    assert document["error"]["type"] == "UsageError" and document["config"] is None
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["ball_report.json"]


@pytest.mark.parametrize(
    "words", [("segment",), ("segment", "x.nii"), ("segmen", "x.nii"), ("evaluate", "x.nii")]
)
def test_incomplete_commands(words, capsys):
    assert run(*words) == 2
    assert capsys.readouterr().err.startswith("error: ")


# ---------------------------------------------------------------------------------------------- what goes wrong


def test_existing_outputs_are_refused_before_anything_is_read(scans, tmp_path, capsys):
    (tmp_path / "ball_trace.csv").write_text("precious")
    absent = scans / "nowhere" / "ball.nii.gz"
    assert run("segment", absent, "-o", tmp_path, *START) == 7
    error = capsys.readouterr().err
    assert "ball_trace.csv: exists already" in error and "--overwrite" in error
    assert [path.name for path in tmp_path.iterdir()] == ["ball_trace.csv"]
    assert (tmp_path / "ball_trace.csv").read_text() == "precious"


def test_overwrite_replaces(scans, tmp_path):
    (tmp_path / "ball_trace.csv").write_text("old")
    assert (
        run(
            "segment",
            scans / "ball.nii.gz",
            "-o",
            tmp_path,
            *START,
            "--max-steps",
            1,
            "--overwrite",
        )
        == 0
    )
    assert (tmp_path / "ball_trace.csv").read_text().startswith("step,")


def test_output_that_cannot_be_written(scans, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert run("segment", scans / "ball.nii.gz", "-o", tmp_path / "file" / "out", *START) == 7
    assert "cannot be written to" in capsys.readouterr().err
    (tmp_path / "out" / "ball_seg.nii.gz").mkdir(parents=True)
    assert run("segment", scans / "ball.nii.gz", "-o", tmp_path / "out", *START, "--overwrite") == 7
    assert "is a folder" in capsys.readouterr().err


def test_bad_input_leaves_a_report_and_does_not_block_the_next_try(scans, tmp_path, capsys):
    (tmp_path / "ball.nii.gz").write_bytes(b"")
    out = tmp_path / "out"
    assert run("segment", tmp_path / "ball.nii.gz", "-o", out, *START) == 3
    error = capsys.readouterr().err
    assert error.startswith("error: ") and "Traceback" not in error and len(error.splitlines()) <= 2
    document = report_of(out)
    assert set(document) >= REPORT_KEYS
    assert (document["status"], document["exit_code"], document["error"]["type"]) == (
        "failed",
        3,
        "InputError",
    )
    assert document["error"]["message"] in error
    assert document["outputs"] == [] and document["input"]["size"] is None
    assert [path.name for path in out.iterdir()] == ["ball_report.json"]

    (tmp_path / "ball.nii.gz").write_bytes((scans / "ball.nii.gz").read_bytes())
    assert run("segment", tmp_path / "ball.nii.gz", "-o", out, *START, "--max-steps", 1) == 0
    assert report_of(out)["status"] == "ok"


def test_a_failure_does_not_replace_the_report_of_a_result(scans, tmp_path):
    good = ("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 1)
    assert run(*good) == 0
    before = (tmp_path / "ball_report.json").read_bytes()
    assert run(*good, "--cfl", "-1") == 2
    assert run(*good) == 7
    assert (tmp_path / "ball_report.json").read_bytes() == before


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--cfl", "-1"), 2),
        (("--start", "label:absent.nii.gz"), 3),
        (("--smoothness", "1000"), 5),
        (("--strict",), 4),
    ],
)
def test_a_failing_run_leaves_a_good_result(words, code, scans, tmp_path, capsys):
    steps = ("--max-steps", 2)
    good = ("segment", scans / "ball.nii.gz", "-o", tmp_path, "--overwrite")
    assert run(*good, *START, *steps) == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    start = () if "--start" in words else START
    assert run(*good, *start, *words, *(() if code == 5 else steps)) == code
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    others = {path.name for path in tmp_path.iterdir()} - set(before)
    assert "ball_failed_report.json" in others and all(
        name.startswith("ball_failed_") for name in others
    )
    failed = report_of(tmp_path, "ball_failed")
    assert (failed["status"], failed["exit_code"]) == ("failed", code)
    assert {
        "ball_failed_report.json",
        *(os.path.basename(one["path"]) for one in failed["outputs"]),
    } == others
    assert run(*good, *START, *steps) == 0
    assert {path.name for path in tmp_path.iterdir()} == set(before)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("words", "code"), [(("--strict",), 4), (("--cfl", "-1"), 2)])
def test_a_failing_run_leaves_the_result_of_an_image_that_is_called_failed(
    words, code, scans, tmp_path, capsys
):
    out, steps = tmp_path / "out", ("--max-steps", 1)
    shutil.copy(scans / "ball.nii.gz", tmp_path / "ball_failed.nii.gz")
    assert run("segment", scans / "ball.nii.gz", "-o", out, *START, *steps) == 0
    assert run("segment", tmp_path / "ball_failed.nii.gz", "-o", out, *START, *steps) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert (
        run("segment", scans / "ball.nii.gz", "-o", out, *START, *steps, "--overwrite", *words)
        == code
    )
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert "is the report of a result" in capsys.readouterr().err


def test_overwrite_takes_away_what_the_earlier_run_wrote_and_nothing_else(scans, tmp_path):
    words = (
        "segment",
        scans / "ball.nii.gz",
        "-o",
        tmp_path,
        *START,
        "--max-steps",
        1,
        "--overwrite",
    )
    assert run(*words, "--mesh", "ply,obj", "--format", "mhd", "--save-sdf") == 0
    assert (tmp_path / "ball_seg.zraw").exists()
    assert {one["kind"] for one in report_of(tmp_path)["outputs"]} >= {"labels", "data", "sdf"}
    (tmp_path / "ball_notes.txt").write_text("mine")
    (tmp_path / "ball_surface.obj").write_text("changed by hand")
    assert run(*words, "--mesh", "stl") == 0
    names = {
        "seg.nii.gz",
        "surface.stl",
        "report.json",
        "trace.csv",
        "preview.png",
        "notes.txt",
        "surface.obj",
    }
    names |= {"statistics.csv", "statistics.json"}
    assert {path.name for path in tmp_path.iterdir()} == {f"ball_{name}" for name in names}
    assert (tmp_path / "ball_surface.obj").read_text() == "changed by hand"


class Killed(BaseException):
    """Ends a run between two renames as a kill would: nothing is tidied up."""


@pytest.mark.parametrize("how", ["--overwrite", "--resume"])
def test_an_unfinished_set_is_named_and_made_anew(how, scans, tmp_path, capsys, monkeypatch):
    """The three runs have other formats: what the first two have written goes by their own sealed reports."""
    words = ("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 3)
    (tmp_path / "ball_notes.txt").write_text("mine")
    assert run(*words[:-1], 1, "--format", "nrrd", "--mesh", "stl") == 0
    before, moved, real = report_of(tmp_path), [], os.replace

    def replace(source, goal):
        if os.path.dirname(goal) == str(tmp_path):
            moved.append(goal)
            if len(moved) == 3:
                raise Killed
        real(source, goal)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(Killed):
        run(*words, "--overwrite", "--format", "mha")
    monkeypatch.undo()
    assert not (tmp_path / "ball_report.json").exists() and list(tmp_path.glob(".*"))
    left = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    for reader in (
        words,
        ("evaluate", tmp_path / "ball_preview.png", scans / "truth.nii.gz"),
        ("refine", tmp_path, "--inside", "point:1,2,3"),
        ("movie", tmp_path, "-o", tmp_path / "a.png", "--preview"),
    ):
        capsys.readouterr()
        assert run(*reader) == 7
        said = capsys.readouterr().err
        assert "ball: is unfinished" in said and "--overwrite" in said
        assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == left
    assert run(*words, how) == 0
    after = report_of(tmp_path)
    assert after["stop"]["steps"] == 3 and after["outputs"] != before["outputs"]
    for one in after["outputs"]:
        assert io.sha256(one["path"]) == one["sha256"]
    listed = {os.path.basename(one["path"]) for one in after["outputs"]}
    left = {path.name for path in tmp_path.iterdir()} - listed
    assert left == {"ball_report.json", "ball_notes.txt"}


def test_a_file_that_appears_while_the_run_goes_on_is_not_replaced(
    scans, tmp_path, capsys, monkeypatch
):
    from accelsurf.output.pictures import preview

    def precious(*args):
        (tmp_path / "ball_trace.csv").write_text("precious")
        return b""

    monkeypatch.setattr(preview, "preview_png", precious)
    assert run("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 1) == 7
    assert "ball_trace.csv: exists already" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {
        "ball_trace.csv",
        "ball_failed_report.json",
    }
    assert (tmp_path / "ball_trace.csv").read_text() == "precious"


def test_two_runs_with_one_output(scans, tmp_path, capsys):
    from accelsurf.io.file_set import open_set

    with open_set(tmp_path, "ball"):
        assert run("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 1) == 7
        assert "another run is writing there now" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "start",
    [
        "ball:500,0,0,5",
        "ball:0,0,0",
        "ball:0,0,0,-5",
        "cone:1,2,3",
        "label:absent.nii.gz",
        "threshold:50,60",
        "",
    ],
)
def test_bad_starts_are_told(start, scans, tmp_path, capsys):
    code = run("segment", scans / "ball.nii.gz", "-o", tmp_path, "--start", start)
    error = capsys.readouterr().err
    assert (
        code in (2, 3)
        and error.startswith("error: ")
        and "hint: " in error
        and "Traceback" not in error
    )
    assert report_of(tmp_path)["exit_code"] == code


def test_strict_asks_for_convergence(scans, tmp_path, capsys):
    words = ("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 3)
    assert run(*words, "--strict") == 4
    assert "error: ball: max-steps after 3 steps" in capsys.readouterr().err
    document = report_of(tmp_path)
    assert (document["status"], document["exit_code"]) == ("failed", 4)
    assert document["error"]["type"] == "NotConvergedError"
    assert (tmp_path / "ball_seg.nii.gz").is_file()
    assert run(*words, "--overwrite") == 0
    document = report_of(tmp_path)
    assert document["status"] == "ok" and any(
        "max-steps" in warning for warning in document["warnings"]
    )


@pytest.mark.pictures
def test_vanished_surface(scans, tmp_path, capsys):
    # An area weight far beyond the object's size: nothing can hold the surface up.
    words = ("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--smoothness", 1000)
    assert run(*words) == 5
    error = capsys.readouterr().err
    assert "vanished" in error and "hint: " in error
    document = report_of(tmp_path)
    assert (document["status"], document["exit_code"]) == ("failed", 5)
    assert (
        document["error"]["type"] == "EmptyResultError" and document["stop"]["reason"] == "vanished"
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("ball_preview.png", "ball_report.json", "ball_trace.csv")
    ]


def test_internal_error_is_a_line_a_report_and_with_debug_a_traceback(
    scans, tmp_path, capsys, monkeypatch
):
    def broken(*args, **kwargs):
        raise ZeroDivisionError("nobody\nexpected this")

    monkeypatch.setattr("accelsurf.api.segment", broken)
    words = ("segment", scans / "ball.nii.gz", "-o", tmp_path, *START)
    assert run(*words) == 1
    error = capsys.readouterr().err
    assert (
        error.splitlines()[0] == "error: ZeroDivisionError: nobody expected this"
        and "--debug" in error
    )
    assert report_of(tmp_path)["error"]["type"] == "ZeroDivisionError"
    with pytest.raises(ZeroDivisionError):
        run(*words, "--debug")


def test_write_that_fails_half_way_is_reported(scans, tmp_path, capsys, monkeypatch):
    from accelsurf.output.pictures import preview

    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(preview, "preview_png", full)
    assert run("segment", scans / "ball.nii.gz", "-o", tmp_path, *START, "--max-steps", 1) == 7
    assert "cannot be written (No space left on device)" in capsys.readouterr().err
    document = report_of(tmp_path)
    assert (document["status"], document["exit_code"]) == ("failed", 7)
    assert document["error"]["type"] == "OutputError" and document["outputs"] == []
    assert [path.name for path in tmp_path.iterdir()] == [
        "ball_report.json"
    ]  # labels of half a run are of none


# ---------------------------------------------------------------------------------------------- other commands


def test_synth_evaluate(tmp_path, capsys):
    assert run("synth", "ball_small", "-o", tmp_path, "--seed", 3) == 0
    assert "ball_small_truth.nii.gz" in capsys.readouterr().out
    description = json.loads((tmp_path / "ball_small.json").read_text())
    assert description["recipe"]["seed"] == 3 and description["volume_mm3"] > 0
    assert run("synth", "ball_small", "-o", tmp_path) == 7
    assert run("synth", "ball_small", "-o", tmp_path, "--seed", 3, "--overwrite") == 0
    assert (
        json.loads((tmp_path / "ball_small.json").read_text())["outputs"] == description["outputs"]
    )
    assert run("synth", "bal_small", "-o", tmp_path) == 2
    truth = tmp_path / "ball_small_truth.nii.gz"
    capsys.readouterr()
    assert run("evaluate", truth, truth) == 0
    values = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert values["dice"] == "1" and values["hausdorff_mm"] == "0"


def test_synth_takes_a_file(tmp_path):
    (tmp_path / "my_cube.toml").write_text('kind = "cube"\nshape = [16, 14, 12]\nside = 6.0\n')
    assert run("synth", tmp_path / "my_cube.toml", "-o", tmp_path / "out") == 0
    assert io.read(tmp_path / "out" / "my_cube.nii.gz").geometry.size == (16, 14, 12)
    (tmp_path / "my_cube.toml").write_text('kind = "cube"\nshape = [16, 14, 12]\nsid = 6.0\n')
    assert run("synth", tmp_path / "my_cube.toml", "-o", tmp_path / "out", "--overwrite") == 2


def test_evaluate_refuses_other_grids(scans, tmp_path, capsys):
    io.write_labels(
        recipes.make(recipes.load_recipe("ball_small")).truth, tmp_path / "other.nii.gz"
    )
    assert run("evaluate", scans / "truth.nii.gz", tmp_path / "other.nii.gz") == 3
    assert "hint: " in capsys.readouterr().err


def test_info(capsys):
    assert run("info", "--json") == 0
    description = json.loads(capsys.readouterr().out)
    assert {"gradient", "flowable-mass"} < set(description["flows"]) and "chan-vese" in description[
        "energies"
    ]
    assert {"ball", "box", "label", "threshold", "center"} <= set(description["starts"])
    assert "interrupted" in description["stop_reasons"] and description["exit_codes"]["130"]
    assert set(description["config_schema"]["properties"]) == set(RunConfig.model_fields)
    assert description["versions"]["numpy"] == np.__version__
    assert run("info", "settings") == 0
    assert "max_steps" in capsys.readouterr().out


def test_info_alone_lists_the_topics_and_each_tells_something(capsys, tmp_path, monkeypatch):
    assert run("info") == 0
    lines = capsys.readouterr().out.splitlines()
    topics = [line.split()[0] for line in lines if line.startswith("  ")]
    assert len(topics) > 10 and len(lines) < 24
    for topic in topics:
        assert run("info", topic) == 0
        assert len(capsys.readouterr().out.splitlines()) > 3, topic
    assert run("info", "preset") == 3
    assert "preset" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flows").mkdir()
    assert run("info", "flows") == 3  # a folder of this name goes before the topic


# ------------------------------------------------------------------------------------------- the program itself


@pytest.mark.program
def test_help_loads_nothing_heavy():
    code = (
        "import sys; from accelsurf.cli import execute; assert execute(['--help']) == 0; "
        "heavy = {'numpy', 'numba', 'scipy', 'SimpleITK', 'matplotlib', 'skimage', 'pydantic', 'pyvista'}; "
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    began = time.perf_counter()
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert "segment" in ended.stdout and "--debug" in ended.stdout
    assert time.perf_counter() - began < 5  # half a second on an idle machine


@pytest.mark.program
def test_program_version_and_exit_codes(scans, tmp_path):
    from accelsurf import __version__

    assert command("--version").stdout.decode().strip() == __version__
    assert command("segment", "--cfl", "7", "--dump-config").returncode == 2
    ended = command("segment", tmp_path / "absent.nii.gz", "-o", tmp_path)
    assert ended.returncode == 3 and b"Traceback" not in ended.stderr


def test_every_command_has_help(capsys):
    for name in ("segment", "synth", "batch", "evaluate", "info"):
        assert run(name, "--help") == 0
        assert f"Usage: accelsurf {name}" in capsys.readouterr().out


@pytest.mark.program
def test_ctrl_c_keeps_an_earlier_result(tmp_path):
    recipe = recipes.Recipe(kind="cube", shape=(64, 64, 64), side=36.0, noise=1.0)
    io.write(recipes.make(recipe).image, tmp_path / "ball.nii.gz")
    words = (
        "segment",
        tmp_path / "ball.nii.gz",
        "-o",
        tmp_path / "out",
        "--start",
        "ball:2,1,-1,5",
        "--overwrite",
    )
    assert run(*words, "--max-steps", "2") == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    words = (*words, "--cfl", "0.02")
    program = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *map(str, words), "--progress", "json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert program.stderr is not None
    for line in program.stderr:
        if line.startswith("{") and json.loads(line)["step"] >= 2:
            program.send_signal(signal.SIGINT)
            break
    _, error = program.communicate(timeout=120)
    assert program.returncode == 130, error
    assert "Traceback" not in error
    after = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert set(after) - set(before) == {"ball_failed_report.json", "ball_checkpoint.npz"}
    assert {name: after[name] for name in before} == before
    document = json.loads(after["ball_failed_report.json"])
    assert (document["status"], document["exit_code"], document["outputs"]) == (
        "interrupted",
        130,
        [],
    )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
@pytest.mark.program
def test_streams_that_cannot_be_written():
    def shell(words):
        line = f"'{sys.executable}' -m accelsurf {words}"
        return subprocess.run(["sh", "-c", line], capture_output=True, text=True)

    full = shell("info >/dev/full")
    assert full.returncode == 7
    assert (
        full.stderr.splitlines()[0]
        == "error: standard output: cannot be written (No space left on device)"
    )
    for words, code in (
        ("info >&-", 0),
        ("info 2>&-", 0),
        ("segmen >&- 2>&-", 2),
        ("segmen 2>/dev/full", 2),
    ):
        ended = shell(words)
        assert (
            ended.returncode == code
            and "Traceback" not in ended.stderr
            and "error: " not in ended.stdout
        ), words


@pytest.mark.program
def test_closed_stdout_is_no_error():
    line = f"'{sys.executable}' -m accelsurf info | head -1"
    ended = subprocess.run(line, shell=True, capture_output=True, text=True)
    assert ended.returncode == 0 and ended.stderr == "" and ended.stdout
