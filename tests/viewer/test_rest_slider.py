"""The slider over steps: ticks where the surface rested, and a click on one."""

import importlib.util

import pytest

from tests.support.offscreen import lines_of

pytestmark = pytest.mark.skipif(importlib.util.find_spec("PySide6") is None, reason="PySide6 is not installed")

#: Qt without a screen, in a process of its own.
PROGRAM = """
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
app = QApplication([])
from accelsurf.viewer.window.playback_bar import RestSlider
slider = RestSlider()
slider.resize(400, 24)
slider.setRange(0, 10)
slider.setValue(0)
clicked = []
slider.tick_clicked.connect(clicked.append)
plain = slider.grab().toImage()
slider.show_ticks([4.0, 7.5], [40, 80])
ticked = slider.grab().toImage()
columns = [x for x in range(400) if ticked.pixelColor(x, 1) != plain.pixelColor(x, 1)]
print(min(columns), max(columns), slider.tick_at(4.0), slider.tick_at(7.5))
QTest.mouseClick(slider, Qt.MouseButton.LeftButton, pos=QPoint(slider.tick_at(7.5) + 2, 12))
QTest.mouseClick(slider, Qt.MouseButton.LeftButton, pos=QPoint(slider.tick_at(4.0), 12))
print(clicked, slider.value(), "40, 80" in slider.toolTip())
slider.show_ticks([], [])
QTest.mouseClick(slider, Qt.MouseButton.LeftButton, pos=QPoint(slider.tick_at(4.0), 12))
print(clicked, slider.grab().toImage() == plain or slider.value() > 0)
"""


def test_ticks_are_drawn_and_a_click_on_one_goes_there():
    places, after, without = lines_of(PROGRAM)
    first, last, four, seven = (int(word) for word in places.split())
    assert abs(first - four) <= 1 and abs(last - seven) <= 1
    assert after == "[80, 40] 0 True"
    assert without.startswith("[80, 40]")
