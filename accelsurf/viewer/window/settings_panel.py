"""The panel of settings: a widget for each row of the state, those that are not common folded by groups."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
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
    choice,
    framed,
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
        self.label = QLabel(titled(row))
        self.label.setWordWrap(True)
        self.label.setMinimumWidth(1)
        self._value, kind = "", row["kind"]
        self.amount = Amount(row) if kind == "slider" else None
        self.box = switch("") if kind == "switch" else None
        self.choice = choice(row["label"]) if kind in ("list", "energy") else None
        self.line = QLineEdit() if kind in ("text", "energy") else None
        self.error = QLabel("") if kind == "energy" else None
        self._lay_out()
        self._connect(row["label"])

    def _lay_out(self) -> None:
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(3)
        grid.setColumnStretch(0, 4)
        grid.setColumnStretch(1, 5)
        grid.addWidget(self.label, 0, 0, 1, 1 if self.amount is None else 2)
        if self.amount is not None:  # below the name
            grid.addWidget(self.amount, 1, 0, 1, 2)
        if self.box is not None:
            grid.addWidget(self.box, 0, 1, Qt.AlignmentFlag.AlignRight)
        if self.choice is not None:
            grid.addWidget(self.choice, 0, 1)
        if self.line is not None and self.error is None:
            grid.addWidget(self.line, 0, 1)
        elif self.line is not None and self.error is not None:
            self.error.setObjectName("message")
            self.error.setProperty("failed", True)
            self.error.setWordWrap(True)
            grid.addWidget(self.line, 1, 0, 1, 2)
            grid.addWidget(self.error, 2, 0, 1, 2)

    def _connect(self, name: str) -> None:
        if self.amount is not None:
            self.amount.changed.connect(lambda value: self.changed.emit(value))
        if self.box is not None:
            self.box.setAccessibleName(name)
            self.box.toggled.connect(lambda on: self.changed.emit(on))
        if self.choice is not None:
            self.choice.activated.connect(
                lambda _, made=self.choice: self.changed.emit(made.currentData())
            )
        if self.line is not None and self.error is None:
            self.line.setAccessibleName(name)
            self.line.editingFinished.connect(functools.partial(self._typed, self.line))
        elif self.line is not None:
            self.line.setAccessibleName("energy expression")
            self.line.setPlaceholderText("local-region:R=8 + 0.3*geodesic")
            self.line.textEdited.connect(self.typing)
            self.line.returnPressed.connect(lambda line=self.line: self.changed.emit(line.text()))
        if self.line is not None:
            self.line.returnPressed.connect(self.line.clearFocus)  # keys are the window's again

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

    def _typed(self, line: QLineEdit) -> None:
        if line.text().strip() != self._value:
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
        whole = framed(QVBoxLayout(self.body), 5)
        self._first = QVBoxLayout()
        whole.addLayout(self._first)
        self.rows: dict[str, SettingRow] = {}
        self.groups: dict[str, Section] = {}
        self._whole = whole
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
        places: dict[str, int] = {}
        for row in rows:
            group, place = row["group"], places.get(row["group"], 0)
            self._layout_of(group).insertWidget(place, self.rows[row["key"]])
            places[group] = place + 1

    def _layout_of(self, group: str) -> QVBoxLayout:
        """Return the layout of a group's rows; the group of the common ones has no name."""
        if not group:
            return self._first
        if group not in self.groups:
            self.groups[group] = folded = Section(group, self.user_actions, folded=True)
            framed(QVBoxLayout(folded.body), 5)
            self._whole.addWidget(folded)
        layout = self.groups[group].body.layout()
        assert isinstance(layout, QVBoxLayout)
        return layout

    def _made(self, row: Row) -> SettingRow:
        widget = SettingRow(row)
        if row["term"]:
            widget.changed.connect(
                lambda value, term=row["term"]: self.ask("set_term", *term, value)
            )
        else:
            widget.changed.connect(functools.partial(self.ask, "set", row["key"]))
        widget.typing.connect(lambda text: self.ask("type_energy", text))
        return widget
