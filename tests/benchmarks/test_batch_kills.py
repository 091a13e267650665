"""Killed batches: what their trials would call a fault, without a batch; ``scripts/kills`` has the trials."""

import random
import subprocess
import sys
import time

import pytest

from benchmarks import batch_kills


def test_seconds_may_differ_and_nothing_else(tmp_path):
    for name, voxels, seconds in (("whole", "a", 1), ("same", "a", 2), ("other", "b", 1)):
        (tmp_path / name / "one").mkdir(parents=True)
        (tmp_path / name / "one" / "one_seg.nii").write_text(voxels)
        (tmp_path / name / "batch.csv").write_text(f"id,seconds\none,{seconds}\n")
        (tmp_path / name / "batch_report.json").write_text(f"{seconds}")
    whole = batch_kills.content(tmp_path / "whole")
    assert batch_kills.difference(batch_kills.content(tmp_path / "same"), whole) == ""
    assert "one/one_seg.nii" in batch_kills.difference(
        batch_kills.content(tmp_path / "other"), whole
    )
    (tmp_path / "same" / "more.json").touch()
    assert "more.json" in batch_kills.difference(batch_kills.content(tmp_path / "same"), whole)
    (tmp_path / "same" / "more.json").unlink()
    (tmp_path / "same" / "batch_report.json").unlink()
    assert "batch_report.json" in batch_kills.difference(
        batch_kills.content(tmp_path / "same"), whole
    )


PARENT = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60) # spawn_main"])
print("ready", flush=True)
child.wait()
"""


@pytest.mark.parametrize("kind", batch_kills.KINDS)
def test_what_a_kill_leaves_is_found(kind, monkeypatch):
    """The worker of a parent that it does not end with; nothing where all processes or the worker were killed."""
    monkeypatch.setattr(batch_kills, "LEAVE_SECONDS", 0.3)
    program = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, start_new_session=True
    )
    assert program.stdout is not None and program.stdout.readline() == b"ready\n"
    deadline = time.monotonic() + 10
    while not (workers := batch_kills.workers_of(program.pid)) and time.monotonic() < deadline:
        time.sleep(0.01)
    struck, left = batch_kills.killed(program, kind, 0.0, random.Random(0))
    program.stdout.close()
    assert struck and left == (workers if kind in ("parent", "Ctrl-C") else [])
    for worker in left:
        subprocess.run(["kill", "-9", str(worker)], check=True)
