"""Parts of the window by themselves: the line of messages, and the wheel over numbers and sliders of the panels."""

import importlib.util

import pytest

from tests.support.offscreen import lines_of

pytestmark = pytest.mark.skipif(importlib.util.find_spec("PySide6") is None, reason="PySide6 is not installed")

#: Qt without a screen, in a process of its own.
MESSAGE = """
from PySide6.QtWidgets import QApplication
app = QApplication([])
from accelsurf.viewer.window.section_panel import OneLine
line = OneLine("saved in a folder: one.nii.gz, two.stl, three.csv")
for width in (600, 120):
    line.resize(width, 20)
    line.grab()
    print(line.shown == line.text(), line.shown.endswith(chr(8230)), line.toolTip() == line.text())
print(line.minimumSizeHint().width() < 120 or line.sizePolicy().horizontalPolicy().name)
"""
WHEEL = """
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtWidgets import QApplication, QDoubleSpinBox, QSlider, QVBoxLayout, QWidget
app = QApplication([])
from accelsurf.viewer.window.section_panel import ScrollGuard
window = QWidget()
column = QVBoxLayout(window)
parts = [QDoubleSpinBox(), QSlider(Qt.Orientation.Horizontal)]
for part in parts:
    part.setRange(0, 100)
    part.setValue(50)
    ScrollGuard(part)
    column.addWidget(part)
other = QDoubleSpinBox()
column.addWidget(other)
window.show()
other.setFocus()
app.processEvents()


def turn(part):
    middle = QPointF(part.rect().center())
    app.notify(part, QWheelEvent(middle, part.mapToGlobal(middle), QPoint(), QPoint(0, 120), Qt.MouseButton.NoButton,
                                 Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False))


for part in parts:
    turn(part)
    before = part.value()
    part.setFocus()
    turn(part)
    print(before, part.value() > 50)
    other.setFocus()
"""


def test_a_message_that_is_too_long_ends_in_an_ellipsis_and_has_a_tip():
    assert lines_of(MESSAGE) == ["True False False", "False True True", "Ignored"]


def test_the_wheel_changes_a_number_only_after_it_was_clicked():
    assert lines_of(WHEEL) == ["50.0 True", "50 True"]
