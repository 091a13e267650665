"""The command line. Each command is one thin module, imported when it is called: ``--help`` loads nothing heavy.

Results go to stdout, progress and errors to stderr. An error is one line and a hint; ``--debug`` shows the traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import NoReturn

from cyclopts import App, CycloptsError

from accelsurf import __version__
from accelsurf.errors import AccelsurfError

INTERRUPTED = 130

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
    INTERRUPTED: "interrupted (Ctrl-C); the present state is written",
}

_OF_EVERY_COMMAND = ("--debug", "--allow-outside-data")

app = App(
    name="accelsurf",
    help="Surfaces of objects in 3D images, by level sets with momentum.",
    help_epilogue="Every command takes --help, --debug to show the full traceback of an error, and "
    "--allow-outside-data to read data files that a header (.mhd, .nrrd) names in other folders than its own.",
    version=__version__,
    help_format="plaintext",
)
app.command("accelsurf.cli.demo:demo", name="demo", help="Segment a cube in noise with and without momentum.")
app.command("accelsurf.cli.segment:segment", name="segment", help="Segment one object in a volume.")
app.command("accelsurf.cli.synth:synth", name="synth", help="Make a synthetic volume and its truth from a recipe.")
app.command("accelsurf.cli.compare:compare", name="compare", help="Run several flows on one volume side by side.")
app.command("accelsurf.cli.movie:movie", name="movie", help="Make a movie of a run, without a screen.")
app.command("accelsurf.cli.evaluate:evaluate", name="evaluate", help="Measure how well two label maps agree.")
app.command("accelsurf.cli.view:view", name="view", help="Watch and steer a segmentation in a window.")
app.command("accelsurf.cli.info:info", name="info", help="Show versions, names, exit codes and settings.")


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and end the process with its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process by default.
    """
    sys.exit(execute(sys.argv[1:] if argv is None else argv))


def execute(argv: Sequence[str]) -> int:
    """Run the command line and return its exit code; see ``EXIT_CODES``.

    Parameters
    ----------
    argv : sequence of str
        Arguments without the program's name.
    """
    arguments = list(argv)
    end = arguments.index("--") if "--" in arguments else len(arguments)
    debug, outside = (word in arguments[:end] for word in _OF_EVERY_COMMAND)
    arguments = [word for place, word in enumerate(arguments) if word not in _OF_EVERY_COMMAND or place >= end]
    try:
        with _outside_data(outside):
            code = app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return int(code or 0)
    except CycloptsError as error:
        command = " ".join(["accelsurf", *(error.command_chain or ())])
        return _say(2, str(error), f"{command} --help lists the options")
    except AccelsurfError as error:
        if debug:
            raise
        return _say(error.exit_code, error.message, error.hint)
    except KeyboardInterrupt:
        return _say(INTERRUPTED, "interrupted", "")
    except BrokenPipeError:
        # The reader of stdout closed it (as in `accelsurf info | head`): not our error, but stdout cannot be used.
        sys.stdout = None
        return 0
    except MemoryError as error:
        if debug:
            raise
        return _say(3, f"not enough memory {error}".strip(), "crop or downsample the volume")
    except Exception as error:
        if debug:
            raise
        hint = "this is a bug in accelsurf; run again with --debug and report the traceback"
        return _say(1, f"{type(error).__name__}: {error}", hint)


def _outside_data(allowed: bool) -> AbstractContextManager[None]:
    if not allowed:
        return nullcontext()
    from accelsurf.io.headers import outside_data_allowed

    return outside_data_allowed()


def _say(code: int, message: str, hint: str) -> int:
    """Print one line about an error, and one about what to do, to stderr; return the code."""
    print("error: " + " ".join(message.split()), file=sys.stderr)
    if hint:
        print("hint: " + " ".join(hint.split()), file=sys.stderr)
    return code
