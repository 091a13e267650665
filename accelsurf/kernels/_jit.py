"""The one door to numba: every kernel is compiled with these flags and no others."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any, overload

import numba

from accelsurf.kernels.storage import STORAGE

# No nnan/ninf: the code tests for NaN. No reassoc: a sum must not depend on how a loop was vectorised.
FASTMATH = {"contract", "arcp", "nsz"}


class Stage(Enum):
    """Stage of a step that a kernel belongs to, for ``--profile``; in the order of a step, as people read them."""

    CLOSEST_POINTS = "closest points"
    BAND = "band"
    EXTENSION = "extension"
    ADVANCE = "advance"
    ENERGY = "energy and force"
    FLOW = "flow"
    DIFFUSION = "diffusion"


#: Stage by name of a kernel: filled by `kernel` as the kernels are defined, and by nothing else.
STAGE_OF_KERNEL: dict[str, Stage] = {}


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
        With ``@kernel``: a kernel that other kernels call.
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
            raise ValueError(
                f"kernel {name} has stage {STAGE_OF_KERNEL[name]} elsewhere, {stage} was given"
            )
        return _compiled(function, inlined)

    return compiled_with_stage


def _compiled(function: Callable[..., Any], inlined: bool = False) -> Callable[..., Any]:
    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = usual if STORAGE is None else str(STORAGE)
    try:
        # Nothing calls a kernel as a C function: without that wrapper a tenth less is compiled and loaded.
        compile_ = numba.njit(
            cache=STORAGE is not None,
            nogil=True,
            error_model="numpy",
            fastmath=FASTMATH,
            forceinline=inlined,
            no_cfunc_wrapper=True,
        )
        compiled: Callable[..., Any] = compile_(function)
    finally:
        numba.config.CACHE_DIR = usual
    return compiled
