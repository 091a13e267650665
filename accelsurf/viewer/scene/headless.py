"""Pictures without a screen: whether VTK can draw on this machine at all.

VTK looks for a screen, then for EGL, then for OSMesa; where it finds none of them, it ends the process. So this is
tried in another process first.
"""

from __future__ import annotations

import functools
import subprocess
import sys

from vtkmodules.vtkCommonCore import vtkLogger
from vtkmodules.vtkRenderingCore import vtkRenderWindow

from accelsurf.errors import AccelsurfError

#: Advice for a machine without a graphics driver.
HINT = (
    "install a software renderer: on Debian and Ubuntu apt install libosmesa6 or libegl1 libgl1-mesa-dri, "
    "on Fedora mesa-libOSMesa or mesa-libEGL"
)
#: Names of renderers without a graphics card.
SOFTWARE = ("llvmpipe", "softpipe", "SWR", "Software")
_PROBE = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkCommonCore import vtkLogger
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(16, 16)
window.AddRenderer(vtkRenderer())
window.Render()
print("drew with", window.GetClassName())
"""
_SECONDS = 120


class GraphicsError(AccelsurfError):
    """Nothing can be drawn on this machine (exit 8)."""

    exit_code = 8
    kind = "graphics"


def require_graphics() -> str:
    """Make sure that pictures can be drawn without a screen, and keep VTK's warnings about its search off stderr.

    Returns
    -------
    str
        Name of VTK's render window.

    Raises
    ------
    GraphicsError
        When nothing here can draw, with packages to install.
    """
    name = _probed()
    if not name:
        raise GraphicsError(
            "no picture can be drawn: neither a screen nor EGL nor OSMesa was found", HINT
        )
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    return name


def draws_in_software(window: vtkRenderWindow) -> bool:
    """Return whether the processor draws a window, not a graphics card."""
    capabilities = window.ReportCapabilities()
    return any(name in capabilities for name in SOFTWARE)


@functools.cache
def _probed() -> str:
    """Name of the render window that drew in another process, or nothing; does not change while we run."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=_SECONDS
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    before, found, name = done.stdout.partition("drew with ")
    # The base class draws nothing.
    return (
        name.strip() if done.returncode == 0 and found and name.strip() != "vtkRenderWindow" else ""
    )
