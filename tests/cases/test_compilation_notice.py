"""What is said while kernels are compiled: one line, off a terminal too, and nothing where all are stored."""

import json
import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from accelsurf.cases.watcher import COMPILING, COMPILING_ANEW, Watcher
from accelsurf.cli.options import Display
from accelsurf.kernels import storage
from accelsurf.kernels._jit import kernel


@pytest.fixture
def compile_now(tmp_path, monkeypatch):
    """A function that compiles a kernel which nobody has stored, twice for two types."""
    monkeypatch.setattr("accelsurf.kernels._jit.STORAGE", None)
    # Numba reads the environment again where it compiles; tests before may have begun with another number of threads.
    monkeypatch.setenv("NUMBA_NUM_THREADS", str(numba.config.NUMBA_NUM_THREADS))

    def call():
        def fresh(values):
            return values[0] + 1

        compiled = kernel(fresh)
        return compiled(np.zeros(2)), compiled(np.zeros(2, np.int32))

    return call


@pytest.mark.parametrize("text", [COMPILING, COMPILING_ANEW])
def test_the_notice_is_one_line_of_a_terminal(text):
    assert len(text) < 80 and text.isascii()


@pytest.mark.parametrize("shown", [None, "none", "bar"])
def test_it_is_said_once_in_a_process_that_compiles(shown, compile_now, capsys):
    watcher = Watcher(Display(progress=shown))
    for name in ("one", "two"):
        with watcher.watch(name, 10):
            compile_now()
    assert capsys.readouterr().err.count(COMPILING) == 1


def test_it_is_an_event_where_progress_is_json(compile_now, capsys):
    with Watcher(Display(progress="json")).watch("scan", 10):
        compile_now()
    (line,) = capsys.readouterr().err.splitlines()
    assert json.loads(line) == {
        "event": "compiling",
        "run": "scan",
        "message": COMPILING.removeprefix("note: "),
    }


def test_it_is_not_said_when_quiet_before_or_after_a_run_or_when_nothing_is_compiled(
    compile_now, capsys
):
    with Watcher(Display(quiet=True)).watch("scan", 10):
        compile_now()
    with Watcher(Display()).watch("scan", 10):
        pass
    compile_now()
    assert capsys.readouterr().err == ""


def test_where_nothing_can_be_stored_it_says_what_to_do(compile_now, capsys, monkeypatch):
    monkeypatch.setattr(storage, "STORAGE", None)
    with Watcher(Display()).watch("scan", 10):
        compile_now()
    assert capsys.readouterr().err == f"{COMPILING_ANEW}\n"


@pytest.mark.slow
def test_a_kernel_that_is_stored_is_loaded_without_a_word(tmp_path):
    code = (
        "import numpy as np; from accelsurf.cli.options import Display; from accelsurf.cases.watcher import Watcher\n"
        "from accelsurf.image.kernels.counts import count_high_bits\n"
        "with Watcher(Display()).watch('scan', 1):\n"
        "    count_high_bits(np.zeros(3, np.uint32), np.zeros(65536, np.int64))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True
        )
        for _ in range(2)
    )
    assert (first.returncode, first.stderr) == (0, f"{COMPILING}\n")
    assert (second.returncode, second.stderr) == (0, "")
