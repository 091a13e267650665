"""``accelsurf warmup``: compile and store every kernel before the first image waits for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from accelsurf.cli.options import Display
from accelsurf.cli.progress import COMPILING_ALL, counted
from accelsurf.errors import OutputError
from accelsurf.io import LazyVolume
from accelsurf.settings.run_config import RunConfig

#: A file beside the stored kernels: all are there, for the processor and the compiler that it names.
_COMPLETE = "complete.txt"
#: Said in place of `COMPILING_ALL` where nothing is to be compiled.
_LOADING = "loading the kernels, which are stored already"


def warmup(*, display: Display | None = None) -> int:
    """Compile all kernels and store them, which the first runs would do otherwise: about a minute, once.

    Run it after an installation or an update of accelsurf or numba, as the user who will segment, or with
    NUMBA_CACHE_DIR set as it will be then. What is stored already is only loaded.
    """
    from accelsurf.kernels import storage

    if storage.STORAGE is None:
        raise OutputError(
            "compiled kernels: there is no folder that they can be stored in",
            "set NUMBA_CACHE_DIR to a folder that may be written to",
        )
    display = display or Display()
    before = storage.stored()
    compile_all(display)
    if not display.quiet:
        new = len(storage.stored() - before)
        compiled = f"{new} kernels compiled and stored" if new else "nothing to compile"
        print(f"{compiled}, {len(before)} kernels were stored already")
        print(f"folder {storage.STORAGE}")
    return 0


def compile_all(display: Display) -> None:
    """Compile and store all kernels with a bar, where they are not stored yet: before several processes want them."""
    from accelsurf.kernels import storage

    runs = small_runs()
    with counted(display, _LOADING if is_complete() else COMPILING_ALL, len(runs)) as advance:
        for name, run in runs.items():
            advance(name)
            run()
    if storage.STORAGE is not None:
        (storage.STORAGE / _COMPLETE).write_text(_made_for())


def is_complete() -> bool:
    """True where all kernels are stored, for this processor and compiler; also where nothing is compiled."""
    from accelsurf.kernels import storage

    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return True
    if storage.STORAGE is None:
        return False
    try:
        return (storage.STORAGE / _COMPLETE).read_text() == _made_for()
    except (OSError, ValueError):
        return False


def _made_for() -> str:
    """Processor and compiler, whose change makes stored kernels useless."""
    from accelsurf.kernels import storage

    return f"{storage.processor_name()}, numba {storage.compiler_version()}\n"


def small_runs() -> dict[str, Callable[[], Any]]:
    """Return runs by name, that together call every kernel: segmentations and trackings."""
    from accelsurf.api import small_segmentations
    from accelsurf.track import warm_up

    return {
        **small_segmentations(),
        "windows": _in_windows,
        "tracking": warm_up,
    }


def _in_windows() -> None:
    """Runs on images that are read in parts, of floats and of integers."""
    import numpy as np

    from accelsurf.api import MIDDLE, START, ball
    from accelsurf.large import LargeImage, segment_in_windows

    image = ball()
    config = RunConfig(start=f"ball:{MIDDLE},{START}vox", max_steps=2, levels=1)
    for values in (image.array, np.clip(100 * image.array, 0, 255).astype(np.uint8)):
        large = LargeImage((LazyVolume.of_array(image.with_array(values)),), sys.maxsize)
        segment_in_windows(large, config)
