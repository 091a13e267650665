"""Session: a run that is watched and steered, in a thread of its own. Draws nothing and knows no window.

Whoever watches calls from any thread. Commands (`run`, `pause`, `change`, ...) return a Future at once and are carried
out between two steps; `take` returns what is new to be drawn. What was steered is kept as the edits of the
configuration, so that `save` writes a ``run.toml`` that makes the same bytes from the command line.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal, NamedTuple

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.evolution.records import StepRecord, Stop
from accelsurf.grid.volume import Volume
from accelsurf.settings.edits import Edit
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core import saving
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.core.timeline import Timeline

#: Frames a second at most, and the part of the time that making and drawing them may take while the solver runs.
FRAME_RATE, DRAWING_SHARE = 15.0, 0.06
#: Voxels of a frame while the run runs; a frame of a run that rests has all of them.
RUNNING_VOXELS = 3_000_000
#: Memory for kept states unless another is given, MB.
KEPT_MB = 512.0


class Status(NamedTuple):
    """Where a session stands.

    Attributes
    ----------
    ready : bool
        The image is prepared; before that `step` and so on say nothing.
    running : bool
        Steps are being made.
    step : int
        Steps made so far, the number of the coming one.
    kept : tuple of int
        Steps that can be gone back to at once.
    settings : RunConfig
        In force now, without edits.
    edits : tuple of Edit
        All, those to come too after going back.
    stop : Stop or None
        Why the run has ended.
    message : str
        One line: what happened last, or went wrong.
    failed : bool
        Whether that is an error.
    undoable : int
        How many changes can be taken back.
    """

    ready: bool
    running: bool
    step: int
    kept: tuple[int, ...]
    settings: RunConfig
    edits: tuple[Edit, ...]
    stop: Stop | None
    message: str
    failed: bool
    undoable: int


class View(NamedTuple):
    """What is to be drawn: the ``frame``, the ``rows`` of the trace up to it, and the ``status`` then."""

    frame: Frame
    rows: tuple[StepRecord, ...]
    status: Status


class Session:
    """A run in a thread of its own.

    Parameters
    ----------
    volume : Volume
    config : RunConfig, optional
        Settings and edits; ``levels = "auto"`` is 1 here, where one wants to see what one steers.
    name : str, optional
        First part of the names of files.
    source : Path, optional
        The image's file, for the report.
    kept_mb : float, optional
        Memory for kept states, MB.
    channels : sequence of Volume, optional
        Further channels of the image.

    See Also
    --------
    accelsurf.viewer.core.timeline.Timeline : what going back and changing mean.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = Volume.from_array((x**2 + y**2 + z**2 < 8**2) * 100.0)
    >>> with Session(image, RunConfig(start="ball:9,9,9,4")) as session:
    ...     session.run_to(5).result()
    ...     at_rest = session.wait()
    ...     session.change(smoothness=0.2).result()
    ...     session.status.step, session.status.settings.smoothness, session.status.edits[0].step
    (5, 0.2, 5)
    """

    def __init__(
        self,
        volume: Volume,
        config: RunConfig | None = None,
        *,
        name: str = "",
        source: Path | None = None,
        kept_mb: float = KEPT_MB,
        channels: Sequence[Volume] = (),
    ) -> None:
        config = config or RunConfig()
        if config.levels == "auto":
            config = config.replace(levels=1)
        self.volume, self.source = volume, source or volume.source
        self.name = name or "surface"
        self._config, self._kept_mb, self._channels = config, kept_mb, tuple(channels)
        self._timeline: Timeline | None = None
        self._running = False
        self._message, self._failed = "preparing", False
        self._commands: queue.SimpleQueue[tuple[Callable[[], Any] | None, Future[Any]]] = queue.SimpleQueue()
        #: Guards what is waited for (commands not carried out yet) and what is handed over (the view).
        self._rest, self._handing = threading.Condition(), threading.Lock()
        self._pending, self._wanted = 0, False
        self._view: View | None = None
        self._version, self._shown = 0, -1
        self._next_frame, self._drawing = 0.0, 0.0
        self._status = self._status_now()
        #: Set when the image is prepared; has the error if it could not be.
        self.ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._loop, name="accelsurf session", daemon=True)
        self._thread.start()

    # -- to watch ------------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """Where the session stands; costs nothing."""
        return self._status

    def take(self, drawing_seconds: float = 0.0) -> View | None:
        """Return what is new to be drawn, or None; and ask for the next.

        Frames are made only when somebody has asked, `FRAME_RATE` a second at most, and so that making and drawing
        them takes no more than `DRAWING_SHARE` of the time while the run runs.

        Parameters
        ----------
        drawing_seconds : float, optional
            How long the last frame took to draw.
        """
        if drawing_seconds:
            self._drawing = drawing_seconds
        with self._handing:
            view, self._view = self._view, None
            self._wanted = True
        if not self._running and self._shown != self._version and self._commands.empty():
            self._commands.put((None, Future()))
        return view

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no step is being made and no command is left; False when the time was not enough."""
        with self._rest:
            return self._rest.wait_for(self._is_at_rest, timeout)

    # -- commands ------------------------------------------------------------------------------------------

    def run(self) -> Future[None]:
        """Run until it ends or is paused; one that has converged goes on, its stop rule begins anew."""
        return self._do(lambda: self._ready.go_on(-1))

    def run_to(self, step: int) -> Future[None]:
        """Run until so many steps have been made."""
        return self._do(lambda: self._ready.go_on(step))

    def single_step(self) -> Future[None]:
        """Make one step; asked for twice at once, two. A run that runs rests after it."""
        return self._do(lambda: self._ready.one_more())

    def pause(self) -> Future[None]:
        """Rest after the present step."""
        return self._do(lambda: self._ready.pause())

    def back(self, step: int) -> Future[None]:
        """Go back (or, among kept states, forward) to a step; from one not kept the steps in between are made again."""
        return self._do(lambda: self._ready.go_back(step))

    def restart(self) -> Future[None]:
        """Begin again from the start with the settings in force; balls added or taken are gone."""
        return self._do(lambda: self._ready.restart())

    def change(self, **settings: Any) -> Future[None]:
        """Change settings from the present step on.

        Raises
        ------
        UsageError
            From the Future, when a setting makes no sense; nothing is changed then.
        """
        return self._do(lambda: self._ready.change(settings))

    def push(self, kind: Literal["add", "remove"], ball: str) -> Future[None]:
        """Unite the object with a ball, ``ball:X,Y,Z,R``, or take one away from it.

        Raises
        ------
        UsageError, InputError
            From the Future, when it is no ball or lies outside the volume.
        """
        return self._do(lambda: self._ready.push(kind, ball))

    def start_from(self, start: Sequence[str]) -> Future[None]:
        """Begin another run from another start, with the settings in force."""
        return self._do(lambda: self._ready.start_from(tuple(start)))

    def undo(self) -> Future[None]:
        """Take the last change back, and go to the step that it was made at."""
        return self._do(lambda: self._ready.undo())

    def save(
        self, folder: Path, what: Sequence[str] = saving.KINDS, overwrite: bool = False
    ) -> Future[list[Path]]:
        """Write files into a folder as `accelsurf segment` does, and ``run.toml``, which repeats the run.

        Parameters
        ----------
        folder : Path
            Made when missing.
        what : sequence of str
            Of `saving.KINDS`.
        overwrite : bool
            Replace files that another session or program has written; those of this one are replaced always.

        Raises
        ------
        OutputError, UsageError
            From the Future; files written before stay whole.
        """
        return self._do(lambda: self._ready.save(Path(folder), self.name, self.source, tuple(what), overwrite))

    def close(self, timeout: float = 10.0) -> bool:
        """End the run after the present step; what was asked for before, saving too, is done first.

        Returns
        -------
        bool
            Whether it has ended in time.
        """
        self._commands.put((self._end, Future()))
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # -- the thread ----------------------------------------------------------------------------------------

    def _do(self, work: Callable[[], Any]) -> Future[Any]:
        future: Future[Any] = Future()
        if not self._thread.is_alive():
            future.set_exception(UsageError("the session has been closed"))
            return future
        with self._rest:
            self._pending += 1
        self._commands.put((work, future))
        return future

    def _end(self) -> None:
        raise _End

    @property
    def _ready(self) -> Timeline:
        if self._timeline is None:
            raise UsageError(self._message or "the run is not ready")
        return self._timeline

    def _loop(self) -> None:
        try:
            self._timeline = Timeline(self.volume, self._config, self._kept_mb, self._channels)
            self._message = ""
            self._status = self._status_now()
            self.ready.set_result(None)
        except BaseException as error:
            self._tell(error)
            self._status = self._status_now()
            self.ready.set_exception(error)
        try:
            while True:
                self._turn()
        except _End:
            pass
        finally:
            if self._timeline is not None:
                self._timeline.running = False
                self._timeline.close()
            with self._rest:
                self._running, self._pending = False, 0
                self._rest.notify_all()
            self._status = self._status_now()

    def _turn(self) -> None:
        """Carry out a command, or make a step."""
        try:
            work, future = self._commands.get(block=not self._running)
        except queue.Empty:
            self._work(self._ready.advance)
        else:
            self._carry_out(work, future)
        if self._commands.empty():
            self._publish()
        if not self._running:
            with self._rest:
                self._rest.notify_all()

    def _is_at_rest(self) -> bool:
        return not self._running and self._pending == 0 and self.ready.done()

    def _carry_out(self, work: Callable[[], Any] | None, future: Future[Any]) -> None:
        if work is None:
            return
        try:
            answer, error = self._work(work)
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(answer)
        finally:
            with self._rest:
                self._pending -= 1

    def _work(self, work: Callable[[], Any]) -> tuple[Any, BaseException | None]:
        """Do something to the run, and tell how that went; an error ends the running, not the session."""
        answer, failure = None, None
        try:
            answer = work()
            timeline = self._ready
            timeline.settle()
            self._message, self._failed = timeline.message, False
        except _End:
            raise
        except BaseException as error:
            if work == getattr(self._timeline, "advance", None):
                self._ready.pause()
            self._tell(error)
            failure = error
        self._running = self._timeline is not None and self._timeline.running
        self._version += 1
        self._status = self._status_now()
        return answer, failure

    def _publish(self) -> None:
        """Make a frame if one is wanted and it is time."""
        now = time.perf_counter()
        if not self._wanted or self._timeline is None or self._shown == self._version:
            return
        run = self._timeline.run
        if self._running and now < self._next_frame:
            return
        try:
            step = run.look()
            most = RUNNING_VOXELS if self._running else None
            frame = Frame.of(step, run.geometry, run.evolution.flow, most, run.prepared.first)
        except Exception as error:
            self._tell(error)
            self._status, self._wanted = self._status_now(), False
            return
        history = run.evolution.history
        rows = tuple(history) if run.stop is not None else (*history, step.row)
        with self._handing:
            self._view, self._wanted, self._shown = View(frame, rows, self._status), False, self._version
        spent = time.perf_counter() - now + self._drawing
        self._next_frame = now + max(1.0 / FRAME_RATE, spent / DRAWING_SHARE)

    def _tell(self, error: BaseException) -> None:
        """Show an error in one line."""
        known = isinstance(error, AccelsurfError)
        text = error.message if isinstance(error, AccelsurfError) else f"{type(error).__name__}: {error}"
        hint = f" ({error.hint})" if isinstance(error, AccelsurfError) and error.hint else ""
        self._message, self._failed = " ".join((text + hint).split()), True
        if not known:
            self._message = f"internal error, going back to a kept step may help: {self._message}"

    def _status_now(self) -> Status:
        timeline = self._timeline
        if timeline is None:
            settings = self._config.at(0)
            return Status(
                False, False, 0, (), settings, self._config.edit, None, self._message, self._failed, 0
            )
        return Status(
            ready=True,
            running=timeline.running,
            step=timeline.place,
            kept=timeline.kept.steps,
            settings=timeline.run.now,
            edits=timeline.run.config.edit,
            stop=timeline.run.stop,
            message=self._message,
            failed=self._failed,
            undoable=timeline.undoable,
        )


class _End(Exception):
    """The session is to end."""
