"""A shell that beats while frames hide it: a cavity that its momentum would close is there when it is seen again."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.image.volume import Volume
from accelsurf.io.library_images import VolumeSequence
from accelsurf.track.track import track


def shell(shape: tuple[int, ...], centre: np.ndarray, radii: tuple[float, float]) -> np.ndarray:
    """Share of each voxel between two radii about a centre (z, y, x), of a ring in an image of one slice."""
    away = np.indices(shape).astype(float) - centre[:, None, None, None]
    if shape[0] == 1:
        away = away[1:]
    distance = np.sqrt((away**2).sum(axis=0))
    inner, outer = (np.clip(0.5 + r - distance, 0.0, 1.0) for r in radii)
    return outer - inner


def beating(
    shape: tuple[int, ...], hidden: tuple[int, ...], seed: int, rate: float
) -> tuple[VolumeSequence, list[np.ndarray]]:
    """A shell that shrinks by ``rate`` voxels a frame, turns while it is hidden, and grows again; and its labels."""
    random = np.random.default_rng(seed)
    start = (np.array(shape) - 1) / 2 + random.uniform(-0.5, 0.5, 3)
    way = random.uniform(-0.4, 0.4, 3) * (np.array(shape) > 1)
    turn = hidden[0] - 0.5
    images, truth = [], []
    for n in range(hidden[-1] + 4):
        cavity = 3.0 + rate * abs(n - turn)
        part = shell(shape, start + n * way, (cavity, cavity + 3.5))
        truth.append(part >= 0.5)
        seen = np.zeros(shape) if n in hidden else part
        noisy = 100.0 * seen + random.normal(0.0, 20.0, shape)
        images.append(Volume.from_array(noisy.astype(np.float32)))
    return VolumeSequence(images), truth


SLICE, VOLUME = (1, 64, 64), (34, 34, 34)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("model", ["flowable-mass", "last-displacement"])
@pytest.mark.parametrize(
    ("shape", "hidden", "rate"), [(SLICE, (4, 5, 6), 1.5), (VOLUME, (3, 4), 1.0)]
)
def test_a_cavity_is_there_when_a_shell_is_seen_again(shape, hidden, rate, model, seed) -> None:
    """Behind the gap it has 1.9 times its volume, in one slice 1.8 times its area."""
    images, truth = beating(shape, hidden, seed, rate)
    results = list(track(images, start="otsu", model=model, threads=1, max_gap=4))
    assert_seen_rightly(results, truth)
    assert [result.objects[0].seen for result in results] == [
        n not in hidden for n in range(len(truth))
    ]


@pytest.mark.parametrize("model", ["flowable-mass", "last-displacement"])
def test_a_shell_that_comes_back_more_than_twice_as_large_is_lost_and_said_to_be(model) -> None:
    """It has 2.3 times its volume then, and lies where its cavity was: it cannot be told from another object."""
    hidden = (3, 4)
    images, truth = beating(VOLUME, hidden, 0, 1.5)
    results = list(track(images, start="otsu", model=model, threads=1, max_gap=4))
    assert_seen_rightly(results, truth)
    assert not any(one.seen for result in results[hidden[0] :] for one in result.objects)


def assert_seen_rightly(results, truth) -> None:
    """Dice and volume of all that is seen."""
    for result in results:
        there = truth[result.frame]
        for one in result.objects:
            if one.seen:
                found = np.zeros(there.shape, bool)
                found[one.surface.box] = one.surface.psi < 0
                assert 2 * (found & there).sum() / (found.sum() + there.sum()) > 0.85
                assert found.sum() == pytest.approx(there.sum(), rel=0.25)
