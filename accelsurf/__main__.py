"""The program ``accelsurf``, also ``python -m accelsurf``."""

from __future__ import annotations

import gc
import os
from typing import NoReturn

#: So many new containers before Python looks for cycles among the youngest. What is imported, loaded and drawn makes
#: 400,000 that stay, which Python's own 700 would have looked through 450 times; steps make none that stay.
GC_THRESHOLD = 500_000


def main() -> NoReturn:
    """Run the command line of this process; Ctrl-C ends it in one line also while the program is being loaded."""
    gc.set_threshold(GC_THRESHOLD)  # in the program only: who imports accelsurf chooses for himself
    try:
        from accelsurf.cli import main as run
    except KeyboardInterrupt:
        os.write(2, b"error: interrupted: no result is written; what was there before is as it was\n")
        os._exit(130)
    run()


if __name__ == "__main__":
    main()
