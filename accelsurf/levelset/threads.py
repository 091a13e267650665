"""Kernels over ranges of slots in several threads, with the same bytes for any number of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np

from accelsurf.grid.boxes import sum_in_order
from accelsurf.kernels.grid import BATCH, BLOCK

#: Slots of a range are a multiple of this: vectors and their batches are the same for any ranges.
GRAIN = 4 * BATCH
#: Seconds of one thread from which on a call is shared out: to wake a thread and hand the Python lock back and forth
#: takes about 80 microseconds. And the seconds that a range is worth. Timed in benchmarks/notes/speed.md.
SHARED_FROM = 200e-6
SHORTEST = 60e-6


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of a x b over two equal arrays, the same bytes on any machine.

    np.dot and @ hand long arrays to a library that splits the sum by the number of its own threads, which then spin
    for a while beside the workers.
    """
    return float((a * b).sum())


class Workers:
    """Runs kernels that own a range of slots, on ``threads`` threads.

    Kernels release the Python lock and write only inside their range; reductions leave one row per block of
    fixed size, added here in order of the blocks. Use as a context manager, or call `close`.
    """

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        #: Band cells handed to kernels so far: the cost of a run that does not depend on the machine.
        self.visited = 0
        #: Wall seconds by name of kernel, for `--profile`; `kernels._jit` has the stage of each.
        self.seconds: dict[str, float] = {}
        #: Seconds that a slot, block or plane took one thread in the last call of more than a grain, by name of kernel.
        self.pace: dict[str, float] = {}
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def parallel(self, kernel: Callable[..., Any], size: int, *args: Any) -> None:
        """Call ``kernel(start, stop, *args)`` so that the ranges cover ``0 .. size``."""
        if size:
            self._run(kernel, size, size, GRAIN, args)

    def block_sums(
        self, kernel: Callable[..., Any], size: int, columns: int, *args: Any
    ) -> np.ndarray:
        """Sum the rows that ``kernel(first_block, last_block, *args, rows)`` leaves, one per block, in order."""
        blocks = -(-size // BLOCK)
        rows = np.zeros((blocks, columns))
        self._run(kernel, size, blocks, 1, (*args, rows))
        total: np.ndarray = rows.sum(axis=0)
        return total

    def plane_sums(
        self, kernel: Callable[..., Any], shape: tuple[int, int, int], columns: int, *args: Any
    ) -> np.ndarray:
        """Sum the rows that ``kernel(first_plane, last_plane, *args, rows)`` leaves, one per plane, in order.

        Rows of planes with nothing to add are 0: the sums of a part have the same bytes on every box that contains it.
        """
        rows = np.zeros((shape[0], columns))
        self._run(kernel, math.prod(shape), shape[0], 1, (*args, rows))
        return sum_in_order(rows)

    def serial(self, kernel: Callable[..., Any], *args: Any) -> Any:
        """Call a kernel that one thread must do, on this one."""
        began = time.perf_counter()
        result = kernel(*args)
        self._count(kernel, began)
        return result

    def _run(
        self, kernel: Callable[..., Any], cells: int, size: int, grain: int, args: tuple[Any, ...]
    ) -> None:
        """Call a kernel on the ranges of ``0 .. size``, which have ``cells`` cells in all; both are counted."""
        self.visited += cells
        began = time.perf_counter()
        self._share_out(kernel, size, grain, args)
        self._count(kernel, began)

    def _count(self, kernel: Callable[..., Any], began: float) -> None:
        name = kernel.__name__
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began

    def _share_out(
        self, kernel: Callable[..., Any], size: int, grain: int, args: tuple[Any, ...]
    ) -> None:
        """Distribute ``0 .. size`` in ranges of whole grains over the threads, including this one.

        In as many ranges as are worth their cost, by the last time of a slot in the kernel: the bytes are the same.
        """
        name = kernel.__name__
        alone = self.pace.get(name, math.inf) * size
        if self._pool is None or size <= grain or alone < SHARED_FROM:
            took = _seconds(kernel, 0, size, args)
        else:
            # A few ranges per thread: the cost of a slot varies (front or not).
            count = int(min(4 * self.threads, max(2.0, alone / SHORTEST)))
            step = -(-size // (count * grain)) * grain
            took = self._drained(
                self._pool, kernel, [(i, min(i + step, size)) for i in range(0, size, step)], args
            )
        # A smaller size takes the overhead of a call.
        if size > grain:
            self.pace[name] = took / size

    def _drained(
        self,
        pool: ThreadPoolExecutor,
        kernel: Callable[..., Any],
        pieces: list[tuple[int, int]],
        args: tuple[Any, ...],
    ) -> float:
        """Call the kernel on the ranges ``pieces`` in several threads; returns the seconds of all of them together."""
        ranges, took = iter(pieces), [0.0]

        def drain() -> None:
            for start, stop in ranges:
                took.append(_seconds(kernel, start, stop, args))

        others = [pool.submit(drain) for _ in range(min(self.threads, len(pieces)) - 1)]
        try:
            drain()
        finally:
            # One that has not begun finds no ranges left.
            for other in others:
                if not other.cancel():
                    other.result()
        return sum(took)

    @contextmanager
    def borrowing_threads(self, others: Workers) -> Iterator[None]:
        """Use the threads of ``others`` for a while, with separate counts."""
        before = self._pool, self.threads
        self._pool, self.threads = others._pool, others.threads
        try:
            yield
        finally:
            self._pool, self.threads = before

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _seconds(kernel: Callable[..., Any], start: int, stop: int, args: tuple[Any, ...]) -> float:
    """Call the kernel on a range; returns the seconds that it took."""
    began = time.perf_counter()
    kernel(start, stop, *args)
    return time.perf_counter() - began
