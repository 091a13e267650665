"""Sine and cosine of multiples of pi by a polynomial: vectors instead of a call of the library for each value."""

from __future__ import annotations

from accelsurf.kernels._jit import kernel


@kernel(inlined=True)
def sine_of_pi(x):
    """sin(pi x) for -1/2 <= x <= 1/2, within 1e-11: its series up to x^15."""
    t = 3.141592653589793 * x
    u = t * t
    series = 1.0 - u / 210.0
    series = 1.0 - u / 156.0 * series
    series = 1.0 - u / 110.0 * series
    series = 1.0 - u / 72.0 * series
    series = 1.0 - u / 42.0 * series
    series = 1.0 - u / 20.0 * series
    series = 1.0 - u / 6.0 * series
    return t * series


@kernel(inlined=True)
def bump(x):
    """1 + cos(pi x) for 0 <= x <= 1; a square, so never below 0."""
    s = sine_of_pi(0.5 - 0.5 * x)
    return 2.0 * s * s
