"""Percentiles of an image that is read in parts: exact, the same bytes as `numpy.percentile` of the whole array."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.image.kernels.counts import count_high_bits, count_integers, count_low_bits

#: Values of half of the bits of a float32.
HALF = 1 << 16


class OrderStatistics(ABC):
    """Values of a float32 image in the order of their size. Its parts are added, then it is asked."""

    size: int

    @abstractmethod
    def add(self, part: NDArray[Any]) -> None:
        """Count the voxels of a part, an array of any shape."""

    @abstractmethod
    def at(self, ranks: NDArray[np.int64]) -> NDArray[np.float32]:
        """The values of these ranks; that of rank 0 is the smallest."""

    @property
    def extremes(self) -> NDArray[np.float32]:
        """The smallest and the largest value, (2,)."""
        return self.at(np.array([0, self.size - 1]))

    def percentiles(
        self,
        q: float | Sequence[float],
        mapped: Callable[[NDArray[np.float32]], NDArray[np.float32]] = lambda values: values,
    ) -> Any:
        """Percentiles as ``numpy.percentile(mapped(image), q)``; ``mapped`` keeps the order of values.

        Examples
        --------
        >>> statistics = IntegerCounts(np.dtype(np.uint8))
        >>> statistics.add(np.array([[3, 1], [2, 6]], np.uint8))
        >>> statistics.percentiles([0, 50, 75])
        array([1.  , 2.5 , 3.75])
        """
        # numpy's linear method: a plain number as q leaves the result in the precision of the image.
        place = (self.size - 1) * np.true_divide(q, 100)
        below = np.minimum(np.floor(place).astype(np.int64), self.size - 1)
        ranks = np.stack([below, np.minimum(below + 1, self.size - 1)])
        low, high = mapped(self.at(ranks.ravel())).reshape(ranks.shape)
        share: Any = place - below
        if isinstance(q, int | float):
            share = float(share)
        width = high - low
        return np.where(np.asarray(share) >= 0.5, high - width * (1 - share), low + width * share)[
            ()
        ]


class IntegerCounts(OrderStatistics):
    """Counts of integers of at most 16 bits, in one pass.

    Parameters
    ----------
    dtype : numpy.dtype

    Attributes
    ----------
    values : ndarray (n,), float32
        All values that the dtype has, ascending.
    counts : ndarray (n,), int64
        How often each occurs.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        least, most = (
            (0, 1) if dtype.kind == "b" else (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))
        )
        self._least, self.size = least, 0
        self.values = np.arange(least, most + 1).astype(np.float32)
        self.counts = np.zeros(self.values.size, np.int64)

    @classmethod
    def can_count(cls, dtype: np.dtype[Any]) -> bool:
        """Test if images of a dtype can be counted."""
        return dtype.kind in "bui" and dtype.itemsize <= 2

    def add(self, part: NDArray[Any]) -> None:
        """Count the voxels of a part."""
        # Big-endian numbers are none that kernels know.
        values = part.ravel().astype(part.dtype.newbyteorder("="), copy=False)
        count_integers(
            values.view(np.uint8) if values.dtype.kind == "b" else values, self._least, self.counts
        )
        self.size += part.size

    def at(self, ranks: NDArray[np.int64]) -> NDArray[np.float32]:
        """The values of these ranks."""
        return self.values[np.searchsorted(np.cumsum(self.counts), ranks, side="right")]


class FloatCounts(OrderStatistics):
    """Counts of float32: of the upper halves of their bits; then of the lower halves that are asked for.

    Parameters
    ----------
    parts : callable
        Returns the parts once more. They are read again when ranks are asked for whose upper halves are new.
    """

    def __init__(self, parts: Callable[[], Iterable[NDArray[np.float32]]]) -> None:
        self._parts, self.size = parts, 0
        self._high = np.zeros(HALF, np.int64)
        self._low: dict[int, NDArray[np.int64]] = {}

    def add(self, part: NDArray[np.float32]) -> None:
        """Count the voxels of a part."""
        count_high_bits(_bits_of(part), self._high)
        self.size += part.size

    def at(self, ranks: NDArray[np.int64]) -> NDArray[np.float32]:
        """The values of these ranks."""
        upto = np.cumsum(self._high)
        upper = np.searchsorted(upto, ranks, side="right")
        # The extremes are asked for sooner or later: they come with the first pass.
        wanted = {
            int(half) for half in (*upper, *np.searchsorted(upto, [0, self.size - 1], side="right"))
        }
        self._count_low(sorted(wanted - set(self._low)))
        ordered = np.empty(len(ranks), np.uint32)
        for i, (half, rank) in enumerate(zip(upper, ranks, strict=True)):
            within = rank - (upto[half] - self._high[half])
            lower = np.searchsorted(np.cumsum(self._low[int(half)]), within, side="right")
            ordered[i] = (int(half) << 16) | int(lower)
        sign = np.uint32(0x80000000)
        return np.where(ordered & sign, ordered ^ sign, ~ordered).astype(np.uint32).view(np.float32)

    def _count_low(self, new: Sequence[int]) -> None:
        if not new:
            return
        row_of, counts = np.full(HALF, -1, np.int64), np.zeros((len(new), HALF), np.int64)
        row_of[list(new)] = np.arange(len(new))
        for part in self._parts():
            count_low_bits(_bits_of(part), row_of, counts)
        self._low.update(zip(new, counts, strict=True))


def _bits_of(part: NDArray[np.float32]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(part, np.float32).ravel().view(np.uint32)
