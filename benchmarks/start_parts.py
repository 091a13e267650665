"""Where the processor's seconds of one command go: ``python -m benchmarks.start_parts segment IMAGE -o DIR ...``.

Prints a JSON object, seconds by part. Libraries are imported one after another, then the command is run with its
parts timed on the thread that runs it; give ``--threads 1``, so that there is no other.
"""

from __future__ import annotations

import functools
import gc
import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

from accelsurf.__main__ import GC_THRESHOLD

#: Modules by the part that their import is counted in, in the order in which they are imported here.
IMPORTS = {
    "command line": ("accelsurf.cli",),
    "settings": ("accelsurf.cli.options", "accelsurf.settings.run_config"),
    "numpy": ("numpy",),
    "numba": ("numba",),
    "scipy, scikit-image": ("scipy.ndimage", "skimage.measure", "skimage.graph"),
    "SimpleITK": ("SimpleITK",),
    "Pillow": ("PIL.Image", "PIL.ImageDraw", "PIL.ImageFont"),
    "accelsurf": (
        "accelsurf.cases.case",
        "accelsurf.api.segment",
        "accelsurf.output.outputs",
        "accelsurf.io.itk",
    ),
}
#: Functions by the part that they are counted in, without what others of them take within.
FUNCTIONS = {
    "kernels: numba's own": ("numba.core.base:BaseContext.refresh",),
    "kernels: from the disk": ("numba.core.caching:Cache.load_overload",),
    "image": (
        "accelsurf.io.formats.nifti:import_nibabel_for",
        "accelsurf.io.channels:read_channels",
        "accelsurf.io:sha256",
    ),
    "first surface": ("accelsurf.run.run:Run.__init__",),
    "steps": ("accelsurf.run.run:Run.step",),
    "quality": ("accelsurf.run.result:assess",),
    "mesh": ("accelsurf.run.result:extract",),
    "picture": ("accelsurf.output.pictures.preview:preview_png",),
    "files": ("accelsurf.cases.case:_write",),
}


def main(words: list[str]) -> None:
    gc.set_threshold(GC_THRESHOLD)  # as the program does
    seconds = {"python": time.process_time()}
    for part, names in IMPORTS.items():
        began = time.process_time()
        for name in names:
            importlib.import_module(name)
        seconds[part] = time.process_time() - began
    within: list[float] = []
    for part, places in FUNCTIONS.items():
        for place in places:
            _time(place, part, seconds, within)
    cli = importlib.import_module("accelsurf.cli")
    began, before = time.process_time(), sum(seconds.values())
    if code := cli.execute(words):
        sys.exit(code)
    seconds["other"] = time.process_time() - began - (sum(seconds.values()) - before)
    print(json.dumps(seconds))


def _time(place: str, part: str, seconds: dict[str, float], within: list[float]) -> None:
    """Put a function in place of another, that counts its seconds without those of the others that it calls."""
    module, _, path = place.partition(":")
    *owners, name = path.split(".")
    owner = functools.reduce(getattr, owners, importlib.import_module(module))
    function: Callable[..., Any] = getattr(owner, name)

    @functools.wraps(function)
    def timed(*args: Any, **options: Any) -> Any:
        began = time.thread_time()
        within.append(0.0)
        try:
            return function(*args, **options)
        finally:
            took = time.thread_time() - began
            seconds[part] = seconds.get(part, 0.0) + took - within.pop()
            if within:
                within[-1] += took

    setattr(owner, name, timed)


if __name__ == "__main__":
    main(sys.argv[1:])
