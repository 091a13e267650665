"""Session: a run that is watched and steered, in a thread of its own. Draws nothing and knows no window.

Its methods may be called from any thread. Commands (`play`, `pause`, `change`, ...) return a Future at once and are
carried out between two steps; `next_view` returns a new view to draw. Settings that
the user changes are edits of the configuration, and clicks its corrections, so that `save` writes a ``NAME_run.toml``
that makes the same bytes from the command line.
When the run has ended, its uncertain locations are found: where the surface has the least evidence.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from accelsurf.errors import UsageError
from accelsurf.grid.clicks import Side
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.command_queue import Command, CommandQueue
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.core.status import (
    SAVED_KINDS,
    Status,
    UncertainLocation,
    View,
    ViewSlot,
    error_line,
)

if TYPE_CHECKING:
    from accelsurf.run import Result, Run, SegmentedObject
    from accelsurf.viewer.core.object_commands import ObjectCommands
    from accelsurf.viewer.core.timeline import Timeline


#: Seconds without a command after which uncertain locations are looked for.
IDLE = 0.4


#: Voxels of a frame while the run plays; a frame of a paused run has all of them.
PLAYING_VOXELS = 3_000_000
#: Memory for checkpoints unless another amount is given, MB.
CHECKPOINT_MB = 512.0
#: State at the beginning of a session: nothing that could be saved, a result that is saved, or one that is not.
Origin = Literal["new", "saved", "unsaved"]

T = TypeVar("T")


class Session:
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
    origin : str, optional
        "new"; "saved" where the run makes a result again that has its files, "unsaved" where it has none.

    Attributes
    ----------
    origin : str
    ready : Future
        Set when the image is prepared; has the error if it could not be.

    See Also
    --------
    accelsurf.viewer.core.timeline.Timeline : meaning of going back and of changes.

    Examples
    --------
    >>> import numpy as np
    >>> z, y, x = np.indices((24, 24, 24)) - 11.5
    >>> image = Volume.from_array((x**2 + y**2 + z**2 < 8**2) * 100.0)
    >>> with Session(image, RunConfig(start="ball:9,9,9,4")) as session:
    ...     session.play(5).result()
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
        origin: Origin = "new",
    ) -> None:
        self.origin = origin
        config = config or RunConfig()
        if config.levels == "auto":
            config = config.replace(levels=1)
        self.volume, self.source = volume, source or volume.source
        self.name = name or "surface"
        self._config, self._checkpoint_mb = config, checkpoint_mb
        self._channels = tuple(channels)
        self._commands, self._views = CommandQueue(), ViewSlot()
        #: Counts changes of the picture: steps and commands.
        self._version, self._uncertainty = 0, UncertaintyWatch()
        self._status = Status.preparing(config, "preparing", False)
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
        """True if commands are carried out, or will be: False once it has been closed."""
        return self._thread.is_alive() if self._has_begun else not self._never_begins

    @property
    def has_unseen_state(self) -> bool:
        """True if the state has changed since the last view was made."""
        return self._views.version != self._version

    def next_view(self, drawing_seconds: float = 0.0) -> View | None:
        """Return a new view to draw, or None; and ask for the next.

        Views are made only when asked for, at most `status.FRAME_RATE` a second, and so that making and drawing
        them takes at most the share `status.DRAWING_SHARE` of the time while the run plays.

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
        """End the run after the present step; earlier commands, saving too, are carried out first.

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

    def _do(self, work: Callable[[Timeline], T]) -> Future[T]:
        """Have a command carried out on the timeline."""
        if not self.is_alive:
            future: Future[T] = Future()
            future.set_exception(UsageError("the session has been closed"))
            return future
        return self._commands.put(work)

    def _is_idle(self) -> bool:
        return not self._status.playing and self._commands.pending == 0 and self.ready.done()

    # -- commands, carried out between two steps ------------------------------------------------------------

    def play(self, last_step: int = -1) -> Future[None]:
        """Make steps until there are ``last_step``, with -1 until the run ends or is paused.

        A converged run continues, with its stop rule reset.
        """
        return self._do(lambda timeline: timeline.play(last_step))

    def go_on(self, last_step: int = -1) -> Future[None]:
        """Make the steps of an earlier session again, up to ``last_step``, with -1 up to the end of the run, and the
        corrections of the configuration after it. No step is made of a label map, which corrections alone change.
        """
        return self._do(lambda timeline: timeline.go_on(last_step))

    def single_step(self) -> Future[None]:
        """Make one step; asked for twice at once, two. A run that plays is paused after it."""
        return self._do(lambda timeline: timeline.single_step())

    def pause(self) -> Future[None]:
        """Pause after the present step."""
        return self._do(lambda timeline: timeline.pause())

    def go_to(self, step: int) -> Future[None]:
        """Go back, or forward again, to a step; where it has no checkpoint the steps before it are made again."""
        return self._do(lambda timeline: timeline.go_to(step))

    def restart(self) -> Future[None]:
        """Begin again from the start with the settings in force, without corrections."""
        return self._do(lambda timeline: timeline.restart())

    def change(self, **settings: Any) -> Future[None]:
        """Change settings from the present step on.

        Raises
        ------
        UsageError
            From the Future, when a setting is not valid; nothing is changed then.
        """
        return self._do(lambda timeline: timeline.change(settings))

    def add_click(
        self, side: Side, where: str | Sequence[str], object_id: int | None = None
    ) -> Future[None]:
        """Say of voxels that they are in the object, or are not, as `--inside` takes them: balls, points, paths.

        Several at once are one correction, as `accelsurf refine` makes it: a run that goes on ends at the present step.
        They take voxels that they contradict from earlier ones. Of several objects it is the one with this id, or else
        the one that is nearest to where the first begins. A text that is no place, a place outside, and clicks that
        would leave nothing clicked inside are refused.
        """
        texts = (where,) if isinstance(where, str) else tuple(where)
        return self._do(lambda timeline: timeline.add_click(side, texts, object_id))

    def reach_of(
        self, side: Side, where: Sequence[str], object_id: int | None = None
    ) -> Future[float | None]:
        """Return how far from clicks the object may change, mm, before they are made; None while the run goes on."""
        return self._do(lambda timeline: timeline.reach_of(side, tuple(where), object_id))

    def press(
        self, ball: str, size_mm3: float = 0.0, object_id: int | None = None
    ) -> Future[SizeDrag]:
        """Begin to drag the size of an object from a ball in it, ``ball:X,Y,Z,R``.

        The answer has the arrival times: the object of any size is read from it in the caller's own thread, so
        that a drag never waits for a step. They have room up to ``size_mm3``; `size_drag.Dragging` asks for more when a
        drag needs them. `release` ends it. Of several objects one is named; with an id that none has it is a new one.
        A text that is no ball and a ball outside are refused.
        """
        return self._do(lambda timeline: timeline.objects.press(ball, size_mm3, object_id))

    def release(self, drag_mm: float) -> Future[None]:
        """Play another run from the press, of a size that a drag of this length stands for; others stay.

        With 0 it is a click alone, and the image says how large the object is.
        """
        return self._do(lambda timeline: timeline.objects.release(drag_mm))

    def take_answer(self, number: int) -> Future[None]:
        """Play another run, of another answer to the first click, one of `Status.answers` by its number."""
        return self._do(lambda timeline: timeline.objects.take_answer(number))

    def objects(self, work: Callable[[ObjectCommands], Any]) -> Future[None]:
        """Have objects merged, split, removed, named or coloured; all or nothing."""
        return self._do(lambda timeline: work(timeline.objects))

    def start_from(self, start: Sequence[str]) -> Future[None]:
        """Begin another run from another start, with the settings in force."""
        return self._do(lambda timeline: timeline.start_from(tuple(start)))

    def restart_with(self, **settings: Any) -> Future[None]:
        """Begin another run from the start with other settings, also those that are fixed while a run runs.

        Corrections stay, and are made again when the run has ended. A ``preset`` overrides the settings in force, but
        for values that need clicks where there are none yet.

        Raises
        ------
        UsageError, InputError
            From the Future, when a setting is not valid, or no run can be made with it; nothing is changed then.
        """
        return self._do(lambda timeline: timeline.restart_with(settings))

    def undo(self) -> Future[None]:
        """Undo the last change, and go to the step where it was made."""
        return self._do(lambda timeline: timeline.undo())

    def redo(self) -> Future[None]:
        """Make the change again that was undone last."""
        return self._do(lambda timeline: timeline.redo())

    def go_to_change(self, count: int) -> Future[None]:
        """Undo changes, or make them again, until the first ``count`` of `Status.changes` are in force; in one go."""
        return self._do(lambda timeline: timeline.go_to_change(count))

    def save(
        self,
        folder: Path,
        what: Sequence[str] = SAVED_KINDS,
        overwrite: bool = False,
        mesh: str = "",
    ) -> Future[list[Path]]:
        """Write files into a folder as `accelsurf segment` does, and ``NAME_run.toml``, which repeats the run.

        Parameters
        ----------
        folder : Path
            Made when missing.
        what : sequence of str
            Of `SAVED_KINDS`.
        overwrite : bool
            Replace files that another session or program has written; this session's are always replaced.
        mesh : str
            Format of meshes, in place of that of the settings.

        Raises
        ------
        OutputError, UsageError
            From the Future; files written before stay whole.
        """
        kinds = tuple(what)
        return self._do(
            lambda timeline: timeline.save(
                Path(folder), self.name, self.source, kinds, overwrite, mesh
            )
        )

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
            timeline = _solver()(
                self.volume, self._config, self._checkpoint_mb, self._channels, self._show_progress
            )
        except Exception as error:
            self._status = Status.preparing(self._config, error_line(error), True)
            self.ready.set_exception(error)
            self._reject_commands()
            return
        self._status = timeline.status("", False)
        self.ready.set_result(None)
        try:
            self._carry_out_commands(timeline)
        finally:
            timeline.close()
            self._status = timeline.status(self._status.message, self._status.failed)

    def _reject_commands(self) -> None:
        """Answer each command with the error of the preparation, until the session is closed."""
        while (
            command := self._commands.next(block=True)
        ) is not None or not self._commands.is_closed:
            if command is not None:
                command.future.set_exception(UsageError(self._status.message))
                self._commands.done()
            self._commands.notify()

    def _carry_out_commands(self, timeline: Timeline) -> None:
        """Carry out commands, and make steps while the timeline plays, until the session is closed."""
        while True:
            looks = (
                self._uncertainty.is_wanted(self._version, timeline.stop is not None)
                and not timeline.is_playing
            )
            answers = timeline.answers.is_wanted(timeline.run)
            command = self._commands.next(
                not timeline.is_playing and not answers, IDLE if looks else None
            )
            if command is not None:
                self._carry_out(command, timeline)
            elif self._commands.is_closed:
                return
            elif answers and not self._views.is_due(self._version, False):
                self._find_answer(timeline)
            elif timeline.is_playing:
                self._step(timeline)
            elif looks:
                self._look_for_uncertain(timeline)
            if self._commands.is_empty:
                self._make_view(timeline)
            if not timeline.is_playing:
                self._commands.notify()

    def _carry_out(self, command: Command, timeline: Timeline) -> None:
        """Carry out a command; its error is reported and does not end the session."""
        try:
            answer = command.work(timeline)
            timeline.apply_edits()
        except Exception as error:
            self._report(timeline, error)
            command.future.set_exception(error)
        else:
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
        self._uncertainty.postpone()
        message = timeline.message if error is None else error_line(error)
        self._status = timeline.status(message, error is not None)

    def _find_answer(self, timeline: Timeline) -> None:
        """Find the surface of one more answer to the first click."""
        try:
            timeline.answers.find_next(timeline.run)
            found = timeline.answers.offered(timeline.run, timeline.corrections.wanted)
        except Exception as error:
            self._status = self._status._replace(message=error_line(error), failed=True)
        else:
            self._status = self._status._replace(answers=found)

    def _look_for_uncertain(self, timeline: Timeline) -> None:
        """Find where to click next, when it has been idle for some time."""
        try:
            found = self._uncertainty.find(
                self._version, timeline.run, timeline.corrections.result()
            )
        except Exception as error:
            self._status = self._status._replace(message=error_line(error), failed=True)
            return
        if found is not None:
            uncertain, likelihoods = found
            self._status = self._status._replace(uncertain=uncertain, likelihoods=likelihoods)

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
            self._status = timeline.status(error_line(error), True)
            return
        self._views.put(
            View(frame, histories, self._status), self._version, time.perf_counter() - began
        )


def _solver() -> type[Timeline]:
    """Load the solver, which takes as long as a window's first picture does without it; return `Timeline`.

    All that the thread will need is loaded here: nothing is then loaded while a person waits, and no other thread loads
    a part of it meanwhile. Two sessions that begin at once wait for one another, as both begin with the same module.
    """
    from accelsurf.viewer.core.timeline import Timeline

    return Timeline


#: Places that are offered, of all objects together.
COUNT = 5
#: Of more objects the probabilities take longer than a click may wait.
MAX_JUDGED = 8
#: Below this uncertainty there is nothing to click.
MIN_SHARE = 0.1


class UncertaintyWatch:
    """Decides when uncertain locations are looked for: once for each state after the run's end, when nothing is asked.

    Looking takes tenths of a second on a large object, which the next command must not wait for.
    """

    def __init__(self) -> None:
        self._looked_at, self._busy_until = -1, 0.0

    def is_wanted(self, version: int, has_ended: bool) -> bool:
        """Return True if this version of the state has not been looked at."""
        return has_ended and self._looked_at != version

    def postpone(self) -> None:
        """Something was done: wait again until it has been idle for some time."""
        self._busy_until = time.perf_counter() + IDLE

    def find(
        self, version: int, run: Run, corrected: Result | None
    ) -> tuple[tuple[UncertainLocation, ...], dict[int, str]] | None:
        """Return the uncertain locations of a version of the state, and how likely each object is good; None
        while it is not idle yet.
        """
        from accelsurf.interact import result_of

        if time.perf_counter() < self._busy_until:
            return None
        self._looked_at = version
        result = corrected if corrected is not None else result_of(run)
        judged = result.objects if len(result.objects) <= MAX_JUDGED else ()
        return uncertain_locations(result), {
            each.id: each.quality.likely for each in judged if each.labels.any()
        }


def uncertain_locations(result: Result) -> tuple[UncertainLocation, ...]:
    """Return the most uncertain locations of a result, the first of each object as `Quality.next_click` has it.

    Parameters
    ----------
    result : Result
        Of a run that has ended.
    """
    ranked = [
        entry for segmented in result.objects for entry in enumerate(_uncertain_in(segmented))
    ]
    return tuple(
        location
        for _, location in sorted(ranked, key=lambda entry: (entry[0], -entry[1].share))[:COUNT]
    )


def _uncertain_in(segmented: SegmentedObject) -> list[UncertainLocation]:
    from accelsurf.measure import gather_evidence, uncertain_places

    inside = segmented.psi < 0
    evidence = gather_evidence(
        inside, segmented.image, segmented.geometry.spacing, segmented.clicked
    )
    if evidence is None:
        return []
    volume = float(np.count_nonzero(inside)) * segmented.geometry.voxel_volume
    out = []
    for index, share in uncertain_places(evidence, segmented.geometry.spacing, volume, COUNT):
        x, y, z = (float(v) for v in segmented.geometry.index_to_world(np.array(index, float)))
        if share >= MIN_SHARE:
            out.append(UncertainLocation((x, y, z), share, segmented.id))
    return out
