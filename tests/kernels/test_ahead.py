"""Kernels of a first run compiled by another process, from the last to the first."""

import importlib
import os
import subprocess
import sys
import time

import numba
import pytest

from accelsurf.kernels import ahead
from accelsurf.kernels.signatures import from_text, to_text

#: Two that are compiled within a second.
LIST = "value_counts.count_high_bits: uint32[1], int64[1]\nband.merged_order: int64[1], int64, bool[1], int64[1]\n"
#: Waits within the block until all of a list is stored, without compiling anything; prints what is.
CODE = """
import sys, time
from pathlib import Path
from accelsurf.kernels import ahead
path = Path(sys.argv[1])
with ahead.compiling_ahead(path):
    end = time.monotonic() + float(sys.argv[2])
    while time.monotonic() < end and ahead.missing(path):
        time.sleep(0.05)
print(*(one.name for one in ahead.called_kernels(path) if one not in ahead.missing(path)))
"""


@pytest.fixture
def two(tmp_path):
    (tmp_path / "called.txt").write_text(LIST)
    return tmp_path / "called.txt"


def stored_by_it(two, seconds="60", **environment):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(two.parent), "NUMBA_NUM_THREADS": "2", **environment}
    words = [sys.executable, "-c", CODE, two, seconds]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert not ended.stderr
    return ended.stdout.split()


def test_the_other_process_stores_what_the_list_says(two):
    assert stored_by_it(two) == ["count_high_bits", "merged_order"]


def test_one_core_and_one_kernel_need_no_other_process(two):
    assert stored_by_it(two, NUMBA_NUM_THREADS="1", seconds="3") == []
    two.write_text(LIST.splitlines()[0])
    assert stored_by_it(two, seconds="3") == []


def test_it_ends_with_the_block_and_with_the_process_that_began_it(two, monkeypatch):
    started = []
    usual = subprocess.Popen

    def popen(*arguments, **options):
        started.append(usual(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(ahead, "STORAGE", two.parent)
    monkeypatch.setattr(ahead, "stored", set)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    monkeypatch.setattr(subprocess, "Popen", popen)
    with pytest.raises(KeyboardInterrupt), ahead.compiling_ahead(two):
        assert started[0].poll() is None
        raise KeyboardInterrupt
    assert started[0].poll() is not None
    alone = usual([sys.executable, "-m", "accelsurf.kernels.ahead", ahead.CALLED], stdin=subprocess.PIPE)
    time.sleep(0.5)
    alone.communicate(timeout=60)  # closes its pipe, as the end of this process would
    assert alone.returncode == 0


def test_without_room_for_a_process_nothing_is_lost(two, monkeypatch):
    def refuse(*arguments, **options):
        raise BlockingIOError

    monkeypatch.setattr(ahead, "STORAGE", two.parent)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    monkeypatch.setattr(ahead, "stored", set)
    monkeypatch.setattr(subprocess, "Popen", refuse)
    with ahead.compiling_ahead(two):
        assert len(ahead.missing(two)) == 2


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
