"""The start page of the window: recent files, phantoms, buttons to open something; and the dialogs of opening."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from PySide6.QtCore import QMargins, QSize, Qt, Signal
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
from accelsurf.viewer.window.section_panel import Message, filled, furnished, in_row

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
        self.open_file = furnished(
            QPushButton("Open file ..."),
            toolTip="An image in a file (Ctrl+O)",
            clicked=self.file_wanted,
        )
        self.open_folder = furnished(
            QPushButton("Open folder ..."),
            toolTip="A scan in DICOM, slices, OME-Zarr, or a result (Ctrl+Shift+O)",
            clicked=self.folder_wanted,
        )
        self.recent = _list(
            "Recent images", lambda item: self._ask("open_recent", self.recent.row(item))
        )
        self.phantoms = _list("Phantoms", lambda item: self._ask("open_phantom", item.data(_NAME)))
        self.message = Message()
        self.hint = QLabel("or drop an image, or the folder of a scan, here")
        buttons = in_row(self.open_file, self.open_folder, self.hint)
        buttons.addStretch(1)
        lists = furnished(QHBoxLayout(), spacing=24)
        for name, made in (("Recent", self.recent), ("Phantoms, with known truth", self.phantoms)):
            label = QLabel(name)
            label.setBuddy(made)
            lists.addLayout(filled(QVBoxLayout(), label, made))
        title = furnished(QLabel("accelsurf"), objectName="title")
        column = filled(furnished(QVBoxLayout(), spacing=12), title, buttons, lists, self.message)
        column.setStretchFactor(lists, 1)
        whole = furnished(QHBoxLayout(self), contentsMargins=QMargins(40, 30, 40, 24))
        whole.addStretch(1)
        whole.addLayout(column)
        whole.addStretch(1)
        self.show_state(opening.state())

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


def _list(name: str, work: Callable[[QListWidgetItem], None]) -> QListWidget:
    return furnished(
        QListWidget(),
        accessibleName=name,
        minimumWidth=_WIDTH,
        spacing=2,
        itemActivated=work,
        itemClicked=work,
    )


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
    dialog = furnished(QInputDialog(parent), windowTitle="Which image?", size=QSize(560, 300))
    dialog.setOption(QInputDialog.InputDialogOption.UseListViewForComboBoxItems)
    dialog.setComboBoxItems(list(texts))
    dialog.setLabelText(f"{len(texts)} images are in it:")
    dialog.setOkButtonText("Open")
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
