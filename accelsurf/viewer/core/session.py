"""Session: a run that is watched and steered, in a thread of its own. Draws nothing and knows no window.

Its methods may be called from any thread. Commands (`play`, `pause`, `change`, ...) return a Future at once and are
carried out between two steps; `next_view` returns what is new to be drawn. What the user did is stored as the edits of
the configuration, so that `save` writes a ``run.toml`` that makes the same bytes from the command line.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from accelsurf.errors import UsageError
from accelsurf.grid.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.command_queue import Command, CommandQueue
from accelsurf.viewer.core.doubt_watch import QUIET, DoubtWatch
from accelsurf.viewer.core.session_commands import SessionCommands
from accelsurf.viewer.core.status import Status, View, error_line
from accelsurf.viewer.core.view_slot import ViewSlot

if TYPE_CHECKING:
    from accelsurf.viewer.core.timeline import Timeline

#: Voxels of a frame while the run plays; a frame of a paused run has all of them.
PLAYING_VOXELS = 3_000_000
#: Memory for checkpoints unless another amount is given, MB.
CHECKPOINT_MB = 512.0

T = TypeVar("T")


class Session(SessionCommands):
    """A run in a thread of its own.

    Parameters
    ----------
    volume : Volume
    config : RunConfig, optional
        Settings and edits; ``levels = "auto"`` is 1 here: users want to see the grid on which they steer.
    name : str, optional
        First part of the names of files.
    source : Path, optional
        The image's file, for the report.
    checkpoint_mb : float, optional
        Memory for checkpoints, MB.
    channels : sequence of Volume, optional
        Further channels of the image.
    begin : bool, optional
        Begin to prepare the image at once; else `start_preparing` does: who shows the image first has the processor
        until then.

    See Also
    --------
    accelsurf.viewer.core.timeline.Timeline : what going back and changing mean.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = Volume.from_array((x**2 + y**2 + z**2 < 8**2) * 100.0)
    >>> with Session(image, RunConfig(start="ball:9,9,9,4")) as session:
    ...     session.play_to(5).result()
    ...     is_paused = session.wait()
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
        checkpoint_mb: float = CHECKPOINT_MB,
        channels: Sequence[Volume] = (),
        begin: bool = True,
    ) -> None:
        config = config or RunConfig()
        if config.levels == "auto":
            config = config.replace(levels=1)
        self.volume, self.source = volume, source or volume.source
        self.name = name or "surface"
        self._config, self._checkpoint_mb, self._channels = config, checkpoint_mb, tuple(channels)
        self._commands, self._views = CommandQueue(), ViewSlot()
        #: Counts what changes the picture: steps and commands.
        self._version, self._doubts = 0, DoubtWatch()
        self._status = Status.preparing(config, "preparing", False)
        #: Set when the image is prepared; has the error if it could not be.
        self.ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._loop, name="accelsurf session", daemon=True)
        self._has_begun, self._never_begins = False, False
        if begin:
            self.start_preparing()

    def start_preparing(self) -> None:
        """Begin to prepare the image; nothing when that has begun, or the session has been closed."""
        if not self._has_begun and not self._never_begins:
            self._has_begun = True
            self._thread.start()

    # -- to watch -----------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """The present status; costs nothing."""
        return self._status

    @property
    def is_alive(self) -> bool:
        """Whether commands are carried out, or will be: False once it has been closed."""
        return self._thread.is_alive() if self._has_begun else not self._never_begins

    @property
    def has_unseen_state(self) -> bool:
        """Whether the state has changed since the last view was made."""
        return self._views.version != self._version

    def next_view(self, drawing_seconds: float = 0.0) -> View | None:
        """Return what is new to be drawn, or None; and ask for the next.

        Views are made only when asked for, at most `view_slot.FRAME_RATE` a second, and so that making and drawing
        them takes at most the share `view_slot.DRAWING_SHARE` of the time while the run plays.

        Parameters
        ----------
        drawing_seconds : float, optional
            How long the last frame took to draw.
        """
        view = self._views.fetch(drawing_seconds)
        if not self._status.playing and self.has_unseen_state and self._commands.is_empty:
            self._commands.wake()
        return view

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no step is being made and no command is left; False when the time was not enough."""
        return self._commands.wait_for(self._is_idle, timeout)

    def close(self, timeout: float = 10.0) -> bool:
        """End the run after the present step; what was asked for before, saving too, is done first.

        Returns
        -------
        bool
            Whether it has ended in time.
        """
        self._commands.close()
        if self._has_begun:
            self._thread.join(timeout)
        else:
            self._never_begins = True
            self._commands.abandon()
        return not self.is_alive

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _do(self, work: Callable[[Timeline], Any], changes: bool = True) -> Future[Any]:
        """Have a command carried out on the timeline."""
        if not self.is_alive:
            future: Future[Any] = Future()
            future.set_exception(UsageError("the session has been closed"))
            return future
        return self._commands.put(work, changes)

    def _is_idle(self) -> bool:
        return not self._status.playing and self._commands.pending == 0 and self.ready.done()

    # -- the thread ---------------------------------------------------------------------------------------

    def _loop(self) -> None:
        """All that the session's thread does."""
        try:
            self._prepare_and_run()
        finally:
            self._commands.abandon()

    def _prepare_and_run(self) -> None:
        """Make the run, and carry out commands until the session is closed."""
        try:
            timeline = _solver()(self.volume, self._config, self._checkpoint_mb, self._channels)
        except Exception as error:
            self._status = Status.preparing(self._config, error_line(error), True)
            self.ready.set_exception(error)
            self._reject_commands()
            return
        timeline.corrections.progress = self._show_progress
        self._status = Status.of(timeline, "", False)
        self.ready.set_result(None)
        try:
            self._carry_out_commands(timeline)
        finally:
            timeline.close()
            self._status = Status.of(timeline, self._status.message, self._status.failed)

    def _reject_commands(self) -> None:
        """Answer each command with the error of the preparation, until the session is closed."""
        while (command := self._commands.next(block=True)) is not None or not self._commands.is_closed:
            if command is not None:
                command.future.set_exception(UsageError(self._status.message))
                self._commands.done()
            self._commands.notify()

    def _carry_out_commands(self, timeline: Timeline) -> None:
        """Carry out commands, and make steps while the timeline plays, until the session is closed."""
        while True:
            looks = self._doubts.is_wanted(self._version, timeline.stop is not None) and not timeline.is_playing
            command = self._commands.next(not timeline.is_playing, QUIET if looks else None)
            if command is not None:
                self._carry_out(command, timeline)
            elif self._commands.is_closed:
                return
            elif timeline.is_playing:
                self._step(timeline)
            elif looks:
                self._look_for_doubts(timeline)
            if self._commands.is_empty:
                self._make_view(timeline)
            if not timeline.is_playing:
                self._commands.notify()

    def _carry_out(self, command: Command, timeline: Timeline) -> None:
        """Carry out a command; its error is reported and does not end the session."""
        try:
            answer = command.work(timeline)
            if command.changes:
                timeline.apply_edits()
        except Exception as error:
            if command.changes:
                self._report(timeline, error)
            command.future.set_exception(error)
        else:
            if command.changes:
                self._report(timeline)
            command.future.set_result(answer)
        self._commands.done()

    def _step(self, timeline: Timeline) -> None:
        """Make a step; an error pauses the run."""
        try:
            timeline.step()
            timeline.apply_edits()
        except Exception as error:
            timeline.pause()
            self._report(timeline, error)
        else:
            self._report(timeline)

    def _report(self, timeline: Timeline, error: Exception | None = None) -> None:
        """Renew the status after something was done, well or with an error."""
        self._version += 1
        self._doubts.postpone()
        message = timeline.message if error is None else error_line(error)
        self._status = Status.of(timeline, message, error is not None)

    def _look_for_doubts(self, timeline: Timeline) -> None:
        """Find where to click next, when it has been quiet for some time."""
        try:
            found = self._doubts.find(self._version, timeline.run, timeline.corrections.result())
        except Exception as error:
            self._status = self._status._replace(message=error_line(error), failed=True)
            return
        if found is not None:
            self._status = self._status._replace(doubts=found)

    def _show_progress(self, message: str) -> None:
        """Renew the message while a command is being carried out."""
        self._status = self._status._replace(message=message, failed=False)

    def _make_view(self, timeline: Timeline) -> None:
        """Make a view if one is wanted and it is time."""
        playing = timeline.is_playing
        if not self._views.is_due(self._version, playing):
            return
        began = time.perf_counter()
        try:
            frame, histories = timeline.picture(PLAYING_VOXELS if playing else None)
        except Exception as error:
            self._views.refuse()
            self._status = Status.of(timeline, error_line(error), True)
            return
        self._views.put(View(frame, histories, self._status), self._version, time.perf_counter() - began)


def _solver() -> type[Timeline]:
    """Load the solver, which takes as long as a window's first picture does without it; return what makes a run.

    All that the thread will need is loaded here: nothing is then loaded while a person waits, and no other thread loads
    a part of it meanwhile. Two sessions that begin at once wait for one another, as both begin with the same module.
    """
    import accelsurf.segmentation.image_force
    import accelsurf.viewer.core.doubts
    import accelsurf.viewer.core.figures  # noqa: F401
    from accelsurf.viewer.core.timeline import Timeline

    return Timeline
