"""The window of accelsurf: the start page, or an image in a `Window` within it; opens another in its place."""

from __future__ import annotations

from typing import Any, Literal

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QApplication, QFileDialog, QMainWindow, QMenu

from accelsurf.settings.file_formats import image_suffixes
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.opening import Opening, ViewerSettings
from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import SIZE
from accelsurf.viewer.window.appearance import palette, sheet
from accelsurf.viewer.window.desktop import Window, application
from accelsurf.viewer.window.section_panel import furnished, made_action
from accelsurf.viewer.window.start_page import StartPage, choice_dialog, question_box

#: Interval between looks for an opened image, milliseconds.
POLL_MS = 30
#: Share of the screen's width and height that the window takes, where that is more than its usual size.
SHARE = 0.85


class MainWindow(QMainWindow):
    """The start page, or the image that is open; `application` must be called first.

    Parameters
    ----------
    opening : Opening
    settings : ViewerSettings

    Attributes
    ----------
    inner : Window or None
        Shows the open image.
    start_page : StartPage or None
        Shown before.
    """

    def __init__(self, opening: Opening, settings: ViewerSettings) -> None:
        super().__init__()
        self.opening, self._settings = opening, settings
        self.inner: Window | None = None
        #: The session without whose run the window closes, until that is prepared.
        self._awaited: Session | None = None
        #: A signal has come: it closes whatever is open, and asks nothing.
        self._is_ending = False
        #: Where a close that saves first stands.
        self._saving: Literal["", "choosing", "saving"] = ""
        self._shown: dict[str, Any] = {}
        self.dialog: Any = None
        self.setWindowTitle("accelsurf")
        self._fit_screen()
        self.setAcceptDrops(True)
        self._add_menu()
        application().setPalette(palette(settings.theme))
        self.setStyleSheet(sheet(settings.theme))
        self.start_page: StartPage | None = StartPage(opening)
        self.start_page.file_wanted.connect(self.ask_file)
        self.start_page.folder_wanted.connect(self.ask_folder)
        self.setCentralWidget(self.start_page)
        self._timer = furnished(QTimer(self), interval=POLL_MS, timeout=self._poll)
        self._timer.start()

    def _fit_screen(self) -> None:
        """Take most of the screen: the space beside an image says nothing of it."""
        room = self.screen().availableGeometry()
        width, height = (
            min(whole, max(least, round(SHARE * whole)))
            for whole, least in zip((room.width(), room.height()), SIZE, strict=True)
        )
        self.resize(width, height)
        self.move(room.x() + (room.width() - width) // 2, room.y() + (room.height() - height) // 2)

    def _add_menu(self) -> None:
        menu = self.menuBar().addMenu("&File")
        self._recent, self._phantoms = QMenu("Open recent", self), QMenu("Phantoms", self)
        self._reference = made_action(self, "Add reference ...", "Ctrl+R", self.ask_reference)
        menu.addAction(made_action(self, "Open file ...", "Ctrl+O", self.ask_file))
        menu.addAction(made_action(self, "Open folder ...", "Ctrl+Shift+O", self.ask_folder))
        menu.addMenu(self._recent)
        menu.addMenu(self._phantoms)
        menu.addSeparator()
        menu.addAction(self._reference)
        menu.addSeparator()
        menu.addAction(made_action(self, "Close", "", self.close))

    # -- requests of the user -----------------------------------------------------------------------------

    def ask_file(self) -> None:
        """Ask for a file, and open it."""
        self._choose_file("Open an image", "open")

    def ask_folder(self) -> None:
        """Ask for a folder that is an image, and open it."""
        name = QFileDialog.getExistingDirectory(
            self, "Open a folder: a scan in DICOM, slices, OME-Zarr, or a result"
        )
        if name:
            self.opening.request("open", name)

    def ask_reference(self) -> None:
        """Ask for labels to compare the open image with."""
        self._choose_file("Labels to compare with", "open_reference")

    def _choose_file(self, title: str, request: str) -> None:
        images = " ".join(f"*{suffix}" for suffix in image_suffixes())
        name, _ = QFileDialog.getOpenFileName(self, title, "", f"Images ({images});;All files (*)")
        if name:
            self.opening.request(request, name)

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        """Take files of this machine."""
        if any(url.isLocalFile() for url in event.mimeData().urls()):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:
        """Open a dropped file or folder."""
        event.acceptProposedAction()
        self.opening.request(
            "drop", *(url.toLocalFile() for url in event.mimeData().urls() if url.isLocalFile())
        )

    # -- news ---------------------------------------------------------------------------------------------

    def _poll(self) -> None:
        if self._is_ending:
            self._end()
            return
        if self._awaited is not None and self._awaited.ready.done():
            has_failed = self._awaited.ready.exception() is not None
            self._awaited = None
            if has_failed:
                self.close()
                return
        opened = self.opening.fetch()
        if opened is not None:
            self.open(opened)
        if self.opening.closing and self._go_on_closing():
            return
        state = self.opening.state()
        if state == self._shown:
            return
        before, self._shown = self._shown, state
        if self.start_page is not None:
            self.start_page.show_state(state)
        if self.inner is not None:
            self.inner.side.show_hints(state["hints"])
        self._reference.setEnabled(state["is_open"])
        self._fill_menus(state, before)
        self._ask_back(state)

    def _fill_menus(self, state: dict[str, Any], before: dict[str, Any]) -> None:
        lists = (
            (self._recent, "recent", "open_recent"),
            (self._phantoms, "phantoms", "open_phantom"),
        )
        for menu, key, request in lists:
            if state[key] == before.get(key):
                continue
            menu.clear()
            for number, entry in enumerate(state[key]):
                value = number if key == "recent" else entry["name"]
                furnished(
                    menu.addAction(entry["name"]),
                    toolTip=entry.get("folder") or entry.get("text"),
                    enabled=entry.get("exists", True),
                    triggered=lambda _, ask=(request, value): self.opening.request(*ask),
                )
            menu.setEnabled(bool(state[key]))

    def _ask_back(self, state: dict[str, Any]) -> None:
        """Show the question that is open, or the choice; the window goes on meanwhile."""
        if self.dialog is not None:
            return
        if state["question"]:
            box = question_box(self, state["question"], state["answers"])
            box.finished.connect(
                lambda _: self._answered(
                    "answer",
                    box.clickedButton().property("name")
                    if box.clickedButton() is not None
                    else "cancel",
                )
            )
            self.dialog = box
        elif state["choices"]:
            choice, rows = choice_dialog(self, state["choices"])
            choice.accepted.connect(lambda: self._answered("choose", rows.currentIndex().row()))
            choice.rejected.connect(lambda: self._answered("answer", "cancel"))
            self.dialog = choice
        else:
            return
        self.dialog.open()

    def _answered(self, request: str, value: Any) -> None:
        dialog, self.dialog = self.dialog, None
        dialog.deleteLater()
        self.opening.request(request, value)

    # -- images -------------------------------------------------------------------------------------------

    def open(
        self, opened: OpenedImage, session: Session | None = None, close_if_it_fails: bool = False
    ) -> None:
        """Show an image in place of the present one; its slices at once, its surface when the run is prepared.

        Parameters
        ----------
        opened : OpenedImage
        session : Session, optional
            Of it; one is begun otherwise.
        close_if_it_fails : bool, optional
            Close the window if the run cannot be prepared, unless another image is open by then; else the window shows
            the error.
        """
        settings, former = self._settings, self.inner
        session = (
            opened.session(settings.checkpoint_mb, begin=False) if session is None else session
        )
        theme = settings.theme if former is None else former.scene.theme_name
        folder = self.opening.results_of_next(settings.folder, opened.name)
        self.inner = Window(
            session, opened.reference, folder, theme, settings.overwrite, opened.frames
        )
        self.inner.setWindowFlags(Qt.WindowType.Widget)
        self.inner.windowTitleChanged.connect(self.setWindowTitle)
        self.inner.side.hints_unwanted.connect(lambda: self.opening.request("hints_off"))
        self.inner.side.show_hints(self.opening.state()["hints"])
        if former is not None:
            former.leave()
        self.start_page = None
        self.setCentralWidget(self.inner)  # deletes the former
        self.setWindowTitle(self.inner.windowTitle())
        self.inner.show()
        self.opening.show(self.inner.user_actions, opened)
        self._awaited = session if close_if_it_fails else None

    # -- the end ------------------------------------------------------------------------------------------

    def end_soon(self) -> None:
        """Close at the next look, whatever is open and without a question: may be called by the handler of a signal."""
        self._is_ending = True

    def _end(self) -> None:
        for other in QApplication.topLevelWidgets():
            if other is not self and other.isVisible():
                other.close()
        self.close()

    def _go_on_closing(self) -> bool:
        """Close as the person has said: at once, or when all is saved. True when it is closed."""
        if self.opening.closing == "discard":
            return self.close()
        if self.inner is None or self._saving == "choosing":
            return False
        actions = self.inner.user_actions
        files = actions.feature(FilesFeature)
        if not self._saving and not files.is_saving:
            if actions.session.status.playing:
                actions.session.pause()
            if not actions.session.wait(0.0):
                return False
            self._saving = "choosing"
            self.inner.save()  # may ask for a folder, in a loop of events of its own
        self._saving = "saving"
        if files.is_saving:
            return False
        actions.collect_results()
        self._saving = ""
        if files.is_unsaved:
            self.opening.stay()  # the message says why
            return False
        return self.close()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask about unsaved work; then close the image, and let all sessions finish their commands."""
        if not self._is_ending and not self.opening.may_close():
            event.ignore()
            return
        self._timer.stop()
        if self.inner is not None and self._is_ending:
            self.inner.leave()
        elif self.inner is not None:
            self.inner.close()
        if not self._is_ending:
            self.opening.close()
        super().closeEvent(event)
