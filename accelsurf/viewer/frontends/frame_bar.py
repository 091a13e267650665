"""The bar over the frames of a sequence: before, play, next, and a slider; hidden for an image without time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSlider, QWidget

from accelsurf.viewer.workplace.workplace import Workplace


class FrameBar(QWidget):
    """Buttons and a slider to move over frames."""

    def __init__(self, workplace: Workplace) -> None:
        super().__init__()
        self._workplace = workplace
        self.before = self._button("<", "Frame before this one (,)", "step_frame", -1)
        self.play = self._button("Play", "Play the frames, or stop (X)", "play_frames")
        self.next = self._button(">", "Next frame (.)", "step_frame", 1)
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.slider.setAccessibleName("frame")
        self.slider.valueChanged.connect(lambda number: workplace.request("frame", number))
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
        button.clicked.connect(lambda: self._workplace.request(name, *values))
        return button

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state of the workplace."""
        self.setVisible(state["frames"] > 1)
        self.play.setText("Stop" if state["frames_play"] else "Play")
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, max(state["frames"] - 1, 0))
            if not self.slider.isSliderDown():
                self.slider.setValue(state["frame"])
        self.where.setText(state["frame_words"])
        self.where.setToolTip(state["frame_lines"])
