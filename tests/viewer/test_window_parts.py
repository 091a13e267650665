"""Parts of the window by themselves: messages, order of panels and tools, the wheel over numbers and sliders."""

import importlib.util
import re

import pytest

from accelsurf.viewer.actions.tools import Size
from accelsurf.viewer.page.page import PANELS as page_panels
from accelsurf.viewer.page.page import document, page_text
from tests.support.offscreen import lines_of

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("PySide6") is None, reason="PySide6 is not installed"
)

#: Qt without a screen, in a process of its own.
MESSAGE = """
from PySide6.QtWidgets import QApplication, QHBoxLayout, QLabel, QTextEdit, QVBoxLayout, QWidget
app = QApplication([])
from accelsurf.viewer.window.appearance import sheet
from accelsurf.viewer.window.section_panel import Message
window, message = QWidget(), Message()
read_out = QLabel("-101.31, -110.12, 135.66 mm   voxel 170, 189, 170   value 1360")
window.setStyleSheet(sheet("dark"))
rows, last = QVBoxLayout(window), QHBoxLayout()
rows.addWidget(QTextEdit(), 1)
last.addWidget(message, 1)
last.addWidget(read_out)
rows.addLayout(last)
window.show()
texts = ["ready", "word " * 60, "saved 11 files in /home/" + "a_long_name/" * 20, "x" * 300]
texts.append("inside: ball:1.25,-3.5,7,2 " * 11)
for width, height in ((1024, 768), (1280, 720), (1920, 1080), (3840, 2160)):
    window.resize(width, height)
    for text in texts:
        for failed in (False, True):
            message.say(text, failed)
            app.processEvents()
            app.processEvents()
            inside = window.width() == width and message.geometry().right() < read_out.geometry().left()
            needed = message.fontMetrics().boundingRect(0, 0, message.width(), 9999, 0x1000 | 0x2000, message.text())
            is_whole = message.height() >= message.heightForWidth(message.width()) and needed.width() <= message.width()
            seen = message.text().replace(chr(0x200B), "")
            print(inside and is_whole and seen == ("Error: " if failed else "") + text)
"""
PANELS = """
import numpy as np
from PySide6.QtWidgets import QApplication, QPushButton
app = QApplication([])
from accelsurf import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.window.desktop import SidePanels
from accelsurf.viewer.window.playback_bar import PlaybackBar
volume = Volume.from_array(np.random.default_rng(0).random((8, 9, 10)).astype(np.float32))
with Session(volume, RunConfig(threads=1)) as session:
    session.ready.result(60)
    actions = Actions(session, Scene(volume, size=(320, 200)))
    side, bar = SidePanels(actions), PlaybackBar(actions)
    state = actions.state()
    side.show_state(state)
    bar.show_state(state)
    tools = side.panels["ToolsPanel"]
    print(*(panel.title.text() for panel in side.panels.values()))
    print(*(made.text() for made in side.changes.findChildren(QPushButton)))
    print(*(made.text() for made in tools.tools.values()))
    print(*(made.text() for made in tools.tools.values() if made.isChecked()))
    print(tools.tip.text())
    print(*(made.text() for made in bar.findChildren(QPushButton)))
    print(bar.isVisibleTo(side), side.changes.save.isEnabled(), side.panels["ResultPanel"].isVisibleTo(side))
    side.show_hints(["Press in the object"])
    print(side.hints.isVisibleTo(side), [])
    side.show_hints([])
    print(side.hints.isVisibleTo(side), [])
    print([folded.title.text() for folded in side.panels["SettingsPanel"].groups.values()])
"""
SCROLL = """
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


def test_a_message_is_seen_as_a_whole_at_any_size():
    assert lines_of(MESSAGE) == ["True"] * 40


def test_window_and_page_have_the_same_panels_tools_and_buttons_in_the_same_order():
    titles, changes, tools, selected, tip, bar, unbegun, shown, hidden, folded = lines_of(PANELS)
    assert tools.split()[:4] == ["Size", "Inside", "Outside", "Look"] and selected == "Size"
    assert tip == Size.tip and len(tip) < 80
    assert (
        unbegun == "False False False" and folded == "['Expert']"
    )  # nothing to run, to save, or to be judged
    assert (shown, hidden) == ("True []", "False []")
    page = {name: page_text(f"{name}.html") for name in (*page_panels, "canvas")}
    summaries = [
        found
        for name in page_panels
        for found in re.findall(r"<summary>([A-Za-z ]+)</summary>", page[name])
    ]
    assert summaries[: len(titles.split())] == titles.split()
    buttons = re.findall(r">(Undo|Redo|Save)</button>", page["head"])
    assert buttons == changes.split()[:3]
    found = re.findall(r">(Restart|Back|\{\{ playing .*?\}\}|Step)</button>", page["canvas"])
    assert [found[0], found[1], found[3]] == ["Restart", "Back", "Step"] and "Run" in found[2]
    assert bar == "Restart Back Run Step"
    assert document(page_panels).index("<main>") < document(page_panels).index(
        'aria-label="panels"'
    )


def test_the_scroll_changes_a_number_only_after_it_was_clicked():
    assert lines_of(SCROLL) == ["50.0 True", "50 True"]


def test_a_property_that_qt_does_not_know_is_refused():
    program = """
from PySide6.QtWidgets import QApplication, QPushButton
application = QApplication([])
from accelsurf.viewer.window.section_panel import furnished
pressed = []
made = furnished(QPushButton("a"), toolTip="tip", enabled=True, clicked=lambda: pressed.append(1))
made.click()
print(made.toolTip(), pressed)
for wrong in ({"tooltip": "b"}, {"pushed": print}):
    try:
        furnished(made, **wrong)
    except AttributeError as error:
        print(error)
"""
    first, *others = lines_of(program)
    assert first == "tip [1]"
    assert len(others) == 2 and all("QPushButton" in line for line in others)
