"""A smooth random field at the points of the surface, as a sum of plane waves."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel
from accelsurf.kernels.grid import unravel
from accelsurf.kernels.stages import Stage


@kernel(stage=Stage.FLOW)
def sum_of_waves(start, stop, grid, band, front, vectors, phases, out):
    """sqrt(2/m) sum_j cos(k_j . x + p_j) at the foot x (mm) of every front cell, 0 elsewhere; ``vectors`` k (m, 3)."""
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
