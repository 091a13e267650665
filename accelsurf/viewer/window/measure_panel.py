"""The panel of measures: the figures of the objects, and what was drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.window.section_panel import Section, framed, in_row

#: Lines of a table that are seen without scrolling.
LINES = 10


class MeasurePanel(Section):
    """Tables of the objects and of lengths and angles, and buttons to copy and save them."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Measures", actions, folded=True)
        tip = "Volume, surface, intensity and diameters of each object as it is now"
        self.measure = self.button("Measure", tip, "measure_table")
        tip = "Draw the largest diameter, the one across, and both in the axial slice"
        self.diameters = self.button("Diameters", tip, "measure_diameters")
        self.copy = self.button("Copy", "Copy the tables, with tabs between the columns", "measure_copy")
        self.save = self.button("CSV", "Save the tables in the folder of the run", "measure_save")
        tip = "Delete all lengths and angles (one: choose its line, press Delete)"
        self.clear = self.button("Clear", tip, "measure_clear")
        self.step = QLabel("")
        self.objects, self.drawn = _table("figures of the objects"), _table("lengths and angles")
        delete = QAction(self.drawn, shortcut=QKeySequence("Delete"))
        delete.setShortcutContext(Qt.ShortcutContext.WidgetShortcut)
        delete.triggered.connect(self._delete)
        self.drawn.addAction(delete)
        column = framed(QVBoxLayout(self.body))
        column.addLayout(in_row(self.measure, self.diameters, spacing=4))
        column.addWidget(self.step)
        column.addWidget(self.objects)
        column.addWidget(self.drawn)
        column.addLayout(in_row(self.copy, self.save, self.clear, spacing=4))
        self._shown: dict[str, Any] = {}

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the tables."""
        shown = {key: state[key] for key in ("figures", "measurements", "figures_step", "figures_current")}
        self.measure.setEnabled(state["ready"] and not state["measuring"])
        self.diameters.setEnabled(state["ready"])
        if shown == self._shown:
            return
        lines, drawn = state["figures"], state["measurements"]
        if lines != self._shown.get("figures"):
            _fill(self.objects, lines)
        if drawn != self._shown.get("measurements"):
            _fill(self.drawn, [["", "kind", "value"], *([str(number), kind, text] for number, kind, text in drawn)])
            self.drawn.setVisible(bool(drawn))
        self._shown = shown
        other = "" if state["figures_current"] else ", not the one shown"
        self.step.setText(f"of step {state['figures_step']}{other}")
        self.step.setVisible(bool(lines))
        for made in (self.copy, self.save):
            made.setEnabled(bool(lines or drawn))
        self.clear.setEnabled(bool(drawn))

    def _delete(self) -> None:
        for place in {index.row() for index in self.drawn.selectedIndexes()}:
            self.ask("measure_delete", self._shown["measurements"][place][0])


def _table(name: str) -> QTableWidget:
    made = QTableWidget(0, 0)
    made.setAccessibleName(name)
    made.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    made.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    made.verticalHeader().hide()
    made.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    made.horizontalHeader().setStretchLastSection(True)
    made.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
    made.hide()
    return made


def _fill(made: QTableWidget, lines: Sequence[Sequence[str]]) -> None:
    """Show lines, the first of which names the columns."""
    made.setRowCount(max(len(lines) - 1, 0))
    made.setColumnCount(len(lines[0]) if lines else 0)
    for row, cells in enumerate(lines):
        for column, text in enumerate(cells):
            if row:
                made.setItem(row - 1, column, QTableWidgetItem(text))
            else:
                made.setHorizontalHeaderItem(column, QTableWidgetItem(text))
    made.resizeRowsToContents()
    height = made.horizontalHeader().sizeHint().height() + sum(
        made.rowHeight(row) for row in range(min(made.rowCount(), LINES))
    )
    made.setFixedHeight(height + 18)
    made.setVisible(bool(lines))
