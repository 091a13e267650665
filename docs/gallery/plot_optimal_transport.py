"""
Optimal transport between two shapes
====================================

Mass on the whole grid that nothing pushes goes straight on. If its first velocity is the gradient of a potential q,
with I + t D^2 q > 0 all the way, that motion is the cheapest one that takes the first density to the last (Benamou &
Brenier 2000): T stays what it is, and 2 t^2 T is the square of the Wasserstein distance. `region-mass` without a force
does this, and its surface goes along: a disc becomes a bar, through shapes, not through mixtures of both images.
"""

import matplotlib.pyplot as plt
import numpy as np

from accelsurf.energies import RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import RegionMass, StepLimits
from accelsurf.levelset import LevelSet

n = 160
h = 4.0 / n
y, x = (np.indices((n, n)) - (n - 1) / 2) * h
disc = LevelSet((np.hypot(x, y) - 0.7)[None], (h, h, h), 4.0)
density = 0.5 * (1 - np.tanh((np.hypot(x, y) - 0.7) / 0.03))

# %%
# q = .35 x^2 - .25 y^2 + .13 (x^2 - .25) y^2: its gradient draws the disc out along x and makes it thinner along y.

velocity = np.stack([0 * x, -0.5 * y + 0.26 * (x**2 - 0.25) * y, 0.7 * x + 0.26 * x * y**2])[
    :, None
]

# %%
# A force of 0 and no friction: nothing but the first velocity moves the mass.

flow = RegionMass(friction=0.0)
evolution = Evolution(
    disc,
    RegionField(np.zeros(disc.shape)),
    SolverSetup(flow, StepLimits(0.5, 100.0, 0.5 * h)),
    10_000,
)
evolution.initialize()
flow.set_fluid(density[None], velocity)
frames, kinetic = [(0.0, flow.fluid[0, 0].copy(), disc.psi[0].copy())], []
for step in evolution:
    t = step.record.t + step.record.dt
    kinetic.append(step.record.kinetic)
    if t >= 0.5 * len(frames):
        frames.append((t, flow.fluid[0, 0].copy(), disc.psi[0].copy()))
    if t >= 1.0:
        break
moved = abs(flow.mass / (density.sum() * h**3) - 1)
print(f"T changes by {np.ptp(kinetic) / kinetic[0]:.2%}, mass by {moved:.0e}")

# %%
# Above the motion, halfway and at the end; below the mixture of both images, as interpolation of images gives it.

figure, axes = plt.subplots(2, 3, figsize=(9, 5.6), sharex=True, sharey=True)
extent = (-2, 2, -2, 2)
first, last = frames[0][1], frames[-1][1]
for (above, below), (t, rho, psi) in zip(axes.T, frames, strict=True):
    above.imshow(rho, cmap="gray", origin="lower", extent=extent, vmin=0, vmax=1.5)
    above.contour(psi, [0], colors="#ff9d2e", linewidths=1.5, extent=extent, origin="lower")
    above.set_title(f"transported, t = {t:.1f}", fontsize=10)
    below.imshow(
        (1 - t) * first + t * last, cmap="gray", origin="lower", extent=extent, vmin=0, vmax=1.5
    )
    below.set_title(f"mixed, t = {t:.1f}", fontsize=10)
for axis in axes.flat:
    axis.set(ylim=(-1.3, 1.3), xticks=[], yticks=[])
figure.tight_layout()
plt.show()
