"""Which level is the object: edges along it, the expected Dice, what balls and disks say of the size."""

import numpy as np
import pytest

from accelsurf.energies.seeded.appearance import count_of, radius_of
from accelsurf.energies.seeded.proposal import (
    Prior,
    by_evidence,
    candidate_counts,
    edge_along,
    edges_of,
    level_evidence,
    prior_of,
    safest,
)
from accelsurf.kernels.arrival import Tissue


def tissue_of(*gradients):
    ones = np.ones(len(gradients))
    return Tissue(ones, ones, np.array(gradients), np.ones(6))


def test_edges_are_gradients_in_units_of_the_tissues():
    z, y, x = np.indices((4, 6, 8)).astype(np.float32)
    spacing = (2.0, 1.0, 0.5)
    order = np.arange(z.size)[::-1].copy()
    slope = edges_of([6.0 * z + 4.0 * y], spacing, tissue_of(2.5), order)
    np.testing.assert_allclose(slope, np.hypot(3.0, 4.0) / 2.5, rtol=1e-6)
    both = edges_of([6.0 * z, 4.0 * x], spacing, tissue_of(1.0, 2.0), order)
    np.testing.assert_allclose(both, np.hypot(3.0, 4.0), rtol=1e-6)


def test_edges_of_some_voxels_are_those_of_all():
    image = np.random.default_rng(0).normal(0, 1, (5, 9, 9)).astype(np.float32)
    every = edges_of([image], (1.0, 1.0, 1.0), tissue_of(1.0), np.arange(image.size))
    inner = np.ravel_multi_index((np.full(4, 2), np.array([3, 4, 4, 5]), np.array([4, 4, 3, 4])), image.shape)
    np.testing.assert_allclose(edges_of([image], (1.0, 1.0, 1.0), tissue_of(1.0), inner), every[inner], rtol=1e-6)


def test_the_edge_along_a_level_is_that_of_what_comes_then():
    edges = np.ones(1000)
    edges[480:520] = 11.0
    assert edge_along(edges, np.array([100, 500, 800])) == pytest.approx([1.0, 1.0 + 400 / 96, 1.0], rel=0.02)


def test_the_safest_level_has_the_largest_expected_dice():
    random = np.random.default_rng(3)
    for _ in range(20):
        counts = np.sort(random.integers(10, 5000, 12))
        score = random.normal(0, 2, 12)
        part = np.exp(score) / np.exp(score).sum()
        expected = [sum(p * 2 * min(n, m) / (n + m) for p, m in zip(part, counts, strict=True)) for n in counts]
        assert safest(counts, score) == int(np.argmax(expected))


def test_the_level_with_an_edge_along_it_is_taken():
    """Times and values say nothing of the size; the edges do."""
    n = 4000
    times, order = np.arange(1, n + 1, dtype=np.float32), np.arange(n)
    values = np.zeros((1, n), np.float32)
    found = []
    for at in (600, 1500):
        edges = np.full(n, 0.01)
        edges[int(0.97 * at) : int(1.03 * at)] = 50.0
        proposal = by_evidence(level_evidence(values, edges, times, order, 100), Prior(1000.0, 1.2), 2.0)
        found.append(proposal.volume_mm3 / 2.0)
        assert all(abs(np.log(other / proposal.volume_mm3)) > 0.2 for other in proposal.others)
    assert found == pytest.approx([600, 1500], rel=0.15)


def test_candidates_end_where_the_speed_of_the_front_is_still_known():
    counts = candidate_counts(10, 1000)
    assert counts[0] == 15 and 740 < counts[-1] <= 800


@pytest.mark.parametrize("flat", [False, True])
def test_the_count_of_a_radius_is_the_inverse(flat):
    spacing = (5.0, 0.5, 0.8)
    assert radius_of(count_of(7.0, spacing, flat), spacing, flat) == pytest.approx(7.0)


def test_a_disk_says_less_of_the_size_than_a_ball():
    solid, flat = prior_of(100, None, 50.0, False), prior_of(100, None, 50.0, True)
    assert (solid.voxels, solid.even) == pytest.approx((4400.0, 550.0))
    assert (flat.voxels, flat.even) == pytest.approx((400.0 * 5.5 ** (2 / 3), 100.0 * 5.5 ** (2 / 3)))
