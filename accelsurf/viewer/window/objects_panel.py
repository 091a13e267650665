"""The panel of objects: a table of names, colours and volumes; the row that is selected takes corrections and sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QSignalBlocker, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QColorDialog,
    QGridLayout,
    QHeaderView,
    QLabel,
    QSlider,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
)

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.objects import NEAREST
from accelsurf.viewer.window.section_panel import (
    ScrollGuard,
    Section,
    button,
    framed,
    furnished,
)

Index = QModelIndex | QPersistentModelIndex
COLUMNS = ("", "", "Name", "Volume", "State")
_SEEN, _COLOR, _NAME, _VOLUME, _WORD = range(5)
#: Rows that are in sight at once, at most.
ROWS = 4


class _ColorCell(QStyledItemDelegate):
    """A cell whose colour is seen in a selected row too."""

    def initStyleOption(self, option: QStyleOptionViewItem, index: Index) -> None:
        """Draw it as if it were not selected."""
        super().initStyleOption(option, index)
        option.state &= ~QStyle.StateFlag.State_Selected


class ObjectsPanel(Section):
    """All objects. A double click renames one, one on its colour changes that."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Objects", actions)
        table = self.table = furnished(
            QTableWidget(0, len(COLUMNS)),
            accessibleName="objects",
            toolTip="The chosen object takes strokes and sizes; double click: rename, or another colour",
            selectionBehavior=QAbstractItemView.SelectionBehavior.SelectRows,
            focusPolicy=Qt.FocusPolicy.ClickFocus,
            itemChanged=self._edited,
            cellClicked=lambda row, _: self.ask("object_active", self._id(row)),
            cellDoubleClicked=self._double_clicked,
        )
        table.setHorizontalHeaderLabels(list(COLUMNS))
        table.verticalHeader().hide()
        header = table.horizontalHeader()
        header.setMinimumSectionSize(20)
        volume = table.fontMetrics().horizontalAdvance("888.8 mm3") + 18
        for column, width in {_SEEN: 22, _COLOR: 20, _VOLUME: volume, _WORD: 76}.items():
            header.setSectionResizeMode(column, QHeaderView.ResizeMode.Fixed)
            table.setColumnWidth(column, width)
        header.setSectionResizeMode(_NAME, QHeaderView.ResizeMode.Stretch)
        table.verticalHeader().setDefaultSectionSize(table.fontMetrics().lineSpacing() + 7)
        table.setItemDelegateForColumn(_COLOR, _ColorCell(table))
        self.add = self.button(
            "Add", "A further object: the next press or click inside begins it (U)", "object_add"
        )
        self.merge = button(
            "Merge",
            "Make the chosen objects the first of them (choose several with Ctrl)",
            clicked=lambda: self.ask("object_merge", *self._selected()),
        )
        self.remove = button("Remove", "Take the chosen object away", clicked=self._remove)
        tip = "Strokes are for the object that is nearest to where they begin"
        self.nearest = self.button("Nearest", tip, "object_active", NEAREST)
        self.opacity = furnished(
            QSlider(Qt.Orientation.Horizontal),
            accessibleName="opacity",
            maximum=100,
            valueChanged=self._set_opacity,
        )
        ScrollGuard(self.opacity)
        grid = framed(QGridLayout(self.body))
        grid.addWidget(table, 0, 0, 1, 4)
        for column, made in enumerate((self.add, self.merge, self.remove, self.nearest)):
            grid.addWidget(made, 1, column)
        grid.addWidget(QLabel("Opacity"), 2, 0)
        grid.addWidget(self.opacity, 2, 1, 1, 3)
        self._rows: list[dict[str, Any]] = []
        self._active = 0
        #: Typed text may not be taken: the known rows are shown again.
        self._is_typed = False

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the objects, and which one is active."""
        rows, active = state["object_rows"], state["object_active"]
        is_typing = self.table.state() == QAbstractItemView.State.EditingState
        if is_typing or ((rows, active) == (self._rows, self._active) and not self._is_typed):
            return
        self._is_typed = False
        selected, moved = self._selected(), active != self._active
        self._rows, self._active = rows, active
        with QSignalBlocker(self.table):
            self.table.setRowCount(len(rows))
            self.table.setFixedHeight(
                (min(len(rows), ROWS) + 1) * (self.table.fontMetrics().lineSpacing() + 9)
            )
            for place, row in enumerate(rows):
                self._fill(place, row)
            # With Ctrl several are selected, of which the last one is active.
            self._choose({active} if moved and active not in selected else set(selected))
        shown = next((row for row in rows if row["id"] == active), rows[0])
        with QSignalBlocker(self.opacity):
            self.opacity.setValue(round(100 * shown["opacity"]))

    def _fill(self, place: int, row: Mapping[str, Any]) -> None:
        """Write a row of the table."""
        texts = {
            _SEEN: "",
            _COLOR: "",
            _NAME: row["name"],
            _VOLUME: row["volume"],
            _WORD: row["word"],
        }
        for column, text in texts.items():
            item = self.table.item(place, column)
            if item is None:
                item = QTableWidgetItem()
                self.table.setItem(place, column, item)
            item.setText(text)
            flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
            if column == _SEEN:
                item.setCheckState(
                    Qt.CheckState.Checked if row["visible"] else Qt.CheckState.Unchecked
                )
                item.setToolTip("Whether it is drawn")
                flags |= Qt.ItemFlag.ItemIsUserCheckable
            if column == _COLOR:
                item.setBackground(QColor(row["color"]))
                item.setToolTip("Double click: another colour")
            if column == _NAME:
                flags |= Qt.ItemFlag.ItemIsEditable
                font = item.font()
                font.setBold(row["id"] == self._active)
                item.setFont(font)
                item.setToolTip(f"object {row['id']}, {row['voxels']} voxels")
            item.setFlags(flags)

    def _choose(self, ids: set[int]) -> None:
        self.table.clearSelection()
        model = self.table.selectionModel()
        for place, row in enumerate(self._rows):
            if row["id"] in ids:
                index = self.table.model().index(place, _NAME)
                model.select(index, model.SelectionFlag.Select | model.SelectionFlag.Rows)

    def _id(self, row: int) -> int:
        return int(self._rows[row]["id"])

    def _selected(self) -> list[int]:
        """Ids of the selected rows, in their order."""
        places = sorted(index.row() for index in self.table.selectionModel().selectedRows())
        return [self._id(place) for place in places if place < len(self._rows)]

    def _edited(self, item: QTableWidgetItem) -> None:
        """A name was typed, or a box checked."""
        if item.column() == _NAME:
            self.ask("object_name", self._id(item.row()), item.text())
        elif item.column() == _SEEN:
            self.ask(
                "object_visible", self._id(item.row()), item.checkState() == Qt.CheckState.Checked
            )
        self._is_typed = True

    def _double_clicked(self, row: int, column: int) -> None:
        if column == _COLOR:
            color = QColorDialog.getColor(
                QColor(self._rows[row]["color"]), self, "Colour of the object"
            )
            if color.isValid():
                self.ask("object_color", self._id(row), color.name())

    def _set_opacity(self, percent: int) -> None:
        if self._rows:
            self.ask("object_opacity", self._active or self._id(0), percent / 100)

    def _remove(self) -> None:
        for object_id in self._selected():
            self.ask("object_remove", object_id)
