"""Progress of a run on stderr, and the way Ctrl-C reaches it."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

from accelsurf.cli.options import Display
from accelsurf.report.document import to_json
from accelsurf.settings.trace_columns import row_values

if TYPE_CHECKING:
    from accelsurf.evolution.records import StepRecord


#: What the bar says until the first step: the one place where a run may seem to hang.
BEFORE = "preparing (the first run on a machine compiles for about half a minute)"


class Watcher:
    """Shows each step, and asks the run to stop once Ctrl-C was pressed.

    Parameters
    ----------
    display : Display
        What the person asked to see.
    """

    def __init__(self, display: Display) -> None:
        kind = display.progress or ("bar" if sys.stderr.isatty() and not display.quiet else "none")
        self._show_json = kind == "json"
        self._bar = _Bar() if kind == "bar" else None
        self.interrupted = False

    @contextmanager
    def watch(self, label: str, max_steps: int) -> Iterator[Watcher]:
        """Show one run. Until it ends, a first Ctrl-C asks it to stop and a second one breaks it off.

        Parameters
        ----------
        label : str
            Name of the run.
        max_steps : int
            The most steps it may take.
        """
        if self._bar is not None:
            self._bar.start(label, max_steps)
        self._label = label
        before = signal.signal(signal.SIGINT, self._ask_to_stop)
        try:
            yield self
        finally:
            signal.signal(signal.SIGINT, before)
            if self._bar is not None:
                self._bar.stop()

    def _ask_to_stop(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True
        print("interrupted: ending this step and writing what was reached (once more: give up)", file=sys.stderr)

    def on_step(self, row: StepRecord, own: int | None = None) -> bool:
        """Show one step, of the object ``own`` if there are several.

        Returns
        -------
        bool
            True to ask the run to stop.
        """
        if self._bar is not None:
            self._bar.step(row, "" if own is None else f"object {own}, ")
        if self._show_json:
            line = {"event": "step", "run": self._label, **({} if own is None else {"object": own}), **row_values(row)}
            print(json.dumps(json.loads(to_json(line))), file=sys.stderr, flush=True)
        return self.interrupted


class _Bar:
    """A bar for a terminal."""

    def start(self, label: str, max_steps: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("step {task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._task = self._progress.add_task(label, total=max_steps, state=BEFORE)
        self._progress.start()

    def step(self, row: Any, what: str) -> None:
        state = f"{what}energy {row.potential:.5g}, moved {row.motion_voxels:.3f} voxels"
        if row.level:
            state = f"level {row.level}, {state}"
        self._progress.update(self._task, completed=row.step, state=state)

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
