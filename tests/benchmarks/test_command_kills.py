"""What the trials of killed commands would call a fault, without a command; ``scripts/kills`` has the trials."""

import random
import sys
from collections import Counter

import pytest

from benchmarks import command_kills, kills

OLD = {"a_seg.nii": "old", "a_report.json": "1 s", "a_trace.csv": "step,seconds\n1,0.1\n"}
NEW = {"a_seg.nrrd": "new", "a_report.json": "2 s", "a_trace.csv": "step,seconds\n2,0.3\n"}


def laid(folder, files):
    folder.mkdir()
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


@pytest.fixture
def trial(tmp_path, monkeypatch):
    """A trial whose command is none, and whose next command removes what is hidden in one folder."""
    old, new = laid(tmp_path / "old", OLD), laid(tmp_path / "new", NEW)

    def look_at(out):
        for path in out.glob(".mine.*"):
            path.rmdir()
        return any(out.glob(".torn.*"))

    monkeypatch.setattr(command_kills, "look_at", look_at)
    monkeypatch.setattr(
        command_kills, "finished", lambda words: "" if words else "exit 1: no words"
    )
    command = command_kills.Command(lambda out: [], lambda out: [])
    return command_kills.Trial(
        command, tmp_path, command_kills.content(old), command_kills.content(new), 1.0
    )


def faults(trial, files, to_the_end=False, hidden=()):
    out = laid(trial.folder / "out", files)
    for name in hidden:
        (out / name).mkdir()
    return trial._faults(out, to_the_end, Counter())


@pytest.mark.parametrize(
    "files", [OLD, NEW, {**OLD, "a_report.json": "3 s"}, {**OLD, "a_frames/frame_1.npz": "state"}]
)
def test_all_old_or_all_new_files_are_right_and_what_is_hidden_may_go_with_the_next_command(
    trial, files
):
    assert faults(trial, files, hidden=[".mine.accelsurf"]) == []


@pytest.mark.parametrize("left_out", ["a_seg.nrrd", "a_report.json", "a_trace.csv", "nothing"])
def test_old_files_beside_new_ones_are_a_fault(trial, left_out):
    mixed = {name: text for name, text in {**OLD, **NEW}.items() if name != left_out}
    (fault,) = faults(trial, mixed)
    assert fault.startswith("neither the old files nor the new ones: ")


def test_what_the_next_command_leaves_is_a_fault(trial):
    (fault,) = faults(trial, OLD, hidden=[".mine.accelsurf", ".other.accelsurf"])
    assert fault == "left after the next command: .other.accelsurf"


@pytest.mark.parametrize("has_report", [True, False])
def test_an_unfinished_set_has_no_report_and_is_made_anew(has_report, trial, monkeypatch):
    given = []

    def finished(words):
        given.append(words)
        out = trial.folder / "out"
        for path in out.iterdir():
            path.rmdir() if path.is_dir() else path.unlink()
        for name, text in NEW.items():
            (out / name).write_text(text)
        return ""

    monkeypatch.setattr(command_kills, "finished", finished)
    mixed = {"a_seg.nrrd": "new", "a_trace.csv": OLD["a_trace.csv"]}
    left = mixed | ({"a_report.json": "1 s"} if has_report else {})
    found = faults(trial, left, hidden=[".torn.accelsurf"])
    assert found == (["unfinished, and a report stands"] if has_report else [])
    assert given == [["--overwrite"]]


def test_a_command_that_fails_or_leaves_a_state_when_it_is_given_again_is_a_fault(trial):
    found = faults(trial, {**OLD, "a_checkpoint.npz": "state"}, to_the_end=True)
    assert found == [
        "once more: exit 1: no words",
        "left by the command that was given once more: a_checkpoint.npz",
    ]


def test_a_program_is_killed_at_the_moment_that_follows_from_the_seed(trial, monkeypatch):
    waited = []
    monkeypatch.setattr(
        command_kills, "wait_until", lambda program, is_so, longest: waited.append(longest)
    )
    said = [
        trial._wait(None, random.Random(seed), trial.folder) for seed in (*range(20), *range(20))
    ]
    assert said[:20] == said[20:] and len(set(said)) == 20
    assert all(0 <= moment <= 60 for moment in waited)


@pytest.mark.parametrize("count", [0, 1, 7, 100])
def test_kills_are_shared_out_among_all_commands(count):
    shares = kills.shared_out(count)
    assert sum(shares.values()) == count and set(shares) == {
        "segment",
        "refine",
        "track",
        "movie",
        "batch",
    }
    assert count < 100 or min(shares.values()) >= 15


def test_a_wait_ends_with_the_program():
    program = command_kills.subprocess.Popen([sys.executable, "-c", ""])
    command_kills.wait_until(program, lambda: False, 100.0)
    assert program.returncode == 0
