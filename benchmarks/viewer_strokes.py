"""How soon the window draws what a hand does, and how soon the surface obeys, on a large volume.

Usage: python -m benchmarks.viewer_strokes [--shape NZ,NY,NX] [--ct] [--display :N]
[-o benchmarks/results/viewer_strokes.json]

A ball in noise, 256^3 unless another shape is given, or with --ct in a body in air as 16 bit (the CT of the issue:
--shape 300,512,512 --ct), is opened in the window, on the display given or a screen of its own (Xvfb). Events of the
mouse are put into Qt's queue from another thread, as a hand does, at most 60 a second; each is timed from there until
the picture that shows it is drawn, inside the window; beside it the time of the processor that the window's own thread
took, which a busy machine changes little. What is timed: a placed ball; a stroke in a slice while the run plays and
after its end; a stroke on the surface in 3D; the slider of the radius; slices by the wheel, and how many a second; grey
values by a drag with the right button; a press in the object that is drawn to its size; from the release of a
correcting stroke until the surface is drawn that obeys it. Software rendering competes with the solver for the same
cores. Run it on a quiet machine.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.screen import own_screen

ROOT = Path(__file__).resolve().parent.parent
#: Motions of a drag, a second; how many of each kind; wanted: drawn within so many ms, obeyed within so many s.
RATE, MOTIONS, DRAWN_MS, OBEYED_S = 60.0, 40, 50.0, 1.0
#: Radius of the ball, of the shortest side: 92 000 voxels at 256^3. A correction takes longer on a larger object.
RADIUS = 0.11
#: Correcting strokes.
CORRECTIONS = 4


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--shape", default="256,256,256")
    options.add_argument("--ct", action="store_true")
    options.add_argument("--display", default="")
    options.add_argument(
        "-o", "--output", type=Path, default=ROOT / "benchmarks/results/viewer_strokes.json"
    )
    given = options.parse_args()
    shape = tuple(int(n) for n in given.shape.split(","))
    with tempfile.TemporaryDirectory() as folder:
        source, start = phantom(shape, Path(folder), given.ct)
        if not (given.display or shutil.which("Xvfb")):
            sys.exit("Xvfb is needed, or --display of a screen")
        with (
            contextlib.nullcontext(given.display)
            if given.display
            else own_screen(1600, 900) as display
        ):
            found = in_window(source, start, display, Path(folder))
    known = json.loads(given.output.read_text()) if given.output.exists() else {}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    report = {
        "cores": cores,
        "machine": platform.machine(),
        "load": round(os.getloadavg()[0], 2),
        **found,
    }
    known["x".join(map(str, shape[::-1])) + (" ct" if given.ct else "")] = report
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(json.dumps(known, indent=2) + "\n")
    print(json.dumps(report, indent=2))


def phantom(shape: Sequence[int], folder: Path, is_ct: bool) -> tuple[Path, dict[str, str]]:
    """A bright ball in noise, or in a body in air, and settings that find it by a click."""
    from accelsurf import io
    from accelsurf.image.volume import Volume

    z, y, x = (
        (np.arange(n, dtype=np.float32) - 0.5 * n).reshape(
            [-1 if a == axis else 1 for a in range(3)]
        )
        for axis, n in enumerate(shape)
    )
    radius = RADIUS * min(shape)
    image = np.random.default_rng(0).normal(0, 12, shape).astype(np.float32)
    image += 100.0 * (z**2 + y**2 + x**2 < radius**2)
    if is_ct:
        body = (y / (0.36 * shape[1])) ** 2 + (x / (0.44 * shape[2])) ** 2 < 1.0
        image = (image + np.where(body, 40.0, -1000.0)).astype(np.int16)
    path = folder / "scan.nii"
    io.write(Volume.from_array(image), path)
    middle = io.read(path).geometry.index_to_world([0.5 * n for n in shape])
    ball = "ball:" + ",".join(f"{v:g}" for v in (*middle, 0.4 * radius))
    return path, {"inside": ball, "radius": f"{radius:g}"}


def in_window(source: Path, start: dict[str, str], display: str, folder: Path) -> dict[str, Any]:
    """Open the window in another process, on a screen."""
    result_file = folder / "result.json"
    env = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
    words = [
        sys.executable,
        "-m",
        "benchmarks.viewer_strokes",
        "--in-window",
        str(source),
        str(result_file),
    ]
    subprocess.run([*words, json.dumps(start)], env=env, cwd=ROOT, check=True, timeout=1800)
    return json.loads(result_file.read_text())


def window_process(source: str, result_file: str, start: str) -> None:
    """What happens in the other process."""
    from accelsurf import io
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.viewer.core.session import Session
    from accelsurf.viewer.window.desktop import Window, application

    said = json.loads(start)
    app = application()
    session = Session(
        io.read(source), RunConfig(inside=said["inside"], levels=1, max_steps=100_000), name="scan"
    )
    session.ready.result()
    window = Window(session)
    window.resize(1280, 720)
    window.show()
    hand = Hand(window, float(said["radius"]))
    thread = threading.Thread(target=hand.work, args=(app, Path(result_file)), daemon=True)
    thread.start()
    app.exec()


def summary(times: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Of milliseconds until drawn, and of the window's thread in them."""
    wall, own = np.array(times).T
    return {
        "median_ms": round(float(np.median(wall)), 1),
        "p95_ms": round(float(np.percentile(wall, 95)), 1),
        "largest_ms": round(float(wall.max()), 1),
        "within_50_ms": round(float(np.mean(wall <= DRAWN_MS)), 3),
        "own_median_ms": round(float(np.median(own)), 1),
        "own_largest_ms": round(float(own.max()), 1),
        "a_second": round(1000.0 / max(float(wall.mean()), 1000.0 / RATE), 1),
    }


class Hand:
    """A hand at a window, in a thread of its own; it puts events into Qt's queue and waits for what is drawn."""

    def __init__(self, window: Any, radius: float) -> None:
        self.window, self.radius = window, radius
        #: When each picture was finished, and what the window's thread had worked until then.
        self._drawn: list[tuple[float, float]] = []
        self._place = (0.5, 0.5)
        self._clock = time.pthread_getcpuclockid(threading.main_thread().ident or 0)
        self._watch()

    def _watch(self) -> None:
        """Note when each picture is finished."""
        render = self.window.scene.render

        def timed() -> None:
            render()
            self._drawn.append((time.perf_counter(), self._own_seconds()))

        self.window.scene.render = timed

    def _own_seconds(self) -> float:
        return time.clock_gettime(self._clock)

    def work(self, app: Any, result_file: Path) -> None:
        """All that is timed, then the window is closed."""
        try:
            found = self._measure()
            result_file.write_text(json.dumps(found))
        finally:
            self._in_window(self.window.close)

    def _measure(self) -> dict[str, Any]:
        session, found = self.window.session, {}
        self._until(lambda: self.window.scene.frame is not None)
        time.sleep(2.0)
        session.play()
        self._until(lambda: session.status.step > 3)
        found["stroke in a slice while it runs"] = self._drag(
            "inside", self._along("axial"), keep=True
        )
        self._until(lambda: session.status.stop is not None and not session.status.playing, 900)
        time.sleep(2.0)
        found["stroke in a slice"] = self._drag("inside", self._along("axial"))
        time.sleep(1.5)
        found["stroke on the surface"] = self._drag("outside", self._over_the_ball())
        time.sleep(1.5)
        found["radius"] = self._slide()
        found["slices by the wheel"] = self._scroll()
        found["grey values by a drag"] = self._grey()
        found["obeyed"] = [self._correct(number) for number in range(CORRECTIONS)]
        found["placed ball"] = self._drag("ball", self._along("axial"))
        found["drag to the size"] = self._drag("size", self._outwards("axial"))
        times = found.pop("obeyed")
        found = {name: summary(value) for name, value in found.items()}
        return found | {
            "obeyed_s": [wall for wall, _ in times],
            "obeyed_cpu_s": [cpu for _, cpu in times],
        }

    # -- what the hand does -------------------------------------------------------------------------------

    def _along(self, tile: str) -> Iterator[tuple[float, float]]:
        """Places across the ball in a tile, as parts of the canvas."""
        yield from self._beside_the_middle(tile, -0.6, 0.6)

    def _outwards(self, tile: str) -> Iterator[tuple[float, float]]:
        """Places from the middle of a tile to one side, as parts of the canvas."""
        yield from self._beside_the_middle(tile, 0.0, 0.9)

    def _beside_the_middle(
        self, tile: str, first: float, last: float
    ) -> Iterator[tuple[float, float]]:
        """Places so many radii of the ball beside the middle of a tile, whatever the layout and the size of a pixel."""
        left, bottom, right, top = self.window.scene.tiles.renderer(tile).GetViewport()
        pixel = 1.0 / self.window.scene.plotter.render_window.GetSize()[0]
        for radii in np.linspace(first, last, MOTIONS):
            across = radii * self.radius / self.window.scene.tiles.tile(tile).mm_per_pixel() * pixel
            yield 0.5 * (left + right) + across, 1.0 - (bottom + 0.5 * (top - bottom))

    def _over_the_ball(self) -> Iterator[tuple[float, float]]:
        """Places across the ball in 3D, as parts of the canvas."""
        renderer, scene = self.window.scene.tiles.renderer("space"), self.window.scene
        camera, middle = renderer.GetActiveCamera(), scene.geometry.center_world()
        across = np.cross(camera.GetDirectionOfProjection(), camera.GetViewUp())
        width, height = scene.plotter.render_window.GetSize()
        for share in np.linspace(-0.7, 0.7, MOTIONS):
            renderer.SetWorldPoint(
                *(middle + share * self.radius * across / np.linalg.norm(across)), 1.0
            )
            renderer.WorldToDisplay()
            x, y, _ = renderer.GetDisplayPoint()
            yield x / width, 1.0 - y / height

    def _drag(
        self, tool: str, places: Iterator[tuple[float, float]], keep: bool = False
    ) -> list[tuple[float, float]]:
        """Milliseconds from each event of a drag until it is drawn; undone afterwards unless it is to be kept."""
        self._take(tool)
        time.sleep(1.0)
        made = self.window.session.status.undoable
        kinds = ["press", *["move"] * (MOTIONS - 1)]
        times = [self._event(kind, place) for kind, place in zip(kinds, places, strict=True)]
        self._event("release", None)
        session = self.window.session
        time.sleep(0.2)
        session.wait(300) if not keep else time.sleep(1.0)
        if (
            not keep and session.status.undoable > made
        ):  # a stroke that changes nothing is none to be undone
            session.undo().result(300)
            session.wait(300)
        return times

    def _take(self, tool: str) -> None:
        """Take a tool, with balls of the size that fits the object."""
        self._in_window(lambda: self.window._ask("tool", tool))
        self._in_window(lambda: self.window.user_actions.request("radius", 0.12 * self.radius))

    def _event(
        self, kind: str, place: tuple[float, float] | None, right: bool = False
    ) -> tuple[float, float]:
        """Send an event of a button; milliseconds until the picture after it, and of the window's thread until then."""
        from PySide6.QtCore import QEvent, Qt
        from PySide6.QtGui import QMouseEvent

        kinds = {
            "press": QEvent.Type.MouseButtonPress,
            "move": QEvent.Type.MouseMove,
            "release": QEvent.Type.MouseButtonRelease,
        }
        self._place = place or self._place
        at = self._on_canvas(self._place)
        buttons = Qt.MouseButton.RightButton if right else Qt.MouseButton.LeftButton
        button = Qt.MouseButton.NoButton if kind == "move" else buttons
        anywhere = self.window.canvas.mapToGlobal(at)
        event = QMouseEvent(
            kinds[kind], at, anywhere, button, buttons, Qt.KeyboardModifier.NoModifier
        )
        return self._until_drawn(event, 3.0 if kind != "release" else 0.5)

    def _on_canvas(self, place: tuple[float, float]) -> Any:
        """A place that is parts of the canvas, in pixels."""
        from PySide6.QtCore import QPointF

        canvas = self.window.canvas
        return QPointF(place[0] * (canvas.width() - 1), place[1] * (canvas.height() - 1))

    def _until_drawn(self, event: Any, seconds: float) -> tuple[float, float]:
        """Send an event; milliseconds until the next picture, at most some seconds, and of the window's thread."""
        from PySide6.QtWidgets import QApplication

        before = len(self._drawn)
        began = time.perf_counter()
        worked = self._own_seconds()
        QApplication.postEvent(self.window.canvas, event)
        while len(self._drawn) == before and time.perf_counter() - began < seconds:
            time.sleep(0.0005)
        drawn, own = (
            self._drawn[before]
            if len(self._drawn) > before
            else (began + seconds, self._own_seconds())
        )
        time.sleep(max(0.0, began + 1.0 / RATE - time.perf_counter()))
        return 1000.0 * (drawn - began), 1000.0 * (own - worked)

    def _scroll(self) -> list[tuple[float, float]]:
        """Milliseconds from a turn of the wheel over the axial slices until the next slice is drawn."""
        from PySide6.QtCore import QPoint, Qt
        from PySide6.QtGui import QWheelEvent

        at = self._on_canvas(next(self._along("axial")))
        none = Qt.MouseButton.NoButton
        anywhere = self.window.canvas.mapToGlobal(at)
        times = []
        for number in range(2 * MOTIONS):
            turned = QPoint(0, 120 if number % MOTIONS < MOTIONS // 2 else -120)
            keys, phase = Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase
            event = QWheelEvent(at, anywhere, QPoint(), turned, none, keys, phase, False)
            times.append(self._until_drawn(event, 3.0))
        time.sleep(1.0)
        return times

    def _grey(self) -> list[tuple[float, float]]:
        """Milliseconds from each event of a drag with the right button until its grey values are drawn."""
        places = list(self._along("axial"))
        self._event("press", places[0], True)
        times = [self._event("move", place, True) for place in places[1:]]
        self._event("release", None, True)
        time.sleep(1.0)
        return times

    def _slide(self) -> list[tuple[float, float]]:
        """Milliseconds from a motion of the radius slider until the slider is painted."""
        slider = self.window.side.panels["ToolsPanel"].radius.slider
        times = []
        for value in range(100, 100 + 10 * MOTIONS, 10):
            began, worked = time.perf_counter(), self._own_seconds()
            self._in_window(lambda value=value: (slider.setValue(value), slider.repaint()))
            times.append(
                (1000.0 * (time.perf_counter() - began), 1000.0 * (self._own_seconds() - worked))
            )
            time.sleep(1.0 / RATE)
        time.sleep(1.0)
        return times

    def _correct(self, number: int) -> tuple[float, float]:
        """Seconds from a correcting stroke's release until the surface obeys and is drawn, and of the processor."""
        session, window = self.window.session, self.window
        side = ("outside", "inside")[number % 2]
        renderer = window.scene.tiles.renderer("axial")
        tile = window.scene.slice_tiles["axial"]
        middle = window.scene.geometry.center_world()
        away = (1.05 if side == "inside" else 0.92) * self.radius
        angle = 0.5 * np.pi * number
        world = middle + away * np.array([np.cos(angle), np.sin(angle), 0.0])
        self._in_window(lambda: window._ask("cursor", *(float(v) for v in middle)))
        right, up = tile.to_tile(window.scene.geometry.world_to_index(world))
        low, high = np.array(tile.to_plane(0.0, 0.0)), np.array(tile.to_plane(1.0, 1.0))
        share = (np.array([right, up]) - low) / (high - low)
        left, bottom, far, top = renderer.GetViewport()
        x, y = left + share[0] * (far - left), 1.0 - (bottom + share[1] * (top - bottom))
        self._take(side)
        time.sleep(1.2)
        self._event("press", (x, y))
        length = (
            0.3
            * self.radius
            / window.scene.tiles.tile("axial").mm_per_pixel()
            / window.canvas.width()
        )
        for part in (0.3, 0.6, 0.9):
            self._event("move", (x + part * length, y))
        count, began = len(session.status.refinements), time.perf_counter()
        frame, spent = window.scene.frame, time.process_time()
        self._event("release", None)
        self._until(
            lambda: len(session.status.refinements) > count and window.scene.frame is not frame, 120
        )
        self._in_window(lambda: None)  # the picture of that frame is drawn in the same turn
        return round(time.perf_counter() - began, 3), round(time.process_time() - spent, 3)

    # -- the window's thread ------------------------------------------------------------------------------

    def _in_window(self, work: Callable[[], Any]) -> None:
        """Have something done in the window's thread, and wait for it."""
        from PySide6.QtCore import QMetaObject, QObject, Qt, Slot

        if not hasattr(self, "_runner"):

            class Runner(QObject):
                work: Callable[[], Any] = staticmethod(lambda: None)

                @Slot()
                def run(self) -> None:
                    self.work()

            self._runner = Runner()
            self._runner.moveToThread(self.window.thread())
        self._runner.work = work
        QMetaObject.invokeMethod(self._runner, "run", Qt.ConnectionType.BlockingQueuedConnection)

    def _until(self, condition: Callable[[], bool], seconds: float = 120.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError
            time.sleep(0.002)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--in-window"]:
        window_process(*sys.argv[2:5])
    else:
        main()
