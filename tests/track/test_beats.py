import numpy as np
import pytest

from accelsurf.track.beats import find_beat


@pytest.mark.parametrize("period", [3.1, 5.0, 9.1])
@pytest.mark.parametrize("growth", [0.0, 0.5])
def test_period_of_a_volume_that_beats_and_grows(period, growth):
    t = np.arange(40) * 0.5
    found = find_beat(t, 100 + growth * t + 15 * np.cos(2 * np.pi * (t - 0.7) / period))
    assert found.kind == "repeats"
    assert found.period == pytest.approx(period, rel=0.02)


def test_period_in_noise_and_with_missing_frames():
    rng = np.random.default_rng(3)
    t = np.delete(np.arange(60.0), [7, 8, 31])
    found = find_beat(t, 100 + 20 * np.cos(2 * np.pi * t / 11) + rng.normal(0, 3, len(t)))
    assert found.period == pytest.approx(11, rel=0.03)
    assert found.ejection_fraction == pytest.approx(40 / 120, abs=0.08)


def test_ejection_fraction_of_one_heart_beat():
    t = np.arange(20) / 20
    found = find_beat(t, 120 - 70 * np.sin(np.pi * t) ** 2)
    assert (found.kind, found.period) == ("closes", None)
    assert found.ejection_fraction == pytest.approx(70 / 120)


@pytest.mark.parametrize(
    "volumes",
    [
        np.full(30, 5.0),
        100 + np.random.default_rng(0).normal(0, 1, 30),  # a still object, measured with noise of 1 %
        100 + np.random.default_rng(1).normal(0, 10, 30),
        np.linspace(50, 100, 30),
        np.linspace(10, 5, 30) ** 2,
        np.zeros(30),
        [1.0, 2.0, 1.0],
    ],
)
def test_what_does_not_beat_has_no_beat(volumes):
    assert find_beat(np.arange(len(volumes), dtype=float), volumes) is None
