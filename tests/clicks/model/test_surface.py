"""The weight of the area by noise; the mean curvature of a mask, and what F is lowered by for it."""

import numpy as np
import pytest

from accelsurf import segment
from accelsurf.clicks.model import surface as module
from accelsurf.clicks.model.surface import (
    AREA,
    NOISY_AREA,
    area_weight,
    mean_curvature,
    surface_offset,
)
from accelsurf.image.volume import Volume


def ball(shape, spacing, middle, radius):
    squares = (
        ((np.arange(n) - m) * h) ** 2 for n, m, h in zip(shape, middle, spacing, strict=True)
    )
    z, y, x = np.meshgrid(*squares, indexing="ij", sparse=True)
    return z + y + x < radius**2


@pytest.mark.parametrize(
    ("spacing", "radius"),
    [((1, 1, 1), 5), ((1, 1, 1), 12.3), ((0.5, 0.5, 0.5), 5), ((1, 0.5, 0.7), 7)],
)
def test_of_a_ball_it_is_two_over_the_radius(spacing, radius):
    shape = tuple(int(2 * radius / h) + 12 for h in spacing)
    found = mean_curvature(ball(shape, spacing, [n / 2 + 0.2 for n in shape], radius), spacing)
    assert found == pytest.approx(2 / radius, rel=0.12)


def test_of_a_disk_in_one_slice_it_is_one_over_the_radius():
    disk = ball((1, 60, 60), (5.0, 1.0, 1.0), (0, 29, 31), 20)
    assert mean_curvature(disk, (5.0, 1.0, 1.0)) == pytest.approx(1 / 20, rel=0.1)


def test_of_a_plate_through_the_volume_it_is_nothing():
    plate = np.zeros((20, 21, 22), bool)
    plate[8:13] = True
    assert abs(mean_curvature(plate, (1.0, 1.0, 1.0))) < 1e-6
    assert mean_curvature(~plate, (1.0, 1.0, 1.0)) == pytest.approx(0.0, abs=1e-6)


def test_where_the_volume_ends_there_is_no_boundary():
    # A half ball on the border is as curved as the whole one.
    half = ball((24, 48, 48), (1.0, 1.0, 1.0), (-0.5, 24, 24), 16)
    assert mean_curvature(half, (1.0, 1.0, 1.0)) == pytest.approx(2 / 16, rel=0.12)


def test_a_restricted_mask_has_the_same(monkeypatch):
    large = ball((80, 80, 80), (1.0, 1.0, 1.0), (40, 40, 40), 32)
    whole = mean_curvature(large, (1.0, 1.0, 1.0))
    monkeypatch.setattr(module, "MOST", 4000)
    assert mean_curvature(large, (1.0, 1.0, 1.0)) == pytest.approx(whole, rel=0.15)


def test_nothing_and_everything_have_none():
    assert mean_curvature(np.zeros((4, 4, 4), bool), (1.0, 1.0, 1.0)) == 0.0
    assert mean_curvature(np.ones((4, 4, 4), bool), (1.0, 1.0, 1.0)) == 0.0


def test_the_same_object_in_a_larger_grid_has_the_same():
    small = ball((30, 30, 30), (1.0, 1.0, 1.0), (15, 15, 15), 9)
    large = np.zeros((50, 60, 70), bool)
    large[10:40, 12:42, 20:50] = small
    assert mean_curvature(large, (1.0, 1.0, 1.0)) == mean_curvature(small, (1.0, 1.0, 1.0))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_the_area_smooths_and_does_not_shrink(noise, monkeypatch):
    """In noise no edge tells the place of the boundary, and F rises gently: the area took away a layer all around."""
    shape, truth = (48, 48, 48), ball((48, 48, 48), (1, 1, 1), (24, 24, 24), 11)
    image = Volume.from_array(
        (truth + np.random.default_rng(3).normal(0, noise, shape)).astype(np.float32), 1.0
    )
    options = {"inside": "ball:24,24,24,5.5", "size": f"{np.count_nonzero(truth)}mm3"}

    def change(result):
        term = result.report["energy"]["terms"][0]
        return term["offset"], np.count_nonzero(result.labels) / np.count_nonzero(truth)

    lowered, now = change(segment(image, **options))
    monkeypatch.setattr("accelsurf.clicks.model.surface.MAX_OFFSET", 0.0)
    none, before = change(segment(image, **options))
    assert lowered > 0.0 and none == 0.0
    assert before < now and abs(now - 1) < 0.1


def test_a_hollow_object_is_not_raised():
    assert surface_offset(0.3, -1.0) == 0.0


def test_the_area_weight_follows_the_noise():
    shape = (24, 26, 28)
    inside = ball(shape, (1, 1, 1), (12, 13, 14), 8)
    noise = np.random.default_rng(6).normal(0, 1, shape)
    found = [
        area_weight([(inside + part * noise).astype(np.float32)], (1.0, 1.0, 1.0), inside)
        for part in (0, 0.5, 5)
    ]
    assert found[0] == pytest.approx(AREA)
    assert found[1] == pytest.approx(AREA + 0.5 * NOISY_AREA, rel=0.1)
    assert found[2] == pytest.approx(AREA + NOISY_AREA)
    clean = inside.astype(np.float32)
    assert area_weight(
        [(5 * noise).astype(np.float32), clean], (4.0, 2.0, 2.0), inside
    ) == pytest.approx(2 * AREA)
