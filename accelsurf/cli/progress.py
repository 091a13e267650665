"""Progress on stderr, of a run and of a batch: a bar, or a line of JSON for each event; Ctrl-C ends a run."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any

from accelsurf.cli.interrupts import MAX_ERROR, Interrupts, printable, say
from accelsurf.cli.options import Display, ProgressKind
from accelsurf.output.document import to_json
from accelsurf.settings.trace_columns import row_values

if TYPE_CHECKING:
    from accelsurf.batch.outcome import Outcome
    from accelsurf.evolution.records import StepRecord
    from accelsurf.grid.window import Window

#: What the bar shows until the first step, when nothing else moves.
PREPARING = "preparing"
#: Said before the first kernel of a command is compiled: where kernels can be stored, and where they cannot.
COMPILING = "note: compiling, once: up to a minute of the processor (all: accelsurf warmup)"
#: Said where all are compiled.
COMPILING_ALL = "compiling kernels, once: about a minute"
COMPILING_ANEW = "note: compiling kernels, in each run: NUMBA_CACHE_DIR names a folder for them"


class Watcher:
    """Shows each step, and stops the run after Ctrl-C.

    Parameters
    ----------
    display : Display
        The kind of progress to show.
    """

    def __init__(self, display: Display) -> None:
        kind = shown_kind(display)
        self._show_json = kind == "json"
        self._has_bar = kind == "bar"
        self._bar: _Bar | None = None
        self._interrupts = Interrupts.current()
        self._is_quiet, self._label = display.quiet, ""
        self._has_noticed = False
        #: Warnings that have been printed before the first step.
        self.printed_warnings: set[str] = set()

    @contextmanager
    def watch(
        self, label: str, max_steps: int, then: str = "keeping its state"
    ) -> Iterator[Watcher]:
        """Show one run. Until it ends, a first Ctrl-C ends it after the present step, a second one at once.

        Parameters
        ----------
        label : str
            Name of the run.
        max_steps : int
            Its largest number of steps.
        then : str, optional
            What follows that step.
        """
        from accelsurf.kernels.storage import first_compilation

        if self._has_bar:
            count = "{task.fields[unit]} {task.completed:.0f}/{task.total:.0f}"
            self._bar = _Bar(label, count, max_steps, state=PREPARING, unit="step")
        self._label = label
        try:
            with (
                self._interrupts.patience(f"finishing this step and {then}"),
                first_compilation(self._on_compilation),
            ):
                yield self
        finally:
            if self._bar is not None:
                self._bar.stop()

    def _on_compilation(self) -> None:
        """Print once the reason of a pause, also off a terminal."""
        from accelsurf.kernels.storage import STORAGE

        if self._is_quiet or self._has_noticed:
            return
        self._has_noticed = True
        text = COMPILING_ANEW if STORAGE is None else COMPILING
        if self._show_json:
            print_json(
                {"event": "compiling", "run": self._label, "message": text.removeprefix("note: ")}
            )
        elif self._bar is not None:
            self._bar.say(text)
        else:
            say(text)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """While files are written, a first Ctrl-C lets them be finished, a second one removes them."""
        with self._interrupts.patience("finishing the files"):
            yield

    @property
    def interrupted(self) -> bool:
        """True if Ctrl-C was pressed."""
        return self._interrupts.count > 0

    def note(self, text: str) -> None:
        """Keep a line about the files on the disk, for the last line after Ctrl-C."""
        self._interrupts.note(text)

    def exit_code(self, code: int) -> int:
        """The exit code of the command, as far as it is known: that of Ctrl-C after it was pressed."""
        return self._interrupts.exit_code(code)

    def on_warning(self, text: str) -> None:
        """Print a doubt about the start, before the first step."""
        self.printed_warnings.add(text)
        say(f"warning: {text}")

    def on_window(self, window: Window) -> None:
        """Show the part of a large image that a run begins on."""
        if self._bar is not None:
            size_text = " x ".join(str(n) for n in reversed(window.shape))
            self._bar.show(completed=0, state=f"a window of {size_text} voxels")
        if self._show_json:
            first, size = list(reversed(window.corner)), list(reversed(window.shape))
            print_json({"event": "window", "run": self._label, "first_voxel": first, "size": size})

    def on_step(self, record: StepRecord, object_id: int | None = None) -> bool:
        """Show one step, of the object ``object_id`` if there are several.

        Returns
        -------
        bool
            True to ask the run to stop.
        """
        if self._bar is not None:
            where = f"level {record.level}, " if record.level else ""
            where += "" if object_id is None else f"object {object_id}, "
            state = f"{where}energy {record.potential:.5g}, moved {record.motion_voxels:.3f} voxels"
            self._bar.show(completed=record.step, state=state)
        if self._show_json:
            which = {} if object_id is None else {"object": object_id}
            line = {"event": "step", "run": self._label, **which, **row_values(record)}
            print_json(line)
        self._interrupts.check()
        return self.interrupted

    def on_frame(self, done: int, count: int, frame: int, objects: int, seconds: float) -> bool:
        """Show a frame of a tracking that is done.

        Parameters
        ----------
        done, count : int
            How many frames are done, and of how many.
        frame : int
            Its number.
        objects : int
            How many are seen in it.
        seconds : float

        Returns
        -------
        bool
            True to ask the tracking to stop.
        """
        if self._bar is not None:
            state = f"frame {frame}, {objects} object{'' if objects == 1 else 's'}"
            self._bar.show(completed=done, total=count, state=state, unit="frame")
        if self._show_json:
            line = {
                "frame": frame,
                "done": done,
                "frames": count,
                "objects": objects,
                "seconds": seconds,
            }
            print_json({"event": "frame", "run": self._label, **line})
        self._interrupts.check()
        return self.interrupted


@contextmanager
def counted(display: Display, text: str, count: int) -> Iterator[Callable[[str], None]]:
    """Show a bar over ``count`` parts; off a terminal a line at its beginning.

    Yields
    ------
    callable
        To be called with the name of each part as it begins.
    """
    kind, begun = shown_kind(display), [0]
    bar = None
    if kind == "bar":
        bar = _Bar(text, "{task.completed:.0f}/{task.total:.0f}", count, state="")
    elif kind == "json":
        print_json({"event": "compiling", "message": text})
    elif not display.quiet:
        say(text)

    def advance(name: str) -> None:
        if bar is not None:
            bar.show(completed=begun[0], state=name)
        begun[0] += 1

    try:
        yield advance
        if bar is not None:
            bar.show(completed=count, state="")
    finally:
        if bar is not None:
            bar.stop()


def shown_kind(display: Display) -> ProgressKind:
    """The kind of progress to show: as asked for, else a bar on a terminal."""
    return display.progress or ("bar" if sys.stderr.isatty() and not display.quiet else "none")


def print_json(line: Mapping[str, Any]) -> None:
    """Print an event on stderr, as JSON on one line."""
    say(json.dumps(json.loads(to_json(line))))


def table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table as text: the first column to the left, the others to the right.

    Examples
    --------
    >>> print(table(("flow", "steps"), [("gradient", "12")]))
    flow      steps
    gradient     12
    """
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = [
        "  ".join(
            [row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in range(1, len(row)))]
        ).rstrip()
        for row in (header, *rows)
    ]
    return "\n".join(lines)


class BatchProgress:
    """Shows the progress of the cases. A context manager.

    Parameters
    ----------
    display : Display
        The kind of progress to show.
    count : int
        Number of cases.
    what : str, optional
        What they are called.
    """

    def __init__(self, display: Display, count: int, what: str = "cases") -> None:
        kind = shown_kind(display)
        self._show_json, self._quiet = kind == "json", display.quiet
        self._count, self._done, self._failed = count, 0, 0
        self._what, self._has_bar = what, kind == "bar"
        self._bar: _Bar | None = None

    def __enter__(self) -> BatchProgress:
        if self._has_bar:
            text = f"{{task.completed:.0f}}/{{task.total:.0f}} {self._what}"
            self._bar = _Bar("", text, self._count, state="starting")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def found(self, count: int) -> None:
        """Show the number of cases that are finished already."""
        self._done += count
        if self._show_json:
            self._print("found", finished=count)
        elif not self._quiet:
            say(f"{count} of {self._count} cases are finished already")
        self._show_state(None)

    def started(self, id: str) -> None:
        """A case begins."""
        if self._show_json:
            self._print("start", case=id)

    def ended(self, outcome: Outcome, seconds_left: float | None) -> None:
        """A case has ended."""
        self._done += 1
        self._failed += outcome.status == "failed"
        if self._show_json:
            self._print(
                "end",
                case=outcome.id,
                status=outcome.status,
                reason=outcome.reason,
                seconds=outcome.seconds,
                seconds_left=seconds_left,
            )
        elif outcome.status == "failed":
            say(printable(f"failed: {outcome.id}: {outcome.reason}", MAX_ERROR))
        self._show_state(seconds_left)

    def ended_objects(self, name: str, count: int, failure: str) -> None:
        """Show that ``count`` objects, called ``name``, have ended at once; ``failure`` says why there is nothing."""
        self._done += count
        self._failed += count if failure else 0
        if self._show_json:
            self._print(
                "end", objects_of=name, status="failed" if failure else "ok", reason=failure
            )
        elif failure:
            say(printable(f"failed: {name}: {failure}", MAX_ERROR))
        self._show_state(None)

    def take_back(self, count: int) -> None:
        """Take back the end of ``count`` objects, which are run once more."""
        self._done -= count

    def warned(self, text: str) -> None:
        """Something about the batch itself is not as it should be."""
        say(printable(f"warning: {text}", MAX_ERROR))

    def _show_state(self, seconds_left: float | None) -> None:
        if self._bar is not None:
            self._bar.show(completed=self._done, state=state_text(self._failed, seconds_left))

    def _print(self, event: str, **fields: Any) -> None:
        print_json(
            {
                "event": event,
                **fields,
                "done": self._done,
                "failed": self._failed,
                self._what: self._count,
            }
        )


def state_text(failed: int, seconds_left: float | None) -> str:
    """Return the text beside the bar.

    Examples
    --------
    >>> state_text(0, 75.0), state_text(2, None), state_text(1, 7300.0)
    ('1 min left', '2 failed', '1 failed, 2 h 2 min left')
    """
    parts = [f"{failed} failed"] if failed else []
    if seconds_left is not None:
        minutes = round(seconds_left / 60)
        time = f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"
        parts.append(f"{time if seconds_left >= 60 else f'{seconds_left:.0f} s'} left")
    return ", ".join(parts)


class _Bar:
    """A bar for a terminal, with a count and the state beside it.

    Parameters
    ----------
    label : str
        Text before the bar; empty for none.
    count : str
        Format of the count, of a task of rich.
    total : int
    **fields
        First ``state``, and what else ``count`` has.
    """

    def __init__(self, label: str, count: str, total: int, **fields: Any) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            *([TextColumn("{task.description}")] if label else []),
            BarColumn(bar_width=24),
            TextColumn(count),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._task = self._progress.add_task(label, total=total, **fields)
        self._progress.start()

    def show(self, **values: Any) -> None:
        self._progress.update(self._task, **values)

    def say(self, line: str) -> None:
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def stop(self) -> None:
        self._progress.stop()
