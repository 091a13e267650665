"""The widgets of one setting, made from its row; see `accelsurf.viewer.workplace.settings_rows`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout, QWidget

from accelsurf.viewer.frontends.panels.amount import Amount
from accelsurf.viewer.frontends.panels.section import button, choice, switch
from accelsurf.viewer.workplace.settings_rows import Row

#: What a list shows for the empty word; and behind the name of a setting whose change begins another run.
NOTHING, RESTARTS = "none", "\N{ANTICLOCKWISE OPEN CIRCLE ARROW}"
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
        self.choice: QComboBox = choice(label=row["label"])
        self.choice.activated.connect(lambda _: self.changed.emit(self.choice.currentData()))
        self._grid.addWidget(self.choice, 0, 1)

    def show_row(self, row: Row) -> None:
        super().show_row(row)
        show_names(self.choice, row["names"], row["value"])


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


def show_names(made: QComboBox, names: Sequence[dict[str, str]], value: Any) -> None:
    """Show what can be chosen, with its help, and what is; not while the list is open."""
    if made.view().isVisible():
        return
    with QSignalBlocker(made):
        if [made.itemData(place) for place in range(made.count())] != [one["name"] for one in names]:
            made.clear()
            for one in names:
                made.addItem(one["name"] or NOTHING, one["name"])
                made.setItemData(made.count() - 1, one["help"], Qt.ItemDataRole.ToolTipRole)
        made.setCurrentIndex(made.findData(value))


def column(parent: QWidget) -> QVBoxLayout:
    """Return the layout of a panel's body with rows below each other."""
    made = QVBoxLayout(parent)
    made.setSpacing(5)
    made.setContentsMargins(8, 2, 8, 6)
    return made
