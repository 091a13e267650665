"""The panel of changes: a list to go back and forward in, and where to click next; undo, redo, save above all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QVBoxLayout, QWidget

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.window.section_panel import Section, button, framed, in_row


class ChangesBar(QWidget):
    """Buttons to undo, redo and save."""

    save_wanted = Signal()

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self.undo = button("Undo", "Undo the last change (Ctrl+Z)")
        self.redo = button("Redo", "Make the undone change again (Ctrl+Shift+Z)")
        self.save = button("Save", "Labels, mesh, picture, report and run.toml (Ctrl+S)")
        self.undo.clicked.connect(lambda: actions.request("undo"))
        self.redo.clicked.connect(lambda: actions.request("redo"))
        self.save.clicked.connect(self.save_wanted)
        row = in_row(self.undo, self.redo, self.save)
        row.setContentsMargins(0, 0, 0, 0)
        self.setLayout(row)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show what can be undone."""
        self.undo.setEnabled(state["undoable"] > 0)
        self.redo.setEnabled(state["redoable"] > 0)
        self.save.setEnabled(state["ready"] and not state["saving"])


#: Lines that are in sight at once.
LINES = 4


class HistoryPanel(Section):
    """All changes; a click on one goes there."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("History", actions)
        self.list = QListWidget()
        self.list.setAccessibleName("changes")
        self.list.setToolTip("A click goes back, or forward again, to what was in force after that change")
        self.list.setFixedHeight(LINES * self.list.fontMetrics().lineSpacing() + 14)
        # A long line ends in an ellipsis, with all of it in its tip: a bar below would cover one of the few lines.
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.list.itemClicked.connect(lambda item: self.ask("change", self.list.row(item)))
        tip = "Go to the most doubtful place; again: the next one (N)"
        self.next = self.button("Where to click next", tip, "next_uncertain")
        self.where = QLabel("")
        column = framed(QVBoxLayout(self.body))
        column.addWidget(self.list)
        row = in_row(self.next)
        row.addWidget(self.where, 1)
        column.addLayout(row)
        self._shown: list[Any] = []

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the changes, those that are undone in grey, and how many locations are uncertain."""
        uncertain = state["uncertain"]
        self.next.setEnabled(bool(uncertain))
        at = state["uncertain_at"]
        self.where.setText(f"{at} of {len(uncertain)}" if at else f"{len(uncertain)} places" if uncertain else "")
        if state["changes"] == self._shown:
            return
        self._shown = state["changes"]
        grey = self.palette().color(QPalette.ColorGroup.Disabled, QPalette.ColorRole.Text)
        with QSignalBlocker(self.list):
            self.list.clear()
            self.list.addItem("0: as at first")
            for change in self._shown:
                item = QListWidgetItem(f"{change['number']}: {change['line']}")
                item.setToolTip(f"{change['line']}, at step {change['step']}{'' if change['done'] else ', undone'}")
                if not change["done"]:
                    item.setForeground(grey)
                self.list.addItem(item)
            done = sum(change["done"] for change in self._shown)
            self.list.setCurrentRow(done)
            self.list.scrollToItem(self.list.item(done))
