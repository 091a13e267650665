"""The panel of settings: the common ones, and the others folded by the groups of the help."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog, QHBoxLayout, QVBoxLayout

from accelsurf.viewer.frontends.panels.section import Section, button
from accelsurf.viewer.frontends.panels.setting_row import EnergyRow, FileRow, SettingRow, column, row_widget
from accelsurf.viewer.workplace.settings import SettingsFeature
from accelsurf.viewer.workplace.settings_rows import Row
from accelsurf.viewer.workplace.workplace import Workplace


class SettingsPanel(Section):
    """A widget for each row of the state.

    Attributes
    ----------
    rows : dict of str to SettingRow
        By the key of the setting, in their order.
    groups : dict of str to Section
        What is folded, by the group of the help.
    """

    def __init__(self, workplace: Workplace) -> None:
        super().__init__("Settings", workplace)
        whole = column(self.body)
        self._first = QVBoxLayout()
        whole.addLayout(self._first)
        boxes = QHBoxLayout()
        self.around = button("Box around object", "The run is made in a box around what there is now")
        self.around.clicked.connect(lambda: self.ask("box_around"))
        self.no_box = button("No box", "The run is made in the whole image")
        self.no_box.clicked.connect(lambda: self.ask("box_none"))
        for one in (self.around, self.no_box):
            boxes.addWidget(one)
        whole.addLayout(boxes)
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
        """Where the rows of a group are; that of the common ones has no name."""
        if not group:
            return self._first
        if group not in self.groups:
            self.groups[group] = folded = Section(f"More: {group[:1].lower()}{group[1:]}", self.workplace, folded=True)
            column(folded.body)
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
            self.workplace.feature(SettingsFeature).use_mask(Path(name))
