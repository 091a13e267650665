"""When a session looks for where to click next."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from accelsurf.segmentation.result import Result
    from accelsurf.segmentation.run import Run
    from accelsurf.viewer.core.doubts import Doubt

#: Seconds without a command after which doubts are looked for.
QUIET = 0.4


class DoubtWatch:
    """When the doubts of a session are looked for: once for each state after the run's end, when nothing else is asked.

    Looking takes tenths of a second on a large object, which the next command must not wait for.
    """

    def __init__(self) -> None:
        self._looked_at, self._busy_until = -1, 0.0

    def is_wanted(self, version: int, has_ended: bool) -> bool:
        """Whether this version of the state has not been looked at."""
        return has_ended and self._looked_at != version

    def postpone(self) -> None:
        """Something was done: wait again until it has been quiet for some time."""
        self._busy_until = time.perf_counter() + QUIET

    def find(self, version: int, run: Run, corrected: Result | None) -> tuple[Doubt, ...] | None:
        """The doubts of a version of the state; None while it is not quiet yet."""
        from accelsurf.segmentation.run_result import result_of
        from accelsurf.viewer.core.doubts import doubts_of

        if time.perf_counter() < self._busy_until:
            return None
        self._looked_at = version
        return doubts_of(corrected if corrected is not None else result_of(run))
