"""``--checkpoint`` and ``--resume``: a killed command that is repeated ends with the files of one that was not."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.batch import pool as pools
from accelsurf.image.volume import Volume
from accelsurf.run.checkpoint_file import CheckpointFile
from tests.support.batch_jobs import InlinePool

pytestmark = pytest.mark.program

PROGRAM = (sys.executable, "-m", "accelsurf")
WORDS = (
    "--start",
    "ball:14,14,12,4",
    "--levels",
    "1",
    "--threads",
    "1",
    "--max-steps",
    "40",
    "--save-sdf",
)
#: Not the preview, which is drawn of them: it takes longer than the run.
SAME = ("ball_seg.nii.gz", "ball_surface.ply", "ball_sdf.nii.gz")


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """A bright ball in noise."""
    z, y, x = np.indices((24, 28, 32))
    image = 100.0 * ((z - 12) ** 2 + (y - 14) ** 2 + (x - 14) ** 2 < 8**2)
    image += np.random.default_rng(1).normal(0, 40, image.shape)
    path = tmp_path_factory.mktemp("scan") / "ball.nii.gz"
    io.write(Volume.from_array(image.astype(np.float32), 1.0), path)
    return path


@pytest.fixture(scope="module")
def whole(scan, tmp_path_factory):
    """The files of a run that was not stopped."""
    folder = tmp_path_factory.mktemp("whole")
    assert run("segment", scan, "-o", folder, *WORDS) == 0
    return content(folder)


def content(folder):
    return {name: (folder / name).read_bytes() for name in SAME}


def started(scan, folder, *words):
    """A command in a process of its own, once its first state is written."""
    program = subprocess.Popen(
        [*PROGRAM, "segment", str(scan), "-o", str(folder), *WORDS, "--checkpoint", "1", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while program.poll() is None and not (folder / "ball_checkpoint.npz").exists():
        time.sleep(0.005)
    assert program.poll() is None, program.communicate()
    return program


def test_a_killed_command_goes_on(scan, whole, tmp_path, capsys):
    program = started(scan, tmp_path / "out")
    program.kill()
    program.communicate()
    assert (tmp_path / "out" / "ball_checkpoint.npz").exists()
    assert run("segment", scan, "-o", tmp_path / "out", *WORDS) == 7
    assert "add --resume" in capsys.readouterr().err
    assert run("segment", scan, "-o", tmp_path / "out", *WORDS, "--resume") == 0
    assert content(tmp_path / "out") == whole
    assert not (tmp_path / "out" / "ball_checkpoint.npz").exists()


@pytest.mark.parametrize(("number", "step"), [(signal.SIGINT, 1), (signal.SIGTERM, 4)])
def test_a_signal_leaves_no_result_but_a_state_that_goes_on(scan, whole, tmp_path, number, step):
    out, words = tmp_path / "out", ("segment", str(scan), "-o", str(tmp_path / "out"), *WORDS)
    program = subprocess.Popen(
        [*PROGRAM, *words, "--progress", "json"], stderr=subprocess.PIPE, text=True
    )
    for line in program.stderr:
        if line.startswith("{") and json.loads(line).get("step") == step:
            program.send_signal(number)
            break
    _, error = program.communicate(timeout=60)
    assert program.returncode == 128 + number, error
    assert {path.name for path in out.iterdir()} == {"ball_report.json", "ball_checkpoint.npz"}
    report = json.loads((out / "ball_report.json").read_text())
    assert (
        report["status"] == "interrupted"
        and report["exit_code"] == 128 + number
        and not report["outputs"]
    )
    (said,) = (line for line in error.splitlines() if "to go on: accelsurf " in line)
    assert (
        run(*shlex.split(said.partition("to go on: accelsurf ")[2])[:-1]) == 7
    )  # the state is not lost
    assert run(*shlex.split(said.partition("to go on: accelsurf ")[2])) == 0
    assert content(out) == whole
    assert json.loads((out / "ball_report.json").read_text())["status"] == "ok"


def test_without_a_state_the_run_begins_and_one_that_ended_stays(scan, whole, tmp_path, capsys):
    folder = tmp_path / "out"
    assert run("segment", scan, "-o", folder, *WORDS, "--resume") == 0
    assert content(folder) == whole
    times = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert run("segment", scan, "-o", folder, *WORDS, "--resume") == 0
    assert "has ended already" in capsys.readouterr().out
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == times
    # Other settings are another run: its files are not replaced.
    assert run("segment", scan, "-o", folder, *WORDS, "--smoothness", "0.5", "--resume") == 7
    # So is a result that somebody has changed.
    (folder / "ball_surface.ply").write_bytes(b"mine")
    assert run("segment", scan, "-o", folder, *WORDS, "--resume") == 7
    assert (folder / "ball_surface.ply").read_bytes() == b"mine"


@pytest.mark.slow
def test_overwrite_begins_anew(scan, whole, tmp_path):
    program = started(scan, tmp_path / "out")
    program.kill()
    program.communicate()
    words = ["3" if word == "40" else word for word in WORDS]
    assert run("segment", scan, "-o", tmp_path / "out", *words, "--overwrite") == 0
    report = json.loads((tmp_path / "out" / "ball_report.json").read_text())
    assert report["stop"]["steps"] == 3
    assert not (tmp_path / "out" / "ball_checkpoint.npz").exists()


@pytest.mark.slow
def test_a_state_of_other_settings_is_refused_and_stays(scan, tmp_path, capsys):
    program = started(scan, tmp_path / "out")
    program.kill()
    program.communicate()
    words = ("segment", scan, "-o", tmp_path / "out", *WORDS, "--resume", "--smoothness", "0.5")
    assert run(*words) == 3
    assert "smoothness was 0.0, is 0.5" in capsys.readouterr().err
    assert (tmp_path / "out" / "ball_checkpoint.npz").exists()
    assert run("segment", scan, "-o", tmp_path / "out", *WORDS, "--resume") == 0


@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_full_disk_ends_the_run_and_keeps_the_last_state(scan, whole, tmp_path):
    import resource

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    program = subprocess.run(
        [*PROGRAM, "segment", str(scan), "-o", str(tmp_path / "out"), *WORDS, "--checkpoint", "1"],
        capture_output=True,
        text=True,
        preexec_fn=limited,
        check=False,
    )
    assert (
        program.returncode == 7
        and "ball_checkpoint.npz" in program.stderr
        and "Traceback" not in program.stderr
    )
    assert run("segment", scan, "-o", tmp_path / "out", *WORDS, "--resume") == 0
    assert content(tmp_path / "out") == whole


@pytest.mark.slow
def test_a_case_of_a_batch_goes_on_from_its_state(scan, whole, tmp_path, monkeypatch):
    program = started(scan, tmp_path / "out" / "ball")
    program.kill()
    program.communicate()
    resumed_place = []
    restore = CheckpointFile.restore

    def watched(self, run, growth):
        found = restore(self, run, growth)
        resumed_place.append(run.step_number)
        return found

    monkeypatch.setattr(CheckpointFile, "restore", watched)
    monkeypatch.setattr(pools, "LocalPool", InlinePool)
    assert run("batch", scan, "-o", tmp_path / "out", *WORDS, "--resume", "--quiet") == 0
    assert len(resumed_place) == 1 and resumed_place[0] > 0
    assert content(tmp_path / "out" / "ball") == whole
    assert not (tmp_path / "out" / "ball" / "ball_checkpoint.npz").exists()
