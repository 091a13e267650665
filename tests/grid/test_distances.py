"""Distances from a ball, against the formula at every voxel."""

import numpy as np
import pytest

from accelsurf.grid import boxes
from accelsurf.grid.geometry import ball_distance

BOX, SPACING, CENTRE, RADIUS = (
    (slice(2, 9), slice(0, 11), slice(5, 13)),
    (2.5, 0.8, 1.1),
    (4.3, 5.1, 8.7),
    3.3,
)


def by_formula():
    index = np.stack(
        np.meshgrid(*(np.arange(s.start, s.stop) for s in BOX), indexing="ij"), axis=-1
    )
    return np.linalg.norm((index - CENTRE) * SPACING, axis=-1) - RADIUS


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_distance_at_every_voxel(precision):
    got = ball_distance(BOX, SPACING, CENTRE, RADIUS, precision)
    assert got.dtype == np.float32 and (got < 0).any()
    np.testing.assert_allclose(got, by_formula(), atol=1e-5 if precision is np.float32 else 1e-6)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_slabs_make_no_difference(monkeypatch, precision):
    whole = ball_distance(BOX, SPACING, CENTRE, RADIUS, precision)
    monkeypatch.setattr(boxes, "SLAB_VOXELS", 1)
    np.testing.assert_array_equal(ball_distance(BOX, SPACING, CENTRE, RADIUS, precision), whole)
