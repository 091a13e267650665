"""The desktop window: the scene, the panel of controls, the steps of the run below; mouse and keys."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QSignalBlocker, Qt, QTimer
from PySide6.QtGui import QAction, QCloseEvent, QKeySequence, QMouseEvent, QResizeEvent, QShowEvent, QWheelEvent
from PySide6.QtWidgets import (
    QApplication,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QMainWindow,
    QPushButton,
    QSlider,
    QVBoxLayout,
    QWidget,
)
from pyvistaqt import QtInteractor

from accelsurf.errors import AccelsurfError
from accelsurf.grid.volume import Volume
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.session import Session, Status
from accelsurf.viewer.frontends.appearance import HELP, palette, sheet
from accelsurf.viewer.frontends.controls import TOOLS, Panel
from accelsurf.viewer.scene.scene import SIZE, Scene

#: How often the window looks for something new, milliseconds.
POLL_MS = 15
#: Samples of a pixel, and the names of renderers without a graphics card.
SAMPLES, SOFTWARE = 8, ("llvmpipe", "softpipe", "SWR", "Software")
#: A brush that is drawn along makes a ball each time it has gone this part of its radius.
BRUSH_STEP = 0.5


class Window(QMainWindow):
    """A window on a session.

    Parameters
    ----------
    session : Session
        Closed with the window.
    reference : Volume, optional
        Labels to compare with.
    folder : Path, optional
        Where to save; asked for at the first time otherwise.
    theme : str
        "dark" or "light".
    overwrite : bool
        Whether files of others in the folder may be replaced.
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
        self._theme, self._tool = theme, "look"
        self._points: list[str] = []
        self._brushed: NDArray[np.float64] | None = None
        self._dragging = ""
        self._drawing = 0.0
        self._software: bool | None = None
        self._shown: Status | None = None
        self._saving: Future[list[Path]] | None = None
        self._note, self._note_until = "", 0.0
        self._lay_out()
        self._connect()
        self.canvas.installEventFilter(self)
        self.paint(theme)
        self._timer = QTimer(self, interval=POLL_MS)
        self._timer.timeout.connect(self._poll)
        self._timer.start()

    # -- how it is laid out --------------------------------------------------------------------------------

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
        bar = QHBoxLayout()
        bar.setContentsMargins(8, 5, 8, 5)
        bar.setSpacing(6)
        self.restart, self.back, self.play, self.forward = (
            _button(text, told) for text, told in (
                ("|<", "Restart: from the start, with the settings in force (Home)"),
                ("<", "Back one step (Left)"),
                ("Run", "Run or pause (Space)"),
                (">", "One step (Right)"),
            )
        )
        self.play.setFixedWidth(84)
        self.play.setObjectName("play")
        self.timeline = QSlider(Qt.Orientation.Horizontal)
        self.timeline.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.timeline.setToolTip("Steps that are kept: drag to go back and forth")
        self.where = QLabel("")
        self.where.setMinimumWidth(170)
        self.help_button = _button("?", "Keys and mouse (F1)")
        for part in (self.restart, self.back, self.play, self.forward):
            bar.addWidget(part)
        bar.addWidget(self.timeline, 1)
        bar.addWidget(self.where)
        bar.addWidget(self.help_button)
        rows.addLayout(bar)
        self.message = QLabel("")
        self.message.setObjectName("message")
        self.message.setContentsMargins(10, 0, 10, 5)
        rows.addWidget(self.message)
        self.setCentralWidget(whole)
        self.help = QLabel(HELP, whole)
        self.help.setObjectName("help")
        self.help.hide()

    def _connect(self) -> None:
        session, panel = self.session, self.panel
        self.play.clicked.connect(self.toggle)
        self.restart.clicked.connect(lambda: self._ask(session.restart()))
        self.back.clicked.connect(self.step_back)
        self.forward.clicked.connect(lambda: self._ask(session.single_step()))
        self.timeline.valueChanged.connect(self._go_to_kept)
        self.help_button.clicked.connect(self.toggle_help)
        panel.setting.connect(lambda key, value: self._ask(session.change(**{key: value})))
        panel.tool_chosen.connect(self.take_tool)
        panel.radius.changed.connect(lambda _: self._show_ball())
        panel.color_chosen.connect(self.color_by)
        panel.volume_wanted.connect(lambda on: self._redraw(lambda: self.scene.show_volume(on)))
        panel.planes_wanted.connect(lambda on: self._redraw(lambda: self.scene.show_planes(on)))
        panel.theme_wanted.connect(self.paint)
        panel.undo_wanted.connect(self.undo)
        panel.save_wanted.connect(self.save)
        keys: dict[str, Callable[[], Any]] = {
            "Space": self.toggle,
            "Right": self.forward.click,
            "Left": self.step_back,
            "Home": self.restart.click,
            "Ctrl+Z": self.undo,
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
            **{key: functools.partial(self.take_tool, name) for name, (key, _, _) in TOOLS.items()},
        }
        for key, work in keys.items():
            action = QAction(self)
            action.setShortcut(QKeySequence(key))
            action.triggered.connect(lambda _=False, work=work: work())
            self.addAction(action)

    # -- what people ask for -------------------------------------------------------------------------------

    def toggle(self) -> None:
        """Run or pause."""
        self._ask(self.session.pause() if self.session.status.running else self.session.run())

    def step_back(self) -> None:
        """To the state before the last step."""
        if self.session.status.step > 0:
            self._ask(self.session.back(self.session.status.step - 1))

    def undo(self) -> None:
        """Take the last change back."""
        if self.session.status.undoable:
            self._ask(self.session.undo())

    def save(self) -> None:
        """Save into the folder, asked for if it is not known, beside a picture of the window's scene."""
        if self._saving is not None:
            return
        if self._folder is None:
            chosen = QFileDialog.getExistingDirectory(self, "Save labels, mesh, picture and run.toml in")
            if not chosen:
                return
            self._folder = Path(chosen)
        self._saving = self.session.save(self._folder, overwrite=self._overwrite)
        self.say("saving ...", 600)

    def color_by(self, name: str) -> None:
        """Colour the surface by a quantity."""
        self.panel.color.setCurrentText(name)
        self._redraw(lambda: self.scene.color_by(name))

    def _next_color(self) -> None:
        if self.panel.color.isEnabled():
            self.color_by(COLORS[(COLORS.index(self.panel.color.currentText()) + 1) % len(COLORS)])

    def paint(self, theme: str) -> None:
        """Take up a theme."""
        self._theme = theme
        self.panel.theme.setCurrentText(theme)
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        app.setPalette(palette(theme))
        self.setStyleSheet(sheet(theme))
        self._redraw(lambda: self.scene.paint(theme))

    def take_tool(self, name: str) -> None:
        """Take a tool in the hand."""
        self._tool = name
        self.panel.tools[name].setChecked(True)
        self._points = []
        self.scene.mark_ball(None)
        cursors = {"look": Qt.CursorShape.ArrowCursor}
        self.canvas.setCursor(cursors.get(name, Qt.CursorShape.CrossCursor))
        self.say(TOOLS[name][2], 8)
        self.scene.render()

    def toggle_help(self) -> None:
        """Show the keys, or hide them."""
        self.help.setVisible(not self.help.isVisible())
        self._place_help()

    def _escape(self) -> None:
        if self.help.isVisible():
            self.help.hide()
        else:
            self.take_tool("look")

    def _reset_camera(self) -> None:
        if self.scene.space is not None:
            self._redraw(self.scene.space.look_from)

    def _scale_radius(self, factor: float) -> None:
        self.panel.scale_radius(factor)
        self._show_ball()

    def _redraw(self, work: Callable[[], None]) -> None:
        work()
        self.scene.render()

    def _ask(self, future: Future[Any]) -> None:
        """Errors are told by the session's status."""

    def say(self, text: str, seconds: float = 5.0) -> None:
        """Write a line below for some time."""
        self._note, self._note_until = text, time.monotonic() + seconds
        self._show_message(self.session.status)

    # -- what is new ---------------------------------------------------------------------------------------

    def _poll(self) -> None:
        view = self.session.take(self._drawing)
        if view is not None:
            began, spent = time.perf_counter(), time.thread_time()
            self._smooth(not view.status.running)
            self.scene.update(view.frame, view.rows)
            if not self._dragging:
                self.scene.mark_ball(None)
            self.scene.render()
            if view.status.running:
                # What a graphics card does costs the solver nothing; what is drawn at rest, finer, neither.
                self._drawing = time.perf_counter() - began if self._software else time.thread_time() - spent
        status = self.session.status
        if status is not self._shown:
            self._show_status(status)
        elif self._note and time.monotonic() > self._note_until:
            self._note = ""
            self._show_message(status)
        if self._saving is not None and self._saving.done():
            self._saved(self._saving)

    def _smooth(self, on: bool) -> None:
        """Smooth edges while nothing moves; a processor that draws needs three times as long for it."""
        window = self.canvas.render_window
        if self._software is None:
            self._software = any(name in window.ReportCapabilities() for name in SOFTWARE)
        samples = SAMPLES if on or not self._software else 0
        if window.GetMultiSamples() != samples:
            window.SetMultiSamples(samples)

    def _show_status(self, status: Status) -> None:
        if self._shown is None or status.message != self._shown.message:
            # What has happened now is more important than what was said before.
            self._note = "" if self._saving is None else self._note
        self._shown = status
        self.play.setText("Pause" if status.running else "Run")
        for part in (self.play, self.forward, self.panel.save):
            part.setEnabled(status.ready)
        self.back.setEnabled(status.step > 0)
        self.restart.setEnabled(status.ready)
        self.panel.show_settings(status.settings, status.undoable)
        with QSignalBlocker(self.timeline):
            self.timeline.setRange(0, max(len(status.kept) - 1, 0))
            if not self.timeline.isSliderDown() and status.step in status.kept:
                self.timeline.setValue(status.kept.index(status.step))
        edits = f", {len(status.edits)} edit{'' if len(status.edits) == 1 else 's'}" if status.edits else ""
        self.where.setText(f"step {status.step}{edits}")
        state = "running" if status.running else status.stop.reason if status.stop is not None else "paused"
        self.setWindowTitle(f"accelsurf - {self.session.name} - step {status.step} - {state}")
        self._show_message(status)

    def _show_message(self, status: Status) -> None:
        failed = status.failed and not self._note
        text = self._note or status.message or ("running" if status.running else "ready")
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
                self.say(failure.message, 20)
                return
            self.say(f"saved in {self._folder.absolute()}: {', '.join(path.name for path in future.result())}", 20)
        self._show_message(self.session.status)

    def _go_to_kept(self, place: int) -> None:
        kept = self.session.status.kept
        if place < len(kept) and kept[place] != self.session.status.step:
            self._ask(self.session.back(kept[place]))

    # -- the mouse -----------------------------------------------------------------------------------------

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Mouse and keys on the scene; what is not for us goes to VTK's camera."""
        kind = event.type()
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            # VTK has keys of its own, that close windows and change how things are drawn.
            return True
        if isinstance(event, QWheelEvent):
            return self._wheel(event)
        if isinstance(event, QMouseEvent) and event.button() in (Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton):
            x, y = self._pixel(event.position().x(), event.position().y())
            if kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick):
                return self._press(x, y)
            if kind == QEvent.Type.MouseMove and self._dragging:
                return self._drag(x, y)
            if kind == QEvent.Type.MouseButtonRelease:
                self._smooth(not self.session.status.running)
                return self._release() if self._dragging else self._settle()
        return super().eventFilter(watched, event)

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        """A place in the widget, as VTK counts pixels."""
        ratio = self.canvas.devicePixelRatioF()
        return x * ratio, (self.canvas.height() - 1 - y) * ratio

    def _press(self, x: float, y: float) -> bool:
        tile, world = self.scene.pick(x, y)
        self._smooth(False)
        if world is None or (tile == "space" and self._tool == "look"):
            return tile in self.scene.slice_tiles
        self._dragging = tile
        self._act(world)
        return True

    def _drag(self, x: float, y: float) -> bool:
        tile, world = self.scene.pick(x, y)
        if world is not None and tile == self._dragging and self._tool != "points":
            self._act(world)
        return True

    def _release(self) -> bool:
        self._dragging = ""
        if self._tool == "ball" and self._brushed is not None:
            self._points = []
            self._ask(self.session.start_from([self._ball(self._brushed)]))
        # What was marked is seen as the surface as soon as that is there.
        self._brushed = None
        return True

    def _settle(self) -> bool:
        """The camera was turned: VTK is to know that the button is up, and then to draw once more."""
        QTimer.singleShot(0, self.scene.render)
        return False

    def _act(self, world: NDArray[np.float64]) -> None:
        """What the tool in the hand does at a point."""
        radius = float(self.panel.radius.value)
        if self._tool == "look":
            self._redraw(lambda: self.scene.slices(*world))
            return
        if self._tool == "ball":
            self._brushed = world
        elif self._tool == "points":
            self._points.append(self._ball(world))
            self._ask(self.session.start_from(self._points))
        elif self._brushed is None or np.linalg.norm(world - self._brushed) >= BRUSH_STEP * radius:
            self._brushed = world
            self._ask(self.session.push("add" if self._tool == "grow" else "remove", self._ball(world)))
        self._redraw(lambda: self.scene.mark_ball(world, radius))

    def _ball(self, world: NDArray[np.float64]) -> str:
        return "ball:" + ",".join(f"{v:.6g}" for v in (*world, float(self.panel.radius.value)))

    def _show_ball(self) -> None:
        if self._tool == "ball" and self._brushed is not None:
            self._redraw(lambda: self.scene.mark_ball(self._brushed, float(self.panel.radius.value)))

    def _wheel(self, event: QWheelEvent) -> bool:
        tile, _ = self.scene.pick(*self._pixel(event.position().x(), event.position().y()))
        if tile not in self.scene.slice_tiles:
            return tile != "space"
        count = 1 if event.angleDelta().y() > 0 else -1
        self._redraw(lambda: self.scene.step_slice(tile, count))
        return True

    # -- the window ----------------------------------------------------------------------------------------

    def showEvent(self, event: QShowEvent) -> None:
        """The size is known only now."""
        super().showEvent(event)
        QTimer.singleShot(0, self._reset_camera)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Keep the help in the middle."""
        super().resizeEvent(event)
        self._place_help()

    def _place_help(self) -> None:
        self.help.adjustSize()
        x = max((self.canvas.width() - self.help.width()) // 2, 0)
        self.help.move(x, max((self.canvas.height() - self.help.height()) // 2, 0))
        self.help.raise_()

    def closeEvent(self, event: QCloseEvent) -> None:
        """End the solver; what was asked to be saved is saved first."""
        self._timer.stop()
        if self._saving is not None:
            self.message.setText("saving ...")
            QApplication.processEvents()
        self.session.close(600.0 if self._saving is not None else 30.0)
        self.scene.close()
        super().closeEvent(event)


def _button(text: str, told: str) -> QPushButton:
    button = QPushButton(text)
    button.setToolTip(told)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    button.setFixedWidth(40)
    return button


def show(
    session: Session,
    reference: Volume | None = None,
    folder: Path | None = None,
    theme: str = "dark",
    overwrite: bool = False,
) -> None:
    """Open a window on a session and return when it is closed; the session is then closed too.

    Parameters
    ----------
    session, reference, folder, theme, overwrite
        As for `Window`.
    """
    app = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(app, QApplication)
    app.setApplicationName("accelsurf")
    app.setStyle("Fusion")
    window = Window(session, reference, folder, theme, overwrite)
    window.show()
    app.exec()
