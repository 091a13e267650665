"""The bar below the scene: restart, back, play, forward, and the slider over checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSlider, QWidget

from accelsurf.viewer.workplace.workplace import Workplace


class PlaybackBar(QWidget):
    """Buttons and a slider to move over the steps of a run.

    Attributes
    ----------
    help_wanted : Signal
        The button of the help was clicked.
    """

    help_wanted = Signal()

    def __init__(self, workplace: Workplace) -> None:
        super().__init__()
        self._steps: list[int] = []
        self._workplace = workplace
        self.restart = _button("|<", "Restart: from the start, with the settings in force (Home)")
        self.back = _button("<", "Back one step (Left)")
        self.play = _button("Run", "Run or pause (Space)")
        self.forward = _button(">", "One step (Right)")
        self.play.setFixedWidth(84)
        self.play.setObjectName("play")
        self.timeline = QSlider(Qt.Orientation.Horizontal)
        self.timeline.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.timeline.setToolTip("Stored steps: drag to go back and forward")
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
            button.clicked.connect(lambda _=False, name=name: workplace.request(name))
        self.help.clicked.connect(self.help_wanted)
        self.timeline.valueChanged.connect(self._slid)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state of the workplace."""
        self._steps = list(state["checkpoints"])
        self.play.setText("Pause" if state["playing"] else "Run")
        for part in (self.play, self.forward, self.restart):
            part.setEnabled(state["ready"])
        self.back.setEnabled(state["step"] > 0)
        with QSignalBlocker(self.timeline):
            self.timeline.setRange(0, max(len(self._steps) - 1, 0))
            if not self.timeline.isSliderDown() and state["step"] in self._steps:
                self.timeline.setValue(self._steps.index(state["step"]))
        edits = f", {state['edits']} edit{'' if state['edits'] == 1 else 's'}" if state["edits"] else ""
        self.where.setText(f"step {state['step']}{edits}")

    def _slid(self, place: int) -> None:
        if place < len(self._steps) and self._steps[place] != self._workplace.session.status.step:
            self._workplace.request("go_to", self._steps[place])


def _button(text: str, tip: str) -> QPushButton:
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    button.setFixedWidth(40)
    return button
