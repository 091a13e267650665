"""Unpacked pieces of a file that are held for a while: those that were used last, up to a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any

from numpy.typing import NDArray


class ChunkCache:
    """Arrays by a key; may be used by several threads.

    Parameters
    ----------
    max_bytes : int
        Of all arrays that are held. One that is larger by itself is not held.

    Attributes
    ----------
    bytes_made : int
        Of all arrays that were made so far, held or not.
    """

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes, self.bytes_made = max_bytes, 0
        self._held: OrderedDict[Hashable, NDArray[Any]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return the array of a key, made if it is not held; nobody writes into it.

        Parameters
        ----------
        key : hashable
        make : callable
            Returns the array; two threads that miss it at the same time both call it.

        Examples
        --------
        >>> import numpy as np
        >>> cache = ChunkCache(16)
        >>> for key in "abca":
        ...     held = cache.get(key, lambda: np.zeros(1))
        >>> cache.bytes_made
        32
        """
        with self._lock:
            if (array := self._held.get(key)) is not None:
                self._held.move_to_end(key)
                return array
        array = make()
        array.flags.writeable = False
        with self._lock:
            self.bytes_made += array.nbytes
            if array.nbytes <= self.max_bytes and key not in self._held:
                self._held[key] = array
                self._bytes += array.nbytes
                while self._bytes > self.max_bytes:
                    self._bytes -= self._held.popitem(last=False)[1].nbytes
        return array
