"""Whether a zero level of the interpolant of psi is the surface: in the volume, and between voxels of both sides."""

from __future__ import annotations

import numpy as np

from accelsurf.kernels._jit import kernel

#: Slices are thick from this ratio of the spacings on.
THICK = 4.0


@kernel
def is_near_volume(grid, iz, iy, ix, foot, margin):
    """Whether a foot lies within ``margin`` voxels of the outermost voxel centres: beyond, psi is only continued.

    Along axes of `THICK` slices it must not lie beyond at all: a voxel there is many of the others, and psi continued
    so far has a zero level of its own, which came into the volume far from the object.
    """
    thick = THICK * min(grid.hz, min(grid.hy, grid.hx))
    mz = margin if grid.hz < thick else 1e-3
    my = margin if grid.hy < thick else 1e-3
    mx = margin if grid.hx < thick else 1e-3
    lz, ly, lx = -(iz + mz) * grid.hz, -(iy + my) * grid.hy, -(ix + mx) * grid.hx
    uz, uy = (grid.nz - 1.0 - iz + mz) * grid.hz, (grid.ny - 1.0 - iy + my) * grid.hy
    ux = (grid.nx - 1.0 - ix + mx) * grid.hx
    z, y, x = foot[0], foot[1], foot[2]
    # Without branches: with them this took as long as all the rest of a closest point.
    return (lz <= z) & (z <= uz) & (ly <= y) & (y <= uy) & (lx <= x) & (x <= ux)


@kernel(inlined=True)
def is_between_signs(psi, grid, iz, iy, ix, foot):
    """Whether psi changes its sign among the voxels around a foot.

    Else no voxel is on the other side, and the zero level there is an overshoot of the interpolant, as between thick
    slices: a surface that the labels do not have. A smooth surface may pass a corner of a cube of voxels and change no
    sign there: the next voxels count too, along axes as fine as the finest.
    """
    bz, by, bx = int(iz + foot[0] / grid.hz), int(iy + foot[1] / grid.hy), int(ix + foot[2] / grid.hx)
    inside = psi[np.uint64((iz * grid.ny + iy) * grid.nx + ix)] < 0.0
    # The voxel beyond the surface, if there is one: nearly always this ends it.
    az = min(bz + 1, grid.nz - 1) if foot[0] > 0.0 else bz
    ay = min(by + 1, grid.ny - 1) if foot[1] > 0.0 else by
    ax = min(bx + 1, grid.nx - 1) if foot[2] > 0.0 else bx
    if (psi[np.uint64((az * grid.ny + ay) * grid.nx + ax)] < 0.0) != inside:
        return True
    fine = 2.0 * min(grid.hz, min(grid.hy, grid.hx))
    mz, my, mx = 1 if grid.hz < fine else 0, 1 if grid.hy < fine else 0, 1 if grid.hx < fine else 0
    for more in range(2):
        for az in range(max(bz - more * mz, 0), min(bz + 2 + more * mz, grid.nz)):
            for ay in range(max(by - more * my, 0), min(by + 2 + more * my, grid.ny)):
                row = (az * grid.ny + ay) * grid.nx
                for ax in range(max(bx - more * mx, 0), min(bx + 2 + more * mx, grid.nx)):
                    if (psi[row + ax] < 0.0) != inside:
                        return True
    return False
