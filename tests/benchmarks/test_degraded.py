"""Noise of scans: as strong as it shall be, and of its own kind."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.degraded import BALL as FROM_BALL
from benchmarks.degraded import METHODS, Crop, counted, degraded, measured, projected, rician

BALL = ((np.indices((12, 40, 40)) - np.array([6, 20, 20]).reshape(3, 1, 1, 1)) ** 2).sum(
    axis=0
) < 12**2
IMAGE = (100.0 + 100.0 * BALL).astype(np.float32)


@pytest.mark.parametrize(("make", "most"), [(rician, 10.2), (counted, 10.2), (projected, 13.0)])
def test_noise_is_as_strong_as_asked(make, most):
    added = make(IMAGE, 10.0, np.random.default_rng(0)) - IMAGE
    assert abs(added.mean()) < 1.5
    assert 9.8 < added.std() < most  # in projections that of the detector comes on top


def test_photons_make_more_noise_where_it_is_bright():
    added = counted(IMAGE, 10.0, np.random.default_rng(0)) - IMAGE
    assert added[BALL].std() / added[~BALL].std() == pytest.approx(2**0.5, rel=0.05)


def test_projections_make_more_noise_behind_more_matter():
    added = projected(IMAGE - 100.0, 10.0, np.random.default_rng(0)) - IMAGE + 100.0
    beside = np.abs(np.indices(IMAGE.shape)[2] - 20) > 16
    assert added[3:10][BALL[3:10]].std() > 1.2 * added[3:10][beside[3:10]].std()


def test_the_variance_goes_with_one_over_the_exposure_and_the_noise_is_the_same_each_time():
    crop = Crop("ball", IMAGE, BALL, (1.0, 1.0, 1.0), 100.0, 0.0)
    found = {part: degraded(crop, "fluo_ball", part) for part in (1, 4, 64)}
    assert found[1] is crop
    # Full exposure has noise of a quarter of the contrast.
    assert found[64].noise / found[4].noise == pytest.approx((63 / 3) ** 0.5, rel=0.1)
    assert np.array_equal(degraded(crop, "fluo_ball", 4).values, found[4].values)


@pytest.mark.parametrize("name", [*METHODS[FROM_BALL]])
def test_every_method_finds_a_ball_in_little_noise(name):
    crop = Crop("ball", IMAGE, BALL, (1.0, 1.0, 1.0), 100.0, 0.0)
    values = rician(IMAGE, 10.0, np.random.default_rng(0)).astype(np.float32)
    dice, distance, *_ = measured(
        crop._replace(values=values, noise=10.0), FROM_BALL, name, METHODS[FROM_BALL][name].grid[0]
    )
    assert dice > 0.9 and distance < 1.0  # walks begin at the faces, too, which the ball touches
