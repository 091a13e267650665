"""The program ``accelsurf``, also ``python -m accelsurf``."""

from __future__ import annotations

import gc
import os
import sys
from typing import NoReturn

#: Number of new containers before Python looks for cycles among the youngest. Imports, loading and drawing make
#: 400,000 that stay, which Python's own 700 would have looked through 450 times; steps make none that stay.
GC_THRESHOLD = 500_000
#: The same for commands that go on for hours: an image that is in a cycle shall not stay for long.
LONG = ("batch", "track", "serve")
LONG_THRESHOLD = 50_000


def main() -> NoReturn:
    """Run the command line of this process; Ctrl-C ends it in one line also while the program is being loaded."""
    # In the program only: who imports accelsurf chooses for himself.
    gc.set_threshold(LONG_THRESHOLD if len(sys.argv) > 1 and sys.argv[1] in LONG else GC_THRESHOLD)
    try:
        from accelsurf.cli import main as run
    except KeyboardInterrupt:
        os.write(
            2, b"error: interrupted: no result is written; what was there before is as it was\n"
        )
        os._exit(130)
    run()


if __name__ == "__main__":
    main()
