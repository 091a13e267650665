"""Checks that this machine can show a window or a page: Qt would end the process where it cannot."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from subprocess import PIPE

from accelsurf.viewer.scene.headless import GraphicsError

#: Packages that only the window needs, and those that only the page needs.
WINDOW_PACKAGES = ("PySide6", "pyvistaqt")
PAGE_PACKAGES = ("trame",)
INSTALL_WINDOW = 'pip install "accelsurf[viewer]"'
PROBE = "from PySide6.QtWidgets import QApplication; QApplication([]); print('opened')"
PROBE_SECONDS = 60


def lacks_window_packages() -> str:
    """Return one sentence about the packages that the window lacks; empty when it lacks none."""
    missing = _missing(WINDOW_PACKAGES)
    verb = "is" if len(missing) == 1 else "are"
    return (
        f"the window needs {' and '.join(missing)}, which {verb} not installed" if missing else ""
    )


def has_page_packages() -> bool:
    """Test if the packages of the page are installed."""
    return not _missing(PAGE_PACKAGES)


def require_display(meanwhile: Callable[[], None] = lambda: None) -> None:
    """Make sure that a window can be opened.

    Parameters
    ----------
    meanwhile : callable, optional
        Is done while another process tries it; may not load Qt. Its errors are raised.

    Raises
    ------
    GraphicsError
        When a package or a library is missing, or there is no screen; with advice.
    """
    if lack := lacks_window_packages():
        raise GraphicsError(lack, f"{INSTALL_WINDOW}; accelsurf segment needs no window")
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in screens):
        raise GraphicsError(
            "no screen was found: neither DISPLAY nor WAYLAND_DISPLAY is set",
            "add --browser for a page, log in to a desktop or with ssh -X; accelsurf segment needs no screen",
        )
    # Qt ends the process when it cannot open a window, so another process tries it first.
    try:
        trial = subprocess.Popen([sys.executable, "-c", PROBE], stdout=PIPE, stderr=PIPE, text=True)
    except OSError:
        meanwhile()
        return
    try:
        meanwhile()
        said, complaints = trial.communicate(timeout=PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return
    finally:
        trial.kill()
        trial.communicate()
    if "opened" in said:
        return
    words = " ".join(complaints.split())
    if "xcb-cursor" in words or "cannot open shared object" in words or "libEGL" in words:
        raise GraphicsError(
            f"a library of Qt is missing: {shortened(words)}",
            "on Debian and Ubuntu: apt install libegl1 libxcb-cursor0 libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1 "
            "libxcb-shape0 libdbus-1-3",
        )
    raise GraphicsError(
        f"no window can be opened: {shortened(words)}",
        "is DISPLAY the name of a screen that runs? accelsurf segment needs no screen",
    )


def _missing(packages: tuple[str, ...]) -> list[str]:
    return [name for name in packages if importlib.util.find_spec(name) is None]


def shortened(words: str) -> str:
    """The beginning of Qt's message in whole words, without the names of its parts."""
    words = re.sub(r"qt\.[a-z.]+: ", "", words)
    return textwrap.shorten(words, 160, placeholder=" ...") or "Qt gives no reason"
