"""Pieces of a mask and its holes, against SciPy's."""

import numpy as np
import pytest
from scipy import ndimage

from accelsurf.grid.boxes import connected_to, holes_filled


def random_mask(shape, seed):
    return ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.0) > 0.05


@pytest.mark.parametrize("shape", [(12, 14, 13), (1, 30, 30), (3, 20, 25)])
@pytest.mark.parametrize("seed", range(3))
def test_pieces_and_holes_are_scipy_s(shape, seed):
    mask, seeds = random_mask(shape, seed), np.zeros(shape, bool)
    seeds[tuple(n // 2 for n in shape)] = seeds[0, 0, :] = True
    labels, _ = ndimage.label(mask)
    expected = mask & np.isin(labels, np.unique(labels[seeds & mask]))
    np.testing.assert_array_equal(connected_to(mask, seeds), expected)
    np.testing.assert_array_equal(holes_filled(mask), ndimage.binary_fill_holes(mask))


def test_a_hole_at_a_face_of_the_grid_is_none():
    bowl = np.ones((5, 5, 5), bool)
    bowl[:3, 2, 2] = False
    np.testing.assert_array_equal(holes_filled(bowl), bowl)
    bowl[0, 2, 2] = True
    assert holes_filled(bowl).all()


def test_nothing_and_everything():
    empty = np.zeros((3, 4, 5), bool)
    for mask in (empty, ~empty):
        np.testing.assert_array_equal(holes_filled(mask), mask)
        np.testing.assert_array_equal(connected_to(mask, ~empty), mask)
        assert not connected_to(mask, empty).any()


def test_a_mask_is_not_changed():
    shell = np.ones((3, 3, 3), bool)
    shell[1, 1, 1] = False
    assert holes_filled(shell).all()
    assert not shell[1, 1, 1]
