"""What pytest leaves alone here: the window's modules, where the packages of the viewer are not installed."""

import importlib.util

if importlib.util.find_spec("PySide6") is None or importlib.util.find_spec("pyvistaqt") is None:
    collect_ignore = [f"accelsurf/viewer/{name}.py" for name in ("controls", "desktop", "look")]
