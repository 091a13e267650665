"""The window, driven for real: Xvfb for a screen, xdotool for mouse and keys. Skipped where they are not installed."""

import ctypes.util
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.cli import execute as command
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from tests.support import viewing
from tests.support.screen import own_screen

MISSING = [name for name in ("Xvfb", "xdotool") if shutil.which(name) is None]
MISSING += [name for name in ("PySide6", "pyvistaqt") if importlib.util.find_spec(name) is None]
MISSING += [
    f"lib{name}" for name in ("xcb-cursor", "EGL") if ctypes.util.find_library(name) is None
]
ROOT = Path(__file__).parents[2]
DRIVER = ROOT / "tests" / "support" / "desktop_driver.py"

needs_screen = pytest.mark.skipif(
    bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (see scripts/test --all)"
)
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def screen():
    """A screen of its own, 1280 x 720."""
    with own_screen() as display:
        env = {**os.environ, "DISPLAY": display}
        end = time.monotonic() + 30
        while subprocess.run(
            ["xdotool", "getmouselocation"], env=env, capture_output=True
        ).returncode:
            if time.monotonic() > end:
                pytest.fail(f"Xvfb does not answer on display {display!r}")
            time.sleep(0.2)
        yield display


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    z, y, x = np.indices((40, 48, 48))
    image = ((z - 20) ** 2 + (y - 24) ** 2 + (x - 24) ** 2 < 15**2) * 100.0
    path = tmp_path_factory.mktemp("scan") / "scan.nii.gz"
    io.write(
        Volume.from_array(
            (image + np.random.default_rng(0).normal(0, 30, image.shape)).astype(np.float32)
        ),
        path,
    )
    return path


class Person:
    """Hands on mouse and keys, and eyes on what the window shows."""

    def __init__(self, screen, scan, folder, scale=1, **options):
        self.env = {
            **os.environ,
            "DISPLAY": screen,
            "QT_QPA_PLATFORM": "xcb",
            "QT_SCALE_FACTOR": str(scale),
        }
        self.state_file, self.folder = folder / "state.json", folder
        words = [f"{key}={value}" for key, value in options.items()]
        self.process = subprocess.Popen(
            [sys.executable, str(DRIVER), str(scan), str(self.state_file), *words],
            env=self.env,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.until(lambda now: now["drawn"] is not None, 180)
        # What a window manager does, which this screen has not.
        self.do(
            "search",
            "--sync",
            "--onlyvisible",
            "--name",
            "accelsurf - scan",
            "windowfocus",
            "--sync",
        )
        self.do("mousemove", "700", "690")

    def do(self, *words):
        subprocess.run(
            ["xdotool", *words], env=self.env, check=True, timeout=60, capture_output=True
        )

    def key(self, *names):
        self.do("key", *names)

    def click(self, name):
        now = self.now()
        x, y = now["buttons"].get(name, now["tiles"].get(name))[:2]
        self.do("mousemove", str(x), str(y), "click", "1")

    def drag(self, *places):
        """Press at the first place, move over the others, let go."""
        (x, y), *rest = [(round(a), round(b)) for a, b in places]
        self.do("mousemove", str(x), str(y), "sleep", "0.1", "mousedown", "1", "sleep", "0.1")
        for x, y in rest:
            self.do("mousemove", str(x), str(y), "sleep", "0.15")
        self.do("mouseup", "1")

    def reach(self, place):
        """Scroll the panels until a place in them is on the screen; return it."""
        for _ in range(40):
            x, y, *rest = self.at_rest(place)
            if 90 < y < 600:
                return (x, y, *rest)
            self.do("mousemove", "1100", "300", "click", "5" if y >= 600 else "4")
        raise AssertionError("it cannot be reached")

    def at_rest(self, place):
        """A place once the panels do not move any more."""
        before = None
        while (now := place(self.now())) != before:
            before = now
            time.sleep(0.4)
        return now

    def end(self):
        """End the window, if it is still there."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def slide(self, name, share):
        """Draw a slider from its left end to a share of its length."""
        x, y, width = self.reach(lambda now: now["buttons"][name])
        self.drag((x + 7, y), (x + 0.5 * share * width, y), (x + 7 + share * (width - 14), y))

    def now(self):
        return json.loads(self.state_file.read_text())

    def until(self, condition, seconds=60.0):
        end, now = time.monotonic() + seconds, None
        while time.monotonic() < end:
            if self.state_file.exists():
                now = self.now()
                if condition(now):
                    return now
            if self.process.poll() is not None:
                pytest.fail(f"the window is gone: {self.process.communicate()[0][-3000:]}")
            time.sleep(0.03)
        pytest.fail(f"never: {json.dumps(now)[:3000]}")

    def picture(self, path):
        """A picture of the whole screen."""
        code = (
            "import sys; from PySide6.QtWidgets import QApplication; app = QApplication([]); "
            "app.primaryScreen().grabWindow(0).save(sys.argv[1])"
        )
        subprocess.run(
            [sys.executable, "-c", code, str(path)], env=self.env, check=True, timeout=60
        )

    def leave(self):
        self.key("ctrl+q")
        out, _ = self.process.communicate(timeout=60)
        assert self.process.returncode == 0 and "closed" in out, out
        assert "Traceback" not in out, out


@pytest.fixture
def person(screen, scan, tmp_path):
    made = Person(screen, scan, tmp_path, start="ball:24,24,20,6", result=tmp_path / "out")
    yield made
    made.end()


@needs_screen
def test_run_pause_step_back_slide_save(person, scan, tmp_path):
    person.key("space")
    person.until(lambda now: now["playing"] and now["step"] > 3 and now["play"] == "Pause")
    person.key("space")
    paused = person.until(lambda now: not now["playing"] and now["drawn"][0] == now["step"])
    assert (
        paused["play"] == "Run"
        and f"step {paused['step']}" in paused["title"]
        and "paused" in paused["title"]
    )
    person.key("Right")
    on = person.until(lambda now: now["drawn"][0] == paused["step"] + 1)
    person.click("back")
    person.until(lambda now: now["drawn"][0] == paused["step"])
    person.key("Left")
    back = person.until(lambda now: now["drawn"][0] == paused["step"] - 1)
    assert max(back["checkpoints"]) == on["step"]
    # The slider over checkpoints.
    x, y, width = person.now()["buttons"]["timeline"]
    at = back["checkpoints"].index(back["step"]) / (len(back["checkpoints"]) - 1)
    person.drag((x + 7 + at * (width - 14), y), (x + width // 3, y), (x + 7, y))
    person.until(lambda now: now["drawn"][0] == 0)
    person.drag((x + 7, y), (x + width // 2, y), (x + 8 + width // 2, y))
    middle = person.until(
        lambda now: 0 < now["drawn"][0] < on["step"] and now["drawn"][0] == now["step"]
    )
    assert middle["edits"] == []
    # A slider of the panel.
    person.slide("smoothness", 0.5)
    moved = person.until(lambda now: now["edits"])
    (edit,) = moved["edits"]
    assert edit["step"] == middle["step"] and 0.5 < edit["smoothness"] < 2.5
    assert moved["settings"]["smoothness"] == edit["smoothness"]
    person.key("Right", "Right", "Right")
    person.until(lambda now: now["drawn"][0] == middle["step"] + 3)
    person.click("save")
    person.until(lambda now: "saved in" in now["message"], 120)
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [
        "scan_preview.png",
        "scan_report.json",
        "scan_run.toml",
        "scan_seg.nii.gz",
        "scan_statistics.csv",
        "scan_statistics.json",
        "scan_surface.ply",
        "scan_trace.csv",
        "scan_view.png",
    ]
    person.leave()
    config = RunConfig.from_toml(tmp_path / "out/scan_run.toml")
    assert (
        config.edit[0].settings == {"smoothness": edit["smoothness"]}
        and config.max_steps == middle["step"] + 3
    )
    again = segment(io.read(scan), config=config)
    assert (
        again.labels.tobytes() == io.read_labels(tmp_path / "out/scan_seg.nii.gz").array.tobytes()
    )


@needs_screen
def test_balls_and_undo(person):
    tiles = person.now()["tiles"]
    x, y = tiles["axial"]
    before = person.now()
    person.key("b")
    person.drag((x - 60, y), (x - 20, y + 10), (x + 12, y + 8))
    ball = person.until(
        lambda now: now["start"] != before["start"] and now["drawn"][1] != before["drawn"][1]
    )
    assert len(ball["start"]) == 1 and ball["start"][0].startswith("ball:") and ball["step"] == 0
    person.key("ctrl+z")
    person.until(lambda now: now["start"] == before["start"])
    person.key("v")
    x, y = tiles["coronal"]
    cursor = person.now()["cursor"]
    person.drag((x, y), (x + 15, y - 10))
    moved = person.until(lambda now: now["cursor"] != cursor)
    person.do("mousemove", str(x), str(y), "click", "4", "click", "4")
    person.until(lambda now: now["cursor"][1] != moved["cursor"][1])
    person.leave()


def at_left_ball(screen, folder, values):
    """A person at a window that has an image with two balls, clicked in the left one; and the image."""
    io.write(Volume.from_array(values.astype(np.float32)), folder / "scan.nii")
    image = io.read(folder / "scan.nii")
    place = ",".join(f"{v:g}" for v in image.geometry.index_to_world((12, 20, 16)))
    return Person(
        screen, folder / "scan.nii", folder, inside=f"ball:{place},4", result=folder / "out"
    ), image


@needs_screen
def test_strokes_history_and_where_to_click_next(screen, tmp_path):
    """Two bright balls with a bridge that has hardly an edge; strokes by mouse, the list of changes by clicks."""
    z, y, x = np.indices((24, 40, 64))
    balls = (z - 12) ** 2 + (y - 20) ** 2 + np.minimum(abs(x - 16), abs(x - 48)) ** 2 < 10**2
    bridge = (abs(y - 20) < 4) & (abs(z - 12) < 4) & (x > 16) & (x < 48)
    values = (
        100.0 * balls + 80.0 * bridge * ~balls + np.random.default_rng(0).normal(0, 20, balls.shape)
    )
    person, image = at_left_ball(screen, tmp_path, values)
    try:
        person.key("space")
        first = person.until(lambda now: now["stop"] and now["drawn"][0] == now["step"], 120)
        doubtful = person.until(lambda now: now["state"]["uncertain"])
        person.key("n")
        person.until(
            lambda now: now["state"]["uncertain_at"] == 1 and now["cursor"] != doubtful["cursor"]
        )
        person.key("i")
        now = person.until(lambda now: now["state"]["tool"] == "inside")
        x, y = now["tiles"]["axial"]
        person.drag((x + 30, y), (x + 40, y), (x + 50, y + 4))
        grown = person.until(
            lambda now: len(now["state"]["changes"]) == 1 and now["drawn"][1] != first["drawn"][1]
        )
        assert "inside: stroke of" in grown["state"]["changes"][0]["line"]
        person.key("o")
        person.until(lambda now: now["state"]["tool"] == "outside")
        person.drag((x + 45, y - 6), (x + 45, y + 6))
        cut = person.until(
            lambda now: len(now["state"]["changes"]) == 2 and now["drawn"][1] != grown["drawn"][1]
        )
        x_list, y_list = person.now()["buttons"]["change 2"]
        person.do(
            "mousemove", str(x_list), str(y_list), "click", "--repeat", "3", "4"
        )  # the list is at its end
        person.at_rest(lambda now: now["buttons"]["change 0"])
        person.click("change 0")
        back = person.until(lambda now: now["drawn"][1] == first["drawn"][1])
        assert [one["done"] for one in back["state"]["changes"]] == [False, False]
        person.click("change 2")
        again = person.until(lambda now: all(one["done"] for one in now["state"]["changes"]))
        person.until(lambda now: now["drawn"][1] == cut["drawn"][1])
        assert again["state"]["undoable"] == 2
        person.key("ctrl+s")
        person.until(lambda now: "saved in" in now["message"], 120)
        person.leave()
    finally:
        person.end()
    config = RunConfig.from_toml(tmp_path / "out/scan_run.toml")
    assert len(config.refine) == 2 and config.refine[0].inside[0].startswith("path:")
    labels = segment(image, config=config).labels
    assert labels.tobytes() == io.read_labels(tmp_path / "out/scan_seg.nii").array.tobytes()


@needs_screen
def test_two_objects_are_built_named_and_saved_by_mouse_and_keys(screen, tmp_path):
    z, y, x = np.indices((24, 40, 64))
    balls = (z - 12) ** 2 + (y - 20) ** 2 + np.minimum(abs(x - 16), abs(x - 48)) ** 2 < 10**2
    person, image = at_left_ball(
        screen, tmp_path, 100.0 * balls + np.random.default_rng(0).normal(0, 6, balls.shape)
    )
    try:
        person.key("space")
        first = person.until(lambda now: now["stop"] and not now["playing"], 120)
        left, y = first["tiles"]["axial"]
        voxels = []
        for at in (left - 40, left + 40):
            person.do("mousemove", str(at), str(y))
            before = person.now()["state"]["voxel"]
            moved = person.until(lambda now, before=before: now["state"]["voxel"] != before)
            voxels.append(int(moved["state"]["voxel"].split(",")[0]))
        pixels = 80 / (voxels[1] - voxels[0])
        person.key("u")
        person.until(
            lambda now: now["state"]["object_active"] == 2 and now["state"]["tool"] == "size"
        )
        right = left - 40 + pixels * (48 - voxels[0])
        person.drag((right, y), (right + 5 * pixels, y), (right + 10 * pixels, y))
        person.until(
            lambda now: [one["word"] for one in now["state"]["object_rows"]] == ["converged"] * 2,
            120,
        )
        # They are drawn a moment later.
        two = person.until(lambda now: all(one["volume"] for one in now["state"]["object_rows"]))
        assert viewing.ml(two["state"]["object_rows"][1]) == pytest.approx(4.19, rel=0.15)
        x, row = person.now()["buttons"]["object 1"]
        person.do("mousemove", str(x), str(row), "click", "--repeat", "2", "--delay", "80", "1")
        person.do("sleep", "0.3", "type", "cyst")
        person.key("Return")
        person.until(
            lambda now: [one["name"] for one in now["state"]["object_rows"]] == ["object 1", "cyst"]
        )
        person.click("seen 0")
        person.until(
            lambda now: [one["visible"] for one in now["state"]["object_rows"]] == [False, True]
        )
        person.key("ctrl+s")
        person.until(lambda now: "scan_run.toml" in now["state"]["saved"], 120)
        config = RunConfig.from_toml(tmp_path / "out" / "scan_run.toml")
        assert config.refine[0].new == 2 and config.name == ("1=object 1", "2=cyst")
        labels = io.read_labels(next((tmp_path / "out").glob("*_seg.nii"))).array
        again = segment(image, config=config).labels
        assert sorted(np.unique(labels)) == [0, 1, 2] and np.array_equal(labels, again)
        person.leave()
    finally:
        person.end()


@needs_screen
def test_looks_help_and_errors(person, tmp_path):
    person.picture(tmp_path / "dark.png")
    person.key("F1")
    person.until(lambda now: now["help"])
    person.key("Escape")
    person.until(lambda now: not now["help"])
    person.key("Right", "c")
    person.until(lambda now: now["color"] == "speed")
    person.key("t", "y", "l")
    person.until(lambda now: now["theme"] == "light")
    person.picture(tmp_path / "light.png")
    import matplotlib.image

    dark, light = (
        matplotlib.image.imread(tmp_path / f"{name}.png")[..., :3] for name in ("dark", "light")
    )
    assert dark.shape == (720, 1280, 3) and dark.mean() < 0.35 and light.mean() > dark.mean() + 0.15
    # What others have in the folder is not replaced, and the window goes on.
    (tmp_path / "out").mkdir()
    (tmp_path / "out/scan_run.toml").write_text("precious")
    person.key("ctrl+s")
    person.until(
        lambda now: now["message"].startswith("Error") and "exists already" in now["message"]
    )
    assert (tmp_path / "out/scan_run.toml").read_text() == "precious"
    person.key("space")
    person.until(lambda now: now["stop"] == "converged", 120)
    person.leave()


@needs_screen
def test_closing_while_it_runs_is_prompt(person):
    person.key("space")
    person.until(lambda now: now["step"] > 2)
    began = time.monotonic()
    person.leave()
    assert time.monotonic() - began < 15


@needs_screen
def test_the_command_opens_the_same_window(screen, scan, tmp_path):
    env = {**os.environ, "DISPLAY": screen, "QT_QPA_PLATFORM": "xcb"}
    words = [
        "view",
        str(scan),
        "--start",
        "ball:24,24,20,6",
        "--output",
        str(tmp_path / "out"),
        "--flow",
        "gradient",
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words],
        env=env,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )

    def xdotool(*words):
        return subprocess.run(
            ["xdotool", *words], env=env, capture_output=True, text=True, timeout=60
        ).stdout.split()

    def window(title):
        end = time.monotonic() + 120
        while time.monotonic() < end and process.poll() is None:
            if found := xdotool("search", "--onlyvisible", "--name", title):
                return found[-1]
            time.sleep(0.1)
        process.kill()
        pytest.fail(f"no window {title}: {process.communicate()[0]}")

    xdotool("windowfocus", "--sync", window("accelsurf - scan - step 0 - paused"))
    xdotool("key", "Right", "Right")
    window("accelsurf - scan - step 2 - paused")
    xdotool("key", "ctrl+s")
    end = time.monotonic() + 60
    while not (tmp_path / "out/scan_view.png").exists() and time.monotonic() < end:
        time.sleep(0.1)
    xdotool("key", "ctrl+q")
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0, out
    assert RunConfig.from_toml(tmp_path / "out/scan_run.toml").flow == "gradient"


#: Runs the command with a run that is not prepared until the first picture was looked at; prints what was in it.
SLICES_FIRST = """
import sys, threading
from accelsurf.viewer.core import session
from accelsurf.viewer.window import desktop

looked, solver, draw = threading.Event(), session._solver, desktop.Window._draw_first
session._solver = lambda: solver() if looked.wait(60) else None

def look(window):
    draw(window)
    tile, scene = window.scene.tiles.renderer("axial"), window.scene
    left, bottom, right, top = tile.GetViewport()
    picture = scene.screenshot()
    rows, columns = picture.shape[:2]
    part = picture[int((1 - top) * rows):int((1 - bottom) * rows), int(left * columns):int(right * columns)]
    print(len({int(grey) for grey in part[..., 0].ravel()}), scene.frame is None, window.session.ready.done())
    looked.set()
    window.session.ready.result(60)
    window.window().close()

desktop.Window._draw_first = look
from accelsurf.cli import main
main(sys.argv[1:])
"""


@needs_screen
def test_the_command_draws_the_slices_before_the_run_is_prepared(screen, scan):
    env = {**os.environ, "DISPLAY": screen, "QT_QPA_PLATFORM": "xcb"}
    words = [
        sys.executable,
        "-c",
        SLICES_FIRST,
        "view",
        str(scan),
        "--start",
        "ball:24,24,20,6",
        "--no-recent",
    ]
    done = subprocess.run(words, env=env, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    greys, has_no_frame, is_prepared = done.stdout.split()
    assert int(greys) > 60 and (has_no_frame, is_prepared) == ("True", "False")


@needs_screen
def test_the_command_closes_the_window_where_the_run_cannot_be_prepared(screen, scan):
    env = {**os.environ, "DISPLAY": screen, "QT_QPA_PLATFORM": "xcb"}
    words = [
        sys.executable,
        "-m",
        "accelsurf",
        "view",
        str(scan),
        "--start",
        "ball:999,24,20,6",
        "--no-recent",
    ]
    done = subprocess.run(words, env=env, cwd=ROOT, capture_output=True, text=True, timeout=300)
    error = done.stderr.splitlines()
    assert (
        done.returncode == 3 and len(error) == 2 and error[0].startswith("error: start 'ball:999")
    ), done.stderr


#: Prints for several changes how many tiles were drawn, whether it is seen, and whether all is that there is to see.
PAINTED = """
import sys, time
import numpy as np
from accelsurf import io
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.window.desktop import Window, application

app = application()
window = Window(Session(io.read(sys.argv[1]), RunConfig(start="ball:24,24,20,6", levels=1), name="scan"))
window.resize(900, 600)
window.show()
scene, drawn = window.scene, []

def turn(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        app.processEvents()
        time.sleep(0.01)

def screen():
    picture = window.screen().grabWindow(window.winId()).toImage()
    return np.frombuffer(picture.constBits(), np.uint8).reshape(picture.height(), -1).copy()

def look(name, change, draws):
    turn(0.5)
    before = screen()
    drawn.clear()
    change()
    scene.render() if draws else window.canvas.update()
    turn(0.5)
    shown, count = screen(), len(drawn)
    scene.tiles.redraw.mark_all()
    scene.render()
    window.canvas.update()
    turn(0.3)
    window.canvas.update()  # nothing was drawn by us before: a whole picture
    turn(0.3)
    print(name, count, not np.array_equal(before, shown), np.array_equal(shown, screen()), flush=True)

def azimuth():
    scene.space.renderer.GetActiveCamera().Azimuth(30.0)

turn(1.0)
while scene.frame is None:
    turn(0.1)
window._timer.stop()
turn(0.5)
for renderer in scene.plotter.renderers:
    renderer.AddObserver("StartEvent", lambda *_: drawn.append(1))
middle = scene.geometry.center_world()
look("ball", lambda: scene.mark_ball(middle, 8.0), True)
look("slice", lambda: scene.step_slice("axial", 3), True)
look("turned", azimuth, False)
look("both", lambda: (azimuth(), scene.step_slice("axial", 2)), True)
look("larger", lambda: (scene.step_slice("axial", 1), window.resize(1000, 640)), True)
look("theme", lambda: scene.paint("light"), True)
window._timer.start()
window.close()
"""


@needs_screen
def test_what_was_drawn_is_painted_without_being_drawn_again(screen, scan):
    env = {**os.environ, "DISPLAY": screen, "QT_QPA_PLATFORM": "xcb"}
    done = subprocess.run(
        [sys.executable, "-c", PAINTED, str(scan)],
        env=env,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    found = {name: words for name, *words in map(str.split, done.stdout.splitlines())}
    assert list(found) == ["ball", "slice", "turned", "both", "larger", "theme"], (
        done.stdout + done.stderr
    )
    assert all(words[1:] == ["True", "True"] for words in found.values()), (
        found
    )  # it is on the screen, all of it
    assert (
        int(found["slice"][0]) <= 3
    )  # one tile, the cube beside the object, and a picture of nothing else
    assert (
        int(found["turned"][0]) >= 4 and int(found["both"][0]) >= 2 and int(found["larger"][0]) >= 5
    )


def test_without_a_screen_it_is_one_line(scan, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("accelsurf.viewer.window.display.WINDOW_PACKAGES", ("json",))
    assert command(["view", str(scan)]) == 8
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 2 and "no screen was found" in error[0] and error[1].startswith("hint: ")


class Hiding:
    """A finder of modules that does not find some packages, as if they were not installed."""

    def __init__(self, finder, packages):
        self._finder, self._packages = finder, packages

    def find_spec(self, name, path=None, target=None):
        return (
            None
            if name.partition(".")[0] in self._packages
            else self._finder.find_spec(name, path, target)
        )


@pytest.fixture
def hide(monkeypatch):
    """Hide packages that may be installed here."""

    def hide_packages(*packages):
        for name in [name for name in sys.modules if name.partition(".")[0] in packages]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setattr(
            sys, "meta_path", [Hiding(finder, packages) for finder in sys.meta_path]
        )
        assert all(importlib.util.find_spec(package) is None for package in packages)

    return hide_packages


def test_without_the_packages_one_line_says_what_to_install(scan, hide, capsys):
    hide("PySide6", "pyvistaqt", "trame")
    assert command(["view", str(scan)]) == 8
    error = capsys.readouterr().err.splitlines()
    assert error[0] == "error: the window needs PySide6 and pyvistaqt, which are not installed"
    assert error[1].startswith('hint: pip install "accelsurf[viewer]"') and len(error) == 2
    assert command(["view", str(scan), "--browser"]) == 2
    error = capsys.readouterr().err.splitlines()
    assert error == [
        "error: browser: trame is not installed",
        'hint: pip install "accelsurf[viewer]"',
    ]


def test_without_the_packages_of_the_window_the_page_is_served(scan, hide, capsys, monkeypatch):
    pytest.importorskip("trame", reason='trame is missing: pip install "accelsurf[viewer]"')
    viewing.needs_graphics()
    served = []
    monkeypatch.setattr(
        "accelsurf.viewer.page.page.serve",
        lambda opening, first, *given: served.append(first[0].name),
    )
    hide("PySide6", "pyvistaqt")
    assert command(["view", str(scan), "--start", "ball:24,24,20,6"]) == 0
    assert served == ["scan"]
    error = capsys.readouterr().err
    assert (
        "the window needs PySide6 and pyvistaqt" in error
        and 'pip install "accelsurf[viewer]"' in error
    )
    assert error.count("\n") == 1 and "a page in the browser opens instead" in error


@pytest.mark.skipif(importlib.util.find_spec("PySide6") is None, reason="not installed: PySide6")
def test_a_screen_that_is_gone_is_one_line(scan, monkeypatch, capsys):
    monkeypatch.setenv("DISPLAY", ":4242")
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert command(["view", str(scan)]) == 8
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 2 and error[0].startswith("error: ")


def test_bad_settings_are_an_error_before_a_window_is_opened(scan, capsys):
    assert command(["view", str(scan), "--smoothness", "-1"]) == 2
    assert "smoothness: -1 was given" in capsys.readouterr().err
    assert command(["view", "--reference", str(scan)]) == 2
