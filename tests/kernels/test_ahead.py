"""Kernels of a first run compiled by another process, from the last to the first."""

import importlib
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

from accelsurf.kernels import ahead
from accelsurf.kernels.signatures import from_text, to_text

POPEN = subprocess.Popen
#: Two that are compiled within a second.
LIST = "value_counts.count_high_bits: uint32[1], int64[1]\nband.merged_order: int64[1], int64, bool[1], int64[1]\n"
#: Waits within the block until all of a list is stored, without compiling anything; prints what is.
CODE = """
import sys, time
from pathlib import Path
from accelsurf.kernels import ahead
path = Path(sys.argv[1])
with ahead.compiling_ahead(path):
    end = time.monotonic() + 60
    while time.monotonic() < end and ahead.missing(path):
        time.sleep(0.05)
print(*(one.name for one in ahead.called_kernels(path) if one not in ahead.missing(path)))
"""


@pytest.fixture
def two(tmp_path):
    (tmp_path / "called.txt").write_text(LIST)
    return tmp_path / "called.txt"


def stored_by_it(two):
    root = str(Path(ahead.__file__).parents[2])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(two.parent), "NUMBA_NUM_THREADS": "2", "PYTHONPATH": root}
    words = [sys.executable, "-P", "-c", CODE, two]
    ended = subprocess.run(words, env=environment, cwd=two.parent, capture_output=True, text=True, check=True)
    assert not ended.stderr
    return ended.stdout.split()


def test_the_other_process_stores_what_the_list_says(two):
    assert stored_by_it(two) == ["count_high_bits", "merged_order"]


@pytest.fixture
def no_process(two, monkeypatch):
    """Where two kernels are not stored and there are two cores: no process may begin then."""

    def refuse(*arguments, **options):
        raise AssertionError("a process began")

    monkeypatch.setattr(ahead, "STORAGE", two.parent)
    monkeypatch.setattr(ahead, "stored", set)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: None)
    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.raises(AssertionError, match="a process began"), ahead.compiling_ahead(two):
        pass
    return two


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        (numba.config, "NUMBA_NUM_THREADS", 1),
        (numba.config, "DISABLE_JIT", 1),
        (ahead, "STORAGE", None),
        (sys, "executable", None),
        (multiprocessing, "parent_process", lambda: "a batch"),
    ],
)
def test_where_another_process_does_not_help_none_begins(where, name, value, no_process, monkeypatch):
    monkeypatch.setattr(where, name, value)
    with ahead.compiling_ahead(no_process):
        assert len(ahead.missing(no_process)) == 2


def test_one_kernel_needs_no_other_process(no_process):
    no_process.write_text(LIST.splitlines()[0])
    with ahead.compiling_ahead(no_process):
        assert len(ahead.missing(no_process)) == 1


def test_it_ends_with_the_block(no_process, monkeypatch):
    started = []

    def popen(*arguments, **options):
        started.append(POPEN(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(KeyboardInterrupt), ahead.compiling_ahead(no_process):
        assert started[0].poll() is None
        raise KeyboardInterrupt
    assert started[0].poll() is not None


def test_it_ends_with_the_process_that_began_it(tmp_path):
    """However that ends: its pipe is closed then. All of the list takes more than the time that is given here."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    words = [sys.executable, "-m", "accelsurf.kernels.ahead", ahead.CALLED]
    alone = subprocess.Popen(words, stdin=subprocess.PIPE, env=environment)
    time.sleep(3)
    assert alone.poll() is None
    alone.communicate(timeout=15)
    assert alone.returncode == 0
    assert not list(tmp_path.rglob("march.find_feet*"))


def test_it_reads_nothing_from_the_current_folder(two):
    (two.parent / "ast.py").write_text("raise SystemExit('read from the current folder')")
    assert stored_by_it(two) == ["count_high_bits", "merged_order"]


def test_without_room_for_a_process_nothing_is_lost(no_process, monkeypatch):
    def refuse(*arguments, **options):
        raise BlockingIOError

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with ahead.compiling_ahead(no_process):
        assert len(ahead.missing(no_process)) == 2


def test_each_line_of_the_list_is_a_kernel_and_its_types():
    called = ahead.called_kernels()
    assert len(set(called)) == len(called) > 40
    for one in called:
        dispatcher = getattr(importlib.import_module(f"accelsurf.kernels.{one.module}"), one.name)
        assert isinstance(dispatcher, numba.core.dispatcher.Dispatcher)
        assert to_text(from_text(one.types)) == one.types
        assert f"{one}" == f"{one.module}.{one.name}: {one.types}"


@pytest.mark.parametrize("array", [numba.float32[:], numba.types.Array(numba.float32, 1, "C", readonly=True)])
def test_types_that_text_cannot_say_are_refused(array):
    with pytest.raises(ValueError, match="no text says"):
        to_text([numba.int64, array])


@pytest.mark.parametrize("text", ["int64 + 1", "f(int64)", "float32[2, 3]", "'int64'"])
def test_text_that_says_no_types_is_refused(text):
    with pytest.raises(ValueError, match="types are text"):
        from_text(text)
