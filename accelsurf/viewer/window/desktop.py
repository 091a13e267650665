"""An image in the window: the scene, the panels beside it, the bars to move over steps and frames; keys.

The panels of tools and of the history are here, with the buttons to undo, redo and save above all.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QMargins, QSignalBlocker, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QPalette, QResizeEvent, QShowEvent
from PySide6.QtWidgets import (
    QApplication,
    QButtonGroup,
    QFileDialog,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QMainWindow,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)
from pyvistaqt import QtInteractor

from accelsurf.image.grey_window import parse_window
from accelsurf.image.volume import Volume
from accelsurf.viewer.actions.actions import Actions, IdleDrawing
from accelsurf.viewer.actions.answers import KEYS
from accelsurf.viewer.actions.slices import READ_OUT
from accelsurf.viewer.core.sequence_view import SequenceView
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import SIZE, Scene
from accelsurf.viewer.window.appearance import page_of_help, palette, sheet
from accelsurf.viewer.window.canvas_events import CanvasEvents
from accelsurf.viewer.window.objects_panel import ObjectsPanel
from accelsurf.viewer.window.playback_bar import FrameBar, PlaybackBar
from accelsurf.viewer.window.section_panel import (
    Amount,
    Message,
    Section,
    bare,
    button,
    choice,
    filled,
    framed,
    furnished,
    in_row,
    made_action,
    show_choice,
    wrapped,
)
from accelsurf.viewer.window.settings_panel import SettingsPanel
from accelsurf.viewer.window.slices_panel import PicturePanel, SlicesPanel

#: How often the window looks for something new, milliseconds.
POLL_MS = 15
#: Width of the page of keys where there is room, and the margin beside it, pixels.
HELP_WIDTH = 1240
HELP_MARGIN = 12


def application() -> QApplication:
    """Return the one application of this process, which a window needs; its `exec` ends with the last window."""
    app = QApplication.instance() or QApplication(sys.argv[:1])
    app.setApplicationName("accelsurf")
    app.setStyle("Fusion")
    return app


class Window(QMainWindow):
    """A window on a session, alone or within a `MainWindow`; `application` must be called first.

    Parameters
    ----------
    session : Session
        Begins when the first picture is drawn, if it has not; closed with the window.
    reference : Volume, optional
        Labels to compare with.
    folder : Path, optional
        Where to save; otherwise the user is asked the first time.
    theme : str
        "dark" or "light".
    overwrite : bool
        Replace files in the folder that this session has not written.
    frames : SequenceView, optional
        The sequence that the image is a frame of.

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
        frames: SequenceView | None = None,
    ) -> None:
        super().__init__()
        self.session = session
        self.setWindowTitle(f"accelsurf - {session.name}")
        self.resize(*SIZE)
        geometry = session.volume.geometry
        self.canvas = QtInteractor(self, auto_update=False, **Scene.layout(geometry))
        self.canvas.setAcceptDrops(False)  # VTK would take them for meshes
        self.scene = Scene(
            session.volume,
            theme=theme,
            reference=reference,
            plotter=self.canvas,
            title=session.name,
            window=parse_window(session.status.settings.window),
        )
        self.scene.tiles.redraw.is_painted = True
        self.user_actions = Actions(session, self.scene, folder, overwrite, frames)
        self.side = SidePanels(self.user_actions)
        self.bar, self.frame_bar = PlaybackBar(self.user_actions), FrameBar(self.user_actions)
        self.events = CanvasEvents(self.user_actions, self.canvas, self.refresh)
        self.idle = IdleDrawing(self.user_actions)
        self.drawing_seconds = 0.0
        self._shown: dict[str, Any] = {}
        self._lay_out()
        self._connect()
        self._timer = furnished(QTimer(self), interval=POLL_MS, timeout=self._poll)
        self._timer.start()

    # -- layout -------------------------------------------------------------------------------------------

    def _lay_out(self) -> None:
        whole = QWidget()
        upper = furnished(QHBoxLayout(), spacing=0)
        upper.addWidget(self.canvas, 1)
        upper.addWidget(self.side)
        self.message = Message()
        self.read_out = furnished(
            QLabel(),
            textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse,
            toolTip="Place (x, y, z), voxel (i, j, k), value and label under the mouse",
        )
        last = furnished(QHBoxLayout(), spacing=24, contentsMargins=QMargins(10, 0, 10, 3))
        last.addWidget(self.message, 1)
        last.addWidget(self.read_out)
        rows = filled(bare(QVBoxLayout(whole), 0), upper, self.frame_bar, self.bar, last)
        rows.setStretchFactor(upper, 1)
        self.setCentralWidget(whole)
        page = page_of_help(self.user_actions.keys)
        self.help = furnished(QLabel(page, whole), objectName="help", wordWrap=True)
        self.help.hide()

    def _connect(self) -> None:
        self.side.changes.help_wanted.connect(self.toggle_help)
        self.side.changes.save_wanted.connect(self.save)
        of_window: dict[str, Callable[[], Any]] = {
            "Ctrl+S": self.save,
            "F1": self.toggle_help,
            "H": self.toggle_help,
            "Escape": self._escape,
            "Ctrl+Q": lambda: self.window().close(),
        }
        for key in dict.fromkeys((*self.user_actions.keys, *of_window)):
            work = of_window.get(key) or functools.partial(self._ask, "key", key)
            self.addAction(made_action(self, "", key, work))

    # -- requests --------------------------------------------------------------------------------------

    def _ask(self, name: str, *values: Any) -> None:
        """Make a request, and draw its changes."""
        self.user_actions.request(name, *values)
        self.refresh()

    def save(self) -> None:
        """Save into the folder, which the user is asked for if it is not known."""
        if self.user_actions.folder is None:
            folder = QFileDialog.getExistingDirectory(
                self, "Save labels, mesh, picture and settings in"
            )
            if not folder:
                return
            self.user_actions.folder = Path(folder)
        self.user_actions.request("save")

    def toggle_help(self) -> None:
        """Show the keys, or hide them."""
        self.help.setVisible(not self.help.isVisible())
        self._place_help()

    def _escape(self) -> None:
        if self.help.isVisible():
            self.help.hide()
        else:
            self._ask("tool", "look")

    # -- news ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Draw changes, and show the state: at once, not when the session has something new."""
        if self.user_actions.changed:
            self.idle.interrupt()
            self.scene.render()
        self._show_state()

    def _poll(self) -> None:
        began, spent = time.perf_counter(), time.thread_time()
        view = self.user_actions.poll(self.drawing_seconds)
        if view is not None:
            self.idle.interrupt()
            self.scene.render()
            if view.status.playing:
                # The work of a graphics card takes nothing from the solver, nor do the finer pictures of a paused run.
                wall, computed = time.perf_counter() - began, time.thread_time() - spent
                self.drawing_seconds = wall if self.idle.is_software else computed
        self.refresh()
        self.idle.draw_in_full()

    def _show_state(self) -> None:
        state, before = self.user_actions.state(), self._shown
        if state == before:
            return
        self._shown = state
        if state["theme"] != before.get("theme"):
            QApplication.instance().setPalette(palette(state["theme"]))
            self.setStyleSheet(sheet(state["theme"]))
        if state["copied"] != before.get("copied") and state["copied"][0]:
            QApplication.clipboard().setText(state["copied"][1])
        self.read_out.setText(
            f"{state['where']}   voxel {state['voxel']}   value {state['value']}   label {state['label']}"
        )
        if _without_place(state) == _without_place(before):
            return
        self.side.show_state(state)
        self.bar.show_state(state)
        self.frame_bar.show_state(state)
        self.setWindowTitle(
            f"accelsurf - {self.session.name} - step {state['step']} - {state['state_word']}"
        )
        self.message.say(state["message"], state["failed"])

    # -- the window ---------------------------------------------------------------------------------------

    def showEvent(self, event: QShowEvent) -> None:
        """Fit the camera: the size is known only now."""
        super().showEvent(event)
        QTimer.singleShot(0, self._draw_first)

    def _draw_first(self) -> None:
        """Draw the image, then have its run prepared: both at once, and the picture would wait."""
        self._ask("whole")
        self.session.start_preparing()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Keep the help centred."""
        super().resizeEvent(event)
        self._place_help()

    def _place_help(self) -> None:
        # As wide as its lines are long, and no wider than the window has room.
        room = self.help.parentWidget().size()
        self.help.setFixedWidth(min(HELP_WIDTH, room.width() - 2 * HELP_MARGIN))
        self.help.adjustSize()
        middle = (room - self.help.size()) / 2
        self.help.move(max(middle.width(), 0), max(middle.height(), 0))
        self.help.raise_()

    def leave(self) -> None:
        """Show nothing any more; the session is not ended."""
        self._timer.stop()
        self.scene.close()

    def closeEvent(self, event: QCloseEvent) -> None:
        """End the session; files that are being saved are finished first."""
        self._timer.stop()
        is_saving = self.user_actions.state()["saving"]
        if is_saving:
            self.message.setText("saving ...")
            QApplication.processEvents()
        self.session.close(600.0 if is_saving else 30.0)
        self.scene.close()
        super().closeEvent(event)


def _without_place(state: dict[str, Any]) -> dict[str, Any]:
    """Return the state without the read-out, which changes with each motion of the mouse."""
    return {key: value for key, value in state.items() if key not in READ_OUT}


#: Buttons beside each other.
IN_ROW = 4


class ToolsPanel(Section):
    """A button for each tool, and for each answer to the first click."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Tools", actions)
        grid = framed(QGridLayout(self.body))
        self._group = QButtonGroup(self)
        self.tools: dict[str, QPushButton] = {}
        for place, (name, tool) in enumerate(actions.tools.items()):
            made = self.tools[name] = self.button(
                tool.text, f"{tool.tip} ({tool.key})", "tool", name
            )
            made.setCheckable(True)
            self._group.addButton(made)
            grid.addWidget(made, place // IN_ROW, place % IN_ROW)
        shown = actions.state()["radius_row"]
        self.tip, self.answers = wrapped("tip"), AnswersRow(actions)
        self.radius = furnished(Amount(shown), changed=lambda value: self.ask("set_radius", value))
        title = QLabel(f"Radius of click and ball ({shown['unit']})")
        for part in (self.tip, title, self.radius, self.answers):
            grid.addWidget(part, grid.rowCount(), 0, 1, IN_ROW)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the tool in use, its radius, and other meanings of the first click."""
        self.answers.show_state(state)
        self.tools[state["tool"]].setChecked(True)
        self.tip.setText(state["tool_tip"])
        if not self.radius.is_being_moved:
            self.radius.show_value(state["radius_row"]["value"])


class AnswersRow(QWidget):
    """A line and a button for each answer to the first click; only while there is a choice.

    Attributes
    ----------
    buttons : dict of int to QPushButton
        By the number of the answer.
    """

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self.buttons = {number: self._made(number, actions) for number in KEYS}
        title = QLabel(f"The first click may mean: keys {' '.join(KEYS.values())}")
        filled(bare(QVBoxLayout(self), 2), title, in_row(*self.buttons.values()))
        self.hide()

    def _made(self, number: int, actions: Actions) -> QPushButton:
        return button(
            "",
            f"Show this one; dashed outlines are of the others ({KEYS[number]})",
            checkable=True,
            clicked=lambda: actions.request("take_answer", number),
        )

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the answers, the taken one pressed."""
        answers = {answer["number"]: answer for answer in state["first_answers"]}
        self.setVisible(bool(answers))
        for number, made in self.buttons.items():
            made.setVisible(number in answers)
            if number in answers:
                furnished(made, text=answers[number]["volume"], checked=answers[number]["taken"])


class ChangesBar(QWidget):
    """Buttons to undo, redo and save, and for the page of keys."""

    save_wanted, help_wanted = Signal(), Signal()

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        ask = actions.request
        self.undo = button("Undo", "Undo the last change (Ctrl+Z)", clicked=lambda: ask("undo"))
        self.redo = button(
            "Redo", "Make the undone change again (Ctrl+Shift+Z)", clicked=lambda: ask("redo")
        )
        self.save = button(
            "Save",
            "Labels, mesh, picture, report and settings (Ctrl+S)",
            clicked=self.save_wanted,
        )
        self.mesh = choice(
            "format of the mesh",
            minimumContentsLength=3,
            toolTip="Format of the mesh that is saved",
            textActivated=lambda name: ask("mesh", name),
        )
        self.help = button("?", "Keys and mouse (F1)", clicked=self.help_wanted)
        self.help.setFixedWidth(28)
        filled(bare(QHBoxLayout(self), 4), self.undo, self.redo, self.save, self.mesh, self.help)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state of the buttons."""
        self.undo.setEnabled(state["undoable"] > 0)
        self.redo.setEnabled(state["redoable"] > 0)
        show_choice(self.mesh, state["meshes"], state["mesh"])
        self.save.setEnabled(state["has_begun"] and not state["saving"])


class ResultPanel(Section):
    """Volume, probability and the most doubtful place, and the way to it."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("Result", actions)
        self.lines, self.where = wrapped("result"), QLabel("")
        tip = "Go to the most doubtful place; again: the next one (N)"
        self.next = self.button("Next doubtful place", tip, "next_uncertain")
        row = in_row(self.next)
        row.addWidget(self.where, 1)
        filled(framed(QVBoxLayout(self.body)), self.lines, row)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the lines about the objects; hidden before there is one."""
        self.setVisible(bool(state["result"]))
        self.lines.setText("\n".join(state["result"]))
        count, at = len(state["uncertain"]), state["uncertain_at"]
        self.next.setEnabled(bool(count))
        self.where.setText(f"{at} of {count}" if at else f"{count} places" if count else "")


#: Lines of the history that are in sight at once, at most.
LINES = 4


class HistoryPanel(Section):
    """All changes; a click on one goes there."""

    def __init__(self, actions: Actions) -> None:
        super().__init__("History", actions)
        # A long line ends in an ellipsis, with all of it in its tip: a bar below would cover one of the few lines.
        self.list: QListWidget = furnished(
            QListWidget(),
            accessibleName="changes",
            toolTip="A click goes back, or forward again, to what was in force after that change",
            horizontalScrollBarPolicy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            itemClicked=lambda item: self.ask("change", self.list.row(item)),
        )
        framed(QVBoxLayout(self.body)).addWidget(self.list)
        self._shown: list[Any] | None = None

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the changes, those that are undone in grey."""
        if state["changes"] == self._shown:
            return
        self._shown = state["changes"]
        grey = self.palette().color(QPalette.ColorGroup.Disabled, QPalette.ColorRole.Text)
        with QSignalBlocker(self.list):
            self.list.clear()
            self.list.addItem("0: as at first")
            for change in self._shown:
                item = QListWidgetItem(f"{change['number']}: {change['line']}")
                item.setToolTip(
                    f"{change['line']}, at step {change['step']}{'' if change['done'] else ', undone'}"
                )
                if not change["done"]:
                    item.setForeground(grey)
                self.list.addItem(item)
            lines = min(self.list.count(), LINES)
            self.list.setFixedHeight(
                lines * self.list.sizeHintForRow(0) + 2 * self.list.frameWidth() + 8
            )
            done = sum(change["done"] for change in self._shown)
            self.list.setCurrentRow(done)
            self.list.scrollToItem(self.list.item(done))


#: In their order; that of the page is the same.
PANELS: tuple[Callable[[Actions], Section], ...] = (
    ToolsPanel,
    ResultPanel,
    ObjectsPanel,
    HistoryPanel,
    SettingsPanel,
    SlicesPanel,
    PicturePanel,
)
WIDTH = 318


class SidePanels(QWidget):
    """All panels.

    Attributes
    ----------
    changes : ChangesBar
    panels : dict of str to Section
        By the names of their classes.
    hints_unwanted : Signal
        The hints are to be shown no more.
    """

    hints_unwanted = Signal()

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self.setFixedWidth(WIDTH)
        self.changes = ChangesBar(actions)
        self.panels = {type(panel).__name__: panel for panel in (make(actions) for make in PANELS)}
        self.hints, self._hints_text = QWidget(), wrapped("hints")
        hide = button("Do not show this again", clicked=self.hints_unwanted)
        filled(framed(QVBoxLayout(self.hints)), self._hints_text, hide)
        self.hints.hide()
        inner = QWidget()
        margins = QMargins(8, 2, 8, 8)
        column = furnished(QVBoxLayout(inner), spacing=4, contentsMargins=margins)
        filled(column, self.hints, *self.panels.values()).addStretch(1)
        area = furnished(
            QScrollArea(),
            widgetResizable=True,
            accessibleName="panels",
            frameShape=QScrollArea.Shape.NoFrame,
            horizontalScrollBarPolicy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
            focusPolicy=Qt.FocusPolicy.NoFocus,
        )
        area.setWidget(inner)
        changes = furnished(in_row(self.changes), contentsMargins=QMargins(16, 0, 16, 0))
        whole = furnished(QVBoxLayout(self), contentsMargins=QMargins(0, 8, 0, 0))
        filled(whole, changes, area).setStretchFactor(area, 1)

    def show_state(self, state: Mapping[str, Any]) -> None:
        """Show the state."""
        self.changes.show_state(state)
        for panel in self.panels.values():
            panel.show_state(state)

    def show_hints(self, hints: Sequence[str]) -> None:
        """Show the first steps, or nothing."""
        self._hints_text.setText("\n".join(hints))
        self.hints.setVisible(bool(hints))
