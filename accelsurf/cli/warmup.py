"""``accelsurf warmup``: compile and store every kernel before the first image waits for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated, Any

from cyclopts import Parameter

from accelsurf.errors import OutputError


def warmup(*, quiet: Annotated[bool, Parameter(negative=(), show_default=False)] = False) -> int:
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

    began = time.perf_counter()
    if storage.STORAGE is None:
        raise OutputError(
            "compiled kernels: there is no folder that they can be stored in",
            "set NUMBA_CACHE_DIR to a folder that may be written to",
        )
    before = storage.stored()
    for name, run in small_runs().items():
        if not quiet:
            print(f"  {time.perf_counter() - began:5.1f} s  {name}", flush=True)
        run()
    if not quiet:
        new = len(storage.stored() - before)
        print(
            f"{new} kernels compiled and stored, {len(before)} were there, {time.perf_counter() - began:.1f} s"
        )
        print(f"folder {storage.STORAGE}")
    return 0


def small_runs() -> dict[str, Callable[[], Any]]:
    """Return runs by name, that together call every kernel: segmentations, trackings, and a small picture."""
    from accelsurf.api import warmup as segmentations
    from accelsurf.track import track

    return {
        **segmentations.small_runs(),
        "windows": _in_windows,
        **track.small_runs(),
        "a picture": _picture,
    }


def _in_windows() -> None:
    """Runs on images that are read in parts, of floats and of integers."""
    import numpy as np

    from accelsurf.api.warmup import MIDDLE, START, ball
    from accelsurf.io import LazyVolume
    from accelsurf.large.windowed import LargeImage, segment_in_windows
    from accelsurf.settings.run_config import RunConfig

    image = ball()
    config = RunConfig(start=f"ball:{MIDDLE},{START}vox", max_steps=2, levels=1)
    for values in (image.array, np.clip(100 * image.array, 0, 255).astype(np.uint8)):
        large = LargeImage((LazyVolume.of_array(image.with_array(values)),), sys.maxsize)
        segment_in_windows(large, config)


def _picture() -> None:
    """A triangle that faces the viewer."""
    from accelsurf.output.pictures.rasterizer import render

    render([[0, 0, 0], [9, 0, 0], [0, 0, 9]], [[0, 1, 2]], size=8)
