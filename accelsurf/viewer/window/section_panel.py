"""A panel that folds, and the widgets that several panels use: buttons, lists, numbers on sliders, lines of text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from PySide6.QtCore import QEvent, QObject, QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QLabel,
    QLayout,
    QPushButton,
    QSizePolicy,
    QSlider,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.settings_rows import TICKS

L = TypeVar("L", bound=QLayout)


class ScrollGuard(QObject):
    """Passes scrolling on to the panels, unless its widget has the keyboard."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self._widget = widget
        if widget.focusPolicy() == Qt.FocusPolicy.WheelFocus:
            # Else Qt gives it the keyboard with the first turn, before it asks here.
            widget.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        widget.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Keep scrolling from the widget."""
        if event.type() == QEvent.Type.Wheel and not self._widget.hasFocus():
            event.ignore()
            return True
        return False


class Section(QWidget):
    """A panel with a title; a click on the title folds it.

    Parameters
    ----------
    title : str
    actions : Actions
    folded : bool, optional
        At first.

    Attributes
    ----------
    body : QWidget
        Part that folds away; a panel puts its widgets into its layout.
    """

    def __init__(self, title: str, actions: Actions, folded: bool = False) -> None:
        super().__init__()
        self.user_actions = actions
        self.title = QToolButton()
        self.title.setObjectName("section")
        self.title.setText(title)
        self.title.setCheckable(True)
        self.title.setChecked(not folded)
        self.title.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.title.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.title.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.title.toggled.connect(self._fold)
        self.body = QWidget()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addWidget(self.title)
        column.addWidget(self.body)
        self._fold(not folded)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""

    def ask(self, name: str, *values: Any) -> None:
        """Make a request."""
        self.user_actions.request(name, *values)

    def button(self, text: str, tip: str, request: str, *values: Any) -> QPushButton:
        """Return a button that makes a request."""
        made = button(text, tip)
        made.clicked.connect(lambda: self.ask(request, *values))
        return made

    def switch(self, text: str, request: str, tip: str = "") -> QCheckBox:
        """Return a box to check that makes a request."""
        made = switch(text, tip)
        made.toggled.connect(lambda is_on: self.ask(request, is_on))
        return made

    def choice(self, label: str, request: str) -> QComboBox:
        """Return a list to choose from that makes a request."""
        made = choice(label)
        made.activated.connect(lambda _: self.ask(request, made.currentText()))
        return made

    def _fold(self, is_open: bool) -> None:
        self.title.setArrowType(Qt.ArrowType.DownArrow if is_open else Qt.ArrowType.RightArrow)
        self.body.setVisible(is_open)


def framed(layout: L, spacing: int = 4) -> L:
    """Return the layout of a panel's body, with its margins."""
    layout.setSpacing(spacing)
    layout.setContentsMargins(8, 2, 8, 6)
    return layout


def in_row(*widgets: QWidget, spacing: int | None = None) -> QHBoxLayout:
    """Return a layout of widgets beside each other."""
    row = QHBoxLayout()
    if spacing is not None:
        row.setSpacing(spacing)
    for widget in widgets:
        row.addWidget(widget)
    return row


def choice(label: str) -> QComboBox:
    """Return a list to choose from; it takes the keyboard only when it is clicked or reached by Tab."""
    made = QComboBox()
    made.setAccessibleName(label)
    made.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    made.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
    made.setMinimumContentsLength(6)
    ScrollGuard(made)
    made.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    return made


def show_choice(made: QComboBox, names: Sequence[str] | Mapping[str, str], now: Any) -> None:
    """Show the choices, in a mapping each with its help, and the one in force; not while the list is open."""
    if made.view().isVisible():
        return
    helps = names if isinstance(names, Mapping) else dict.fromkeys(names, "")
    with QSignalBlocker(made):
        if [made.itemData(place) for place in range(made.count())] != list(helps):
            made.clear()
            for place, (name, tip) in enumerate(helps.items()):
                made.addItem(name or NOTHING, name)
                made.setItemData(place, tip, Qt.ItemDataRole.ToolTipRole)
        made.setCurrentIndex(made.findData(now))


def switch(text: str, tip: str = "") -> QCheckBox:
    """Return a box to check."""
    made = QCheckBox(text)
    made.setToolTip(tip)
    made.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    return made


def show_switch(made: QCheckBox, is_on: bool) -> None:
    """Show whether it is on, without emitting it."""
    with QSignalBlocker(made):
        made.setChecked(is_on)


def button(text: str, tip: str = "") -> QPushButton:
    """Return a button that leaves the keyboard to the window."""
    made = QPushButton(text)
    made.setToolTip(tip)
    made.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return made


def wrapped(name: str) -> QLabel:
    """Return a label of several lines, of a name in the style sheet."""
    made = QLabel("")
    made.setObjectName(name)
    made.setWordWrap(True)
    made.setMinimumWidth(1)
    return made


#: Text of the empty word in a list.
NOTHING = "none"
#: How long after the last change the value of a slider is emitted, milliseconds.
DELAY_MS = 250
#: Largest number that a box can have; its width with three digits after the point and that of one more, pixels.
MAX_BOX = 1e12
WIDTH = 74
DIGIT = 8


class Amount(QWidget):
    """A number on a slider and in a box, where it may be larger; optionally words that may stand for it.

    Parameters
    ----------
    shown : mapping of str to object
        Its ends, digits and words, as of `accelsurf.viewer.actions.settings_rows.amount`.
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
                ScrollGuard(part)
        self._delay = QTimer(self, singleShot=True, interval=DELAY_MS)
        self._delay.timeout.connect(self._emit)
        self.slider.valueChanged.connect(self._slid)
        self.slider.sliderReleased.connect(self._emit)
        self.box.valueChanged.connect(self._typed)

    @property
    def value(self) -> float | str:
        """Number, or the word that stands for it."""
        if self.word is not None and self.word.currentText() != "value":
            return self.word.currentText()
        return float(self.box.value())

    @property
    def is_being_moved(self) -> bool:
        """Test if the user is changing it now, so that it does not show the value in force."""
        return self.slider.isSliderDown() or self._delay.isActive() or self.box.hasFocus()

    def show_value(self, value: float | str) -> None:
        """Show the value in force, without emitting it."""
        blockers = [
            QSignalBlocker(part) for part in (self.slider, self.box, self.word) if part is not None
        ]
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


class Message(QLabel):
    """A message in as many lines as it takes: none of it is cut off."""

    def __init__(self) -> None:
        super().__init__("")
        self.setObjectName("message")
        self.setWordWrap(True)

    def say(self, text: str, failed: bool) -> None:
        """Show a text; of an error in another colour."""
        text = f"Error: {text}" if failed else text
        # Paths and settings have no blanks: lines may end in them too.
        self.setText(re.sub(r"(?<=[/_.,:=])(?=\S)|(?<=\S{20})(?=\S)", "\N{ZERO WIDTH SPACE}", text))
        self.setProperty("failed", failed)
        self.style().polish(self)
