"""
An energy of your own
=====================

An energy gives its value U and its force f. This one looks for the brightest region of a known volume:
U = -int_inside I dx + mu/2 (V/V0 - 1)^2 V0.
"""

import matplotlib.pyplot as plt
import numpy as np

import accelsurf

# %%
# ``ImageEnergy`` updates the sums of the image over the inside as the surface moves. When the surface moves by d along
# the inward normal, U changes by -int f d dA: a force above 0 shrinks the object.


class KnownVolume(accelsurf.ImageEnergy):
    """The brightest region of ``volume_mm3``."""

    def __init__(self, image, volume_mm3, mu=10.0):
        super().__init__(image)
        self.wanted, self.mu = volume_mm3, mu

    def value(self, surface, fraction, area):
        """Return U of the present surface."""
        self.excess = surface.volume(fraction) / self.wanted - 1.0
        bright = self.sums.inside(surface, fraction).total * surface.voxel_volume
        return -bright + 0.5 * self.mu * self.excess**2 * self.wanted

    def force(self, surface, front, curvature):
        """Return f = -I + mu (V/V0 - 1) at each front cell."""
        return -accelsurf.sample_at_front(self.sums.image, surface, front) + self.mu * self.excess


# %%
# A blob without an edge: no threshold is better than another, but the volume decides.

z, y, x = np.indices((40, 40, 40)) - 19.5
blob = np.exp(-(x**2 / 2 + y**2 + z**2) / (2 * 7.0**2))
volumes = (1000.0, 4000.0, 9000.0)
results = [
    accelsurf.segment(blob, start="ball:22,18,20,5vox", energy=KnownVolume(blob, volume))
    for volume in volumes
]

# %%
figure, axis = plt.subplots(figsize=(5, 5))
axis.imshow(blob[20], cmap="gray")
for volume, result, colour in zip(volumes, results, ("#ffd29b", "#ff9d2e", "#c45f00"), strict=True):
    axis.contour(result.psi[20], [0.0], colors=colour)
    print(f"{result.energy}: wanted {volume:.0f} mm3, found {result.volume_mm3:.0f} mm3")
axis.set_title("regions of 1000, 4000 and 9000 mm3")
axis.axis("off")
plt.show()
