"""The levels of a pyramid: which of them fits into the memory."""

from __future__ import annotations

import math
from collections.abc import Sequence

from accelsurf.errors import UsageError
from accelsurf.io.memory import available_memory
from accelsurf.settings.reading import Level

#: Of a run, for each voxel, at most.
_RUN_BYTES = 80


def checked_level(level: Level, shapes: Sequence[tuple[int, ...]]) -> int:
    """The number of a level that was asked for.

    Parameters
    ----------
    level : int or "auto"
        "auto" is the finest whose run fits into the free memory, else the coarsest.
    shapes : sequence of tuple of int
        Of the levels, finest first.

    Raises
    ------
    UsageError
        When there is no such level.

    Examples
    --------
    >>> checked_level("auto", [(10**5, 10**5, 10**5), (8, 8, 8)])
    1
    """
    if level == "auto":
        free = available_memory()
        small = (n for n, shape in enumerate(shapes) if math.prod(shape) * _RUN_BYTES <= free)
        return next(small, len(shapes) - 1)
    if not 0 <= level < len(shapes):
        raise UsageError(f"level {level} asked for, the image has {len(shapes)}", f"give 0 to {len(shapes) - 1}")
    return level
