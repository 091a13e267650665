"""The panel of settings: a widget for each row of the state, those that are not common folded by groups."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGridLayout,
    QLabel,
    QLineEdit,
    QVBoxLayout,
    QWidget,
)

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.settings_rows import Row
from accelsurf.viewer.window.section_panel import (
    Amount,
    Section,
    bare,
    choice,
    framed,
    furnished,
    show_choice,
    show_switch,
    switch,
)

#: Mark behind the name of a setting whose change begins another run.
RESTARTS = "\N{ANTICLOCKWISE OPEN CIRCLE ARROW}"
STICKS = "\N{NO-BREAK SPACE}"


class SettingRow(QWidget):
    """A setting: its name, and the widgets of its kind, see `settings_rows`; other widgets are None.

    Parameters
    ----------
    row : dict

    Attributes
    ----------
    amount : Amount or None
        Of a number on a slider.
    box : QCheckBox or None
        Of a switch.
    choice : QComboBox or None
        Words, energies or files to choose from.
    other : QPushButton or None
        To choose a file that is not offered.
    line : QLineEdit or None
        To type a text in, or the expression of an energy.
    error : QLabel or None
        Error of the expression that is typed.
    changed, typing : Signal
        With the value that was selected; with each text on the way to an expression.
    """

    changed, typing = Signal(object), Signal(str)

    def __init__(self, row: Row) -> None:
        super().__init__()
        again = (
            "\nA change begins the run again from the start; clicks stay."
            if row["restarts"]
            else ""
        )
        self.setToolTip(row["help"] + again)
        self.label = furnished(QLabel(titled(row)), wordWrap=True, minimumWidth=1)
        self.amount: Amount | None = None
        self.box: QCheckBox | None = None
        self.choice: QComboBox | None = None
        self.line: QLineEdit | None = None
        self.error: QLabel | None = None
        kind, name = row["kind"], row["label"]
        self._value = ""
        grid = bare(QGridLayout(self), 3)
        grid.setColumnStretch(0, 4)
        grid.setColumnStretch(1, 5)
        grid.addWidget(self.label, 0, 0, 1, 2 if kind == "slider" else 1)
        if kind == "slider":  # below the name
            self.amount = furnished(Amount(row), changed=self.changed.emit)
            grid.addWidget(self.amount, 1, 0, 1, 2)
        elif kind == "switch":
            self.box = switch("", accessibleName=name, toggled=self.changed.emit)
            grid.addWidget(self.box, 0, 1, Qt.AlignmentFlag.AlignRight)
        elif kind == "text":
            self.line = furnished(QLineEdit(), accessibleName=name, editingFinished=self._typed)
            grid.addWidget(self.line, 0, 1)
        else:
            made = self.choice = choice(name)
            made.activated.connect(lambda _: self.changed.emit(made.currentData()))
            grid.addWidget(made, 0, 1)
        if kind == "energy":
            self._add_energy(grid)
        if self.line is not None:
            self.line.returnPressed.connect(self.line.clearFocus)  # keys are the window's again

    def _add_energy(self, grid: QGridLayout) -> None:
        """Add the line in which an energy is typed, and its error."""
        line = self.line = furnished(
            QLineEdit(),
            accessibleName="energy expression",
            placeholderText="local-region:R=8 + 0.3*geodesic",
            textEdited=self.typing,
        )
        line.returnPressed.connect(lambda: self.changed.emit(line.text()))
        self.error = furnished(QLabel(), objectName="message", wordWrap=True)
        self.error.setProperty("failed", True)
        grid.addWidget(line, 1, 0, 1, 2)
        grid.addWidget(self.error, 2, 0, 1, 2)

    def show_row(self, row: Row) -> None:
        """Show the value in force, except where the person is changing it."""
        self.setEnabled(row["enabled"])
        value = row["value"]
        if self.amount is not None and not self.amount.is_being_moved:
            self.amount.show_value(value)
        if self.box is not None:
            show_switch(self.box, value)
        if self.choice is not None:
            show_choice(
                self.choice, {choice["name"]: choice["help"] for choice in row["names"]}, value
            )
        if self.line is not None:
            if self.error is None:
                self.line.setPlaceholderText(row["now"])  # the meaning of an empty line
            if not self.line.hasFocus() or (self.error is None and self._value != value):
                self._value = value
                self.line.setText(value)

    def show_error(self, text: str) -> None:
        """Show the error of the expression that is typed; nothing for an empty text."""
        if self.error is not None:
            self.error.setText(text)
            self.error.setVisible(bool(text))

    def _typed(self) -> None:
        line = self.line
        if line is not None and line.text().strip() != self._value:
            self.changed.emit(line.text().strip())
            line.setText(self._value)  # until the session has taken it


def titled(row: Row) -> str:
    """Return the name of a row, with its unit and the mark of a setting that begins another run."""
    unit = f" ({row['unit']})" if row["unit"] else ""
    # The mark never stands alone in a second line.
    return f"{row['label']}{unit}{f'{STICKS}{RESTARTS}' if row['restarts'] else ''}"


class SettingsPanel(Section):
    """A widget for each row of the state.

    Attributes
    ----------
    rows : dict of str to SettingRow
        By the key of the setting, in their order.
    groups : dict of str to Section
        Folded sections, by the group of the help.
    """

    def __init__(self, actions: Actions) -> None:
        super().__init__("Settings", actions)
        self._whole = framed(QVBoxLayout(self.body), 5)
        self._layouts = {"": QVBoxLayout()}  # the common ones have no name
        self._whole.addLayout(self._layouts[""])
        self.rows: dict[str, SettingRow] = {}
        self.groups: dict[str, Section] = {}
        self._shown: list[Row] = []

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the settings in force, except where the person is changing one."""
        rows = state["settings"]
        if rows is not self._shown:
            self._shown = rows
            if [row["key"] for row in rows] != list(self.rows):
                self._build(rows)
            for row in rows:
                self.rows[row["key"]].show_row(row)
        for widget in self.rows.values():
            widget.show_error(state["energy_error"])

    def _build(self, rows: list[Row]) -> None:
        """Make the widgets that are missing, and remove widgets of former terms of the energy."""
        wanted = [row["key"] for row in rows]
        for key in [key for key in self.rows if key not in wanted]:
            self.rows.pop(key).deleteLater()
        for row in rows:
            if row["key"] not in self.rows:
                self.rows[row["key"]] = self._made(row)
        self.rows = {key: self.rows[key] for key in wanted}
        for row in reversed(rows):
            self._layout_of(row["group"]).insertWidget(0, self.rows[row["key"]])

    def _layout_of(self, group: str) -> QVBoxLayout:
        """Return the layout of a group's rows."""
        if group not in self._layouts:
            self.groups[group] = folded = Section(group, self.user_actions, folded=True)
            self._layouts[group] = framed(QVBoxLayout(folded.body), 5)
            self._whole.addWidget(folded)
        return self._layouts[group]

    def _made(self, row: Row) -> SettingRow:
        widget = SettingRow(row)
        request = ("set_term", *row["term"]) if row["term"] else ("set", row["key"])
        widget.changed.connect(functools.partial(self.ask, *request))
        widget.typing.connect(lambda text: self.ask("type_energy", text))
        return widget
