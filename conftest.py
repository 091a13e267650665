"""What pytest leaves alone here: modules of window and plug-in, where the packages that they need are not installed."""

import importlib.util
import os
import signal
import tempfile

collect_ignore = []
if importlib.util.find_spec("PySide6") is None or importlib.util.find_spec("pyvistaqt") is None:
    collect_ignore.append("accelsurf/viewer/window")
if importlib.util.find_spec("napari") is None:
    collect_ignore += ["accelsurf/napari/widget.py", "tests/support/remote_napari.py"]

# Started in the background, a process and all that it starts ignore Ctrl-C; some tests send it to programs.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Runs of tests keep their journals in a folder of their own, also where they are commands in other processes.
_state = tempfile.TemporaryDirectory(prefix="accelsurf-state-")
os.environ["XDG_STATE_HOME"] = _state.name
