"""Waves: a smooth random field at the points of the surface, and sine and cosine by a polynomial, in vectors."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import Stage, kernel
from accelsurf.kernels.grid import unravel


@kernel(stage=Stage.FLOW)
def sum_of_waves(start, stop, grid, band, front, vectors, phases, out):
    """sqrt(2/m) sum_j cos(k_j . x + p_j) at the closest point x (mm) of every front cell, 0 elsewhere.

    ``vectors`` are the k, (m, 3).
    """
    m = phases.shape[0]
    scale = np.sqrt(2.0 / m)
    for s in range(start, stop):
        out[s] = 0.0
        if not front[s]:
            continue
        iz, iy, ix = unravel(band.cells[s], grid)
        z = iz * grid.hz + band.to_closest[s, 0]
        y = iy * grid.hy + band.to_closest[s, 1]
        x = ix * grid.hx + band.to_closest[s, 2]
        total = 0.0
        for j in range(m):
            total += np.cos(vectors[j, 0] * z + vectors[j, 1] * y + vectors[j, 2] * x + phases[j])
        out[s] = scale * total


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
