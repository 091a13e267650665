"""The training of the networks that read clicks: scenes by seed, a network that learns, a training that goes on."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from accelsurf.clicks.model.network import Layer, Network, logits_around, networks
from benchmarks.clicks.reading import around, lessons
from benchmarks.clicks.reading.__main__ import fitted, gathered
from benchmarks.clicks.reading.games import boundary_rows, first_rows, later_rows
from benchmarks.clicks.reading.scenes import scene
from benchmarks.clicks.reading.training import loss, trained


def test_a_network_learns() -> None:
    random = np.random.default_rng(0)
    table = random.normal(size=(60_000, 4)).astype(np.float32)
    wanted = (table[:, 0] * table[:, 1] > 0).astype(np.float32)
    table[::7, 3] = np.nan
    network = trained(list("abcd"), table[:50_000], wanted[:50_000], (16, 8), 6, 200)
    assert loss(network, table[50_000:], wanted[50_000:]) < 0.15  # of the mean alone it is .69


def some_layers(random: np.random.Generator, features: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Layers of random weights, so that each counts."""
    return [
        (0.3 * random.standard_normal(w.shape), 0.3 * random.standard_normal(b.shape))
        for w, b in around.started(features)
    ]


@pytest.mark.parametrize("shape", [(6, 7, 5), (4, 8, 4), (1, 9, 2)])
def test_what_is_trained_on_windows_is_what_the_program_asks(shape: tuple[int, int, int]) -> None:
    random = np.random.default_rng(2)
    layers = [(w.astype(np.float32), b.astype(np.float32)) for w, b in some_layers(random, 3)]
    values, answer = (
        random.standard_normal((*shape, 3)).astype(np.float32),
        random.standard_normal(shape),
    )
    expected, _ = around.forward(layers, values, answer.astype(np.float32))
    first = np.ascontiguousarray(np.moveaxis(values, -1, 0))
    found = logits_around([Layer(*layer) for layer in layers], first, answer.astype(np.float32))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_slopes_on_windows_are_those_of_differences() -> None:
    random = np.random.default_rng(1)
    layers = some_layers(random, 3)
    values, answer, wanted = (random.standard_normal((6, 7, 5, n)) for n in (3, 1, 1))
    _, held = around.forward(layers, values, answer[..., 0])
    slopes = around.backward(layers, held, wanted[..., 0])
    for i, layer in enumerate(layers):
        for j, part in enumerate(layer):
            way, sides = random.standard_normal(part.shape), []
            for step in (1e-6, -1e-6):
                moved = [list(pair) for pair in layers]
                moved[i][j] = part + step * way
                sides.append(
                    float((around.forward(moved, values, answer[..., 0])[0] * wanted[..., 0]).sum())
                )
            assert (sides[0] - sides[1]) / 2e-6 == pytest.approx(
                float((slopes[i][j] * way).sum()), rel=1e-3, abs=1e-3
            )


def test_slopes_of_the_error_are_those_of_differences() -> None:
    random = np.random.default_rng(3)
    logits, share = 2.0 * random.standard_normal((4, 5, 3)), random.uniform(size=(4, 5, 3))
    fixed = random.uniform(size=share.shape) < 0.3
    known = share, fixed, fixed & (random.uniform(size=share.shape) < 0.5)
    slope = lessons.error(logits, *known)[2]
    assert not slope[fixed].any()
    way, ends = np.where(fixed, 0.0, random.standard_normal(share.shape)), []
    for step in (1e-5, -1e-5):
        entropy, dice, _ = lessons.error(logits + step * way, *known)
        ends.append(entropy - dice)
    assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(float((slope * way).sum()), rel=1e-3)


def test_scenes_are_the_same_for_a_seed_and_their_objects_are_whole() -> None:
    first, second = scene(11), scene(11)
    assert np.array_equal(first[0].array, second[0].array) and first[1]
    for mask, again in zip(first[1], second[1], strict=True):
        assert np.array_equal(mask, again) and mask.shape == first[0].array.shape


def test_rows_of_games_are_those_that_the_networks_are_asked_with() -> None:
    known = networks()
    for name, rows in (
        ("first", first_rows(5)),
        ("later", later_rows(5, known)),
        ("boundary", boundary_rows(5, known)),
    ):
        assert rows and set(known[name].names) <= set(rows[0].names)
        assert all(len(each.table) == len(each.wanted) == len(each.scenes) for each in rows)
        assert all(0.0 <= each.wanted.min() and each.wanted.max() <= 1.0 for each in rows)


@pytest.mark.slow
def test_a_short_training_learns_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    rows = gathered(tmp_path, "first", 0, 36, first_rows, 2)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    network, record = fitted("first", rows, 3)
    assert record["cross_entropy_held"] < record["cross_entropy_of_the_mean"]
    later = later_rows(100_003, {"first": network})
    assert later and isinstance(network, Network)
    gathered(tmp_path, "first", 0, 36, partial(first_rows), 1)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")} == times
