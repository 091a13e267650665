"""Progress on stderr, of a batch and of parts that are counted, and tables as text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any

from accelsurf.cases import MAX_ERROR, Bar, print_json, printable, say, shown_kind
from accelsurf.cli.options import Display

if TYPE_CHECKING:
    from accelsurf.batch import Outcome

#: Said where all are compiled.
COMPILING_ALL = "compiling kernels, once: about a minute"


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
        bar = Bar(text, "{task.completed:.0f}/{task.total:.0f}", count, state="")
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


def table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table as text: the first column to the left, the others to the right.

    Examples
    --------
    >>> print(table(("flow", "steps"), [("gradient", "12")]))
    flow      steps
    gradient     12
    """
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = []
    for row in (header, *rows):
        others = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *others]).rstrip())
    return "\n".join(lines)


class BatchProgress:
    """Shows the progress of the cases. A context manager.

    Parameters
    ----------
    display : Display
        The kind of progress to show.
    count : int
        Number of cases.
    unit : str, optional
        Noun for them, in the plural.
    """

    def __init__(self, display: Display, count: int, unit: str = "cases") -> None:
        kind = shown_kind(display)
        self._show_json, self._quiet = kind == "json", display.quiet
        self._count = count
        self._done = 0
        self._failed = 0
        self._unit, self._has_bar = unit, kind == "bar"
        self._bar: Bar | None = None

    def __enter__(self) -> BatchProgress:
        if self._has_bar:
            text = f"{{task.completed:.0f}}/{{task.total:.0f}} {self._unit}"
            self._bar = Bar("", text, self._count, state="starting")
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
                self._unit: self._count,
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
