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

from accelsurf.config import RunConfig
from accelsurf.edits import Edit
from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.evolution import Row, Stop
from accelsurf.run import KeptRun, Run
from accelsurf.viewer import saving
from accelsurf.viewer.frame import Frame
from accelsurf.viewer.kept import KeptStates
from accelsurf.volume import Volume

#: Frames a second at most, and the part of the time that making and drawing them may take while the solver runs.
FRAME_RATE, DRAWING_SHARE = 15.0, 0.1
#: Voxels of a frame while the run runs; a frame of a run that rests has all of them.
RUNNING_VOXELS = 3_000_000
#: Memory for kept states unless another is given, MB.
KEPT_MB = 512.0
#: Why a run ended for good: there is nothing to go on from.
ENDED = ("vanished", "filled", "diverged")


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
    rows: tuple[Row, ...]
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

    Notes
    -----
    A state is kept at each step, before the edits of that step. Going back keeps what comes after, edits too, so going
    on makes the same steps again; a change made then takes their place.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = Volume.from_array((x**2 + y**2 + z**2 < 8**2) * 100.0)
    >>> with Session(image, RunConfig(start="ball:9,9,9,4")) as session:
    ...     session.run_to(5).result()
    ...     session.wait()
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
    ) -> None:
        config = config or RunConfig()
        if config.levels == "auto":
            config = config.replace(levels=1)
        self.volume, self.source = volume, source or volume.source
        self.name = name or "surface"
        self._config = config
        self._run: Run | None = None
        self._here: KeptRun | None = None
        self._kept = KeptStates(kept_mb)
        self._past: list[tuple[RunConfig, int]] = []
        self._own: set[Path] = set()
        self._running, self._until = False, -1
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
        return self._do(lambda: self._start_running(-1))

    def run_to(self, step: int) -> Future[None]:
        """Run until so many steps have been made."""
        return self._do(lambda: self._start_running(step))

    def single_step(self) -> Future[None]:
        """Make one step; asked for twice at once, two. A run that runs rests after it."""
        return self._do(lambda: self._start_running(1 + (self._until if self._running else self._place)))

    def pause(self) -> Future[None]:
        """Rest after the present step."""
        return self._do(self._pause)

    def back(self, step: int) -> Future[None]:
        """Go back (or, among kept states, forward) to a step; from one not kept the steps in between are made again."""
        return self._do(lambda: self._go_back(step))

    def restart(self) -> Future[None]:
        """Begin again from the start with the settings in force; balls added or taken are gone."""
        return self._do(self._restart)

    def change(self, **settings: Any) -> Future[None]:
        """Change settings from the present step on.

        Raises
        ------
        UsageError
            From the Future, when a setting makes no sense; nothing is changed then.
        """
        return self._do(lambda: self._change_settings(settings))

    def push(self, kind: Literal["add", "remove"], ball: str) -> Future[None]:
        """Unite the object with a ball, ``ball:X,Y,Z,R``, or take one away from it.

        Raises
        ------
        UsageError, InputError
            From the Future, when it is no ball or lies outside the volume.
        """
        return self._do(lambda: self._push(kind, ball))

    def start_from(self, start: Sequence[str]) -> Future[None]:
        """Begin another run from another start, with the settings in force."""
        return self._do(lambda: self._start_from(tuple(start)))

    def undo(self) -> Future[None]:
        """Take the last change back, and go to the step that it was made at."""
        return self._do(self._undo)

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
        return self._do(lambda: self._save(Path(folder), tuple(what), overwrite))

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

    def _loop(self) -> None:
        try:
            self._build(self._config)
            self._say("")
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
            if self._run is not None:
                self._run.workers.close()
            with self._rest:
                self._running, self._pending = False, 0
                self._rest.notify_all()
            self._status = self._status_now()

    def _turn(self) -> None:
        """Carry out a command, or make a step."""
        try:
            work, future = self._commands.get(block=not self._running)
        except queue.Empty:
            self._make_step()
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
            self._answer(work, future)
        finally:
            with self._rest:
                self._pending -= 1

    def _answer(self, work: Callable[[], Any], future: Future[Any]) -> None:
        try:
            if self._run is None and work != self._end:
                raise UsageError(self._message or "the run is not ready")
            answer = work()
            if not self._running and self._run is not None:
                self._run.apply()
        except _End:
            raise
        except BaseException as error:
            self._tell(error)
            self._status = self._status_now()
            future.set_exception(error)
            return
        self._version += 1
        self._status = self._status_now()
        future.set_result(answer)

    def _make_step(self) -> None:
        run = self._ready_run
        try:
            run.step()
            if run.evolution.stop is None:
                self._arrive()
                if self._until >= 0 and self._place >= self._until:
                    self._running = False
                    run.apply()
            else:
                self._running = False
                self._say(f"{run.evolution.stop.reason}: {run.evolution.stop.message}")
        except BaseException as error:
            self._running = False
            self._tell(error)
        self._version += 1
        self._status = self._status_now()

    def _publish(self) -> None:
        """Make a frame if one is wanted and it is time."""
        now = time.perf_counter()
        if not self._wanted or self._run is None or self._shown == self._version:
            return
        if self._running and now < self._next_frame:
            return
        try:
            step = self._run.look()
            most = RUNNING_VOXELS if self._running else None
            frame = Frame.of(step, self.volume.geometry, self._run.evolution.flow, most)
        except Exception as error:
            self._tell(error)
            self._status, self._wanted = self._status_now(), False
            return
        ledger = self._run.evolution.ledger
        rows = tuple(ledger) if self._run.evolution.stop is not None else (*ledger, step.row)
        with self._handing:
            self._view, self._wanted, self._shown = View(frame, rows, self._status), False, self._version
        spent = time.perf_counter() - now + self._drawing
        self._next_frame = now + max(1.0 / FRAME_RATE, spent / DRAWING_SHARE)

    def _say(self, message: str) -> None:
        self._message, self._failed = message, False

    def _tell(self, error: BaseException) -> None:
        """Show an error in one line."""
        known = isinstance(error, AccelsurfError)
        text = error.message if isinstance(error, AccelsurfError) else f"{type(error).__name__}: {error}"
        hint = f" ({error.hint})" if isinstance(error, AccelsurfError) and error.hint else ""
        self._message, self._failed = " ".join((text + hint).split()), True
        if not known:
            self._message = f"internal error, going back to a kept step may help: {self._message}"

    def _status_now(self) -> Status:
        run, here = self._run, self._here
        config = self._config if run is None else run.config
        return Status(
            ready=run is not None,
            running=self._running,
            step=0 if here is None else here.step,
            kept=self._kept.steps,
            settings=config.at(0) if run is None else run.now,
            edits=config.edit,
            stop=None if run is None else run.evolution.stop,
            message=self._message,
            failed=self._failed,
            undoable=len(self._past),
        )

    # -- how commands are carried out, in the thread -------------------------------------------------------

    @property
    def _ready_run(self) -> Run:
        assert self._run is not None
        return self._run

    @property
    def _place(self) -> int:
        """Steps made."""
        return 0 if self._here is None else self._here.step

    def _build(self, config: RunConfig) -> None:
        """Begin another run; the present one goes on to exist until that one is ready."""
        before, self._run = self._run, Run(self.volume, config)
        if before is not None:
            before.workers.close()
        self._kept.clear()
        self._here = None
        self._arrive()

    def _arrive(self) -> None:
        """Keep the state before the edits of the coming step."""
        state = self._ready_run.keep()
        if self._here is not None and state.level != self._here.level:
            # States of a coarser level cannot be taken back on this one.
            self._kept.clear()
        self._here = state
        self._kept.add(state)

    def _start_running(self, until: int) -> None:
        run = self._ready_run
        stop = run.evolution.stop
        if stop is not None and stop.reason in ENDED:
            raise UsageError(f"the run has ended: {stop.message}", "go back, change the settings, or restart")
        if stop is not None and stop.reason == "max-steps":
            run.resume(self._state_here)
        elif stop is not None:
            self._edit((*self._edits_so_far(), Edit(step=self._place)))
        if self._place >= run.evolution.max_steps:
            run.evolution.extend(self._place + max(run.config.max_steps, 1))
        if 0 <= until <= self._place:
            # Asked of a run without an end.
            until = self._place + 1 if self._running else until
        if 0 <= until <= self._place:
            return
        self._running, self._until = True, until
        self._say("")

    def _pause(self) -> None:
        self._running, self._until = False, -1

    @property
    def _state_here(self) -> KeptRun:
        assert self._here is not None
        return self._here

    def _go_back(self, step: int) -> None:
        if not 0 <= step:
            raise UsageError(f"step {step} was given, expected a number at least 0")
        kept = self._kept.steps
        if step > max(self._place, kept[-1] if kept else 0):
            raise UsageError(f"step {step} was given, expected at most {max(self._place, kept[-1])}", "run on to it")
        self._pause()
        self._go(step)
        self._say(f"step {step}")

    def _go(self, step: int) -> None:
        """To the state before the edits of a step; runs there from the last kept one."""
        run = self._ready_run
        state = self._state_here if step == self._place else None
        state = state or self._kept.nearest(step, self._state_here.level)
        if state is None:
            self._build(run.config)
        else:
            run.resume(state)
            self._here = state
        if self._place < step:
            self._running, self._until = True, step

    def _edits_so_far(self) -> tuple[Edit, ...]:
        return tuple(edit for edit in self._ready_run.config.edit if edit.step <= self._place)

    def _edit(self, edits: tuple[Edit, ...]) -> None:
        """Go on with other edits from the present step; what came after it is forgotten."""
        run, place = self._ready_run, self._place
        before = run.config
        if edits == before.edit and run.evolution.stop is None:
            return
        for edit in edits:
            if edit.step >= place:
                run.check(edit)
        before.replace(edit=edits)
        if run.evolution.stop is not None or run.edits_done > self._state_here.done:
            run.resume(self._state_here)
        run.set_edits(edits)
        self._kept.drop_after(place)
        self._past.append((before, place))

    def _change_settings(self, settings: dict[str, Any]) -> None:
        run, place = self._ready_run, self._place
        edits = self._edits_so_far()
        # Several changes at one step are one edit: a slider that is drawn to and fro.
        last = edits[-1] if edits and edits[-1].step == place and not edits[-1].balls else None
        earlier = edits if last is None else edits[:-1]
        run.check(Edit(step=place, **settings))
        run.config.replace(edit=(*earlier, Edit(step=place, **settings)))
        before = run.config.replace(edit=earlier).at(place)
        after = before.replace(**{**(last.settings if last else {}), **settings})
        changed = {
            key: getattr(after, key) for key in RunConfig.model_fields if getattr(after, key) != getattr(before, key)
        }
        goes_on = last is not None and not last.settings
        altered = (*earlier, Edit(step=place, **changed)) if changed or goes_on else earlier
        if altered != edits:
            self._edit(altered)
        self._say(", ".join(f"{key} {value}" for key, value in settings.items()))

    def _push(self, kind: str, ball: str) -> None:
        self._edit((*self._edits_so_far(), *RunConfig(edit=[{"step": self._place, kind: ball}]).edit))
        self._say(f"{'added' if kind == 'add' else 'took away'} {ball}")

    def _restart(self) -> None:
        run = self._ready_run
        base, now, config = run.config.at(-1), run.now, run.config
        changed = {key: getattr(now, key) for key in RunConfig.model_fields if getattr(now, key) != getattr(base, key)}
        changed.pop("seed", None)
        self._pause()
        self._go(0)
        edits = (Edit(step=0, **changed),) if changed else ()
        if edits != config.edit:
            self._edit(edits)
        self._say("at the start")

    def _start_from(self, start: tuple[str, ...]) -> None:
        run = self._ready_run
        before = run.config
        self._pause()
        self._build(run.now.replace(start=start))
        self._past.append((before, 0))
        self._say("start: " + " + ".join(start))

    def _undo(self) -> None:
        if not self._past:
            raise UsageError("there is no change to take back")
        run = self._ready_run
        config, place = self._past.pop()
        self._pause()
        state = self._kept.nearest(min(place, self._place), self._state_here.level)
        if config.at(-1) != run.config.at(-1) or state is None:
            self._build(config)
        else:
            place = min(place, self._place)
            self._kept.drop_after(place)
            self._go(place)
            run.set_edits(config.edit)
        if self._place < place:
            self._running, self._until = True, place
        self._say(f"took the last change back, at step {place}")

    def _save(self, folder: Path, what: tuple[str, ...], overwrite: bool) -> list[Path]:
        run = self._ready_run
        run.apply()
        written = saving.save(run, folder, self.name, self.source, what, None if overwrite else self._own)
        self._own.update(written)
        self._say(f"saved {len(written)} files in {folder}")
        return written


class _End(Exception):
    """The session is to end."""
