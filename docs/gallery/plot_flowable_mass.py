"""
Flowable mass in twenty lines
=============================

The other system of the paper (Yezzi and Sundaramoorthi, arXiv 1711.09867): the surface carries mass of density
:math:`\\rho`, which is conserved and flows along it. Each piece of mass is a particle with the velocity V; the paper
writes the system for curves, where :math:`T = C_s` is the tangent:

.. math::

    \\frac{\\partial V}{\\partial t} = \\frac{\\lambda k^2 t^{k-2}}{\\rho} f N - (V\\cdot C_s) V_s - \\frac{k+1}{t} V,
    \\qquad \\frac{\\partial\\rho}{\\partial t} = -(V\\cdot C_s) \\rho_s - \\rho \\, V_s\\cdot C_s, \\qquad
    \\frac{\\partial\\psi}{\\partial t} = -V\\cdot\\nabla\\psi

(the last with its sign corrected: the paper prints a plus). On a surface the stretch :math:`V_s\\cdot C_s` becomes the
divergence of V along it.
"""

import matplotlib.pyplot as plt
import numpy as np

from accelsurf.levelset import LevelSet, Motion

# %%
# ``V`` and ``rho`` are constant along the normals, so the divergence along the surface is the plain one. ``redistance``
# reads them at the points that the motion has taken to the surface: that is the advection,
# :math:`(V\cdot\nabla)V` and :math:`V\cdot\nabla\rho`. No curvature is needed. With the same steps the flow of the
# package, which balances the mass as well, lies within 0.5 dt mm and 0.06 voxel.


def flowable_mass(surface, force, dt, steps, k=2.0, lam=1.0, density=1.0):
    """Move ``surface`` from rest under ``force``, a function of points z, y, x, by ``steps`` steps of ``dt``."""
    V, rho = np.zeros((surface.size, 3), np.float32), np.full(surface.size, density, np.float32)
    for n in range(steps):
        t = (n + 0.5) * dt
        kick = dt if n else 0.5 * dt
        front = surface.front(surface.half_width - 1)
        f, N = force(*closest_points(surface).T), surface.normals()
        w = lam * k**2 * t ** (k - 2)
        V = (V + kick * w * (f / rho)[:, None] * N) / (1 + kick * (k + 1) / t)
        fields = [*V.T.astype(np.float32).copy()]
        for field in fields:
            surface.extend_outwards(field, front)
        V = np.stack(fields, axis=1)
        rho = (rho / (1 + dt * divergence(surface, V))).astype(np.float32)
        surface.extend_outwards(rho, front)
        surface.advect(V, dt)
        *fields, rho = surface.redistance([*fields, rho], Motion(V, dt)).fields
        V = np.stack(fields, axis=1)
        yield t + 0.5 * dt, rho


def divergence(surface, V):
    """Divergence (n,) of V (n, 3) at the cells of the band."""
    total = np.zeros(surface.size)
    for axis, h in enumerate(surface.spacings):
        dense = np.zeros(surface.shape, np.float32)
        dense.ravel()[surface.band.cells] = V[:, axis]
        total += np.gradient(dense, h, axis=axis).ravel()[surface.band.cells]
    return total


def closest_points(surface):
    """Points (n, 3) of the surface that are closest to the cells of its band, mm from the middle of the volume."""
    cells = np.stack(np.unravel_index(surface.band.cells, surface.shape), axis=1)
    return (
        cells - 0.5 * (np.array(surface.shape) - 1)
    ) * surface.spacings + surface.band.to_closest


# %%
# The force of Chan and Vese between the means 1 and 0, for an image that is 1 in an ellipsoid and goes to 0 within half
# a millimetre. The surface starts as a ball beside the middle, with its mass spread evenly.


def force(z, y, x):
    """Force at points (n,) each, mm."""
    image = 0.5 - 0.5 * np.tanh((np.sqrt(1.6 * z**2 + y**2 + 0.6 * x**2) - 0.8) / 0.25)
    return (image - 1) ** 2 - image**2


def ball(n):
    """Return the start on a grid of 2.6 mm with ``n`` voxels along each axis, in a band of 4 voxels."""
    z, y, x = (np.indices((n, n, n)) - 0.5 * (n - 1)) * 2.6 / n
    return LevelSet(np.sqrt((z - 0.1) ** 2 + y**2 + (x - 0.15) ** 2) - 0.45, (2.6 / n,) * 3, 4.0)


# %%
# Mass is neither made nor lost where the surface grows: the density falls, most where it grows most. A gas without
# pressure: soon after this its paths cross. ``accelsurf.flows.FlowableMass`` has what it then takes to go on.

surface = ball(48)
slices, mass, spread, times = [], [], [], []
for t, rho in flowable_mass(surface, force, dt=0.02, steps=60):
    area = surface.fraction_and_area()[1]
    times.append(t)
    mass.append(float((area * rho).sum()))
    spread.append((rho[area > 0].min(), rho[area > 0].max()))
    if len(times) % 20 == 0:
        slices.append(surface.psi[24].copy())
print(f"mass changes by {mass[-1] / mass[0] - 1:.1%}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4))
for psi, shade, t in zip(slices, ("#ffd29b", "#ff9d2e", "#c45f00"), times[19::20], strict=True):
    left.contour(psi, [0.0], colors=[shade])
    left.plot([], [], color=shade, label=f"t = {t:.1f}")
left.set(aspect="equal", title="middle slice", ylim=(0, 54))
left.legend(fontsize=8, ncols=3, loc="upper center")
right.fill_between(times, *np.transpose(spread), color="#ff9d2e", label="least to largest density")
right.plot(times, np.array(mass) / mass[0], "k", label="mass, of its first")
right.set(xlabel="t", ylim=(0, 1.2))
right.legend(fontsize=8)
figure.tight_layout()
plt.show()
