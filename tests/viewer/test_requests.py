"""What a page may ask: whatever it sends, nothing raises, nothing is done that was not meant."""

import math
import time

import numpy as np
import pytest

from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.picture import MAX_SIZE, MIN_SIZE
from accelsurf.viewer.actions.settings_rows import SETTINGS
from accelsurf.viewer.core.session import Session
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
def handler(scene_and_session, tmp_path):
    scene, session = scene_and_session
    made = Actions(session, scene, tmp_path / "out")
    scene.tiles.lay_out("one", "space", True, True)
    made.request("layout", "one")  # selected: it does not follow from the size of the picture
    scene.tiles.show_whole()
    session.pause().result(60)
    session.go_to(0).result(60)
    session.wait(60)
    return made


def finish(handler):
    assert handler.session.wait(120)
    handler.collect_results()


def draw(handler):
    view = handler.session.next_view()
    for _ in range(400):
        if view is not None:
            break
        time.sleep(0.02)
        view = handler.session.next_view()
    handler.scene.update(view.frame, view.histories)
    return handler.scene.screenshot()


def test_run_pause_back_change_undo_save(handler, tmp_path):
    handler.request("step")
    finish(handler)
    assert handler.session.status.step == 1
    handler.request("toggle")
    finish(handler)
    assert handler.session.status.stop is not None
    handler.request("go_to", 3)
    finish(handler)
    assert handler.session.status.step == 3
    handler.request("set", "smoothness", "0.25")
    finish(handler)
    assert handler.session.status.settings.smoothness == 0.25 and not handler.message
    handler.request("set", "flow", "gradient")
    finish(handler)
    assert handler.session.status.settings.flow == "gradient"
    handler.request("undo")
    finish(handler)
    assert handler.session.status.settings.flow == "auto"
    handler.request("save")
    finish(handler)
    assert handler.message == "" and {"ball_run.toml", "ball_seg.nii.gz"} <= set(
        handler.feature(FilesFeature).files
    )
    assert {path.parent for path in handler.feature(FilesFeature).files.values()} == {
        tmp_path / "out"
    }
    handler.request("restart")
    finish(handler)
    assert handler.session.status.step == 0


BAD = [
    None,
    True,
    -1,
    1e308,
    -1e308,
    math.inf,
    math.nan,
    10**400,
    "",
    "x" * 100_000,
    "../../etc/passwd",
    "a\x00b",
    "\ud800",
    "<script>",
    [],
    {},
    [[[[]]]],
    {"a": {"b": 1}},
    b"\xff" * 1000,
    object(),
    ["play"],
    3.5,
    "nan",
    "1e999",
]


def test_nothing_that_is_sent_raises_or_leaves_the_folder(handler, tmp_path):
    """Each request with each bad value, alone and in company, and too many or too few of them."""
    outside = tmp_path / "secret"
    outside.write_text("mine")
    handler.request("size", 640, 360)
    for name in (
        *handler.names,
        "_set",
        "__init__",
        "request",
        "files",
        "nothing",
        None,
        7,
        [],
        {},
        ("play",),
    ):
        if name in ("play", "toggle", "save", "step"):
            continue
        for bad in BAD:
            for values in (
                (bad,),
                (bad, bad),
                (bad, bad, bad),
                ("smoothness", bad),
                (bad, 0.5, 0.5),
                (0.5, 0.5, bad),
            ):
                handler.request(name, *values)
                assert isinstance(handler.message, str) and len(handler.message) < 400
        handler.request(name, *range(50))
        handler.request(name)
    finish(handler)
    width, height = handler.scene.plotter.render_window.GetSize()
    assert MIN_SIZE[0] <= width <= MAX_SIZE[0] and MIN_SIZE[1] <= height <= MAX_SIZE[1]
    assert np.isfinite(handler.scene.cursor).all()
    assert (
        sorted(path.name for path in tmp_path.iterdir()) == ["secret"]
        and outside.read_text() == "mine"
    )
    handler.request("restart")
    handler.request("size", 640, 360)
    finish(handler)
    handler.request("step")
    finish(handler)
    assert handler.session.status.ready and draw(handler).std() > 0
    status = handler.session.status.settings
    assert all(math.isfinite(float(getattr(status, key))) for key in ("smoothness", "cfl")), (
        SETTINGS
    )


@pytest.mark.parametrize("what", ["../labels", "/etc", "labels/..", "", "RUN", ["labels"]])
def test_only_what_there_is_can_be_saved(handler, tmp_path, what):
    handler.request("save", what)
    finish(handler)
    assert "was given, expected labels" in handler.message and not (tmp_path / "out").exists()


def test_dragging_turns_the_camera_and_moves_slices(handler):
    handler.request("tool", "look")
    handler.request("size", 800, 448)
    draw(handler)
    before = handler.scene.screenshot()
    for name, values in (("press", (0.2, 0.5, 0)), ("move", (0.3, 0.45)), ("release", ())):
        handler.request(name, *values)
        assert not handler.message
    turned = handler.scene.screenshot()
    assert (turned != before).mean() > 0.01
    handler.request("press", 0.2, 0.5, 0, True)
    handler.request("move", 0.25, 0.5)
    handler.request("release")
    assert (handler.scene.screenshot() != turned).any()
    cursor = handler.scene.cursor
    handler.request("press", 0.6, 0.27, 0)
    handler.request("release")
    assert np.linalg.norm(handler.scene.cursor - cursor) > 1
    cursor = handler.scene.cursor
    handler.request("scroll", 0.6, 0.27, 1)
    assert np.linalg.norm(handler.scene.cursor - cursor) > 0.5
    zoomed = handler.scene.screenshot()
    handler.request("scroll", 0.2, 0.5, 1)
    assert (handler.scene.screenshot() != zoomed).any()
    assert not handler.message


def test_a_ball_is_placed_where_the_mouse_is(handler):
    handler.request("size", 800, 448)
    draw(handler)
    volume_before = handler.session.next_view() or handler.session.status
    assert volume_before is not None
    handler.request("tool", "ball")
    handler.request("radius", 3.0)
    handler.request("press", 0.625, 0.25)  # the middle of the axial slice
    handler.request("move", 0.626, 0.25)
    handler.request("release")
    finish(handler)
    assert handler.message == ""
    (start,) = handler.session.status.settings.start
    assert start.startswith("ball:") and start.endswith(",3")
    handler.request("undo")
    finish(handler)


def test_clicks_say_what_is_inside_and_what_is_not(handler):
    handler.request("size", 800, 448)
    draw(handler)
    for mode, across in (("inside", 0.625), ("outside", 0.70)):
        before = handler.scene.screenshot()
        handler.request("tool", mode)
        handler.request("radius", 1.0)
        handler.request("press", across, 0.25)
        handler.request("release")
        finish(handler)
        assert handler.message == ""
        assert getattr(handler.session.status.refinements[-1], mode)[0].startswith("ball:")
        assert (draw(handler) != before).any()  # its mark
    for _ in range(2):
        handler.request("undo")
        finish(handler)


def test_a_size_is_drawn_out_and_a_run_begins_with_it(handler):
    handler.request("size", 800, 448)
    plain = draw(handler)
    handler.request("tool", "size")
    handler.request("radius", 2.0)
    handler.request("press", 0.625, 0.25)
    finish(handler)
    handler.request("move", 0.655, 0.25)
    shown = handler.scene.screenshot()
    assert (shown != plain).any() and handler.tools["size"].drag_mm > 1
    handler.request("move", 0.670, 0.25)
    assert (handler.scene.screenshot() != shown).any()
    handler.request("release")
    finish(handler)
    settings = handler.session.status.settings
    assert handler.message == "" and settings.energy == "seeded" and settings.size.endswith("mm3")
    assert settings.inside[0].startswith("ball:")
    handler.request("undo")
    finish(handler)
    assert handler.session.status.settings.inside == ()
