"""The learned reading of clicks: its features mean the same in every scan, its network learns, its weights are ours."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from benchmarks.clicks.reading.features import Features, features_of_first, features_of_later
from benchmarks.clicks.reading.network import Network, load, loss, save, trained
from benchmarks.clicks.reading.session import WEIGHTS, ReadingSession
from benchmarks.clicks.reading.windows import SCALES, inscribed_radius, window_around

from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from benchmarks.clicks import phantoms
from benchmarks.clicks.person import PersonClick, next_click
from benchmarks.clicks.reading.__main__ import first_rows, fitted, gathered, later_rows
from benchmarks.clicks.reading.scenes import scene

SHAPE = (17, 21, 19)
SPACING = (2.0, 1.0, 1.0)


def ball() -> np.ndarray:
    """A ball of 6 mm."""
    z, y, x = np.ogrid[-16.0:17.0:2, -10.0:11.0, -9.0:10.0]
    return z**2 + y**2 + x**2 <= 36.0


def image_of(truth: np.ndarray, noise: float = 0.2) -> np.ndarray:
    """Values 0 and 1 with noise."""
    return (truth + np.random.default_rng(4).normal(0.0, noise, truth.shape)).astype(np.float32)


def features(values: np.ndarray, spacing: tuple[float, float, float], scale: float = 1.0) -> Features:
    """Features of a click in the middle, and of a later one outside."""
    clicks = [
        PersonClick("inside", (8, 10, 9), (0.0, 0.0, 0.0), 3.0 * scale),
        PersonClick("outside", (8, 1, 9), (0.0, 0.0, 0.0), 1.5 * scale),
    ]
    largest = 8.0 * min(spacing)
    window = window_around(values, spacing, clicks[:1], SCALES[1], largest)
    out = features_of_first(window, inscribed_radius(clicks[0], spacing))
    window = window_around(values, spacing, clicks, SCALES[1], largest)
    volume = float(ball().sum() * np.prod(spacing))
    later, _ = features_of_later(window, inscribed_radius(clicks[1], spacing), ball(), False, 2, volume)
    return out | {f"later {name}": values for name, values in later.items()}


def test_features_are_the_same_in_other_units() -> None:
    values = image_of(ball())
    usual = features(values, SPACING)
    other = features(5.0 * values + 70.0, (6.0, 3.0, 3.0), 3.0)
    assert sorted(usual) == sorted(other)
    for name, wanted in usual.items():
        different = np.abs(np.asarray(wanted, float) - other[name]) > 1e-2 * (1.0 + np.abs(wanted))
        assert np.mean(different) < 0.02, name  # ties of an order may fall elsewhere


def test_a_network_learns_and_is_the_same_after_a_file(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    table = random.normal(size=(60_000, 4)).astype(np.float32)
    wanted = (table[:, 0] * table[:, 1] > 0).astype(np.float32)
    table[::7, 3] = np.nan
    network = trained(list("abcd"), table[:50_000], wanted[:50_000], (16, 8), 6, 200)
    assert loss(network, table[50_000:], wanted[50_000:]) < 0.15  # of the mean alone it is .69
    save(tmp_path / "weights.npz", {"some": network})
    again = load(tmp_path / "weights.npz")["some"]
    assert again.names == network.names
    np.testing.assert_allclose(again.probability(table[:99]), network.probability(table[:99]), atol=5e-3)


def test_weights_are_those_of_the_record_and_small() -> None:
    record = json.loads(WEIGHTS.with_suffix(".json").read_text())
    assert hashlib.sha256(WEIGHTS.read_bytes()).hexdigest() == record["sha256"]
    assert sum(network.parameters for network in load(WEIGHTS).values()) <= 20_000


def test_first_click_finds_a_ball_and_later_ones_move_to_their_side_alone() -> None:
    truth = ball()
    image = Volume.from_array(image_of(truth), SPACING)
    session = ReadingSession(image)
    click = next_click(truth, None, image.geometry)
    assert click is not None
    first = session.click(click).copy()
    assert dice(first, truth) > 0.85
    away = PersonClick("outside", (8, 6, 9), (0.0, 0.0, 0.0), 1.5)
    second = session.click(away).copy()
    assert not (second & ~first).any() and not second[8, 6, 9]
    third = session.click(PersonClick("inside", (8, 15, 9), (0.0, 0.0, 0.0), 1.0))
    assert not (second & ~third).any() and third[8, 15, 9]


@pytest.mark.parametrize("kind", ["phantom-blob", "phantom-touching"])
def test_same_clicks_same_labels(kind: str) -> None:
    image, truth = phantoms.made(kind, 1)
    click = next_click(truth, None, image.geometry)
    assert click is not None
    first, second = (ReadingSession(image).click(click) for _ in range(2))
    assert np.array_equal(first, second) and first.any()


def test_scenes_are_the_same_for_a_seed_and_their_objects_are_whole() -> None:
    first, second = scene(11), scene(11)
    assert np.array_equal(first[0].array, second[0].array) and first[1]
    for mask, again in zip(first[1], second[1], strict=True):
        assert np.array_equal(mask, again) and mask.shape == first[0].array.shape


@pytest.mark.slow
def test_a_short_training_learns_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    rows = gathered(tmp_path, "first", 0, 36, first_rows, 2)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    network, record = fitted(rows, 3)
    assert record["cross_entropy_held"] < record["cross_entropy_of_the_mean"]
    later = later_rows(100_003, {"first": network})
    assert later and isinstance(network, Network)
    gathered(tmp_path, "first", 0, 36, partial(first_rows), 1)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")} == times
