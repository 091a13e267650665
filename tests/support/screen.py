"""A screen of its own for a window, where there is none: Xvfb."""

import contextlib
import os
import subprocess
from collections.abc import Iterator


@contextlib.contextmanager
def own_screen(width: int = 1280, height: int = 720) -> Iterator[str]:
    """Have a screen while it is needed; gives its name."""
    read, write = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write),
            "-screen",
            "0",
            f"{width}x{height}x24",
            "-noreset",
            "-nolisten",
            "tcp",
        ],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as line:
            yield f":{line.readline().strip()}"
    finally:
        server.terminate()
        server.wait(20)
