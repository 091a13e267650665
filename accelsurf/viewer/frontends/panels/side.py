"""All panels beside the scene, one below the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QScrollArea, QVBoxLayout, QWidget

from accelsurf.viewer.frontends.panels.changes import ChangesBar
from accelsurf.viewer.frontends.panels.histogram import HistogramPanel
from accelsurf.viewer.frontends.panels.history import HistoryPanel
from accelsurf.viewer.frontends.panels.measure import MeasurePanel
from accelsurf.viewer.frontends.panels.objects import ObjectsPanel
from accelsurf.viewer.frontends.panels.picture import PicturePanel
from accelsurf.viewer.frontends.panels.section import Section
from accelsurf.viewer.frontends.panels.settings import SettingsPanel
from accelsurf.viewer.frontends.panels.slices import SlicesPanel
from accelsurf.viewer.frontends.panels.tools import ToolsPanel
from accelsurf.viewer.workplace.workplace import Workplace

#: In their order; that of the page is the same.
PANELS: tuple[Callable[[Workplace], Section], ...] = (
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
    """The panels of a workplace.

    Attributes
    ----------
    changes : ChangesBar
    panels : dict of str to Section
        By the names of their classes.
    """

    def __init__(self, workplace: Workplace) -> None:
        super().__init__()
        self.setFixedWidth(WIDTH)
        self.changes = ChangesBar(workplace)
        self.panels = {type(panel).__name__: panel for panel in (make(workplace) for make in PANELS)}
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
        """Show what the workplace says."""
        self.changes.show_state(state)
        for panel in self.panels.values():
            panel.show_state(state)
