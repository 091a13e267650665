"""
A ball in noise, with and without momentum
==========================================

The image is a ball in noise as strong as its contrast, so that the energy has many local minima. Under
equal conditions descent fills the object more slowly: when its steps end, holes are left that momentum has closed.
"""

import matplotlib.pyplot as plt
import numpy as np

import accelsurf

# %%
# A ball of radius 14 voxels, contrast 1, noise of standard deviation 1. The start is a small ball off the centre.

n = 40
z, y, x = np.indices((n, n, n)) - (n - 1) / 2
truth = x**2 + y**2 + z**2 < 14**2
image = truth + np.random.default_rng(1).normal(0, 1, truth.shape)
start = "ball:14,16,18,5vox"

# %%
# Both flows get the same step control. ``percentile=100`` turns the speed limiter off, and ``levels=1`` stays on the
# image's own grid: limiter and coarse grids make descent faster as well, and would hide the difference.

results = {
    flow: accelsurf.segment(
        image, start=start, flow=flow, cfl=0.25, percentile=100, levels=1, max_steps=300
    )
    for flow in ("gradient", "constant-density")
}

# %%
# The middle slice, with the truth in white.


def dice(labels):
    """Dice coefficient of a label map with the truth."""
    return 2 * (labels.astype(bool) & truth).sum() / (labels.sum() + truth.sum())


figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.6))
for axis, (flow, result) in zip(axes, results.items(), strict=False):
    axis.imshow(image[n // 2], cmap="gray", vmin=-2, vmax=3)
    axis.contour(truth[n // 2], [0.5], colors="white", linewidths=1, linestyles="dotted")
    axis.contour(result.labels[n // 2], [0.5], colors="#ff9d2e", linewidths=1.5)
    axis.set_title(f"{flow}: Dice {dice(result.labels):.3f}", fontsize=10)
    axis.axis("off")
    axes[2].plot([record.potential for record in result.history], label=flow)
axes[2].set(xlabel="step", title="potential energy")
axes[2].legend()
figure.tight_layout()
plt.show()
