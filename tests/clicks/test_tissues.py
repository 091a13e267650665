"""A click alone on phantoms of tissue: an organ beside its neighbours, a mass with a rim, a cell with organelles."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.api.segment import segment
from accelsurf.measure.metrics import dice
from tests.support import tissues

SHAPE, SPACING = (30, 44, 48), (2.0, 1.0, 0.8)


def noisy(values, noise, seed=1):
    """Values blurred by a scanner of 0.7 mm resolution, with noise."""
    blurred = ndimage.gaussian_filter(values.astype(np.float32), [0.7 / h for h in SPACING])
    return blurred + np.random.default_rng(seed).normal(0, noise, SHAPE).astype(np.float32)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("value", "clicks"), [(60, {"outside": "point:43,22,15vox"}), (110, {})])
def test_organ_beside_muscle_and_fat(value, clicks):
    """Muscle at 30 HU: from an organ without contrast agent, as bright within the noise, a click outside parts it."""
    axes = [(np.arange(n) - 0.5 * (n - 1)) * h for n, h in zip(SHAPE, SPACING, strict=True)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    organ = (x + 3) ** 2 + y**2 + z**2 < 15**2
    muscle = ((x - 15) ** 2 + y**2 + z**2 < 5**2) & ~organ
    image = noisy(-100.0 + (100 + value) * organ + 130 * muscle, 15)
    labels = segment(image, spacing=SPACING, inside="ball:20,22,15,8vox", **clicks).labels
    assert dice(labels, organ) > 0.9 and labels[muscle].mean() < 0.5


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("make", "least"), [("tumour", 0.93), ("organelle", 0.7)])
def test_a_click_on_tissue_of_several_brightnesses(make, least):
    image, truth = getattr(tissues, make)()
    middle = ",".join(str((n - 1) // 2) for n in image.shape[::-1])
    result = segment(image, inside=f"ball:{middle},5vox")
    assert dice(result.labels, truth) > least
