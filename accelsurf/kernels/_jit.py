"""The one door to numba: every kernel is compiled with these flags and no others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# No nnan/ninf: the code tests for NaN. No reassoc: a sum must not depend on how a loop was vectorised.
FASTMATH = {"contract", "arcp", "nsz"}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``function`` without the Python lock, cached on disk; arithmetic errors follow IEEE."""
    compiled: Callable[..., Any] = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)(function)
    return compiled
