"""The panels beside the scene: tools, and all others below."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QButtonGroup, QGridLayout, QLabel, QPushButton, QScrollArea, QVBoxLayout, QWidget

from accelsurf.viewer.frontends.panels.histogram import HistogramPanel
from accelsurf.viewer.frontends.panels.history import ChangesBar, HistoryPanel
from accelsurf.viewer.frontends.panels.measure import MeasurePanel
from accelsurf.viewer.frontends.panels.objects import ObjectsPanel
from accelsurf.viewer.frontends.panels.section import Amount, Section, framed
from accelsurf.viewer.frontends.panels.settings import SettingsPanel
from accelsurf.viewer.frontends.panels.slices import PicturePanel, SlicesPanel
from accelsurf.viewer.workplace.workplace import Actions

#: Buttons beside each other.
IN_ROW = 4


class ToolsPanel(Section):
    """A button for each tool."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Mouse", actions)
        grid = framed(QGridLayout(self.body))
        self._group = QButtonGroup(self)
        self.tools: dict[str, QPushButton] = {}
        for place, (name, tool) in enumerate(actions.tools.items()):
            made = self.tools[name] = self.button(tool.text, f"{tool.tip} ({tool.key})", "tool", name)
            made.setCheckable(True)
            self._group.addButton(made)
            grid.addWidget(made, place // IN_ROW, place % IN_ROW)
        row = -(-len(self.tools) // IN_ROW)
        shown = actions.state()["radius_row"]
        self.radius = Amount(shown)
        self.radius.changed.connect(lambda value: self.ask("set_radius", value))
        grid.addWidget(QLabel(f"Radius of click, ball and brush ({shown['unit']})"), row, 0, 1, IN_ROW)
        grid.addWidget(self.radius, row + 1, 0, 1, IN_ROW)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the tool in use, and its radius."""
        self.tools[state["tool"]].setChecked(True)
        if not self.radius.is_being_moved:
            self.radius.show_value(state["radius_row"]["value"])


#: In their order; that of the page is the same.
PANELS: tuple[Callable[[Actions], Section], ...] = (
    ToolsPanel,
    ObjectsPanel,
    HistoryPanel,
    SettingsPanel,
    HistogramPanel,
    SlicesPanel,
    PicturePanel,
    MeasurePanel,
)
WIDTH = 318


class SidePanels(QWidget):
    """All panels.

    Attributes
    ----------
    changes : ChangesBar
    panels : dict of str to Section
        By the names of their classes.
    """

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self.setFixedWidth(WIDTH)
        self.changes = ChangesBar(actions)
        self.panels = {type(panel).__name__: panel for panel in (make(actions) for make in PANELS)}
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(8, 2, 8, 8)
        column.setSpacing(4)
        for panel in self.panels.values():
            column.addWidget(panel)
        column.addStretch(1)
        area = QScrollArea()
        area.setWidget(inner)
        area.setWidgetResizable(True)
        area.setAccessibleName("panels")
        area.setFrameShape(QScrollArea.Shape.NoFrame)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        whole = QVBoxLayout(self)
        whole.setContentsMargins(0, 8, 0, 0)
        changes = QVBoxLayout()
        changes.setContentsMargins(16, 0, 16, 0)
        changes.addWidget(self.changes)
        whole.addLayout(changes)
        whole.addWidget(area, 1)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""
        self.changes.show_state(state)
        for panel in self.panels.values():
            panel.show_state(state)
