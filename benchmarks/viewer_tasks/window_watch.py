"""Opens the window by the command ``accelsurf view``, and writes to a file, every 40 ms, what a person would see: the
start page, or the image that is open.

Usage: python -m benchmarks.viewer_tasks.window_watch STATE_FILE TRUTH|- IDS WORDS OF ACCELSURF ...

With --browser among the words it is the page that is watched; then the file has only the sizes of its slices.
All that happens to the window comes from outside, as events of mouse and keys. TRUTH is a label map that the window
does not know: with it the watcher says where the surface is wrong most, as a person would see it. In the seconds that
this takes the window does not answer, so it is done only when a file of this name with the ending .judge asks for it.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from PySide6.QtCore import QPoint, QTimer
from PySide6.QtWidgets import QApplication, QLabel, QListView, QListWidget, QWidget
from scipy import ndimage

from accelsurf import cli, io
from accelsurf.viewer.window.main_window import MainWindow

INTERVAL_MS = 40
#: Of the list of objects.
NAME_COLUMN = 2


def slice_sizes(scene: Any, ratio: float) -> dict[str, list[float]]:
    """Width and height of what is drawn of the image in each slice, pixels of a usual screen."""
    found = {}
    for name, tile in scene.slice_tiles.items():
        sides = tile.renderer.GetSize()
        if min(sides) > 0:
            left, right, bottom, top = tile.stack.extent
            lengths = np.array([right - left, top - bottom]) / tile.mm_per_pixel()
            found[name] = (np.minimum(lengths, sides) / ratio).tolist()
    return found


def axial_numbers(scene: Any) -> list[float]:
    """Slices per mm along z, and the number of the slice at z = 0, in the middle of the image."""
    stack, middle = scene.slice_tiles["axial"].stack, scene.geometry.center_world()
    places = [middle + [0.0, 0.0, z] for z in (0.0, 1.0)]
    numbers = [float(stack.place_number(scene.geometry.world_to_index(place))) for place in places]
    slope = numbers[1] - numbers[0]
    return [slope, numbers[0] - slope * float(middle[2])]


def items() -> dict[str, list[int]]:
    """Middle on the screen of each line of the list that is open."""
    popup = QApplication.activePopupWidget()
    found = {}
    for view in popup.findChildren(QListView) if popup is not None else []:
        for row in range(view.model().rowCount()):
            index = view.model().index(row, 0)
            place = view.viewport().mapToGlobal(view.visualRect(index).center())
            found[str(index.data())] = [place.x(), place.y()]
    return found


def write_whole(path: Path, said: dict[str, Any]) -> None:
    """Write a file of JSON, all or nothing."""
    staged = path.with_suffix(".draft")
    staged.write_text(json.dumps(said, default=str))
    os.replace(staged, path)


class WindowWatch:
    """Says where the parts of a window are, what it shows, and where its surface is wrong."""

    def __init__(self, main: Any, state_file: Path, truth: list[Any]) -> None:
        self._main = main
        self._file = state_file
        self._truth = truth
        self._wanted = state_file.with_suffix(".judge")
        self._verdict: dict[str, Any] = {}
        self._frames: list[float] = []
        self._timer = QTimer(main, interval=INTERVAL_MS)
        self._timer.timeout.connect(self.write)
        self._timer.start()

    @property
    def _window(self) -> Any:
        """What shows the image that is open; None at the start page."""
        return self._main.inner

    def write(self) -> None:
        """Write the state, all or nothing."""
        said = {
            "time": time.time(),
            "title": self._main.windowTitle(),
            "widgets": self._widgets(),
            "drawn": None,
        }
        sides = [self._main.width(), self._main.height()]
        said |= {
            "is_start_page": self._window is None,
            "items": items(),
            "size": sides,
            "heights": {
                widget.accessibleName(): widget.height()
                for widget in self._main.findChildren(QListWidget)
            },
        }
        if self._window is not None:
            said |= self._of_image()
        write_whole(self._file, said)

    def _of_image(self) -> dict[str, Any]:
        """What is said of the image that is open."""
        window = self._window
        status, frame = window.session.status, window.scene.frame
        if self._wanted.exists() and frame is not None:
            self._verdict = {**self._judge(frame), "number": self._verdict.get("number", 0) + 1}
            self._wanted.unlink()
        return {
            "state": window.user_actions.state(),
            "tiles": self._tiles(),
            "place_of_slices": axial_numbers(window.scene),
            "slices": slice_sizes(window.scene, window.canvas.devicePixelRatioF()),
            "step": status.step,
            "playing": status.playing,
            "message": window.message.text().replace("\N{ZERO WIDTH SPACE}", ""),
            "stop": status.stop and status.stop.reason,
            "drawn": None if frame is None else [frame.step, frame.volume_mm3],
            "undoable": status.undoable,
            "refinements": len(status.refinements),
            "edits": len(status.edits),
            "settings": status.settings.model_dump(mode="json"),
            "titles": {name: tile.title.text for name, tile in window.scene.slice_tiles.items()},
            "verdict": self._verdict,
            "object_rows": self._object_rows(),
        }

    def _tiles(self) -> dict[str, Any]:
        """Of each tile its middle on the screen, and the pixel of a world point as ``origin + matrix @ world``."""
        window, ratio = self._window, self._window.canvas.devicePixelRatioF()
        corner, found = window.canvas.mapToGlobal(QPoint(0, 0)), {}
        width, height = window.canvas.width(), window.canvas.height()
        for name in window.scene.tiles.names:
            renderer = window.scene.tiles.renderer(name)
            left, bottom, right, top = renderer.GetViewport()
            if right <= left:
                continue
            middle = [
                corner.x() + 0.5 * (left + right) * width,
                corner.y() + (1 - 0.5 * (bottom + top)) * height,
            ]
            found[name] = {"middle": middle}
            tile = window.scene.slice_tiles.get(name)
            if tile is not None:
                x, y, _ = renderer.camera.focal_point
                mm = tile.mm_per_pixel() * ratio

                def pixel(
                    world: Any,
                    tile: Any = tile,
                    x: float = x,
                    y: float = y,
                    mm: float = mm,
                    middle: Any = middle,
                ) -> Any:
                    right, up = tile.to_tile(
                        window.scene.geometry.world_to_index(np.asarray(world, float))
                    )
                    return np.array([middle[0] + (right - x) / mm, middle[1] - (up - y) / mm])

                origin = pixel([0, 0, 0])
                matrix = np.stack([pixel(unit) - origin for unit in np.eye(3)], axis=1)
                found[name] |= {"origin": origin.tolist(), "matrix": matrix.tolist()}
        return found

    def _object_rows(self) -> list[list[int]]:
        """Middle on the screen of the name of each object in the list."""
        table = self._window.side.panels["ObjectsPanel"].table
        rects = [
            table.visualRect(table.model().index(row, NAME_COLUMN))
            for row in range(table.rowCount())
        ]
        places = [table.viewport().mapToGlobal(rect.center()) for rect in rects]
        return [[place.x(), place.y()] for place in places]

    def _widgets(self) -> dict[str, Any]:
        """Middle on the screen of what has a name or a text and is not hidden; a line comes before its label."""
        found: dict[str, Any] = {}
        for widget in sorted(
            self._main.findChildren(QWidget), key=lambda widget: not isinstance(widget, QLabel)
        ):
            text = getattr(widget, "text", None)
            said = text() if callable(text) else ""
            place = widget.mapToGlobal(QPoint(widget.width() // 2, widget.height() // 2))
            for name in (widget.objectName(), said, widget.accessibleName()):
                if name and isinstance(name, str) and len(name) < 60 and widget.isVisible():
                    found[name] = [place.x(), place.y()]
        return found

    def _judge(self, frame: Any) -> dict[str, Any]:
        """Dice of each object; in that with the least the deepest place of what is missing or too much."""
        geometry, shape = self._window.scene.geometry, self._window.scene.geometry.shape
        dice, worst = [], []
        for number, truth in enumerate(self._truth):
            labels = np.zeros(shape, bool)
            if number < len(frame.surfaces):
                surface = frame.surfaces[number]
                places = np.argwhere(surface.psi < 0)
                index = np.rint(surface.to_image(places)).astype(int) if len(places) else places
                labels[tuple(np.clip(index, 0, np.array(shape) - 1).T)] = True
            dice.append(
                round(float(2.0 * (labels & truth).sum() / max(labels.sum() + truth.sum(), 1)), 3)
            )
            worst.append({"depth": 0.0})
            for side, wrong in (("inside", truth & ~labels), ("outside", labels & ~truth)):
                depth = ndimage.distance_transform_edt(np.pad(wrong, 1), sampling=geometry.spacing)[
                    1:-1, 1:-1, 1:-1
                ]
                at = np.unravel_index(int(depth.argmax()), depth.shape)
                if depth[at] > worst[-1]["depth"]:
                    world = geometry.index_to_world(np.array(at, float)).tolist()
                    worst[-1] = {
                        "depth": float(depth[at]),
                        "side": side,
                        "world": world,
                        "object": number,
                    }
        return {"dice": dice, "worst": worst[int(np.argmin(dice))], "mm3": float(frame.volume_mm3)}


def main() -> int:
    """Run the command, and watch the window that it opens."""
    named, truth_file, label, *words = sys.argv[1:]
    state_file = Path(named)
    truth = []
    if truth_file != "-":
        known = io.read_labels(Path(truth_file)).array
        truth = [np.isin(known, [int(one) for one in ids.split(",")]) for ids in label.split(";")]
    if "--browser" in words:
        watch_page(state_file)
        return cli.execute(words)
    original = MainWindow.__init__

    def watched(window: Any, *values: Any, **options: Any) -> None:
        original(window, *values, **options)
        window.watch = WindowWatch(window, state_file, truth)

    MainWindow.__init__ = watched  # type: ignore[method-assign]
    return cli.execute(words)


def watch_page(state_file: Path) -> None:
    """Have the page write the sizes of its slices with each picture."""
    from accelsurf.viewer.page.page import Page

    original = Page._draw

    def drawn(page: Any, actions: Any) -> float:
        seconds = original(page, actions)
        left, bottom, right, top = actions.scene.slice_tiles["axial"].renderer.GetViewport()
        sizes = slice_sizes(actions.scene, actions.scene.tiles.pixel_ratio)
        write_whole(
            state_file,
            {"slices": sizes, "axial": [0.5 * (left + right), 1.0 - 0.5 * (bottom + top)]},
        )
        return seconds

    Page._draw = drawn  # type: ignore[method-assign]


if __name__ == "__main__":
    sys.exit(main())
