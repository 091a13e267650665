"""``accelsurf warmup``: compile and store every kernel before the first image waits for it."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from accelsurf.errors import OutputError


def warmup(
    *, quiet: Annotated[bool, Parameter(negative=(), show_default=False)] = False
) -> int:
    """Compile all kernels and store them, which the first runs would do otherwise: a minute or two, once.

    Run it after an installation or an update of accelsurf or numba, as the user who will segment, or with
    NUMBA_CACHE_DIR set as it will be then. What is stored already is only loaded.

    Parameters
    ----------
    quiet
        Print nothing but warnings and errors.
    """
    import time

    from accelsurf.kernels import storage
    from accelsurf.output import warmup as runs

    began = time.perf_counter()
    if storage.STORAGE is None:
        raise OutputError(
            "compiled kernels: there is no folder that they can be stored in",
            "set NUMBA_CACHE_DIR to a folder that may be written to",
        )
    before = storage.stored()
    for name, run in runs.small_runs().items():
        if not quiet:
            print(f"  {time.perf_counter() - began:5.1f} s  {name}", flush=True)
        run()
    if not quiet:
        new = len(storage.stored() - before)
        print(f"{new} kernels compiled and stored, {len(before)} were there, {time.perf_counter() - began:.1f} s")
        print(f"folder {storage.STORAGE}")
    return 0
