"""Counts of an image's values: of integers, and of the bits of floats in the order of their size."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel


@kernel
def count_integers(values, least, counts):
    """Add to ``counts`` (n,) int64 how often each of ``least``, ``least`` + 1, ... is among ``values`` (m,)."""
    for i in range(values.shape[0]):
        counts[np.int64(values[i]) - least] += 1


@kernel
def ordered_bits(bits):
    """Bits of a float32 as a number that is in the order of the floats; -0 as 0."""
    sign = np.uint32(0x80000000)
    if bits & sign:
        return ~bits if bits != sign else sign
    return bits | sign


@kernel
def count_high_bits(bits, counts):
    """Add to ``counts`` (65536,) int64 how often each upper half of `ordered_bits` is among ``bits`` (m,) uint32."""
    for i in range(bits.shape[0]):
        counts[ordered_bits(bits[i]) >> np.uint32(16)] += 1


@kernel
def count_low_bits(bits, row_of, counts):
    """The same of the lower halves, into the row of ``counts`` (rows, 65536) that the upper half has.

    ``row_of`` (65536,) int64 is -1 where an upper half is not counted.
    """
    for i in range(bits.shape[0]):
        ordered = ordered_bits(bits[i])
        row = row_of[ordered >> np.uint32(16)]
        if row >= 0:
            counts[row, ordered & np.uint32(0xFFFF)] += 1
