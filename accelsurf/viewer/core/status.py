"""State of a session for a front end: its status, and the views that are to be drawn."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from accelsurf.errors import AccelsurfError
from accelsurf.evolution import StepRecord, Stop
from accelsurf.settings.corrections import Correction
from accelsurf.settings.edits import Edit
from accelsurf.settings.labels import LabelTable
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.change_log import ChangeLine
from accelsurf.viewer.core.frame import Frame

if TYPE_CHECKING:
    from accelsurf.viewer.core.first_answers import FirstAnswer

#: Kinds of files that a session can save; ``run`` is the configuration that repeats the run.
SAVED_KINDS = ("labels", "mesh", "picture", "trace", "report", "run")


class UncertainLocation(NamedTuple):
    """An uncertain location: ``world`` (x, y, z), mm LPS, the ``share`` of uncertainty there, and its object."""

    world: tuple[float, float, float]
    share: float
    object_id: int


class Status(NamedTuple):
    """The state of a session.

    Attributes
    ----------
    ready : bool
        The image is prepared; before that `step` and so on mean nothing.
    playing : bool
        Steps are being made.
    step : int
        Steps made so far, the number of the coming one.
    checkpoints : tuple of int
        Steps that can be restored at once.
    settings : RunConfig
        In force now, without edits.
    edits : tuple of Edit
        All, also those after the present step once the session has gone back.
    stop : Stop or None
        Why the run has ended.
    message : str
        One line: the last event, or the error.
    failed : bool
        Whether that is an error.
    undoable : int
        How many changes can be undone.
    labels : LabelTable
        Names and colours that were given to objects.
    object_words : dict of int to str
        The state of each object in one word, by id.
    objects : tuple of int
        Ids of the objects; none for a run of one object without an id.
    redoable : int
        How many undone changes can be made again.
    refinements : tuple of Correction
        Corrections after the run's end; while it goes on again, those that are made when it ends.
    changes : tuple of ChangeLine
        In order, also those that are undone.
    plateaus : tuple of int
        Steps in which the surface was on a plateau before it broke through, and that have been made.
    uncertain : tuple of UncertainLocation
        Where to click next, the most uncertain location first; found some time after the run's end.
    terms : sequence of dict
        Of the energy of the first object, with every setting resolved, see `MadeEnergy`.
    answers : tuple of FirstAnswer
        To the first click, to choose from; found some time after it, none once something was corrected.
    flow_why : str
        Which flow the run has where the settings leave it open, and why; empty where they name one.
    has_begun : bool
        There is an object, or a start of one; before that nothing is drawn and nothing can run.
    likelihoods : dict of int to str
        How likely each object is good, in words, by id; found with ``uncertain``.
    config : RunConfig or None
        With which a run begins that makes these steps again; has all ``edits``, no ``refinements``.
    """

    ready: bool
    playing: bool
    step: int
    checkpoints: tuple[int, ...]
    settings: RunConfig
    edits: tuple[Edit, ...]
    stop: Stop | None
    message: str
    failed: bool
    undoable: int
    objects: tuple[int, ...] = ()
    redoable: int = 0
    labels: LabelTable = LabelTable()
    object_words: Mapping[int, str] = MappingProxyType({})
    refinements: tuple[Correction, ...] = ()
    changes: tuple[ChangeLine, ...] = ()
    plateaus: tuple[int, ...] = ()
    uncertain: tuple[UncertainLocation, ...] = ()
    terms: Sequence[dict[str, Any]] = ()
    answers: tuple[FirstAnswer, ...] = ()
    flow_why: str = ""
    has_begun: bool = False
    likelihoods: Mapping[int, str] = MappingProxyType({})
    config: RunConfig | None = None

    @classmethod
    def preparing(cls, config: RunConfig, message: str, failed: bool) -> Status:
        """The status before the image is prepared, or when it could not be."""
        return cls(False, False, 0, (), config.at(0), config.edit, None, message, failed, 0)

    @property
    def word(self) -> str:
        """The state in one word: running, paused, or why the run has ended; empty before there is one."""
        if self.playing:
            return "running"
        return self.stop.reason if self.stop is not None else "paused" if self.has_begun else ""


class View(NamedTuple):
    """A view to be drawn: the ``frame``, each object's ``histories`` up to it, and the ``status`` at that time."""

    frame: Frame
    histories: tuple[tuple[StepRecord, ...], ...]
    status: Status


def error_line(error: BaseException) -> str:
    """Return an error in one line, with its hint; one that is none of accelsurf's own is called internal."""
    if not isinstance(error, AccelsurfError):
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return f"internal error, going back to an earlier step may help: {line}"
    hint = f" ({error.hint})" if error.hint else ""
    return " ".join((error.message + hint).split())


#: Frames per second at most, and the share of the time that making and drawing them may take while the run plays.
FRAME_RATE = 15.0
DRAWING_SHARE = 0.06


class ViewSlot:
    """Contains at most one view. One is made only when it was asked for, and not too often while the run plays."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._view: View | None = None
        self._wanted = False
        self._version = -1
        self._next_time, self._drawing_seconds = 0.0, 0.0

    @property
    def version(self) -> int:
        """Version of the state that the last view shows; -1 before the first."""
        return self._version

    def fetch(self, drawing_seconds: float) -> View | None:
        """Take the view out, or None, and ask for the next; ``drawing_seconds`` is the drawing time of the last."""
        if drawing_seconds:
            self._drawing_seconds = drawing_seconds
        with self._lock:
            view, self._view = self._view, None
            self._wanted = True
        return view

    def is_due(self, version: int, playing: bool) -> bool:
        """Return True if a view of this version of the state is to be made now."""
        return (
            self._wanted
            and self._version != version
            and (not playing or time.perf_counter() >= self._next_time)
        )

    def put(self, view: View, version: int, seconds: float) -> None:
        """Put a view of a version of the state there; ``seconds`` is the time to make it."""
        with self._lock:
            self._view = view
            self._wanted = False
            self._version = version
        pause = max(1.0 / FRAME_RATE, (seconds + self._drawing_seconds) / DRAWING_SHARE)
        self._next_time = time.perf_counter() - seconds + pause

    def refuse(self) -> None:
        """No view can be made of this state: make none until `fetch` asks again."""
        self._wanted = False
