"""Storage of compiled kernels, so that they are compiled once: its folder, what their bytes depend on, and a notice."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba.core import event


def kernel_files() -> list[Path]:
    """Return the files of compiled code: those of every folder of the package that is called kernels."""
    package = Path(__file__).parents[1]
    return sorted(package.rglob("kernels/**/*.py"))


def _storage() -> Path | None:
    """Folder of the compiled kernels, named by the source of all of them; None where nothing can be written.

    Numba compares only the file of a kernel to decide whether its compiled form is current, not at the kernels
    that it calls and that were compiled into it: after a change in one of those it would run the old code.
    """
    here = Path(__file__).parent
    source = hashlib.sha256(b"".join(path.read_bytes() for path in kernel_files())).hexdigest()[:12]
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = os.path.expanduser("~")  # as it is for a user who has none
    others = () if home == "~" else (Path(home) / ".cache" / "accelsurf",)
    for base in (Path(given),) if given else (here / "__pycache__", *others):
        folder = base / f"kernels-{source}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return None


#: The folder, or None.
STORAGE = _storage()


def stored() -> set[str]:
    """Names of the compiled kernels there, one for each kernel and types of its arguments."""
    return set() if STORAGE is None else {path.name for path in STORAGE.rglob("*.nbc")}


def processor_name() -> str:
    """The processor's family, as the compiler calls it; two of one name compute the same bytes."""
    return str(llvmlite.binding.get_host_cpu_name())


def compiler_version() -> str:
    """Versions of numba and of LLVM beneath it."""
    return f"{numba.__version__}, LLVM {'.'.join(map(str, llvmlite.binding.llvm_version_info))}"


class _FirstCompilation(event.Listener):
    """Calls a function once, when the first compilation begins."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify: Callable[[], None] | None = notify

    def on_start(self, event: Any) -> None:
        notify, self._notify = self._notify, None
        if notify is not None:
            notify()

    def on_end(self, event: Any) -> None:
        """Nothing is to be done."""


@contextmanager
def first_compilation(notify: Callable[[], None]) -> Iterator[None]:
    """Call ``notify`` before the first kernel that is compiled in this block, if any is.

    Compiling takes seconds; kernels that are stored are only loaded.

    Parameters
    ----------
    notify : callable
        Called once at most, on the thread that compiles.
    """
    listener = _FirstCompilation(notify)
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
