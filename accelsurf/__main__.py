"""``python -m accelsurf`` is the command ``accelsurf``."""

from accelsurf.cli import main

if __name__ == "__main__":
    main()
