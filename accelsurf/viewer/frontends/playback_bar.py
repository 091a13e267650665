"""The bars below the scene: over the steps of a run, and over the frames of a sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSlider, QStyle, QWidget

from accelsurf.viewer.scene.colors import CURSOR
from accelsurf.viewer.workplace.workplace import Actions

#: Half the width in which a tick is hit, and its height, pixels.
HIT, HEIGHT = 5, 5


class RestSlider(QSlider):
    """A slider with ticks where the surface rested; a click on a tick goes to its step.

    Attributes
    ----------
    tick_clicked : Signal(int)
        The tick of this step was clicked.
    """

    tick_clicked = Signal(int)

    def __init__(self) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self._ticks: list[tuple[float, int]] = []

    def show_ticks(self, places: Sequence[float], steps: Sequence[int]) -> None:
        """Show ticks of these steps at these places of the slider's range."""
        ticks = list(zip(places, steps, strict=True))
        if ticks != self._ticks:
            self._ticks = ticks
            words = ", ".join(str(step) for step in steps)
            self.setToolTip("Stored steps: drag to go back and forward" + (f"; it rested at {words}" if words else ""))
            self.update()

    def tick_at(self, place: float) -> int:
        """Pixel of a place of the slider's range, from its left end."""
        margin = self.style().pixelMetric(QStyle.PixelMetric.PM_SliderLength, None, self) / 2
        share = place / self.maximum() if self.maximum() else 0.0
        return round(margin + share * (self.width() - 2 * margin))

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the ticks over the slider."""
        super().paintEvent(event)
        painter = QPainter(self)
        painter.setPen(QPen(QColor(CURSOR), 2))
        for place, _ in self._ticks:
            x = self.tick_at(place)
            painter.drawLine(x, 0, x, HEIGHT)
            painter.drawLine(x, self.height() - HEIGHT, x, self.height())
        painter.end()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Go to a tick that is clicked, unless the handle is there."""
        handle = self.tick_at(float(self.value()))
        x = event.position().x()
        for place, step in self._ticks:
            if abs(x - self.tick_at(place)) <= HIT and abs(x - handle) > HIT:
                self.tick_clicked.emit(step)
                event.accept()
                return
        super().mousePressEvent(event)


class PlaybackBar(QWidget):
    """Buttons and a slider to move over the steps of a run.

    Attributes
    ----------
    help_wanted : Signal
        The button of the help was clicked.
    """

    help_wanted = Signal()

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._steps: list[int] = []
        self._actions = actions
        self.restart = _button("|<", "Restart: from the start, with the settings in force (Home)")
        self.back = _button("<", "Back one step (Left)")
        self.play = _button("Run", "Run or pause (Space)")
        self.forward = _button(">", "One step (Right)")
        self.play.setFixedWidth(84)
        self.play.setObjectName("play")
        self.timeline = RestSlider()
        self.timeline.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.timeline.setToolTip("Stored steps: drag to go back and forward")
        self.timeline.setAccessibleName("stored steps")
        self.where = QLabel("")
        self.where.setMinimumWidth(170)
        self.help = _button("?", "Keys and mouse (F1)")
        line = QHBoxLayout(self)
        line.setContentsMargins(8, 5, 8, 5)
        line.setSpacing(6)
        for part in (self.restart, self.back, self.play, self.forward):
            line.addWidget(part)
        line.addWidget(self.timeline, 1)
        line.addWidget(self.where)
        line.addWidget(self.help)
        for button, name in (
            (self.restart, "restart"), (self.back, "back"), (self.play, "toggle"), (self.forward, "step"),
        ):
            button.clicked.connect(lambda _=False, name=name: actions.request(name))
        self.help.clicked.connect(self.help_wanted)
        self.timeline.valueChanged.connect(self._slid)
        self.timeline.tick_clicked.connect(lambda step: actions.request("go_to", step))

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""
        self._steps = list(state["checkpoints"])
        self.play.setText("Pause" if state["playing"] else "Run")
        for part in (self.play, self.forward, self.restart):
            part.setEnabled(state["ready"])
        self.back.setEnabled(state["step"] > 0)
        self.timeline.show_ticks([self._place_of(step) for step in state["rests"]], state["rests"])
        with QSignalBlocker(self.timeline):
            self.timeline.setRange(0, max(len(self._steps) - 1, 0))
            if not self.timeline.isSliderDown() and state["step"] in self._steps:
                self.timeline.setValue(self._steps.index(state["step"]))
        edits = f", {state['edits']} edit{'' if state['edits'] == 1 else 's'}" if state["edits"] else ""
        self.where.setText(f"step {state['step']}{edits}")

    def _place_of(self, step: int) -> float:
        """Return the place of a step among the stored ones, which the slider counts."""
        after = sum(stored <= step for stored in self._steps)
        if not 0 < after < len(self._steps):
            return float(max(min(after, len(self._steps)) - 1, 0))
        before, following = self._steps[after - 1], self._steps[after]
        return after - 1 + (step - before) / (following - before)

    def _slid(self, place: int) -> None:
        if place < len(self._steps) and self._steps[place] != self._actions.session.status.step:
            self._actions.request("go_to", self._steps[place])


def _button(text: str, tip: str) -> QPushButton:
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    button.setFixedWidth(40)
    return button


class FrameBar(QWidget):
    """Buttons and a slider to move over frames."""

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._actions = actions
        self.before = self._button("<", "Frame before this one (,)", "step_frame", -1)
        self.play = self._button("Play", "Play the frames, or stop (X)", "play_frames")
        self.next = self._button(">", "Next frame (.)", "step_frame", 1)
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.slider.setAccessibleName("frame")
        self.slider.valueChanged.connect(lambda number: actions.request("frame", number))
        self.where = QLabel("")
        self.where.setMinimumWidth(210)
        line = QHBoxLayout(self)
        line.setContentsMargins(8, 5, 8, 0)
        line.setSpacing(6)
        for part in (self.before, self.play, self.next):
            line.addWidget(part)
        line.addWidget(self.slider, 1)
        line.addWidget(self.where)
        self.hide()

    def _button(self, text: str, tip: str, name: str, *values: int) -> QPushButton:
        button = QPushButton(text)
        button.setToolTip(tip)
        button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        button.setFixedWidth(64 if len(text) > 1 else 40)
        button.clicked.connect(lambda: self._actions.request(name, *values))
        return button

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""
        self.setVisible(state["frames"] > 1)
        self.play.setText("Stop" if state["frames_play"] else "Play")
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, max(state["frames"] - 1, 0))
            if not self.slider.isSliderDown():
                self.slider.setValue(state["frame"])
        self.where.setText(state["frame_words"])
        self.where.setToolTip(state["frame_lines"])
