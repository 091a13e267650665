"""The bar below the scene: restart, back, play, forward, and the slider over checkpoints. Knows no session."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSlider, QWidget

from accelsurf.viewer.core.status import Status


class PlaybackBar(QWidget):
    """Buttons and a slider to move over the steps of a run; emits what is asked for.

    Attributes
    ----------
    restart_wanted, back_wanted, play_wanted, forward_wanted, help_wanted : Signal
        A button was clicked.
    step_wanted : Signal(int)
        The slider was moved to the checkpoint of this step.
    """

    restart_wanted = Signal()
    back_wanted = Signal()
    play_wanted = Signal()
    forward_wanted = Signal()
    help_wanted = Signal()
    step_wanted = Signal(int)

    def __init__(self) -> None:
        super().__init__()
        self._status: Status | None = None
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
        for button, signal in (
            (self.restart, self.restart_wanted), (self.back, self.back_wanted), (self.play, self.play_wanted),
            (self.forward, self.forward_wanted), (self.help, self.help_wanted),
        ):
            button.clicked.connect(signal)
        self.timeline.valueChanged.connect(self._slid)

    def show_status(self, status: Status) -> None:
        """Show the status of a session."""
        self._status = status
        self.play.setText("Pause" if status.playing else "Run")
        for part in (self.play, self.forward, self.restart):
            part.setEnabled(status.ready)
        self.back.setEnabled(status.step > 0)
        with QSignalBlocker(self.timeline):
            self.timeline.setRange(0, max(len(status.checkpoints) - 1, 0))
            if not self.timeline.isSliderDown() and status.step in status.checkpoints:
                self.timeline.setValue(status.checkpoints.index(status.step))
        edits = f", {len(status.edits)} edit{'' if len(status.edits) == 1 else 's'}" if status.edits else ""
        self.where.setText(f"step {status.step}{edits}")

    def _slid(self, place: int) -> None:
        steps = () if self._status is None else self._status.checkpoints
        if place < len(steps):
            self.step_wanted.emit(steps[place])


def _button(text: str, tip: str) -> QPushButton:
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    button.setFixedWidth(40)
    return button
