"""A number on a slider and in a box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QHBoxLayout, QSlider, QWidget

from accelsurf.viewer.frontends.panels.wheel import WheelGuard
from accelsurf.viewer.workplace.amounts import TICKS

#: How long after the last change the value of a slider is emitted, milliseconds.
DELAY_MS = 250
#: Largest number that a box can have; its width with three digits after the point and that of one more, pixels.
MAX_BOX, WIDTH, DIGIT = 1e12, 74, 8


class Amount(QWidget):
    """A number on a slider and in a box, where it may be larger; optionally words that may stand for it.

    Parameters
    ----------
    shown : mapping of str to object
        Its ends, digits and words, as of `accelsurf.viewer.workplace.amounts.amount`.
    """

    changed = Signal(object)

    def __init__(self, shown: Mapping[str, Any]) -> None:
        super().__init__()
        low, high = self._low, self._high = shown["low"], shown["high"]
        self._power = shown["power"]
        words, digits = shown["words"], shown["digits"]
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, TICKS)
        self.slider.setPageStep(TICKS // 10)
        self.slider.setMinimumWidth(70)
        self.box = QDoubleSpinBox()
        self.box.setDecimals(digits)
        self.box.setRange(low, min(shown["limit"], MAX_BOX))
        self.box.setSingleStep((high - low) / 20)
        self.box.setKeyboardTracking(False)
        self.box.setFixedWidth(WIDTH + DIGIT * max(digits - 3, 0))
        self.word: QComboBox | None = None
        line = QHBoxLayout(self)
        line.setContentsMargins(0, 0, 0, 0)
        line.setSpacing(4)
        if words:
            self.word = QComboBox()
            self.word.addItems([*words, "value"])
            self.word.setFixedWidth(66)
            self.word.activated.connect(self._on_word)
            line.addWidget(self.word)
        line.addWidget(self.slider, 1)
        line.addWidget(self.box)
        for part in (self.slider, self.box, self.word):
            if part is not None:
                WheelGuard(part)
        self._delay = QTimer(self, singleShot=True, interval=DELAY_MS)
        self._delay.timeout.connect(self._emit)
        self.slider.valueChanged.connect(self._slid)
        self.slider.sliderReleased.connect(self._emit)
        self.box.valueChanged.connect(self._typed)

    @property
    def value(self) -> float | str:
        """The number, or the word that stands for it."""
        if self.word is not None and self.word.currentText() != "value":
            return self.word.currentText()
        return float(self.box.value())

    @property
    def is_being_moved(self) -> bool:
        """Whether the user is changing it now, so that it does not show the value in force."""
        return self.slider.isSliderDown() or self._delay.isActive() or self.box.hasFocus()

    def show_value(self, value: float | str) -> None:
        """Show the value in force, without emitting it."""
        blockers = [QSignalBlocker(part) for part in (self.slider, self.box, self.word) if part is not None]
        if isinstance(value, str) and self.word is not None:
            self.word.setCurrentText(value)
        else:
            if self.word is not None:
                self.word.setCurrentText("value")
            self.box.setValue(float(value))
            self.slider.setValue(self._tick(float(value)))
        self._enable()
        del blockers

    def _enable(self) -> None:
        numeric = self.word is None or self.word.currentText() == "value"
        self.slider.setEnabled(numeric)
        self.box.setEnabled(numeric)

    def _tick(self, value: float) -> int:
        share = min(max((value - self._low) / (self._high - self._low), 0.0), 1.0)
        return round(TICKS * share ** (1.0 / self._power))

    def _slid(self, tick: int) -> None:
        value = self._low + (self._high - self._low) * (tick / TICKS) ** self._power
        with QSignalBlocker(self.box):
            self.box.setValue(value)
        # A drag is one change, emitted at its end; keys and clicks beside the handle are emitted after a delay.
        if not self.slider.isSliderDown():
            self._delay.start()

    def _typed(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._tick(value))
        self._delay.start()

    def _on_word(self) -> None:
        self._enable()
        if self.word is not None and self.word.currentText() == "value" and self.box.value() <= 0:
            self.box.setValue(0.25 * self._high)
        self._emit()

    def _emit(self) -> None:
        self._delay.stop()
        self.changed.emit(self.value)
