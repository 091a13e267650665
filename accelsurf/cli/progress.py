"""Progress of a run on stderr, and how Ctrl-C ends it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from accelsurf.cli.error_lines import doubt_line
from accelsurf.cli.interrupts import Interrupts, say
from accelsurf.cli.options import Display, ProgressKind
from accelsurf.report.document import to_json
from accelsurf.settings.trace_columns import row_values

if TYPE_CHECKING:
    from accelsurf.evolution.records import StepRecord
    from accelsurf.grid.window import Window


#: What the bar shows until the first step, when nothing else moves.
PREPARING = "preparing"
#: What is said once, before the first kernel is compiled: where kernels can be stored, and where they cannot.
COMPILING = "note: compiling kernels, once: about a minute (or: accelsurf warmup)"
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
        self._bar = _Bar() if kind == "bar" else None
        self._interrupts = Interrupts.current()
        self._is_quiet, self._label = display.quiet, ""
        self._has_noticed = False
        #: Warnings that have been printed before the first step.
        self.said: set[str] = set()

    @contextmanager
    def watch(self, label: str, max_steps: int) -> Iterator[Watcher]:
        """Show one run. Until it ends, a first Ctrl-C ends it after the present step, a second one at once.

        Parameters
        ----------
        label : str
            Name of the run.
        max_steps : int
            Its largest number of steps.
        """
        from accelsurf.kernels.storage import first_compilation

        if self._bar is not None:
            self._bar.start(label, max_steps)
        self._label = label
        try:
            with (
                self._interrupts.patience("finishing this step and writing the result"),
                first_compilation(self._on_compilation),
            ):
                yield self
        finally:
            if self._bar is not None:
                self._bar.stop()

    def _on_compilation(self) -> None:
        """Say once what is waited for, also off a terminal."""
        from accelsurf.kernels.storage import STORAGE

        if self._is_quiet or self._has_noticed:
            return
        self._has_noticed = True
        text = COMPILING_ANEW if STORAGE is None else COMPILING
        if self._show_json:
            print_json({"event": "compiling", "run": self._label, "message": text.removeprefix("note: ")})
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
        """Whether Ctrl-C was pressed."""
        return self._interrupts.count > 0

    @property
    def outcome(self) -> str:
        """What is on the disk, for the last line after Ctrl-C."""
        return self._interrupts.outcome

    @outcome.setter
    def outcome(self, text: str) -> None:
        self._interrupts.outcome = text

    def exit_code(self, code: int) -> int:
        """The exit code of the command, as far as it is known: that of Ctrl-C after it was pressed."""
        return self._interrupts.exit_code(code)

    def on_warning(self, text: str) -> None:
        """Print a doubt about the start, before the first step."""
        self.said.add(text)
        say(doubt_line(text))

    def on_window(self, window: Window) -> None:
        """Show the part of a large image that a run begins on."""
        if self._bar is not None:
            self._bar.window(" x ".join(str(n) for n in reversed(window.shape)))
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
            self._bar.step(record, "" if object_id is None else f"object {object_id}, ")
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
            self._bar.frame(done, count, f"frame {frame}, {objects} object{'' if objects == 1 else 's'}")
        if self._show_json:
            line = {"frame": frame, "done": done, "frames": count, "objects": objects, "seconds": seconds}
            print_json({"event": "frame", "run": self._label, **line})
        self._interrupts.check()
        return self.interrupted


def shown_kind(display: Display) -> ProgressKind:
    """The kind of progress to show: as asked for, else a bar on a terminal."""
    return display.progress or ("bar" if sys.stderr.isatty() and not display.quiet else "none")


def print_json(line: Mapping[str, Any]) -> None:
    """Print an event on stderr, as JSON on one line."""
    print(json.dumps(json.loads(to_json(line))), file=sys.stderr, flush=True)


class _Bar:
    """A bar for a terminal."""

    def start(self, label: str, max_steps: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[unit]} {task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._task = self._progress.add_task(label, total=max_steps, state=PREPARING, unit="step")
        self._progress.start()

    def step(self, record: StepRecord, prefix: str) -> None:
        state = f"{prefix}energy {record.potential:.5g}, moved {record.motion_voxels:.3f} voxels"
        if record.level:
            state = f"level {record.level}, {state}"
        self._progress.update(self._task, completed=record.step, state=state)

    def frame(self, done: int, count: int, state: str) -> None:
        self._progress.update(self._task, completed=done, total=count, state=state, unit="frame")

    def window(self, size: str) -> None:
        self._progress.update(self._task, completed=0, state=f"a window of {size} voxels")

    def say(self, line: str) -> None:
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def stop(self) -> None:
        self._progress.stop()


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
        "  ".join([row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in range(1, len(row)))]).rstrip()
        for row in (header, *rows)
    ]
    return "\n".join(lines)
