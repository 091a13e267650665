"""Actions of a person on a session and its scene, in groups; window and page pass on requests and show the state.

mouse, keys, buttons --request--> Actions -> Feature -> Session (a command: a Future) or Scene (drawn at once)
window, page <----state()---- Actions <- each Feature.state(status)
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.viewer.actions.answers import AnswersFeature
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.frames import FramesFeature
from accelsurf.viewer.actions.mouse import MouseFeature, TouchFeature
from accelsurf.viewer.actions.objects import ObjectsFeature
from accelsurf.viewer.actions.picture import PictureFeature
from accelsurf.viewer.actions.run import HistoryFeature, RunFeature
from accelsurf.viewer.actions.settings_rows import SettingsFeature
from accelsurf.viewer.actions.slices import SlicesFeature
from accelsurf.viewer.actions.tool import Feature, Key, P, Tool, carry_out, first_radius
from accelsurf.viewer.actions.tools import ORDER, CorrectionsFeature
from accelsurf.viewer.core.sequence_view import SequenceView
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.status import View, error_line
from accelsurf.viewer.scene.headless import draws_in_software
from accelsurf.viewer.scene.scene import Scene

#: The features, in the order in which window and page show them.
FEATURES: tuple[type[Feature], ...] = (
    FramesFeature,
    RunFeature,
    MouseFeature,
    TouchFeature,
    ObjectsFeature,
    CorrectionsFeature,
    AnswersFeature,
    HistoryFeature,
    SettingsFeature,
    SlicesFeature,
    PictureFeature,
    FilesFeature,
)
#: Requests after which an earlier error stays in sight: the mouse moves all the time.
KEEPING = ("hover", "move", "release", "cancel", "touch_move", "touch_up", "touch_cancel", "size")
#: Seconds without a change after which the picture is drawn in full.
DELAY = 0.4
#: Letters of a message at most.
MAX_MESSAGE = 300


class Actions:
    """All requests of window and page, and the state that they show.

    Parameters
    ----------
    session : Session
    scene : Scene
        Of the same image.
    folder : Path, optional
        Where files are saved; nothing is read or written elsewhere.
    overwrite : bool, optional
        Replace files there that this session has not written.
    frames : SequenceView, optional
        The sequence that the image is a frame of.

    Attributes
    ----------
    message : str
        The last error, in one line; empty when there is none.
    object_id : int or None
        Id of the object that corrections are for; None is the nearest.
    radius : float
        Of click and ball, mm.
    features : tuple of Feature
    tools : dict of str to Tool
        All, by name, in the order of their buttons.
    keys : dict of str to Key
        Action of each key, by Qt's name of the key.
    """

    def __init__(
        self,
        session: Session,
        scene: Scene,
        folder: Path | None = None,
        overwrite: bool = False,
        frames: SequenceView | None = None,
    ) -> None:
        self.session = session
        self.scene = scene
        self.folder = folder
        self.overwrite = overwrite
        self.frames = frames
        self.message = ""
        self.object_id: int | None = None
        self.radius = first_radius(scene.geometry)
        self._note, self._note_until = "", 0.0
        #: How many texts were copied, and the last: the front end copies it when the number changes.
        self._copied = (0, "")
        self._waiting: list[tuple[Future[Any], Callable[[Any], None] | None]] = []
        self.features = tuple(kind(self) for kind in FEATURES)
        self._requests: dict[str, Callable[..., None]] = {
            "key": self._key,
            "copy_failed": self._copy_failed,
        }
        self._requests |= {
            name: work for feature in self.features for name, work in feature.requests().items()
        }
        tools = {tool.name: tool for feature in self.features for tool in feature.tools()}
        self.tools: dict[str, Tool] = {name: tools[name] for name in ORDER}
        self.keys = {
            tool.key: Key("tool", (tool.name,), tool.text.lower()) for tool in self.tools.values()
        }
        self.keys |= {
            key: does for feature in self.features for key, does in feature.keys().items()
        }

    def feature(self, kind: type[P]) -> P:
        """Return the feature of a kind."""
        return next(feature for feature in self.features if isinstance(feature, kind))

    @property
    def changed(self) -> bool:
        """Test if the scene has changed since it was drawn last."""
        return self.scene.tiles.redraw.is_due

    # -- to ask -------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the requests that there are."""
        return tuple(self._requests)

    def request(self, name: Any, *values: Any) -> None:
        """Carry out a request; its error becomes `message`. Raises nothing."""
        if isinstance(name, str) and name not in KEEPING:
            self.message = ""
        try:
            self.feature(FramesFeature).refuse_elsewhere(name)
            carry_out(self._requests, name, values)
        except Exception as error:
            self._say(error)

    def _key(self, key: Any) -> None:
        """Carry out the action of a key, by Qt's name of it; other keys do nothing."""
        does = self.keys.get(key) if isinstance(key, str) else None
        if does is not None:
            self.request(does.request, *does.values)

    def ask(self, future: Future[Any], then: Callable[[Any], None] | None = None) -> None:
        """Wait for a command of the session, without blocking: `collect_results` reports its error, or passes its
        result to ``then``.
        """
        self.message = ""
        self._waiting.append((future, then))

    def note(self, line: str, seconds: float = 8.0) -> None:
        """Show a line for some time, or until something else is to be said."""
        self._note, self._note_until = line, time.monotonic() + seconds

    def copy(self, words: str) -> None:
        """Have the front end put a text on the clipboard."""
        self._copied = (self._copied[0] + 1, words)
        self.note(f"copied {words}")

    def _copy_failed(self) -> None:
        """Refuse: the front end could not put the last text on the clipboard, though `copy` has said that it does."""
        raise UsageError(
            "copy: the browser gives this page no clipboard", "open it on https, or on this machine"
        )

    def poll(self, drawing_seconds: float) -> View | None:
        """Read results, and draw the next view of the session if there is one; not while a button is down.

        Parameters
        ----------
        drawing_seconds : float
            As of `Session.next_view`.
        """
        self.collect_results()
        view = (
            None
            if self.feature(MouseFeature).is_moving
            else self.session.next_view(drawing_seconds)
        )
        if view is not None:
            self.update(view)
        return view

    def collect_results(self) -> None:
        """Read the results and errors of the commands that have been carried out."""
        try:
            self.feature(FramesFeature).tick()
        except Exception as failure:
            self._say(failure)
        waiting, self._waiting = self._waiting, []
        for future, then in waiting:
            if not future.done():
                self._waiting.append((future, then))
            elif error := future.exception():
                self._say(error)
            elif then is not None:
                try:
                    then(future.result())
                except Exception as failure:
                    self._say(failure)

    def _say(self, error: BaseException) -> None:
        self._note = ""
        self.message = (
            error.message if isinstance(error, AccelsurfError) else error_line(error)[:MAX_MESSAGE]
        )

    # -- to show ------------------------------------------------------------------------------------------

    def update(self, view: View) -> None:
        """Draw a view of the session, unless another frame of a sequence is shown."""
        frames = self.feature(FramesFeature)
        frames.note_view(view)
        if frames.shows_run:
            self.scene.update(view.frame, view.histories, coarse=True)  # in full when it is idle
        if not self.feature(MouseFeature).is_dragging:
            self.scene.mark_ball(None)  # the surface is drawn that it has led to
        for feature in self.features:
            feature.update(view)

    def state(self) -> dict[str, Any]:
        """Return the state that panels show, in types of JSON."""
        status = self.session.status
        if self._note and time.monotonic() > self._note_until:
            self._note = ""
        said: dict[str, Any] = {
            "message": self._note
            or self.message
            or status.message
            or ("running" if status.playing else "ready"),
            "failed": not self._note and (bool(self.message) or status.failed),
            "copied": self._copied,
        }
        for feature in self.features:
            said |= feature.state(status)
        return said


class IdleDrawing:
    """Draws in full, all triangles and smooth edges, when nothing has happened for some time.

    Until then it is drawn so that mouse and keys are answered at once. A processor that draws needs three times as long
    for smooth edges, and as long again to begin without them: with a tool in hand they are left out there.

    Parameters
    ----------
    actions : Actions
    """

    def __init__(self, actions: Actions) -> None:
        self._actions = actions
        self._since, self._is_full = time.perf_counter(), True

    @functools.cached_property
    def is_software(self) -> bool:
        """Test if the processor draws, not a graphics card."""
        return draws_in_software(self._actions.scene.plotter.render_window)

    def interrupt(self) -> None:
        """Draw as fast as possible for now: something has changed."""
        self._since, self._is_full = time.perf_counter(), False
        if self.is_software:
            self._actions.scene.tiles.smooth_edges(False)

    def draw_in_full(self) -> bool:
        """Draw all triangles and smooth edges, once nothing has happened for some time; returns whether it is time."""
        mouse = self._actions.feature(MouseFeature)
        is_busy = self._actions.session.status.playing or mouse.is_dragging
        if self._is_full or time.perf_counter() - self._since < DELAY or is_busy:
            return False
        scene, self._is_full = self._actions.scene, True
        changed = scene.tiles.coarsen(False)
        if not self.is_software or mouse.tool.name == "look":
            changed |= scene.tiles.smooth_edges(True)
        if changed:
            scene.render()
        return True
