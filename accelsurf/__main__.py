"""The program ``accelsurf``, also ``python -m accelsurf``."""

from __future__ import annotations

import os
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line of this process; Ctrl-C ends it in one line also while the program is being loaded."""
    try:
        from accelsurf.cli import main as run
    except KeyboardInterrupt:
        os.write(2, b"error: interrupted: no result is written; what was there before is as it was\n")
        os._exit(130)
    run()


if __name__ == "__main__":
    main()
