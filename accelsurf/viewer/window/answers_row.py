"""A row of the window: what the first click may mean, a button for each; only while there is a choice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide6.QtWidgets import QLabel, QPushButton, QVBoxLayout, QWidget

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.answers import KEYS
from accelsurf.viewer.window.section_panel import button, in_row


class AnswersRow(QWidget):
    """A line and buttons for answers to the first click.

    Attributes
    ----------
    buttons : dict of int to QPushButton
        By the number of the answer.
    """

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self.buttons = {number: self._made(number, actions) for number in KEYS}
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addWidget(QLabel(f"The first click may mean: keys {' '.join(KEYS.values())}"))
        column.addLayout(in_row(*self.buttons.values()))
        self._shown: Any = None
        self.hide()

    def _made(self, number: int, actions: Actions) -> QPushButton:
        made = button("", f"Show this one; dashed outlines are of the others ({KEYS[number]})")
        made.setCheckable(True)
        made.clicked.connect(lambda: actions.request("take_answer", number))
        return made

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the answers, the taken one pressed."""
        answers = state["first_answers"]
        if answers == self._shown and [self.buttons[each["number"]].isChecked() for each in answers] == [
            each["taken"] for each in answers
        ]:
            return
        self._shown = answers
        self.setVisible(bool(answers))
        for made in self.buttons.values():
            made.hide()
        for answer in answers:
            made = self.buttons[answer["number"]]
            made.setText(f"{answer['key']} \N{MIDDLE DOT} {answer['volume']}")
            made.setChecked(answer["taken"])
            made.show()
