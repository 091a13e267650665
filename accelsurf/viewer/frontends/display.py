"""Whether a window can be opened here: told in one line, where Qt itself would end the process."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys

from accelsurf.viewer.scene.headless import GraphicsError

#: Packages that only the window needs.
PACKAGES = ("PySide6", "pyvistaqt")
_PROBE = "from PySide6.QtWidgets import QApplication; QApplication([]); print('opened')"
_SECONDS = 60


def require_display() -> None:
    """Make sure that a window can be opened.

    Raises
    ------
    GraphicsError
        When a package or a library is missing, or there is no screen; with what to do.
    """
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise GraphicsError(
            f"the window needs {' and '.join(missing)}, which {'is' if len(missing) == 1 else 'are'} not installed",
            'pip install "accelsurf[viewer]"; accelsurf segment needs no window',
        )
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in screens):
        raise GraphicsError(
            "no screen was found: neither DISPLAY nor WAYLAND_DISPLAY is set",
            "log in to a desktop or with ssh -X; accelsurf segment needs no screen",
        )
    # Qt ends the process when it cannot open a window: asked where that does not hurt.
    try:
        done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=_SECONDS)
    except (OSError, subprocess.TimeoutExpired):
        return
    if "opened" in done.stdout:
        return
    words = " ".join(done.stderr.split())
    if "xcb-cursor" in words or "cannot open shared object" in words or "libEGL" in words:
        raise GraphicsError(
            f"a library of Qt is missing: {_shortened(words)}",
            "on Debian and Ubuntu: apt install libegl1 libxcb-cursor0 libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1 "
            "libxcb-shape0 libdbus-1-3",
        )
    raise GraphicsError(
        f"no window can be opened: {_shortened(words)}",
        "is DISPLAY the name of a screen that runs? accelsurf segment needs no screen",
    )


def _shortened(words: str) -> str:
    """The first sentence of Qt's complaint, without the names of its parts."""
    return words.removeprefix("qt.qpa.xcb: ").removeprefix("qt.qpa.plugin: ")[:160] or "Qt says nothing"
