"""The one door to numba: every kernel is compiled with these flags and no others."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, overload

import numba

from accelsurf.kernels.stages import STAGE_OF_KERNEL, Stage

# No nnan/ninf: the code tests for NaN. No reassoc: a sum must not depend on how a loop was vectorised.
FASTMATH = {"contract", "arcp", "nsz"}


def _cache_folder() -> str | None:
    """Folder of the compiled kernels, named by the source of all of them; None where nothing can be written.

    Numba compares only the file of a kernel to decide whether its compiled form is current, not at the kernels
    that it calls and that were compiled into it: after a change in one of those it would run the old code.
    """
    here = Path(__file__).parent
    source = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(here.rglob("*.py")))).hexdigest()[:12]
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
            return str(folder)
    return None


_CACHE_FOLDER = _cache_folder()


@overload
def kernel(function: Callable[..., Any]) -> Callable[..., Any]: ...


@overload
def kernel(*, stage: Stage) -> Callable[[Callable[..., Any]], Callable[..., Any]]: ...


@overload
def kernel(*, inlined: bool) -> Callable[[Callable[..., Any]], Callable[..., Any]]: ...


def kernel(
    function: Callable[..., Any] | None = None, *, stage: Stage | None = None, inlined: bool = False
) -> Callable[..., Any]:
    """Compile a function without the Python lock, cached on disk; arithmetic errors follow IEEE.

    Parameters
    ----------
    function : callable
        What is compiled, with ``@kernel``: a kernel that other kernels call.
    stage : Stage
        With ``@kernel(stage=...)``: a kernel that the package calls, and the stage that ``--profile`` counts it in.
    inlined : bool
        With ``@kernel(inlined=True)``: a kernel that other kernels call for each cell, compiled into them. A call takes
        5 ns, as every array is five arguments of it.

    Raises
    ------
    ValueError
        When another kernel of this name has another stage.
    """
    if function is not None:
        return _compiled(function)

    def compiled_with_stage(function: Callable[..., Any]) -> Callable[..., Any]:
        name = function.__name__
        if stage is not None and STAGE_OF_KERNEL.setdefault(name, stage) is not stage:
            raise ValueError(f"kernel {name} has stage {STAGE_OF_KERNEL[name]} elsewhere, {stage} was given")
        return _compiled(function, inlined)

    return compiled_with_stage


def _compiled(function: Callable[..., Any], inlined: bool = False) -> Callable[..., Any]:
    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE_FOLDER or usual
    try:
        compile_ = numba.njit(
            cache=_CACHE_FOLDER is not None, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=inlined
        )
        compiled: Callable[..., Any] = compile_(function)
    finally:
        numba.config.CACHE_DIR = usual
    return compiled
