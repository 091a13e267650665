"""A program with Qt, without a screen, in a process of its own."""

import os
import subprocess
import sys

import pytest


def lines_of(program: str) -> list[str]:
    """The lines that a program writes; the test is skipped where the libraries that Qt needs are missing."""
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "QT_SCALE_FACTOR": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=120
    )
    if (
        "could not load the Qt platform" in done.stderr.lower()
        or "cannot open shared object" in done.stderr
    ):
        pytest.skip("Qt's libraries are missing")
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
