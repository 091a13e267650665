"""The program ``accelsurf``, also ``python -m accelsurf``."""

from __future__ import annotations

import sys
from typing import NoReturn

from accelsurf.interrupts import Interrupts


def main() -> NoReturn:
    """Run the command line of this process; end it with the exit code that its signals and its errors ask for."""
    interrupts = Interrupts()
    code = 1
    try:
        interrupts.install()
        from accelsurf.cli import execute, streams

        streams.open_missing()
        code = execute(sys.argv[1:])
    except KeyboardInterrupt:
        interrupts.report("error: ")
    except Exception:
        sys.excepthook(*sys.exc_info())
    leave(code, interrupts)


def leave(code: int, interrupts: Interrupts) -> NoReturn:
    """End the process at once, so that a signal either changes its exit code or comes too late.

    Python's own end takes a fraction of a second more, in which a signal would print a traceback or do nothing.
    """
    import atexit
    import os

    try:
        interrupts.end()
    except KeyboardInterrupt:
        interrupts.end()
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            pass
    atexit._run_exitfuncs()
    interrupts.report()
    os._exit(interrupts.exit_code(code))


if __name__ == "__main__":
    main()
