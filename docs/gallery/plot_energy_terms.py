"""
Energy terms on uneven brightness
=================================

Two means for the whole image (``chan-vese``) fail where the brightness drifts. Two means in a window around each place
(``local-region``) follow the drift.
"""

import matplotlib.pyplot as plt
import numpy as np

import accelsurf

# %%
# A ball on a background that becomes brighter from left to right: on the right the background is as bright as the ball
# is on the left.

n = 44
z, y, x = np.indices((n, n, n)) - (n - 1) / 2
truth = x**2 + y**2 + z**2 < 13**2
image = truth + x / 16 + np.random.default_rng(0).normal(0, 0.1, truth.shape)

# %%
# Terms add with weights. The start lies within R = 8 mm of the edge.

energies = ("chan-vese", "local-region:R=8", "local-region:R=8 + 0.1*area")
results = {
    energy: accelsurf.segment(image, start="center", energy=energy, max_steps=200)
    for energy in energies
}

# %%
figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.8))
for axis, (energy, result) in zip(axes, results.items(), strict=True):
    overlap = 2 * (result.labels.astype(bool) & truth).sum() / (result.labels.sum() + truth.sum())
    axis.imshow(image[n // 2], cmap="gray")
    axis.contour(truth[n // 2], [0.5], colors="white", linewidths=1, linestyles="dotted")
    axis.contour(result.labels[n // 2], [0.5], colors="#ff9d2e", linewidths=1.5)
    axis.set_title(f"{energy}\n{result.stop.reason}, Dice {overlap:.3f}", fontsize=9)
    axis.axis("off")
figure.tight_layout()
plt.show()
