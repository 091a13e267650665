"""
Two objects that touch
======================

Each object has a surface of its own, and surfaces never overlap. Where two meet, neither displaces the other.
"""

import matplotlib.pyplot as plt
import numpy as np

import accelsurf

# %%
# Two balls of equal brightness that overlap by two voxels, on a dark background with noise.

shape = (32, 32, 56)
z, y, x = (axis - (m - 1) / 2 for axis, m in zip(np.indices(shape), shape, strict=True))
inside = ((x - 11) ** 2 + y**2 + z**2 < 12**2) | ((x + 11) ** 2 + y**2 + z**2 < 12**2)
image = inside + np.random.default_rng(0).normal(0, 0.3, shape)

# %%
# The start is a label map: a small cube in each ball, with the ids 1 and 2.

start = np.zeros(shape, np.uint8)
start[13:19, 13:19, 14:20] = 1
start[13:19, 13:19, 36:42] = 2

result = accelsurf.segment_objects(image, start)
for number in (1, 2):
    print(
        f"object {number}: {(result.labels == number).sum()} voxels of 1 mm3, a ball has {4 / 3 * np.pi * 12**3:.0f}"
    )

# %%
figure, axis = plt.subplots(figsize=(7, 4))
axis.imshow(image[16], cmap="gray")
for number, colour in ((1, "#ff9d2e"), (2, "#2ec4ff")):
    axis.contour(start[16] == number, [0.5], colors=colour, linewidths=1, linestyles="dotted")
    axis.contour(result.labels[16] == number, [0.5], colors=colour, linewidths=2)
axis.set_title("starts dotted, results solid")
axis.axis("off")
plt.show()
