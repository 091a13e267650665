"""Progress of a batch on stderr: a bar with the time left, or a line of JSON for each event; failures are named."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any

from accelsurf.cli.error_lines import MAX_ERROR, printable
from accelsurf.cli.interrupts import say
from accelsurf.cli.options import Display
from accelsurf.cli.progress import print_json, shown_kind

if TYPE_CHECKING:
    from accelsurf.batch.outcome import Outcome


class BatchProgress:
    """Shows what becomes of the cases. A context manager.

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
        self._what = what
        self._bar = _Bar(count, what) if kind == "bar" else None

    def __enter__(self) -> BatchProgress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def found(self, count: int) -> None:
        """So many cases are finished already."""
        self._done += count
        if self._show_json:
            self._print("found", finished=count)
        elif not self._quiet:
            say(f"{count} of {self._count} cases are finished already")
        if self._bar is not None:
            self._bar.show(self._done, self._failed, None)

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
        if self._bar is not None:
            self._bar.show(self._done, self._failed, seconds_left)

    def ended_objects(self, name: str, count: int, failure: str) -> None:
        """So many objects, which are called ``name``, have ended at once; ``failure`` says why there is nothing."""
        self._done += count
        self._failed += count if failure else 0
        if self._show_json:
            self._print("end", objects_of=name, status="failed" if failure else "ok", reason=failure)
        elif failure:
            say(printable(f"failed: {name}: {failure}", MAX_ERROR))
        if self._bar is not None:
            self._bar.show(self._done, self._failed, None)

    def taken_back(self, count: int) -> None:
        """So many that had ended are run once more."""
        self._done -= count

    def warned(self, text: str) -> None:
        """Something about the batch itself is not as it should be."""
        say(printable(f"warning: {text}", MAX_ERROR))

    def _print(self, event: str, **facts: Any) -> None:
        print_json({"event": event, **facts, "done": self._done, "failed": self._failed, self._what: self._count})


class _Bar:
    """A bar for a terminal."""

    def __init__(self, count: int, what: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            BarColumn(bar_width=24),
            TextColumn(f"{{task.completed:.0f}}/{{task.total:.0f}} {what}"),
            TextColumn("{task.fields[state]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
        )
        self._task = self._progress.add_task("", total=count, state="starting")

    def start(self) -> None:
        self._progress.start()

    def show(self, done: int, failed: int, seconds_left: float | None) -> None:
        self._progress.update(self._task, completed=done, state=state_text(failed, seconds_left))

    def stop(self) -> None:
        self._progress.stop()


def state_text(failed: int, seconds_left: float | None) -> str:
    """Return what stands beside the bar.

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
