"""Kernels over ranges of slots in several threads, with the same bytes for any number of them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any

import numpy as np

from accelsurf.kernels.grid import BLOCK


class Workers:
    """Runs kernels that own a range of slots, on ``threads`` threads.

    Kernels release the Python lock and write only inside their range; reductions leave one row per block of
    fixed size, added here in order of the blocks. Use as a context manager, or call `close`.
    """

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        #: Band cells handed to kernels so far: the cost of a run that does not depend on the machine.
        self.visited = 0
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def run(self, kernel: Callable[..., Any], size: int, *args: Any) -> None:
        """Call ``kernel(start, stop, *args)`` so that the ranges cover ``0 .. size``."""
        if size == 0:
            return
        self.visited += size
        blocks = -(-size // BLOCK)
        if self._pool is None or blocks == 1:
            kernel(0, size, *args)
            return
        # A few ranges per thread: the cost of a slot varies (front or not), the bytes do not.
        per_task = max(1, -(-blocks // (4 * self.threads))) * BLOCK
        tasks = [
            self._pool.submit(kernel, start, min(start + per_task, size), *args) for start in range(0, size, per_task)
        ]
        for task in tasks:
            task.result()

    def sums(self, kernel: Callable[..., Any], size: int, columns: int, *args: Any) -> np.ndarray:
        """Sum the rows that ``kernel(first_block, last_block, *args, rows)`` leaves, one per block, in order."""
        blocks = -(-size // BLOCK)
        self.visited += size
        rows = np.zeros((blocks, columns))
        if self._pool is None or blocks <= 1:
            kernel(0, blocks, *args, rows)
        else:
            per_task = max(1, -(-blocks // (4 * self.threads)))
            tasks = [
                self._pool.submit(kernel, first, min(first + per_task, blocks), *args, rows)
                for first in range(0, blocks, per_task)
            ]
            for task in tasks:
                task.result()
        total: np.ndarray = rows.sum(axis=0)
        return total

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
