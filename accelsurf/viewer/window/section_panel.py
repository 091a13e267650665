"""A panel that folds, and the widgets that several panels use: buttons, lists, numbers on sliders, lines of text."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from PySide6.QtCore import QEvent, QMargins, QObject, QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import (
    QBoxLayout,
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
Q = TypeVar("Q", bound=QObject)


def furnished(thing: Q, **properties: Any) -> Q:
    """Return a widget, layout or action of Qt with these properties; a callable is connected to the signal of its name.

    Properties are set in their order.

    Raises
    ------
    AttributeError
        When Qt knows no property or signal of a name.

    Examples
    --------
    >>> furnished(QObject(), objectName="tip").objectName()
    'tip'
    """
    for name, value in properties.items():
        if callable(value):
            getattr(thing, name).connect(value)
        elif not thing.setProperty(name, value):
            raise AttributeError(f"{type(thing).__name__} has no property {name}")
    return thing


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
        self.title = furnished(
            QToolButton(),
            objectName="section",
            text=title,
            checkable=True,
            checked=not folded,
            toolButtonStyle=Qt.ToolButtonStyle.ToolButtonTextBesideIcon,
            sizePolicy=_WIDE,
            focusPolicy=Qt.FocusPolicy.TabFocus,
            toggled=self._fold,
        )
        self.body = QWidget()
        filled(bare(QVBoxLayout(self), 2), self.title, self.body)
        self._fold(not folded)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""

    def ask(self, name: str, *values: Any) -> None:
        """Make a request."""
        self.user_actions.request(name, *values)

    def button(self, text: str, tip: str, request: str, *values: Any) -> QPushButton:
        """Return a button that makes a request."""
        return button(text, tip, clicked=lambda: self.ask(request, *values))

    def switch(self, text: str, request: str, tip: str = "") -> QCheckBox:
        """Return a box to check that makes a request."""
        return switch(text, tip, toggled=lambda is_on: self.ask(request, is_on))

    def choice(self, label: str, request: str) -> QComboBox:
        """Return a list to choose from that makes a request."""
        return choice(label, textActivated=lambda name: self.ask(request, name))

    def _fold(self, is_open: bool) -> None:
        self.title.setArrowType(Qt.ArrowType.DownArrow if is_open else Qt.ArrowType.RightArrow)
        self.body.setVisible(is_open)


#: Wide as the panel, and as high as its text.
_WIDE = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)


def framed(layout: L, spacing: int = 4) -> L:
    """Return the layout of a panel's body, with its margins."""
    return furnished(layout, spacing=spacing, contentsMargins=QMargins(8, 2, 8, 6))


def bare(layout: L, spacing: int) -> L:
    """Return a layout without margins."""
    return furnished(layout, spacing=spacing, contentsMargins=QMargins(0, 0, 0, 0))


def filled(layout: L, *parts: QWidget | QLayout) -> L:
    """Return a layout in a line with these parts one after the other."""
    assert isinstance(layout, QBoxLayout)
    for part in parts:
        if isinstance(part, QWidget):
            layout.addWidget(part)
        else:
            layout.addLayout(part)
    return layout


def in_row(*widgets: QWidget, spacing: int | None = None) -> QHBoxLayout:
    """Return a layout of widgets beside each other."""
    row = QHBoxLayout()
    return filled(row if spacing is None else furnished(row, spacing=spacing), *widgets)


def choice(label: str, **properties: Any) -> QComboBox:
    """Return a list to choose from; it takes the keyboard only when it is clicked or reached by Tab."""
    made = furnished(
        QComboBox(),
        accessibleName=label,
        focusPolicy=Qt.FocusPolicy.TabFocus,
        sizePolicy=_WIDE,
        minimumContentsLength=6,
        sizeAdjustPolicy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
    )
    ScrollGuard(made)
    return furnished(made, **properties)


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


def switch(text: str, tip: str = "", **properties: Any) -> QCheckBox:
    """Return a box to check."""
    made = furnished(QCheckBox(text), toolTip=tip, focusPolicy=Qt.FocusPolicy.TabFocus)
    return furnished(made, **properties)


def show_switch(made: QCheckBox, is_on: bool) -> None:
    """Show whether it is on, without emitting it."""
    with QSignalBlocker(made):
        made.setChecked(is_on)


def button(text: str, tip: str = "", **properties: Any) -> QPushButton:
    """Return a button that leaves the keyboard to the window."""
    made = furnished(QPushButton(text), toolTip=tip, focusPolicy=Qt.FocusPolicy.NoFocus)
    return furnished(made, **properties)


def made_action(parent: QObject, text: str, key: str, work: Callable[[], Any]) -> QAction:
    """Return an action of a menu or window, with a key where that is not empty."""
    return furnished(
        QAction(text, parent), shortcut=QKeySequence(key), triggered=lambda _=False: work()
    )


def wrapped(name: str) -> QLabel:
    """Return a label of several lines, of a name in the style sheet."""
    return furnished(QLabel(), objectName=name, wordWrap=True, minimumWidth=1)


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
        self.slider = furnished(
            QSlider(Qt.Orientation.Horizontal),
            maximum=TICKS,
            pageStep=TICKS // 10,
            minimumWidth=70,
            valueChanged=self._slid,
            sliderReleased=self._emit,
        )
        self.box = furnished(
            QDoubleSpinBox(),
            decimals=shown["digits"],
            minimum=low,
            maximum=min(shown["limit"], MAX_BOX),
            singleStep=(high - low) / 20,
            keyboardTracking=False,
            valueChanged=self._typed,
        )
        self.box.setFixedWidth(WIDTH + DIGIT * max(shown["digits"] - 3, 0))
        self.word: QComboBox | None = None
        line = bare(QHBoxLayout(self), 4)
        if shown["words"]:
            self.word = furnished(QComboBox(), activated=lambda _: self._on_word())
            self.word.addItems([*shown["words"], "value"])
            self.word.setFixedWidth(66)
            line.addWidget(self.word)
        line.addWidget(self.slider, 1)
        line.addWidget(self.box)
        self._parts = [part for part in (self.slider, self.box, self.word) if part is not None]
        for part in self._parts:
            ScrollGuard(part)
        self._delay = furnished(
            QTimer(self), singleShot=True, interval=DELAY_MS, timeout=self._emit
        )

    @property
    def value(self) -> float | str:
        """Number, or the word that stands for it."""
        words = "value" if self.word is None else self.word.currentText()
        return float(self.box.value()) if words == "value" else words

    @property
    def is_being_moved(self) -> bool:
        """Test if the user is changing it now, so that it does not show the value in force."""
        return self.slider.isSliderDown() or self._delay.isActive() or self.box.hasFocus()

    def show_value(self, value: float | str) -> None:
        """Show the value in force, without emitting it."""
        blockers = [QSignalBlocker(part) for part in self._parts]
        if self.word is not None:
            self.word.setCurrentText(value if isinstance(value, str) else "value")
        if not isinstance(value, str):
            self.box.setValue(float(value))
            self.slider.setValue(self._tick(float(value)))
        self._enable()
        del blockers

    def _enable(self) -> None:
        numeric = not isinstance(self.value, str)
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
        if not isinstance(self.value, str) and self.box.value() <= 0:
            self.box.setValue(0.25 * self._high)
        self._emit()

    def _emit(self) -> None:
        self._delay.stop()
        self.changed.emit(self.value)


class Message(QLabel):
    """A message in as many lines as it takes: none of it is cut off."""

    def __init__(self) -> None:
        super().__init__("")
        furnished(self, objectName="message", wordWrap=True)

    def say(self, text: str, failed: bool) -> None:
        """Show a text; of an error in another colour."""
        text = f"Error: {text}" if failed else text
        # Paths and settings have no blanks: lines may end in them too.
        self.setText(re.sub(r"(?<=[/_.,:=])(?=\S)|(?<=\S{20})(?=\S)", "\N{ZERO WIDTH SPACE}", text))
        restyle(self, "failed", failed)


def restyle(widget: QWidget, name: str, value: object) -> None:
    """Change a property that the style sheet asks for, and draw the widget accordingly."""
    if widget.property(name) != value:
        widget.setProperty(name, value)
        widget.style().polish(widget)
