"""A panel that folds, and the widgets that several panels use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QCheckBox, QComboBox, QPushButton, QSizePolicy, QToolButton, QVBoxLayout, QWidget

from accelsurf.viewer.frontends.panels.wheel import WheelGuard
from accelsurf.viewer.workplace.workplace import Workplace


class Section(QWidget):
    """A panel with a title; a click on the title folds it.

    Parameters
    ----------
    title : str
    workplace : Workplace
    folded : bool, optional
        At first.

    Attributes
    ----------
    body : QWidget
        What folds away; a panel puts its widgets into its layout.
    """

    def __init__(self, title: str, workplace: Workplace, folded: bool = False) -> None:
        super().__init__()
        self.workplace = workplace
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
        """Show what the workplace says."""

    def ask(self, name: str, *values: Any) -> None:
        """Ask the workplace."""
        self.workplace.request(name, *values)

    def _fold(self, is_open: bool) -> None:
        self.title.setArrowType(Qt.ArrowType.DownArrow if is_open else Qt.ArrowType.RightArrow)
        self.body.setVisible(is_open)


def choice(names: Sequence[str] = (), label: str = "") -> QComboBox:
    """Return a list to choose from; it takes the keyboard only when it is clicked or reached by Tab."""
    made = QComboBox()
    made.addItems(list(names))
    made.setAccessibleName(label)
    made.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    made.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
    made.setMinimumContentsLength(6)
    WheelGuard(made)
    made.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    return made


def show_choice(made: QComboBox, names: Sequence[str], now: str) -> None:
    """Show what can be chosen and what is, without emitting it; not while the list is open."""
    if made.view().isVisible():
        return
    with QSignalBlocker(made):
        if [made.itemText(place) for place in range(made.count())] != list(names):
            made.clear()
            made.addItems(list(names))
        made.setCurrentIndex(made.findText(now))


def switch(text: str, tip: str = "") -> QCheckBox:
    """Return a box to check."""
    made = QCheckBox(text)
    made.setToolTip(tip)
    made.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    return made


def show_switch(made: QCheckBox, on: bool) -> None:
    """Show whether it is on, without emitting it."""
    with QSignalBlocker(made):
        made.setChecked(on)


def button(text: str, tip: str = "") -> QPushButton:
    """Return a button that leaves the keyboard to the window."""
    made = QPushButton(text)
    made.setToolTip(tip)
    made.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return made
