"""Progress of a case on stderr: a bar, or a line of JSON for each event; Ctrl-C ends a run."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, Protocol

from accelsurf.cases.interrupts import Interrupts, say
from accelsurf.output import report_json
from accelsurf.settings.trace_columns import row_values

if TYPE_CHECKING:
    from accelsurf.evolution import StepRecord
    from accelsurf.grid.window import Window

ProgressKind = Literal["bar", "json", "none"]
#: Text of the bar until the first step, when nothing else moves.
PREPARING = "preparing"
#: Said before the first kernel of a command is compiled: where kernels can be stored, and where they cannot.
COMPILING = "note: compiling, once: up to a minute of the processor (all: accelsurf warmup)"
COMPILING_ANEW = "note: compiling kernels, in each run: NUMBA_CACHE_DIR names a folder for them"


class Display(Protocol):
    """Display of progress and messages."""

    @property
    def quiet(self) -> bool:
        """True to print nothing but warnings and errors."""
        ...

    @property
    def progress(self) -> ProgressKind | None:
        """Kind of progress; None for a bar on a terminal."""
        ...


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
        self._bar: Bar | None = None
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
            The action after that step.
        """
        from accelsurf.kernels.storage import first_compilation

        if self._has_bar:
            count = "{task.fields[unit]} {task.completed:.0f}/{task.total:.0f}"
            self._bar = Bar(label, count, max_steps, state=PREPARING, unit="step")
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
        """Print a warning about the start, before the first step."""
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


def shown_kind(display: Display) -> ProgressKind:
    """The kind of progress to show: as asked for, else a bar on a terminal."""
    return display.progress or ("bar" if sys.stderr.isatty() and not display.quiet else "none")


def print_json(line: Mapping[str, Any]) -> None:
    """Print an event on stderr, as JSON on one line."""
    say(json.dumps(json.loads(report_json(line))))


class Bar:
    """A bar for a terminal, with a count and the state beside it.

    Parameters
    ----------
    label : str
        Text before the bar; empty for none.
    count : str
        Format of the count, of a task of rich.
    total : int
    **fields
        First ``state``, and further fields of ``count``.
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
        """Set count and state."""
        self._progress.update(self._task, **values)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def stop(self) -> None:
        """End it."""
        self._progress.stop()
