"""napari with its plug-in for nnInteractive in Remote mode, driven by events of the mouse in a window.

Usage: python -m tests.support.remote_napari ADDRESS KEY FILE

Needs a screen. The phantom of the tests is segmented with each kind of prompt; FILE (.npz) gets the labels after each.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import napari
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

TOOLS = ("point", "box", "scribble", "lasso")
#: Seconds for the server to answer, and between two events of a drag.
PATIENCE, PAUSE = 60.0, 0.02
#: Size of the window, pixels.
SIZE = (1360, 850)


def phantom() -> tuple[NDArray[np.float32], tuple[float, float, float], tuple[int, int, int]]:
    """Image of two balls that touch in slices three times as thick as wide; the scale; the middle of a ball."""
    scale, middle = (3.0, 1.0, 1.0), (8, 24, 20)
    places = np.indices((16, 48, 64))
    balls = [
        sum(((axis - at) * h) ** 2 for axis, at, h in zip(places, ball, scale, strict=True))
        < 12.0**2
        for ball in (middle, (8, 24, 43))
    ]
    image = 100.0 * np.any(balls, axis=0) + np.random.default_rng(5).normal(0, 8, places.shape[1:])
    return image.astype(np.float32), scale, middle


class RemoteNapari:
    """A window of napari with an image, and the plug-in beside it, connected with a server."""

    def __init__(
        self,
        image: NDArray[np.float32],
        scale: Sequence[float],
        address: str,
        key: str,
        name: str = "scan",
    ) -> None:
        self.viewer = napari.Viewer()
        self.window = self.viewer.window._qt_window
        self.window.resize(*SIZE)
        self.image = self.viewer.add_image(image, scale=scale, name=name)
        _, self.widget = self.viewer.window.add_plugin_dock_widget("napari-nninteractive")
        if self.widget.mode_switch.index != 1:
            self.send(self.widget.mode_switch.buttons[1])
        for line, text in ((self.widget.server_url_edit, address), (self.widget.api_key_edit, key)):
            line.setText(text)
            line.editingFinished.emit()
        self.send(self.widget.init_button)
        self.wait(lambda: self.labels is not None and self.widget.undo_button.isEnabled())

    @property
    def labels(self) -> NDArray[np.uint8] | None:
        """Labels that the plug-in shows."""
        name = self.widget.label_layer_name
        return np.asarray(self.viewer.layers[name].data) if name in self.viewer.layers else None

    def wait(self, is_done: Callable[[], bool] = lambda: True) -> None:
        """Let the window work until something is done."""
        end = time.monotonic() + PATIENCE
        while True:
            for _ in range(5):
                QApplication.processEvents()
                time.sleep(0.01)
            if is_done():
                return
            if time.monotonic() > end:
                sys.exit(f"no answer: {self.widget.remote_status_label.text()}")

    def send(self, button: object) -> None:
        """Push a button of the plug-in."""
        QTest.mouseClick(button, Qt.LeftButton)
        self.wait()

    def choose(self, tool: str, is_inside: bool = True) -> None:
        """Choose a kind of prompt, and its side."""
        self.send(self.widget.prompt_button.buttons[0 if is_inside else 1])
        if self.widget.interaction_button.index != TOOLS.index(tool):
            self.send(self.widget.interaction_button.buttons[TOOLS.index(tool)])

    def show(self, place: Sequence[float]) -> None:
        """Show the slice of a voxel."""
        self.viewer.dims.set_point(0, float(self.image.data_to_world(place)[0]))
        self.wait()

    def look_at(self, place: Sequence[float], zoom: float) -> None:
        """Put a voxel in the middle of the view."""
        self.viewer.camera.center = tuple(self.image.data_to_world(place))
        self.viewer.camera.zoom = zoom
        self.wait()

    def draw(self, places: Sequence[Sequence[float]]) -> None:
        """Press at a voxel, drag over the others, and let go."""
        native = self.viewer.window._qt_viewer.canvas.native
        points = [self._point(place) for place in places]
        QTest.mouseMove(native, points[0])
        self.wait()
        QTest.mousePress(native, Qt.LeftButton, pos=points[0])
        for point in points[1:]:
            time.sleep(PAUSE)
            QTest.mouseMove(native, point)
            QApplication.processEvents()
        QTest.mouseRelease(native, Qt.LeftButton, pos=points[-1])
        self.wait()

    def _point(self, place: Sequence[float]) -> QPoint:
        """Return where the canvas shows a voxel of the slice."""
        world = np.asarray(self.image.data_to_world(place))[list(self.viewer.dims.displayed)]
        at = self.viewer.window._qt_viewer.canvas.view.scene.transform.map([*world[::-1], 0, 1])
        return QPoint(*(round(float(value)) for value in at[:2] / at[3]))

    def begin_at(self, labels: NDArray[np.uint8]) -> None:
        """Begin at the label 1 of a labels layer."""
        self.viewer.add_labels(labels, scale=self.image.scale, name="labels of another program")
        self.widget.label_for_init.setCurrentText("labels of another program")
        self.send(self.widget.load_mask_btn)

    def picture(self, path: Path) -> None:
        """Save what the window shows, in 64 colours."""
        self.wait()
        shown = self.viewer.window.screenshot(canvas_only=False, flash=False)
        Image.fromarray(shown).convert("RGB").quantize(64).save(path, optimize=True)


def circle(
    middle: Sequence[float], radius: float, count: int = 16
) -> list[tuple[float, float, float]]:
    """Return voxels of a circle in a slice."""
    z, y, x = middle
    turns = np.linspace(0, 2 * np.pi, count)
    return [
        (z, y + radius * float(np.sin(turn)), x + radius * float(np.cos(turn))) for turn in turns
    ]


def main() -> None:
    address, key, file = sys.argv[1:]
    image, scale, middle = phantom()
    z, y, x = middle
    driven = RemoteNapari(image, scale, address, key)
    driven.show(middle)
    #: Places of a prompt inside, and whether the point in the other ball that corrects it is inside.
    prompts = {
        "point": ([middle], False),
        "box": ([(z, y - 12, x - 12), middle, (z, y + 12, x + 12)], True),
        "scribble": ([(z, y, x + step) for step in range(-6, 7, 2)], False),
        "lasso": (circle(middle, 12), True),
    }
    found = {}
    for tool, (places, is_inside) in prompts.items():
        driven.choose(tool)
        driven.draw(places)
        found[tool] = driven.labels.copy()
        driven.choose("point", is_inside)
        driven.draw([(z, y, x + 23)])
        found[f"{tool}, corrected"] = driven.labels.copy()
        for name in ("undone", "undone twice"):
            driven.send(driven.widget.undo_button)
            found[f"{tool}, {name}"] = driven.labels.copy()
        driven.send(driven.widget.reset_interaction_button)
    driven.begin_at((image > 50).astype(np.uint8))
    found["labels"] = driven.labels.copy()
    driven.choose("point", is_inside=False)
    driven.draw([(z, y, x + 23)])
    found["labels, corrected"] = driven.labels.copy()
    np.savez(file, **found)
    driven.viewer.close()


if __name__ == "__main__":
    main()
