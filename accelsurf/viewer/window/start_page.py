"""The start page of the window: recent files, phantoms, buttons to open something; and the dialogs of opening."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QHBoxLayout,
    QInputDialog,
    QLabel,
    QListView,
    QListWidget,
    QListWidgetItem,
    QMessageBox,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from accelsurf.viewer.actions.opening import Opening
from accelsurf.viewer.window.section_panel import Message, in_row

#: Width of a list, pixels.
_WIDTH = 380


class StartPage(QWidget):
    """Page that is shown while no image is open.

    Attributes
    ----------
    file_wanted, folder_wanted : Signal
        A dialog to choose a file or a folder is asked for.
    """

    file_wanted, folder_wanted = Signal(), Signal()

    def __init__(self, opening: Opening) -> None:
        super().__init__()
        self._opening, self._shown = opening, dict[str, Any]()
        title = QLabel("accelsurf")
        title.setObjectName("title")
        self.open_file, self.open_folder = (
            QPushButton("Open file ..."),
            QPushButton("Open folder ..."),
        )
        self.open_file.setToolTip("An image in a file (Ctrl+O)")
        self.open_folder.setToolTip("A scan in DICOM, slices, or OME-Zarr (Ctrl+Shift+O)")
        self.open_file.clicked.connect(self.file_wanted)
        self.open_folder.clicked.connect(self.folder_wanted)
        self.recent, self.phantoms = _list("Recent images"), _list("Phantoms")
        self.recent.itemActivated.connect(
            lambda item: self._ask("open_recent", self.recent.row(item))
        )
        self.recent.itemClicked.connect(
            lambda item: self._ask("open_recent", self.recent.row(item))
        )
        self.phantoms.itemActivated.connect(
            lambda item: self._ask("open_phantom", item.data(_NAME))
        )
        self.phantoms.itemClicked.connect(lambda item: self._ask("open_phantom", item.data(_NAME)))
        self.message = Message()
        self.hint = QLabel("or drop an image, or the folder of a scan, here")
        self._lay_out(title)
        self.show_state(opening.state())

    def _lay_out(self, title: QLabel) -> None:
        buttons = in_row(self.open_file, self.open_folder, self.hint)
        buttons.addStretch(1)
        lists = QHBoxLayout()
        lists.setSpacing(24)
        for name, made in (("Recent", self.recent), ("Phantoms, with known truth", self.phantoms)):
            column = QVBoxLayout()
            label = QLabel(name)
            label.setBuddy(made)
            column.addWidget(label)
            column.addWidget(made, 1)
            lists.addLayout(column)
        column = QVBoxLayout()
        column.setSpacing(12)
        for part in (title, buttons, lists, self.message):
            if isinstance(part, QWidget):
                column.addWidget(part)
            else:
                column.addLayout(part)
        column.setStretch(2, 1)
        whole = QHBoxLayout(self)
        whole.setContentsMargins(40, 30, 40, 24)
        whole.addStretch(1)
        whole.addLayout(column)
        whole.addStretch(1)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the lists to choose from, and the work in progress."""
        if state["recent"] != self._shown.get("recent"):
            rows = [
                (f"{file['name']}\n{file['folder']}", file["name"], file["exists"])
                for file in state["recent"]
            ]
            _fill(self.recent, rows or [("none yet", "", False)])
        if state["phantoms"] != self._shown.get("phantoms"):
            phantoms = [
                (f"{entry['name']}\n{entry['text']}", entry["name"], True)
                for entry in state["phantoms"]
            ]
            _fill(self.phantoms, phantoms)
        for part in (self.recent, self.phantoms, self.open_file, self.open_folder):
            part.setEnabled(not state["opening"])
        self.message.say(state["opening_message"], state["opening_failed"])
        self._shown = dict(state)

    def _ask(self, name: str, *values: Any) -> None:
        # Enter and a click may both come; an image that is being opened is not asked for again.
        if not self._opening.is_busy:
            self._opening.request(name, *values)


_NAME = Qt.ItemDataRole.UserRole


def _list(name: str) -> QListWidget:
    made = QListWidget()
    made.setAccessibleName(name)
    made.setMinimumWidth(_WIDTH)
    made.setSpacing(2)
    return made


def _fill(made: QListWidget, rows: Sequence[tuple[str, str, bool]]) -> None:
    """Put texts with their names into a list; those that cannot be opened are grey."""
    made.clear()
    for text, name, is_there in rows:
        item = QListWidgetItem(text)
        item.setData(_NAME, name)
        if not is_there:
            item.setFlags(Qt.ItemFlag.NoItemFlags)
        made.addItem(item)


def choice_dialog(parent: QWidget, texts: Sequence[str]) -> tuple[QInputDialog, QListView]:
    """Return a dialog that asks which of several images of a file or folder is meant, and the list in it."""
    dialog = QInputDialog(parent)
    dialog.setOption(QInputDialog.InputDialogOption.UseListViewForComboBoxItems)
    dialog.setComboBoxItems(list(texts))
    dialog.setWindowTitle("Which image?")
    dialog.setLabelText(f"{len(texts)} images are in it:")
    dialog.setOkButtonText("Open")
    dialog.resize(560, 300)
    view = dialog.findChild(QListView)
    view.setCurrentIndex(view.model().index(0, 0))
    view.activated.connect(dialog.accept)
    return dialog, view


#: The roles of answers, by name: they set the meaning of Enter and Escape, and the order of buttons.
_ROLES = {
    "open": QMessageBox.ButtonRole.AcceptRole,
    "resume": QMessageBox.ButtonRole.AcceptRole,
    "save": QMessageBox.ButtonRole.AcceptRole,
    "discard": QMessageBox.ButtonRole.DestructiveRole,
    "later": QMessageBox.ButtonRole.RejectRole,
    "cancel": QMessageBox.ButtonRole.RejectRole,
}


def question_box(parent: QWidget, text: str, answers: Sequence[tuple[str, str]]) -> QMessageBox:
    """Return a question with a button for each answer, (name, words); the name is in the button's property ``name``."""
    box = QMessageBox(QMessageBox.Icon.Question, "accelsurf", text, parent=parent)
    for name, words in answers:
        button: Any = box.addButton(words, _ROLES.get(name, QMessageBox.ButtonRole.ActionRole))
        button.setProperty("name", name)
    return box
