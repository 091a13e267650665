"""Fingers on a screen in the window: Qt's events become requests, and no mouse is made of them."""

import importlib.util
import json

import pytest

from tests.support.offscreen import lines_of

pytestmark = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("PySide6", "pyvistaqt")),
    reason="PySide6 or pyvistaqt is not installed",
)

#: Qt without a screen, in a process of its own.
PROGRAM = """
import json
from types import SimpleNamespace
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QInputDevice
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
app = QApplication([])
from accelsurf.viewer.window.canvas_events import CanvasEvents
asked, drawn, sizes = [], [], []
feature = SimpleNamespace(is_dragging=True, fit_layout=lambda *size: sizes.append(size))
actions = SimpleNamespace(
    request=lambda *request: asked.append(request), feature=lambda kind: feature,
    scene=SimpleNamespace(tiles=SimpleNamespace()),
)
canvas = QWidget()
canvas.resize(101, 51)
events = CanvasEvents(actions, canvas, lambda: drawn.append(len(asked)))
canvas.show()
screen = QTest.createTouchDevice()
QTest.touchEvent(canvas, screen).press(0, QPoint(10, 10), canvas).commit()
QTest.touchEvent(canvas, screen).stationary(0).press(1, QPoint(50, 25), canvas).commit()
QTest.touchEvent(canvas, screen).move(0, QPoint(20, 10), canvas).move(1, QPoint(60, 25), canvas).commit()
QTest.touchEvent(canvas, screen).release(0, QPoint(20, 10), canvas).stationary(1).commit()
QTest.touchEvent(canvas, screen).release(1, QPoint(60, 25), canvas).commit()
print(json.dumps(asked))
print(len(drawn))
asked.clear()
pad = QTest.createTouchDevice(QInputDevice.DeviceType.TouchPad)
QTest.touchEvent(canvas, pad).press(0, QPoint(10, 10), canvas).press(1, QPoint(50, 25), canvas).commit()
print(json.dumps([one for one in asked if one[0].startswith("touch")]))
asked.clear()
QTest.mousePress(canvas, Qt.MouseButton.RightButton, pos=QPoint(50, 25))
QTest.mouseRelease(canvas, Qt.MouseButton.RightButton, pos=QPoint(50, 25))
print(json.dumps(asked))
print(json.dumps(sizes[-1]))
"""


def test_touches_become_requests():
    asked, drawn, of_pad, of_mouse, size = (json.loads(line) for line in lines_of(PROGRAM))
    first, second = asked[0][3], asked[1][3]  # Qt's own numbers of the fingers
    assert first != second
    assert asked == [
        ["touch_down", 0.1, 0.2, first, True],
        ["touch_down", 0.5, 0.5, second, False],
        ["touch_move", 0.2, 0.2, first],
        ["touch_move", 0.6, 0.5, second],
        ["touch_up", first],
        ["touch_up", second],
    ]
    assert size == [101, 51]  # from which the layout follows
    assert drawn == 5 and of_pad == []  # once for an event of both; a pad moves the mouse
    assert of_mouse == [["press", 0.5, 0.5, 2, False], ["release", 2]]
