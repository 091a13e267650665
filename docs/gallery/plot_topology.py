"""
A surface that changes its topology
===================================

The start is a ball in one side of a torus. The surface grows around the ring until its two ends meet and merge; then it
has a hole. No special case is needed: a level set has no mesh that would have to be cut and joined.
"""

import matplotlib.pyplot as plt
import numpy as np

import accelsurf

n = 48
z, y, x = np.indices((n, n, n)) - (n - 1) / 2
torus = (np.hypot(x, y) - 14) ** 2 + z**2 < 5**2
image = torus + np.random.default_rng(0).normal(0, 0.2, torus.shape)

# %%
# ``evolve`` yields each step. The surface of a step is changed by the next one, so what is to be kept is copied.

slices = [
    step.surface.labels[n // 2].copy()
    for step in accelsurf.evolve(image, start="ball:37,23,23,5vox", levels=1, max_steps=400)
]

# %%
# Six steps, evenly spaced from the start to the end of the run.

figure, axes = plt.subplots(2, 3, figsize=(9, 6.4))
for axis, number in zip(axes.flat, np.linspace(0, len(slices) - 1, 6).astype(int), strict=True):
    axis.imshow(image[n // 2], cmap="gray")
    axis.contour(slices[number], [0.5], colors="#ff9d2e", linewidths=1.5)
    axis.set_title(f"step {number}", fontsize=10)
    axis.axis("off")
figure.tight_layout()
plt.show()
