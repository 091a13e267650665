"""The errors of accelsurf: each has the value given, the expected one, and advice.

The command line turns them into one line, a hint and an exit code; in Python the hint travels as a note, so a
traceback shows it below the message.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

_MAX_MESSAGE = 800  # characters


def _shortened(text: str) -> str:
    """A text without its middle where it is very long: a damaged file is not quoted in full."""
    return (
        text
        if len(text) <= _MAX_MESSAGE
        else f"{text[: _MAX_MESSAGE // 2]} ... {text[-_MAX_MESSAGE // 2 :]}"
    )


class AccelsurfError(Exception):
    """Base of every error that accelsurf raises on purpose.

    Parameters
    ----------
    message : str
        The value given and the expected one. Line breaks are folded, so that ``str(error)`` is one line.
    hint : str, optional
        Advice; empty when there is none.

    Attributes
    ----------
    message, hint : str
        The two texts, each one line.
    exit_code : int
        Exit code of the command line for this family.
    kind : str
        Short machine-readable name of the family, as written in reports.

    Examples
    --------
    >>> error = InputError("scan.nii: the file is empty", hint="copy it again")
    >>> str(error), error.hint, error.exit_code, error.kind
    ('scan.nii: the file is empty', 'copy it again', 3, 'input')
    """

    exit_code: ClassVar[int] = 1
    kind: ClassVar[str] = "internal"

    def __init__(self, message: str, hint: str = "") -> None:
        self.message = _shortened(" ".join(str(message).split()))
        self.hint = " ".join(str(hint).split())
        super().__init__(self.message)
        if self.hint:
            self.add_note(f"hint: {self.hint}")

    def __reduce__(self) -> tuple[type[AccelsurfError], tuple[str, str]]:
        # Exception pickles only `args`; without this a worker process would lose the hint.
        return type(self), (self.message, self.hint)


class AccelsurfWarning(UserWarning):
    """Something that a person should know although the work goes on."""


class UsageError(AccelsurfError):
    """An option, a setting or a combination of them that is not valid (exit 2)."""

    exit_code = 2
    kind = "usage"


class InputError(AccelsurfError):
    """A file or an array that cannot be used: unreadable, damaged, or of the wrong kind (exit 3)."""

    exit_code = 3
    kind = "input"


class GeometryError(InputError):
    """An invalid grid: bad spacing, sheared axes, or two grids that should agree and do not (exit 3)."""

    kind = "geometry"


class EmptyResultError(AccelsurfError):
    """The surface vanished or filled the whole volume, so there is no object to write (exit 5)."""

    exit_code = 5
    kind = "empty-result"


class OutputError(AccelsurfError):
    """An output exists already, or cannot be written (exit 7)."""

    exit_code = 7
    kind = "output"


def check_known(what: str, given: str, known: Iterable[str]) -> None:
    """Refuse a word that is none of those ``known``.

    Raises
    ------
    UsageError
        With the known words.
    """
    names = tuple(known)
    if given not in names:
        raise UsageError(
            f"{what}: {given[:60]} was given, expected {', '.join(names)}",
            f"use {names[0]}, for example",
        )


class NotConvergedError(AccelsurfError):
    """The run ended before it converged, which --strict makes an error (exit 4)."""

    exit_code = 4
    kind = "not-converged"


class DoubtfulError(AccelsurfError):
    """There is a result, but its quality is uncertain, which --strict makes an error (exit 5)."""

    exit_code = 5
    kind = "doubtful"


class DivergedError(AccelsurfError):
    """The energy became infinite or NaN (exit 1)."""

    kind = "diverged"


def exit_code_of(error: BaseException) -> int:
    """Return the exit code of a run that an error has ended.

    Examples
    --------
    >>> exit_code_of(OutputError("no space")), exit_code_of(MemoryError()), exit_code_of(KeyError("psi"))
    (7, 3, 1)
    """
    if isinstance(error, AccelsurfError):
        return error.exit_code
    return InputError.exit_code if isinstance(error, MemoryError) else AccelsurfError.exit_code
