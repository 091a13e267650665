"""Bounds that are learned from a start: a lumen half-way to soft tissue, below bone."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.api.segment import segment
from accelsurf.measure.metrics import dice

SHAPE, SPACING = (30, 44, 48), (2.0, 1.0, 0.8)


@pytest.mark.slow
@pytest.mark.parametrize("lumen", [160, 400])
def test_vessel_of_any_phase_beside_bone(lumen):
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(SHAPE, SPACING, strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    vessel = (x - 4 * np.sin(z / 12)) ** 2 + y**2 < 4**2
    bone = (x - 4 * np.sin(z / 12) + 11) ** 2 + y**2 < 6**2
    values = 50.0 + (lumen - 50) * vessel + 850 * bone
    image = ndimage.gaussian_filter(values, [0.7 / h for h in SPACING]) + np.random.default_rng(
        1
    ).normal(0, 15, SHAPE)
    settings = {"energy": "threshold:half:50,learned", "presmooth": 0.5, "smoothness": 0.5}
    result = segment(
        image.astype(np.float32), spacing=SPACING, start="ball:24,22,15,3vox", **settings
    )
    assert result.stop.reason == "converged" and dice(result.labels, vessel) > 0.9
