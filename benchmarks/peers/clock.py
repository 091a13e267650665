"""Where the seconds of a run go: by kernel of the threads' pool, and by stage where the package keeps a record."""

from __future__ import annotations

import time
from typing import Any

from accelsurf.levelset import Workers


class Clock:
    """Counts the seconds that a `Workers` spends in each kernel: the parallel parts of a run.

    Wraps the three calls through which every parallel kernel goes; costs about a microsecond a call.
    """

    def __init__(self, workers: Workers) -> None:
        self.kernels: dict[str, float] = {}
        self._workers = workers
        for name in ("parallel", "block_sums", "plane_sums"):
            setattr(workers, name, self._wrapped(getattr(workers, name)))

    def _wrapped(self, call: Any) -> Any:
        def wrapper(kernel: Any, *args: Any, **keywords: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(kernel, *args, **keywords)
            finally:
                name = getattr(kernel, "__name__", str(kernel))
                self.kernels[name] = self.kernels.get(name, 0.0) + time.perf_counter() - began

        return wrapper

    @property
    def parallel(self) -> float:
        """Seconds in kernels that run on all threads."""
        return sum(self.kernels.values())

    @property
    def stages(self) -> dict[str, float]:
        """The package's own record of seconds by kernel, those that run on one thread among them."""
        return dict(self._workers.seconds)

    def reset(self) -> None:
        """Forget what was counted."""
        self.kernels.clear()
        self._workers.seconds.clear()
