"""The panel of settings: a widget for each row of the state, those that are not common folded by groups."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QGridLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.settings import SettingsFeature
from accelsurf.viewer.actions.settings_rows import Row
from accelsurf.viewer.window.section_panel import Amount, Section, button, choice, framed, in_row, show_choice, switch

#: Mark behind the name of a setting whose change begins another run.
RESTARTS = "\N{ANTICLOCKWISE OPEN CIRCLE ARROW}"
STICKS = "\N{NO-BREAK SPACE}"


class SettingRow(QWidget):
    """A setting with its name; `changed` has the value that was chosen.

    Parameters
    ----------
    row : dict
    """

    changed = Signal(object)

    def __init__(self, row: Row) -> None:
        super().__init__()
        again = "\nA change begins the run again from the start; clicks stay." if row["restarts"] else ""
        self.setToolTip(row["help"] + again)
        self.label = QLabel(titled(row))
        self.label.setWordWrap(True)
        self.label.setMinimumWidth(1)
        self._grid = QGridLayout(self)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self._grid.setSpacing(3)
        self._grid.setColumnStretch(0, 4)
        self._grid.setColumnStretch(1, 5)
        self._grid.addWidget(self.label, 0, 0)

    def show_row(self, row: Row) -> None:
        """Show the value in force, except where the person is changing it."""
        self.setEnabled(row["enabled"])


class SliderRow(SettingRow):
    """A number on a slider, below its name."""

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.amount = Amount(row)
        self.amount.changed.connect(lambda value: self.changed.emit(value))
        self._grid.addWidget(self.label, 0, 0, 1, 2)
        self._grid.addWidget(self.amount, 1, 0, 1, 2)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        if not self.amount.is_being_moved:
            self.amount.show_value(row["value"])


class ListRow(SettingRow):
    """Words to choose from, each with what it means."""

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.choice: QComboBox = choice(row["label"])
        self.choice.activated.connect(lambda _: self.changed.emit(self.choice.currentData()))
        self._grid.addWidget(self.choice, 0, 1)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        show_choice(self.choice, {choice["name"]: choice["help"] for choice in row["names"]}, row["value"])


class TextRow(SettingRow):
    """A line to type in; what an empty line means is shown in it."""

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.line = QLineEdit()
        self.line.setAccessibleName(row["label"])
        self.line.editingFinished.connect(self._typed)
        self.line.returnPressed.connect(self.line.clearFocus)  # keys are the window's again
        self._value = ""
        self._grid.addWidget(self.line, 0, 1)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        self.line.setPlaceholderText(row["now"])
        if not self.line.hasFocus() or self._value != row["value"]:
            self._value = row["value"]
            self.line.setText(row["value"])

    def _typed(self) -> None:
        if self.line.text().strip() != self._value:
            self.changed.emit(self.line.text().strip())
            self.line.setText(self._value)  # until the session has taken it


class SwitchRow(SettingRow):
    """A box to check."""

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.box: QCheckBox = switch("")
        self.box.setAccessibleName(row["label"])
        self.box.toggled.connect(lambda on: self.changed.emit(on))
        self._grid.addWidget(self.box, 0, 1, Qt.AlignmentFlag.AlignRight)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        with QSignalBlocker(self.box):
            self.box.setChecked(row["value"])


class EnergyRow(ListRow):
    """Named energies, a line to type an expression in, and what is wrong with what is typed."""

    typing = Signal(str)

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.line = QLineEdit()
        self.line.setAccessibleName("energy expression")
        self.line.setPlaceholderText("local-region:R=8 + 0.3*geodesic")
        self.line.textEdited.connect(self.typing)
        self.line.returnPressed.connect(self._entered)
        self.error = QLabel("")
        self.error.setObjectName("message")
        self.error.setProperty("failed", True)
        self.error.setWordWrap(True)
        self._grid.addWidget(self.line, 1, 0, 1, 2)
        self._grid.addWidget(self.error, 2, 0, 1, 2)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        if not self.line.hasFocus():
            self.line.setText(row["value"])

    def show_error(self, text: str) -> None:
        """Show what is wrong with what is typed; nothing for an empty text."""
        self.error.setText(text)
        self.error.setVisible(bool(text))

    def _entered(self) -> None:
        self.changed.emit(self.line.text())
        self.line.clearFocus()


class FileRow(ListRow):
    """Files that are offered, and a button to choose another."""

    def __init__(self, row: Row) -> None:
        super().__init__(row)
        self.other: QPushButton = button("...", "Another file")
        self.other.setFixedWidth(30)
        self._grid.addWidget(self.other, 0, 2)


def row_widget(row: Row) -> SettingRow:
    """Return the widget of a row."""
    kinds: dict[str, Callable[[Row], SettingRow]] = {
        "slider": SliderRow, "list": ListRow, "text": TextRow, "switch": SwitchRow, "energy": EnergyRow,
        "file": FileRow,
    }
    return kinds[row["kind"]](row)


def titled(row: Row) -> str:
    """The name of a row, with its unit and the mark of what begins another run."""
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
        What is folded, by the group of the help.
    """

    def __init__(self, actions: Actions) -> None:
        super().__init__("Settings", actions)
        whole = framed(QVBoxLayout(self.body), 5)
        self._first = QVBoxLayout()
        whole.addLayout(self._first)
        tip = "The run is made in a box around what there is now"
        self.around = self.button("Box around object", tip, "box_around")
        self.no_box = self.button("No box", "The run is made in the whole image", "box_none")
        whole.addLayout(in_row(self.around, self.no_box))
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
            if isinstance(widget, EnergyRow):
                widget.show_error(state["energy_error"])
        self.no_box.setEnabled(state["has_box"])

    def _build(self, rows: list[Row]) -> None:
        """Make the widgets that are missing, and remove those of terms that the energy has no longer."""
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
            title = f"More: {group[:1].lower()}{group[1:]}"
            self.groups[group] = folded = Section(title, self.user_actions, folded=True)
            framed(QVBoxLayout(folded.body), 5)
            self._whole.addWidget(folded)
        layout = self.groups[group].body.layout()
        assert isinstance(layout, QVBoxLayout)
        return layout

    def _made(self, row: Row) -> SettingRow:
        widget = row_widget(row)
        if row["term"]:
            widget.changed.connect(lambda value, term=row["term"]: self.ask("set_term", *term, value))
        elif isinstance(widget, FileRow):
            widget.changed.connect(lambda value: self.ask("mask", value))
            widget.other.clicked.connect(self._choose_mask)
        else:
            widget.changed.connect(functools.partial(self.ask, "set", row["key"]))
        if isinstance(widget, EnergyRow):
            widget.typing.connect(lambda text: self.ask("type_energy", text))
        return widget

    def _choose_mask(self) -> None:
        name, _ = QFileDialog.getOpenFileName(self, "Label map on the grid of the image")
        if name:
            self.user_actions.feature(SettingsFeature).use_mask(Path(name))
