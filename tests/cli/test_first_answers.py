"""``--answer``: which of the likely answers to the first click a command takes, and what it says of the others."""

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import accelsurf
from accelsurf import cli, io
from accelsurf.settings.run_config import RunConfig
from tests.support.part_and_whole import BEYOND, CLICK, part_and_whole

WORDS = ("--inside", CLICK, "--levels", "1", "--threads", "1", "--max-steps", "60")
SAME = ("scan_seg.nii.gz", "scan_surface.ply", "scan_run.toml")


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("scan") / "scan.nii.gz"
    io.write(part_and_whole()[0], path)
    return path


@pytest.fixture(scope="module")
def second(scan, tmp_path_factory):
    """The files of the second answer."""
    folder = tmp_path_factory.mktemp("second") / "out"
    assert run("segment", scan, "-o", folder, *WORDS, "--answer", 2) == 0
    return folder


def labels_of(folder):
    return io.read_labels(folder / "scan_seg.nii.gz").array > 0


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def answers_of(folder):
    return json.loads((folder / "scan_report.json").read_text())["quality"]["answers"]


def other_answers(text):
    """The numbers that a command offers."""
    (line,) = [line for line in text.splitlines() if "may also mean" in line]
    return re.findall(r"--answer (\d)", line)


def test_the_other_answer_has_another_volume_and_each_run_names_the_other(
    scan, second, tmp_path, capsys
):
    _, part, whole = part_and_whole()
    assert run("segment", scan, "-o", tmp_path / "first", *WORDS) == 0
    assert other_answers(capsys.readouterr().out) in (["2"], ["2", "3"])
    assert run("segment", scan, "-o", tmp_path / "again", *WORDS, "--answer", 2) == 0
    assert other_answers(capsys.readouterr().out) in (["1"], ["1", "3"])
    assert dice(labels_of(tmp_path / "first"), whole) > 0.85 and dice(labels_of(second), part) > 0.9
    assert [answer["number"] for answer in answers_of(tmp_path / "first")][:2] == [1, 2]
    assert [answer["number"] for answer in answers_of(second)][:2] == [2, 1]
    sizes, others = (
        {answer["number"]: answer["volume_mm3"] for answer in answers_of(folder)[:2]}
        for folder in (tmp_path / "first", second)
    )
    assert sizes == {number: pytest.approx(mm3, rel=0.05) for number, mm3 in others.items()}
    assert sizes[1] > 1.3 * sizes[2]


def test_its_settings_have_it_and_repeat_the_run(scan, second, tmp_path):
    assert RunConfig.from_toml(second / "scan_run.toml").answer == 2
    assert run("segment", scan, "-o", tmp_path / "out", "--config", second / "scan_run.toml") == 0
    for name in SAME:
        assert (tmp_path / "out" / name).read_bytes() == (second / name).read_bytes()


def test_refine_goes_on_from_it(scan, second, tmp_path, capsys):
    folder = shutil.copytree(second, tmp_path / "out")
    before = labels_of(folder)
    assert run("refine", folder, "--inside", BEYOND) == 0
    assert "may also mean" not in capsys.readouterr().out  # it was corrected
    after, (_, _, whole) = labels_of(folder), part_and_whole()
    assert after.sum() > before.sum() and dice(after, whole) > dice(before, whole)
    assert RunConfig.from_toml(folder / "scan_run.toml").answer == 2
    result = accelsurf.segment(
        accelsurf.read(scan), config=RunConfig.from_toml(second / "scan_run.toml")
    )
    assert np.array_equal(accelsurf.refine(result, inside=BEYOND).labels > 0, after)


#: A command that dies after its fourth step.
KILLED = """
import os, sys
from accelsurf import cli
from accelsurf.run.checkpoint_file import CheckpointFile
watch = CheckpointFile.watch
def killed(self, run, growth, at_once=False):
    watch(self, run, growth, at_once)
    if run.step_number == 4:
        os._exit(9)
CheckpointFile.watch = killed
cli.execute(sys.argv[1:])
"""


def test_a_killed_run_of_it_goes_on(scan, second, tmp_path):
    folder = tmp_path / "out"
    words = [str(word) for word in ("segment", scan, "-o", folder, *WORDS, "--answer", 2)]
    program = subprocess.run(
        [sys.executable, "-c", KILLED, *words, "--checkpoint", "1"], check=False
    )
    assert program.returncode == 9 and (folder / "scan_checkpoint.npz").exists()
    assert run("segment", scan, "-o", folder, *WORDS, "--answer", 2, "--resume") == 0
    for name in SAME:
        assert (folder / name).read_bytes() == (second / name).read_bytes()


def test_without_a_model_of_clicks_it_has_no_effect_and_that_is_said(scan, tmp_path, capsys):
    words = ("--start", CLICK, "--levels", "1", "--max-steps", "2")
    assert run("segment", scan, "-o", tmp_path / "out", *words, "--answer", 2) == 0
    said = capsys.readouterr()
    assert (
        "answer was given, but has no effect on" in said.out + said.err
        and "may also mean" not in said.out
    )
    assert answers_of(tmp_path / "out") == []


@pytest.mark.parametrize("value", ["0", "4", "part"])
def test_other_numbers_are_refused(scan, tmp_path, capsys, value):
    assert run("segment", scan, "-o", tmp_path / "out", *WORDS, "--answer", value) == 2
    assert "answer: " in capsys.readouterr().err and not list((tmp_path / "out").glob("*seg*"))
