"""A first run's kernels compiled by two processes: by the run from the first that it calls, by another from the last.

Compiling keeps one core, whatever the number of threads. The other process, ``python -m accelsurf.kernels.ahead LIST``,
goes by the list `CALLED`, which ``python -m benchmarks.called_kernels`` writes. Each loads what the other has stored,
so that little is compiled twice: what both need, and what both are at when they meet.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import numba

from accelsurf.kernels.compilation import first_compilation
from accelsurf.kernels.signatures import from_text
from accelsurf.kernels.storage import STORAGE, stored

#: Kernels that usual runs call, in the order of the first calls.
CALLED = Path(__file__).with_name("called.txt")


class CalledKernel(NamedTuple):
    """A kernel that the package calls: its module in this package, its name, and its arguments' types as text."""

    module: str
    name: str
    types: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}: {self.types}"

    def compile(self) -> None:
        """Compile and store it; load it where it is stored."""
        module = importlib.import_module(f"{__package__}.{self.module}")
        getattr(module, self.name).compile(from_text(self.types))


def called_kernels(path: Path = CALLED) -> list[CalledKernel]:
    """The kernels of a list."""
    called = []
    for line in path.read_text().splitlines():
        function, _, types = line.partition(": ")
        module, _, name = function.rpartition(".")
        called.append(CalledKernel(module, name, types))
    return called


def missing(path: Path = CALLED) -> list[CalledKernel]:
    """Those of a list that are not stored, whatever the types."""
    there = {name.partition("-")[0] for name in stored()}
    return [one for one in called_kernels(path) if f"{one.module}.{one.name}" not in there]


@contextmanager
def compiling_by_two(tell: Callable[[], None] = lambda: None) -> Iterator[None]:
    """From the first kernel that is compiled in this block on, let another process compile too, until the block ends.

    Parameters
    ----------
    tell : callable, optional
        Called before, see `accelsurf.kernels.compilation.first_compilation`.
    """
    with ExitStack() as meanwhile:

        def on_first() -> None:
            tell()
            meanwhile.enter_context(compiling_ahead())

        with first_compilation(on_first):
            yield


@contextmanager
def compiling_ahead(path: Path = CALLED) -> Iterator[None]:
    """Compile in another process during this block, where that helps.

    It does where there is a second core, where kernels are stored, and where two and more of the list are not. Not in a
    process that another one began with its like, as workers of a batch are: they have all cores.

    Parameters
    ----------
    path : Path, optional
        The list.
    """
    process = _begun(path) if _has_room() and len(missing(path)) > 1 else None
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.communicate()


def _has_room() -> bool:
    """Whether another process can compile, on a core of its own."""
    is_python = bool(sys.executable) and not getattr(sys, "frozen", False)
    compiles = STORAGE is not None and numba.config.NUMBA_NUM_THREADS > 1 and not numba.config.DISABLE_JIT
    return is_python and compiles and multiprocessing.parent_process() is None


def _begun(path: Path) -> subprocess.Popen[bytes] | None:
    """The other process; None where there is no room for one, since it only saves time."""
    # As here, and nothing from the current folder (-P): somebody's data lies there.
    found = {**os.environ, "PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)}
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(path)], env=found,
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return None


def _end_with_parent() -> None:
    """End this process when the one that began it does, however that ends: then its pipe is closed."""
    # Not through sys.stdin, whose lock Python wants when it ends.
    while os.read(0, 1):
        pass
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for one in reversed(called_kernels(Path(sys.argv[1]))):
        one.compile()
