"""The first picture comes without the solver: it is loaded when the session begins to prepare its run, all of it."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import io
from accelsurf.image.volume import Volume
from tests.support.viewing import needs_graphics
from tests.viewer.test_desktop import ROOT, needs_screen, screen  # noqa: F401

pytestmark = pytest.mark.program

#: What a run needs and a picture of an image does not.
SOLVER = (
    "numba",
    "llvmlite",
    "skimage",
    "scipy.ndimage",
    "accelsurf.kernels._jit",
    "accelsurf.levelset",
    "accelsurf.energies",
    "accelsurf.flows",
    "accelsurf.evolution.loop",
    "accelsurf.run.run",
    "accelsurf.run.ensemble",
    "accelsurf.interact.refiner",
)

NOTE = f"""
import json, sys
def note(about):
    print(json.dumps([about, [name for name in {SOLVER!r} if name in sys.modules]]), flush=True)
"""

#: Reads an image, draws it, prepares its run, and asks for what a session does with it; says what is loaded by then.
DRAWN = (
    NOTE
    + """
from pathlib import Path
from accelsurf.viewer.core.opening import ImageToOpen
from accelsurf.cli.view import load_viewer
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

wait = ImageToOpen(Path(sys.argv[1]), RunConfig(threads=1), None, None, TrackConfig()).start_reading()
load_viewer()
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.actions.actions import Actions

opened = wait()
session = opened.session(begin=False)
scene = Scene(opened.volume, size=(300, 200))
actions = Actions(session, scene)
actions.state()
assert scene.screenshot().std() > 0
note("picture")
session.start_preparing()
session.ready.result(120)
note("prepared")
known = {name for name in sys.modules if name.startswith("accelsurf.")}
session.play(2).result()
session.wait()
actions.state()
print(json.dumps(["later", sorted({name for name in sys.modules if name.startswith("accelsurf.")} - known)]))
session.close()
scene.close()
"""
)

#: The command itself, which ends when its run is prepared.
COMMAND = (
    NOTE
    + """
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
from accelsurf.cli import execute
from accelsurf.viewer.core.session import Session

begin = Session.start_preparing

def noted(session):
    note("picture")
    begin(session)
    timer = QTimer(QApplication.instance(), interval=20)
    timer.timeout.connect(lambda: QApplication.closeAllWindows() if session.ready.done() else None)
    timer.start()

Session.start_preparing = noted
code = execute(["view", sys.argv[1], "--threads", "1", "--no-recent"])
note("prepared")
sys.exit(code)
"""
)


@pytest.fixture
def ball(tmp_path):
    z, y, x = np.indices((12, 14, 16))
    values = ((z - 6) ** 2 + (y - 7) ** 2 + (x - 8) ** 2 < 16) * 100.0
    io.write(Volume.from_array(values.astype(np.float32)), tmp_path / "ball.nii.gz")
    return tmp_path / "ball.nii.gz"


def said(program, ball, **environment):
    """What a program noted, in order."""
    ended = subprocess.run(
        [sys.executable, "-c", program, str(ball)],
        env={**os.environ, **environment},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert ended.returncode == 0, ended.stderr
    return dict(json.loads(line) for line in ended.stdout.splitlines())


@pytest.mark.slow
def test_an_image_is_drawn_before_anything_of_the_solver_is_loaded(ball):
    needs_graphics()
    loaded = said(DRAWN, ball)
    assert loaded["picture"] == []
    assert loaded["prepared"] == list(SOLVER)
    # Else the window, or a person, would wait for modules at some later moment.
    assert loaded["later"] == []


@needs_screen
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_window_of_the_command_has_its_first_picture_without_the_solver(ball, screen):  # noqa: F811
    loaded = said(COMMAND, ball, DISPLAY=screen, QT_QPA_PLATFORM="xcb", QT_SCALE_FACTOR="1")
    assert loaded["picture"] == []
    assert loaded["prepared"] == list(SOLVER)
