"""What the tests of the viewer share: small images, runs of them, and whether anything can be drawn here."""

import shutil
import time

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.run.run import Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.headless import GraphicsError, require_graphics

# An oblique, left-handed grid: whatever mixes up axes or signs goes wrong on it.
TURN = np.array([[0.8, 0.6, 0.0], [0.6, -0.8, 0.0], [0.0, 0.0, 1.0]])


def needs_graphics():
    """Skip where nothing can be drawn."""
    try:
        require_graphics()
    except GraphicsError as error:
        pytest.skip(f"{error}; {error.hint}")


def ball_image(shape=(20, 40, 44), spacing=(2.0, 1.0, 1.0), direction=None, radius=11.0):
    """A bright ball around a world point near the middle; returns volume, centre (x, y, z) mm."""
    volume = Volume.from_array(np.zeros(shape, np.float32), spacing, (5.0, -3.0, 7.0), direction)
    center = volume.geometry.center_world() + np.array([2.0, -1.5, 1.0])
    where = volume.geometry.index_to_world(np.stack(np.indices(shape), axis=-1))
    inside = np.linalg.norm(where - center, axis=-1) < radius
    return volume.with_array(inside.astype(np.float32) * 100), center


def run_frames(volume, center, **options):
    """Frames of a run from a ball of 6 mm around a world point, and its history."""
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    run = Run(volume, RunConfig(**{"start": start, "threads": 1, "max_steps": 30, **options}))
    frames = []
    with run:
        for _ in run:
            frames.append(Frame.of_run(run))
    return frames, run.history


CHROMIUM_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def needs_chromium():
    """Path of Chromium; skip where it is missing."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    pytest.skip("no Chromium: apt install chromium chromium-driver")


def needs_chromium_driver():
    """Path of the program that drives Chromium; skip where it, Chromium or selenium is missing."""
    pytest.importorskip("selenium.webdriver", reason="selenium is missing: pip install selenium")
    needs_chromium()
    found = shutil.which("chromedriver")
    if found is None:
        pytest.skip("no chromedriver: apt install chromium-driver")
    return found


def wait_until_idle(actions):
    """Wait for all that was asked, and draw it."""
    idle, end = 0, time.monotonic() + 10
    while idle < 4 and time.monotonic() < end:  # some states cannot be drawn
        assert actions.session.wait(60)
        actions.collect_results()
        view = actions.session.next_view()
        if view is not None:
            actions.update(view)
        actions.state()
        # Views are made in the session's thread, after what was asked is done.
        is_drawn = view is None and not actions.session.has_unseen_state
        idle = idle + 1 if is_drawn else 0
        time.sleep(0.002)
    assert actions.session.wait(60)
    actions.collect_results()


def look(session, work):
    """Future of what a function finds in the run, between two steps in the session's thread."""
    return session._do(lambda timeline: work(timeline.run))


def ml(row):
    """Volume of a row of the list of objects, ml."""
    value, unit = row["volume"].split()
    return float(value) * {"um3": 1e-12, "mm3": 1e-3, "ml": 1.0, "l": 1e3}[unit]
