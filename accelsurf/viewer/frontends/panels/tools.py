"""The panel of tools: what the left button does, and how large its ball is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtWidgets import QButtonGroup, QGridLayout, QLabel, QPushButton

from accelsurf.viewer.frontends.panels.amount import Amount
from accelsurf.viewer.frontends.panels.section import Section, button
from accelsurf.viewer.workplace.workplace import Workplace

#: Buttons beside each other.
IN_ROW = 4


class ToolsPanel(Section):
    """A button for each tool."""

    def __init__(self, workplace: Workplace) -> None:
        super().__init__("Mouse", workplace)
        grid = QGridLayout(self.body)
        grid.setSpacing(4)
        grid.setContentsMargins(8, 2, 8, 6)
        self._group = QButtonGroup(self)
        self.tools: dict[str, QPushButton] = {}
        for place, (name, tool) in enumerate(workplace.tools.items()):
            made = self.tools[name] = button(tool.text, f"{tool.tip} ({tool.key})")
            made.setCheckable(True)
            made.clicked.connect(lambda _, name=name: self.ask("tool", name))
            self._group.addButton(made)
            grid.addWidget(made, place // IN_ROW, place % IN_ROW)
        row = -(-len(self.tools) // IN_ROW)
        shown = workplace.state()["radius_row"]
        self.radius = Amount(shown)
        self.radius.changed.connect(lambda value: self.ask("set_radius", value))
        grid.addWidget(QLabel(f"Radius of click, ball and brush ({shown['unit']})"), row, 0, 1, IN_ROW)
        grid.addWidget(self.radius, row + 1, 0, 1, IN_ROW)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the tool in use, and its radius."""
        self.tools[state["tool"]].setChecked(True)
        if not self.radius.is_being_moved:
            self.radius.show_value(state["radius_row"]["value"])
