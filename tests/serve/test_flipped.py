"""Layers that a viewer shows flipped have a negative scale: labels come back in the order of the client's array."""

import itertools
import random

import numpy as np
import pytest

from accelsurf.errors import InputError

pytest.importorskip("blosc2")
session = pytest.importorskip("accelsurf.serve.session")


def image_of(shape, spacing, seed):
    middle = [n // 3 for n in shape]
    far = sum(
        ((axis - at) * h) ** 2
        for axis, at, h in zip(np.indices(shape), middle, spacing, strict=True)
    )
    inside = far < (5 * min(spacing)) ** 2
    return 100.0 * inside + np.random.default_rng(seed).normal(0, 5, shape), inside, middle


def labels_of(image, spacing, middle, seed):
    draw = random.Random(seed)
    made = session.ImageSession(image[np.newaxis].astype(np.float32), spacing)
    labels = np.zeros(image.shape, np.uint8)
    for number in range(2):
        if number == 0:
            made.point(middle, "inside")
        else:
            away = [n - 1 - draw.randrange(max(n // 6, 1)) for n in image.shape]
            made.point(away, "outside")
        answer = made.answer()
        if answer is not None:
            labels[answer.box] = answer.labels
    return labels


@pytest.mark.parametrize("signs", [s for s in itertools.product((1, -1), repeat=3) if -1 in s])
@pytest.mark.parametrize("shape", [(18, 20, 22), (30, 32, 1), (1, 30, 32)])
def test_a_flip_changes_no_label(signs, shape):
    spacing = (1.5, 1.0, 0.75)
    seed = sum(2**place for place, sign in enumerate(signs) if sign < 0)
    image, inside, middle = image_of(shape, spacing, seed)
    expected = labels_of(image, spacing, middle, seed)
    flipped = [h * sign for h, sign in zip(spacing, signs, strict=True)]
    found = labels_of(image, flipped, middle, seed)
    assert np.array_equal(found, expected)
    both = np.count_nonzero((found > 0) & inside)
    assert 2 * both > 0.8 * (np.count_nonzero(found) + np.count_nonzero(inside))


@pytest.mark.parametrize("spacing", [(0.0, 1, 1), (1, -0.0, 1), (-1e-12, 1, 1), (1, 1, -1e12)])
def test_a_voxel_without_a_size_is_refused(spacing):
    with pytest.raises(InputError):
        session.ImageSession(
            np.ones((1, 4, 5, 6), np.float32) * np.arange(6, dtype=np.float32), spacing
        )
