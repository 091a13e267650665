"""Undo, redo, save: always in sight, above the panels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QWidget

from accelsurf.viewer.frontends.panels.section import button
from accelsurf.viewer.workplace.workplace import Workplace


class ChangesBar(QWidget):
    """Buttons to undo, redo and save."""

    save_wanted = Signal()

    def __init__(self, workplace: Workplace) -> None:
        super().__init__()
        self.undo = button("Undo", "Undo the last change (Ctrl+Z)")
        self.redo = button("Redo", "Make the undone change again (Ctrl+Shift+Z)")
        self.save = button("Save", "Labels, mesh, picture, report and run.toml (Ctrl+S)")
        self.undo.clicked.connect(lambda: workplace.request("undo"))
        self.redo.clicked.connect(lambda: workplace.request("redo"))
        self.save.clicked.connect(self.save_wanted)
        line = QHBoxLayout(self)
        line.setContentsMargins(0, 0, 0, 0)
        for part in (self.undo, self.redo, self.save):
            line.addWidget(part)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show what can be undone."""
        self.undo.setEnabled(state["undoable"] > 0)
        self.redo.setEnabled(state["redoable"] > 0)
        self.save.setEnabled(state["ready"] and not state["saving"])
