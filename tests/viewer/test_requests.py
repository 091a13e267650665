"""What a page may ask: whatever it sends, nothing raises, nothing is done that was not meant."""

import math
import time

import numpy as np
import pytest

from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.frontends.requests import MAX_SIZE, MIN_SIZE, SETTINGS, Steering
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


@pytest.fixture(scope="module")
def scene_and_session():
    volume, center = viewing.ball_image()
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    scene = Scene(volume, size=(640, 360))
    with Session(volume, RunConfig(start=start, threads=1, max_steps=60), name="ball") as session:
        session.ready.result(60)
        yield scene, session
    scene.close()


@pytest.fixture
def steering(scene_and_session, tmp_path):
    scene, session = scene_and_session
    made = Steering(session, scene, tmp_path / "out")
    session.pause().result(60)
    session.back(0).result(60)
    session.wait(60)
    return made


def settle(steering):
    assert steering.session.wait(120)
    steering.look_after()


def draw(steering):
    view = steering.session.take()
    for _ in range(400):
        if view is not None:
            break
        time.sleep(0.02)
        view = steering.session.take()
    steering.scene.update(view.frame, view.rows)
    return steering.scene.screenshot()


def test_run_pause_back_change_undo_save(steering, tmp_path):
    steering.request("step")
    settle(steering)
    assert steering.session.status.step == 1
    steering.request("toggle")
    settle(steering)
    assert steering.session.status.stop is not None
    steering.request("back", 3)
    settle(steering)
    assert steering.session.status.step == 3
    steering.request("set", "smoothness", "0.25")
    settle(steering)
    assert steering.session.status.settings.smoothness == 0.25 and not steering.message
    steering.request("set", "flow", "gradient")
    settle(steering)
    assert steering.session.status.settings.flow == "gradient"
    steering.request("undo")
    settle(steering)
    assert steering.session.status.settings.flow == "constant-density"
    steering.request("save")
    settle(steering)
    assert steering.message == "" and {"run.toml", "ball_seg.nii.gz"} <= set(steering.files)
    assert {path.parent for path in steering.files.values()} == {tmp_path / "out"}
    steering.request("restart")
    settle(steering)
    assert steering.session.status.step == 0


BAD = [
    None, True, -1, 1e308, -1e308, math.inf, math.nan, 10**400, "", "x" * 100_000, "../../etc/passwd", "a\x00b",
    "\ud800", "<script>", [], {}, [[[[]]]], {"a": {"b": 1}}, b"\xff" * 1000, object(), ["run"], 3.5, "nan", "1e999",
]  # fmt: skip


def test_nothing_that_is_sent_raises_or_leaves_the_folder(steering, tmp_path):
    """Each request with each bad value, alone and in company, and too many or too few of them."""
    outside = tmp_path / "secret"
    outside.write_text("mine")
    steering.request("size", 640, 360)
    for name in (*steering.names, "_set", "__init__", "request", "files", "nothing", None, 7, [], {}, ("run",)):
        if name in ("run", "toggle", "save", "step"):
            continue
        for bad in BAD:
            for values in ((bad,), (bad, bad), (bad, bad, bad), ("smoothness", bad), (bad, 0.5, 0.5), (0.5, 0.5, bad)):
                steering.request(name, *values)
                assert isinstance(steering.message, str) and len(steering.message) < 400
        steering.request(name, *range(50))
        steering.request(name)
    settle(steering)
    width, height = steering.scene.plotter.render_window.GetSize()
    assert MIN_SIZE[0] <= width <= MAX_SIZE[0] and MIN_SIZE[1] <= height <= MAX_SIZE[1]
    assert np.isfinite(steering.scene.cursor).all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["secret"] and outside.read_text() == "mine"
    steering.request("restart")
    steering.request("size", 640, 360)
    settle(steering)
    steering.request("step")
    settle(steering)
    assert steering.session.status.ready and draw(steering).std() > 0
    status = steering.session.status.settings
    assert all(math.isfinite(float(getattr(status, key))) for key in ("smoothness", "cfl")), SETTINGS


@pytest.mark.parametrize("what", ["../labels", "/etc", "labels/..", "", "RUN", ["labels"]])
def test_only_what_there_is_can_be_saved(steering, tmp_path, what):
    steering.request("save", what)
    settle(steering)
    assert "was given, expected labels" in steering.message and not (tmp_path / "out").exists()


def test_dragging_turns_the_camera_and_moves_slices(steering):
    steering.request("size", 800, 448)
    draw(steering)
    before = steering.scene.screenshot()
    for name, values in (("press", (0.2, 0.5, False)), ("move", (0.3, 0.45)), ("release", ())):
        steering.request(name, *values)
        assert not steering.message
    turned = steering.scene.screenshot()
    assert (turned != before).mean() > 0.01
    steering.request("press", 0.2, 0.5, True)
    steering.request("move", 0.25, 0.5)
    steering.request("release")
    assert (steering.scene.screenshot() != turned).any()
    cursor = steering.scene.cursor
    steering.request("press", 0.6, 0.27, False)
    steering.request("release")
    assert np.linalg.norm(steering.scene.cursor - cursor) > 1
    cursor = steering.scene.cursor
    steering.request("wheel", 0.6, 0.27, 1)
    assert np.linalg.norm(steering.scene.cursor - cursor) > 0.5
    zoomed = steering.scene.screenshot()
    steering.request("wheel", 0.2, 0.5, 1)
    assert (steering.scene.screenshot() != zoomed).any()
    assert not steering.message


def test_a_ball_is_placed_where_the_mouse_is(steering):
    steering.request("size", 800, 448)
    draw(steering)
    volume_before = steering.session.take() or steering.session.status
    assert volume_before is not None
    for mode in ("add", "remove", "start"):
        steering.request("mode", mode)
        steering.request("radius", 3.0)
        steering.request("press", 0.625, 0.25, False)  # the middle of the axial slice
        steering.request("move", 0.626, 0.25)
        steering.request("release")
        settle(steering)
        assert steering.message == ""
        status = steering.session.status
        if mode == "start":
            assert status.settings.start[0].startswith("ball:") and status.settings.start[0].endswith(",3")
        else:
            assert getattr(status.edits[-1], mode).startswith("ball:")
    steering.request("undo")
    settle(steering)
