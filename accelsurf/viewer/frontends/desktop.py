"""The desktop window: the scene, the panel of controls, the bar to move over steps; mouse and keys."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from PySide6.QtCore import QTimer
from PySide6.QtGui import QAction, QCloseEvent, QKeySequence, QResizeEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QFileDialog, QHBoxLayout, QLabel, QMainWindow, QVBoxLayout, QWidget
from pyvistaqt import QtInteractor

from accelsurf.errors import AccelsurfError
from accelsurf.grid.volume import Volume
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.frontends.appearance import HELP, palette, sheet
from accelsurf.viewer.frontends.canvas_tools import CanvasTools
from accelsurf.viewer.frontends.controls import TOOLS, Panel
from accelsurf.viewer.frontends.playback_bar import PlaybackBar
from accelsurf.viewer.scene.scene import SIZE, Scene

#: How often the window looks for something new, milliseconds.
POLL_MS = 15


def application() -> QApplication:
    """Return the one application of this process, which a window needs; its `exec` ends with the last window."""
    app = QApplication.instance() or QApplication(sys.argv[:1])
    app.setApplicationName("accelsurf")
    app.setStyle("Fusion")
    return app


class Window(QMainWindow):
    """A window on a session; `application` must be called first.

    Parameters
    ----------
    session : Session
        Closed with the window.
    reference : Volume, optional
        Labels to compare with.
    folder : Path, optional
        Where to save; otherwise the user is asked the first time.
    theme : str
        "dark" or "light".
    overwrite : bool
        Replace files in the folder that this session has not written.

    Attributes
    ----------
    drawing_seconds : float
        How long the last frame took to draw while the run played.
    """

    def __init__(
        self,
        session: Session,
        reference: Volume | None = None,
        folder: Path | None = None,
        theme: str = "dark",
        overwrite: bool = False,
    ) -> None:
        super().__init__()
        self.session, self._folder, self._overwrite = session, folder, overwrite
        self.setWindowTitle(f"accelsurf - {session.name}")
        self.resize(*SIZE)
        geometry = session.volume.geometry
        self.canvas = QtInteractor(self, auto_update=False, **Scene.layout(geometry))
        self.scene = Scene(session.volume, theme=theme, reference=reference, plotter=self.canvas, title=session.name)
        self.panel = Panel(geometry)
        self.bar = PlaybackBar()
        self.tools = CanvasTools(
            session, self.scene, self.canvas, lambda: float(self.panel.radius.value), lambda: self.panel.object_id
        )
        self._theme = theme
        self.drawing_seconds = 0.0
        self._shown: Status | None = None
        self._saving: Future[list[Path]] | None = None
        self._note, self._note_until = "", 0.0
        self._lay_out()
        self._connect()
        self.paint(theme)
        self._timer = QTimer(self, interval=POLL_MS)
        self._timer.timeout.connect(self._poll)
        self._timer.start()

    # -- layout -------------------------------------------------------------------------------------------

    def _lay_out(self) -> None:
        whole = QWidget()
        rows = QVBoxLayout(whole)
        rows.setContentsMargins(0, 0, 0, 0)
        rows.setSpacing(0)
        upper = QHBoxLayout()
        upper.setSpacing(0)
        upper.addWidget(self.canvas, 1)
        upper.addWidget(self.panel)
        rows.addLayout(upper, 1)
        rows.addWidget(self.bar)
        self.message = QLabel("")
        self.message.setObjectName("message")
        self.message.setContentsMargins(10, 0, 10, 5)
        rows.addWidget(self.message)
        self.setCentralWidget(whole)
        self.help = QLabel(HELP, whole)
        self.help.setObjectName("help")
        self.help.hide()

    def _connect(self) -> None:
        session, panel, bar = self.session, self.panel, self.bar
        bar.play_wanted.connect(self.toggle)
        bar.restart_wanted.connect(lambda: session.restart())
        bar.back_wanted.connect(self.step_back)
        bar.forward_wanted.connect(lambda: session.single_step())
        bar.step_wanted.connect(self._go_to)
        bar.help_wanted.connect(self.toggle_help)
        panel.setting.connect(lambda key, value: session.change(**{key: value}))
        panel.tool_wanted.connect(self.use_tool)
        panel.radius.changed.connect(lambda _: self.tools.show_ball())
        panel.color_wanted.connect(self.color_by)
        panel.volume_wanted.connect(lambda on: self._redraw(lambda: self.scene.show_volume(on)))
        panel.planes_wanted.connect(lambda on: self._redraw(lambda: self.scene.show_planes(on)))
        panel.theme_wanted.connect(self.paint)
        panel.undo_wanted.connect(self.undo)
        panel.redo_wanted.connect(self.redo)
        panel.save_wanted.connect(self.save)
        for key, work in self._shortcuts().items():
            action = QAction(self)
            action.setShortcut(QKeySequence(key))
            action.triggered.connect(lambda _=False, work=work: work())
            self.addAction(action)

    def _shortcuts(self) -> dict[str, Callable[[], Any]]:
        """What each key does."""
        panel, bar = self.panel, self.bar
        return {
            "Space": self.toggle,
            "Right": bar.forward.click,
            "Left": self.step_back,
            "Home": bar.restart.click,
            "Ctrl+Z": self.undo,
            "Ctrl+Shift+Z": self.redo,
            "Ctrl+S": self.save,
            "C": self._next_color,
            "T": lambda: self.paint("light" if self._theme == "dark" else "dark"),
            "O": panel.volume.toggle,
            "L": panel.planes.toggle,
            "R": self._reset_camera,
            "[": lambda: self._scale_radius(1 / 1.25),
            "]": lambda: self._scale_radius(1.25),
            "F1": self.toggle_help,
            "H": self.toggle_help,
            "Escape": self._escape,
            "Ctrl+Q": self.close,
            **{key: functools.partial(self.use_tool, name) for name, (key, _, _) in TOOLS.items()},
        }

    # -- actions of the user ------------------------------------------------------------------------------

    def toggle(self) -> None:
        """Play or pause."""
        if self.session.status.playing:
            self.session.pause()
        else:
            self.session.play()

    def step_back(self) -> None:
        """Go to the state before the last step."""
        if self.session.status.step > 0:
            self.session.go_to(self.session.status.step - 1)

    def _go_to(self, step: int) -> None:
        if step != self.session.status.step:
            self.session.go_to(step)

    def undo(self) -> None:
        """Undo the last change."""
        if self.session.status.undoable:
            self.session.undo()

    def redo(self) -> None:
        """Make the change again that was undone last."""
        if self.session.status.redoable:
            self.session.redo()

    def save(self) -> None:
        """Save into the folder, which the user is asked for if it is not known, with a picture of the scene."""
        if self._saving is not None:
            return
        if self._folder is None:
            folder = QFileDialog.getExistingDirectory(self, "Save labels, mesh, picture and run.toml in")
            if not folder:
                return
            self._folder = Path(folder)
        self._saving = self.session.save(self._folder, overwrite=self._overwrite)
        self._show_note("saving ...", 600)

    def color_by(self, name: str) -> None:
        """Colour the surface by a quantity."""
        self.panel.color.setCurrentText(name)
        self._redraw(lambda: self.scene.color_by(name))

    def _next_color(self) -> None:
        if self.panel.color.isEnabled():
            self.color_by(COLORS[(COLORS.index(self.panel.color.currentText()) + 1) % len(COLORS)])

    def paint(self, theme: str) -> None:
        """Use a theme."""
        self._theme = theme
        self.panel.theme.setCurrentText(theme)
        QApplication.instance().setPalette(palette(theme))
        self.setStyleSheet(sheet(theme))
        self._redraw(lambda: self.scene.paint(theme))

    def use_tool(self, name: str) -> None:
        """Use a tool from now on."""
        self.panel.tools[name].setChecked(True)
        self._show_note(TOOLS[name][2], 8)
        self.tools.use(name)

    def toggle_help(self) -> None:
        """Show the keys, or hide them."""
        self.help.setVisible(not self.help.isVisible())
        self._place_help()

    def _escape(self) -> None:
        if self.help.isVisible():
            self.help.hide()
        else:
            self.use_tool("look")

    def _reset_camera(self) -> None:
        if self.scene.space is not None:
            self._redraw(self.scene.space.look_from)

    def _scale_radius(self, factor: float) -> None:
        self.panel.scale_radius(factor)
        self.tools.show_ball()

    def _redraw(self, work: Callable[[], None]) -> None:
        work()
        self.scene.render()

    def _show_note(self, text: str, seconds: float) -> None:
        """Show a line below the bar for some time."""
        self._note, self._note_until = text, time.monotonic() + seconds
        self._show_message(self.session.status)

    # -- news of the session ------------------------------------------------------------------------------

    def _poll(self) -> None:
        view = self.session.next_view(self.drawing_seconds)
        if view is not None:
            began, spent = time.perf_counter(), time.thread_time()
            self.tools.smooth_edges(not view.status.playing)
            self.scene.update(view.frame, view.histories)
            if not self.tools.is_dragging:
                self.scene.mark_ball(None)
            self.scene.render()
            if view.status.playing:
                # The work of a graphics card takes nothing from the solver, nor do the finer pictures of a paused run.
                wall, own = time.perf_counter() - began, time.thread_time() - spent
                self.drawing_seconds = wall if self.tools.is_software else own
        status = self.session.status
        if status is not self._shown:
            self._show_status(status)
        elif self._note and time.monotonic() > self._note_until:
            self._note = ""
            self._show_message(status)
        if self._saving is not None and self._saving.done():
            self._saved(self._saving)

    def _show_status(self, status: Status) -> None:
        if (self._shown is None or status.message != self._shown.message) and self._saving is None:
            # What has just happened is more important than an older note.
            self._note = ""
        self._shown = status
        self.bar.show_status(status)
        self.panel.save.setEnabled(status.ready)
        self.panel.show_settings(status.settings, status.undoable, status.redoable)
        self.panel.show_objects(status.objects)
        self.setWindowTitle(f"accelsurf - {self.session.name} - step {status.step} - {status.word}")
        self._show_message(status)

    def _show_message(self, status: Status) -> None:
        failed = status.failed and not self._note
        text = self._note or status.message or ("running" if status.playing else "ready")
        if failed:
            text = f"Error: {text}"
        self.message.setText(text)
        self.message.setToolTip(text if len(text) > 120 else "")
        self.message.setProperty("failed", failed)
        self.message.style().polish(self.message)

    def _saved(self, future: Future[list[Path]]) -> None:
        self._saving, self._note = None, ""
        error = future.exception()
        if error is None and self._folder is not None:
            picture = self._folder / f"{self.session.name}_view.png"
            try:
                self.scene.screenshot(picture)
            except AccelsurfError as failure:
                self._show_note(failure.message, 20)
                return
            names = ", ".join(path.name for path in future.result())
            self._show_note(f"saved in {self._folder.absolute()}: {names}", 20)
        self._show_message(self.session.status)

    # -- the window ---------------------------------------------------------------------------------------

    def showEvent(self, event: QShowEvent) -> None:
        """Fit the camera: the size is known only now."""
        super().showEvent(event)
        QTimer.singleShot(0, self._reset_camera)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Keep the help centred."""
        super().resizeEvent(event)
        self._place_help()

    def _place_help(self) -> None:
        self.help.adjustSize()
        x = max((self.canvas.width() - self.help.width()) // 2, 0)
        self.help.move(x, max((self.canvas.height() - self.help.height()) // 2, 0))
        self.help.raise_()

    def closeEvent(self, event: QCloseEvent) -> None:
        """End the session; files that are being saved are finished first."""
        self._timer.stop()
        if self._saving is not None:
            self.message.setText("saving ...")
            QApplication.processEvents()
        self.session.close(600.0 if self._saving is not None else 30.0)
        self.scene.close()
        super().closeEvent(event)
