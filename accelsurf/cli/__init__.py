"""The command line. Each command is one thin module, imported when it is called: ``--help`` loads nothing heavy.

Results go to stdout, progress and errors to stderr. An error is one line and a hint; ``--debug`` shows the traceback.
"""

from __future__ import annotations

import atexit
import errno
import os
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from cyclopts import App, CycloptsError, UnusedCliTokensError

from accelsurf.cases import (
    INTERRUPTED,
    MAX_ERROR,
    MAX_HINT,
    Interrupts,
    open_missing,
    output_failure,
    printable,
    say,
    shown_warnings,
)
from accelsurf.errors import AccelsurfError
from accelsurf.version import __version__

if TYPE_CHECKING:
    from cyclopts.help.protocols import HelpFormatter

#: Letters of a name that an error shows.
_SHOWN_LETTERS = 60
#: Exit code -> meaning, as documented and as `accelsurf info` lists them.
EXIT_CODES = {
    0: "ok",
    1: "internal error, or the run diverged",
    2: "usage: an option or a setting is not valid",
    3: "input unreadable, unsuitable, or of invalid geometry",
    4: "not converged (only with --strict)",
    5: "the surface vanished or filled the volume; with --strict also a doubtful result",
    7: "an output exists already, or cannot be written",
    8: "nothing can be drawn: no screen or driver, or a package of the viewer is missing",
    9: "some cases of a batch or of an evaluation, or some objects of a large image, failed; the others are complete",
    INTERRUPTED: "interrupted (Ctrl-C); no result is written, the state of a run is kept for --resume",
    143: "ended by SIGTERM; as 130",
}

#: Commands and their help; each is the function of this name in the module of this name.
_COMMANDS = {
    "look": "Show slices of an image with a grid in mm, without a run.",
    "segment": "Segment one object in a volume.",
    "batch": "Segment many images, or track many sequences.",
    "refine": "Correct a result by clicks; the rest stays as it is.",
    "track": "Follow objects through a sequence of images.",
    "synth": "Make a synthetic volume and its truth from a recipe.",
    "fetch": "Fetch a public scan to try things on.",
    "movie": "Make a movie of a run, without a screen.",
    "evaluate": "Measure how well two label maps agree.",
    "view": "Watch and steer a segmentation in a window.",
    "serve": "Answer the clicks of Slicer, napari and other viewers.",
    "warmup": "Compile all kernels now, so that no run waits for it.",
    "info": "Show versions, names, exit codes and settings.",
}
#: Shows all options of a command.
HELP_ALL = "--help-all"
#: A value that begins with a minus sign, as of coordinates.
_NEGATIVE = re.compile(r"-\.?\d")


def made_app(formatter: HelpFormatter | None = None) -> App:
    """Make the parser of the command line.

    Parameters
    ----------
    formatter : HelpFormatter, optional
        Draws the help; cyclopts' own draws all of it.
    """
    app = App(
        name="accelsurf",
        help="Surfaces of objects in 3D images, by level sets with momentum.",
        help_epilogue="Every command takes --help, --help-all, and --debug to show the full traceback of an error. "
        "accelsurf SCAN is accelsurf view SCAN.",
        version=__version__,
        help_format="plaintext",
        help_formatter=formatter,
        suppress_keyboard_interrupt=False,  # it would end the process without a line
    )
    # cyclopts imports a command that is named so when it is called.
    for name, text in _COMMANDS.items():
        app.command(f"accelsurf.cli.{name}:{name}", name=name, help=text)
    app.command(
        "accelsurf.cli.completion:install_completion",
        name="--install-completion",
        help="Complete commands, options and names with TAB in this shell.",
    )
    return app


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and end the process with its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; the arguments of the process by default.
    """
    interrupts = Interrupts()
    code = 1
    # Nothing here uses the linear algebra of numpy and SciPy, each of which brings threads that spin while they start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        interrupts.install()
        open_missing()
        code = execute(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        interrupts.report("error: ")
    except Exception:
        sys.excepthook(*sys.exc_info())
    _leave(code, interrupts)


def _leave(code: int, interrupts: Interrupts) -> NoReturn:
    """End the process at once, so that a signal either changes its exit code or comes too late.

    Python's own end takes a fraction of a second more, in which a signal would print a traceback or do nothing.
    """
    try:
        interrupts.end()
    except KeyboardInterrupt:
        interrupts.end()
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            continue
    atexit._run_exitfuncs()
    interrupts.report()
    os._exit(interrupts.exit_code(code))


def execute(argv: Sequence[str]) -> int:
    """Run the command line and return its exit code; see ``EXIT_CODES``.

    Parameters
    ----------
    argv : sequence of str
        Arguments without the program's name.
    """
    arguments = list(argv)
    end = arguments.index("--") if "--" in arguments else len(arguments)
    debug = "--debug" in arguments[:end]
    arguments = [word for place, word in enumerate(arguments) if word != "--debug" or place >= end]
    interrupts = Interrupts.current()
    interrupts.install()
    try:
        with shown_warnings():
            code = _run(arguments, debug, interrupts)
        return interrupts.exit_code(code)
    finally:
        interrupts.uninstall()


def _run(arguments: list[str], debug: bool, interrupts: Interrupts) -> int:
    """Run a command; print its error."""
    try:
        app = _app_for(arguments)
        arguments = as_parsed(arguments)
        code = int(
            app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
            or 0
        )
        sys.stdout.flush()
    except CycloptsError as error:
        command = " ".join(["accelsurf", *(error.command_chain or ())])
        problem = str(error)
        if isinstance(error, UnusedCliTokensError):
            problem = f"{command}: {' '.join(error.unused_tokens or ())}: unexpected argument"
        return _say(2, problem, f"{command} --help lists the options")
    except AccelsurfError as error:
        if debug:
            raise
        return _say(error.exit_code, error.message, error.hint)
    except MemoryError as error:
        if debug:
            raise
        return _say(3, f"not enough memory {error}".strip(), "crop or downsample the volume")
    except SystemExit:  # of rich, which prints the help, when nobody reads it any more
        return 0
    except (KeyboardInterrupt, Exception) as error:
        # A library may have turned the exception of a signal into one of its own.
        if isinstance(error, KeyboardInterrupt) or interrupts.count:
            interrupts.report("error: ")
            return interrupts.exit_code(INTERRUPTED)
        if (failure := output_failure(error)) is not None:
            # A reader that has seen enough, as in `accelsurf info | head`, is no error.
            if failure.errno == errno.EPIPE:
                return 0
            problem = f"standard output: cannot be written ({failure.strerror})"
            return _say(7, problem, "files that were written are complete")
        if debug:
            raise
        if (wrong := _wrong_name(error)) is not None:
            return _say(3, wrong, "correct the name")
        hint = "this is a bug in accelsurf; run again with --debug and report the traceback"
        return _say(1, f"{type(error).__name__}: {error}", hint)
    interrupts.report()
    return code


def _wrong_name(error: BaseException) -> str | None:
    """Return the fault of a file name that the system refuses; None for other errors.

    Most functions of Path raise an error for these names: whoever gave one, no file has it.
    """
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "a file"
        short = name if len(name) <= _SHOWN_LETTERS else f"{name[:_SHOWN_LETTERS]}..."
        return f"{short}: the name of the file is too long"
    if isinstance(error, ValueError) and str(error).startswith("embedded null"):
        return "the name of a file has a zero byte"
    return None


def _app_for(arguments: Sequence[str]) -> App:
    """The parser; with short help where a command of many options is asked for it."""
    if HELP_ALL in arguments or not {"--help", "-h"}.intersection(arguments):
        return made_app()
    from accelsurf.cli.short_help import COMMANDS, ShortHelp

    return made_app(ShortHelp() if arguments[0] in COMMANDS else None)


def as_parsed(arguments: Sequence[str]) -> list[str]:
    """Write arguments as the parser takes them.

    A value with a minus sign is joined to its option, as the parser would take it for an option; a scan alone is
    looked at.

    Examples
    --------
    >>> as_parsed(["look", "ct.nii", "--at", "-10,20,5"])
    ['look', 'ct.nii', '--at=-10,20,5']
    """
    out: list[str] = []
    first = arguments[0] if arguments else "-"
    if not first.startswith("-") and first not in _COMMANDS and os.path.exists(first):
        out.append("view")
    for word in arguments:
        if (
            _NEGATIVE.match(word)
            and out
            and out[-1].startswith("--")
            and "=" not in out[-1]
            and out[-1] != "--"
        ):
            out[-1] = f"{out[-1]}={word}"
        else:
            out.append("--help" if word == HELP_ALL else word)
    return out


def _say(code: int, message: str, hint: str) -> int:
    """Print one line about an error, and one with the hint, to stderr; return the code."""
    say("error: " + printable(message, MAX_ERROR))
    if hint:
        say("hint: " + printable(hint, MAX_HINT))
    return code
