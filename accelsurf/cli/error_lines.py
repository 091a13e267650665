"""Lines about errors and doubts: short, on one line, in characters that a terminal prints."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from accelsurf.cli.interrupts import say
from accelsurf.errors import AccelsurfWarning
from accelsurf.settings.wording import escaped, shown

#: Longest line of an error and of a hint, characters: most paths have room, a megabyte of garbage has not.
MAX_ERROR, MAX_HINT = 390, 1000


def without_garbage(message: str, arguments: Sequence[str]) -> str:
    """Return a message of the command line's parser, with what was typed cut to a readable length.

    Examples
    --------
    >>> len(without_garbage('Unknown option: "' + 200 * "x" + '"', [200 * "x"]))
    78
    """
    for word in sorted(arguments, key=len, reverse=True):
        for part in (word, *word.split("=", 1)):
            if part and shown(part) != part:
                message = message.replace(part, shown(part))
    return message


def printable(text: str, length: int) -> str:
    """Return a text as one line that a terminal prints; if it is longer than ``length`` its middle is left out.

    Examples
    --------
    >>> printable("abc" + 100 * "x" + "yz", 20)
    'abcxxxxx...xxxxxxyz'
    """
    text = " ".join(text.split())
    for _ in range(2):  # escapes make it longer again
        if len(text) > length:
            text = text[: length // 2 - 2] + "..." + text[2 - length // 2 :]
        text = escaped(text)
    return text


def doubt_line(text: str) -> str:
    """Return the line about a doubt: a warning, unless it says itself that it is a note.

    Examples
    --------
    >>> doubt_line("area: it shrinks"), doubt_line("object 3: note: click: of two kinds")
    ('warning: area: it shrinks', 'note: object 3: click: of two kinds')
    """
    before, note, after = text.partition("note: ")
    is_note = note and (not before or before.startswith("object "))
    return f"note: {before}{after}" if is_note else f"warning: {text}"


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print each warning of accelsurf once, as a line; those of libraries go the usual way."""
    with warnings.catch_warnings():
        usual, seen = warnings.showwarning, set[str]()

        def show(message, category, *args, **kwargs):  # type: ignore[no-untyped-def]
            if not issubclass(category, AccelsurfWarning):
                usual(message, category, *args, **kwargs)
            elif str(message) not in seen:
                seen.add(str(message))
                say("warning: " + printable(str(message), MAX_HINT))

        warnings.simplefilter("always", AccelsurfWarning)
        warnings.showwarning = show
        yield
