"""The bars below the scene: over the steps of a run, and over the frames of a sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import QMargins, QSignalBlocker, Qt
from PySide6.QtWidgets import QLabel, QPushButton, QSlider, QWidget

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.window.section_panel import button, furnished, in_row, restyle


class _Bar(QWidget):
    """Buttons, a slider, a text."""

    def __init__(self, actions: Actions, slider: QSlider, name: str) -> None:
        super().__init__()
        self._actions = actions
        furnished(slider, focusPolicy=Qt.FocusPolicy.NoFocus, accessibleName=name)
        self.where = QLabel("")

    def _button(self, text: str, tip: str, request: str, *values: int) -> QPushButton:
        made = button(text, tip, clicked=lambda: self._actions.request(request, *values))
        made.setFixedWidth(64)
        return made

    def _lay_out(self, buttons: Sequence[QWidget], slider: QSlider, below: int) -> None:
        row = in_row(*buttons, slider, self.where, spacing=6)
        row.setStretchFactor(slider, 1)
        self.setLayout(furnished(row, contentsMargins=QMargins(8, 5, 8, below)))


class PlaybackBar(_Bar):
    """Buttons and a slider to move over the steps of a run, once there is one."""

    def __init__(self, actions: Actions) -> None:
        self.timeline = QSlider(Qt.Orientation.Horizontal)
        super().__init__(actions, self.timeline, "stored steps")
        self._steps: list[int] = []
        self.restart = self._button(
            "Restart", "Restart: from the start, with the settings in force (Home)", "restart"
        )
        self.back = self._button("Back", "Back one step (Left)", "back")
        self.play = self._button("Run", "Run or pause (Space)", "toggle")
        self.forward = self._button("Step", "One step (Right)", "step")
        self.play.setObjectName("play")
        self.where.setMinimumWidth(170)
        buttons = self.restart, self.back, self.play, self.forward
        self._lay_out(buttons, self.timeline, 5)
        self.timeline.valueChanged.connect(self._slid)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""
        self.setVisible(state["can_run"])
        self._steps = list(state["checkpoints"])
        self.play.setText("Pause" if state["playing"] else "Run")
        restyle(self.play, "main", state["is_due"])
        self.back.setEnabled(state["step"] > 0)
        plateaus = f"; it rested at {', '.join(map(str, state['rests']))}" if state["rests"] else ""
        self.timeline.setToolTip(f"Stored steps: drag to go back and forward{plateaus}")
        with QSignalBlocker(self.timeline):
            self.timeline.setRange(0, max(len(self._steps) - 1, 0))
            if not self.timeline.isSliderDown() and state["step"] in self._steps:
                self.timeline.setValue(self._steps.index(state["step"]))
        edits = (
            f", {state['edits']} edit{'' if state['edits'] == 1 else 's'}" if state["edits"] else ""
        )
        self.where.setText(f"step {state['step']}{edits}")

    def _slid(self, place: int) -> None:
        if place < len(self._steps) and self._steps[place] != self._actions.session.status.step:
            self._actions.request("go_to", self._steps[place])


class FrameBar(_Bar):
    """Buttons and a slider to move over frames."""

    def __init__(self, actions: Actions) -> None:
        self.slider = QSlider(Qt.Orientation.Horizontal)
        super().__init__(actions, self.slider, "frame")
        self.before = self._button("Before", "Frame before this one (,)", "step_frame", -1)
        self.play = self._button("Play", "Play the frames, or stop (X)", "play_frames")
        self.next = self._button("Next", "Next frame (.)", "step_frame", 1)
        self.slider.valueChanged.connect(lambda number: actions.request("frame", number))
        self.where.setMinimumWidth(210)
        self._lay_out((self.before, self.play, self.next), self.slider, 0)
        self.hide()

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
