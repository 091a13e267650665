"""Values of blocks on voxels, and F that changes sides one way, against numpy."""

import numpy as np
import pytest

from accelsurf.energies.seeded.appearance import median_change
from accelsurf.kernels.blocks import add_between, changes_up_to, hold_side, scaled_means, tally_changes

pytestmark = pytest.mark.nojit


def places(steps, first, counts, blocks):
    """For each axis the blocks below the voxels and the parts of the way to the next."""
    found = []
    for step, begin, count, n in zip(steps, first, counts, blocks, strict=True):
        at = np.clip((begin + np.arange(count) - 0.5 * (step - 1)) / step, 0, n - 1)
        below = np.floor(at).astype(np.int64)
        found.append((below, (at - below).astype(np.float32)))
    return found


@pytest.mark.parametrize(
    ("steps", "first", "counts", "corner", "shape"),
    [
        ((1, 1, 1), (0, 0, 0), (3, 4, 5), (0, 0, 0), (3, 4, 5)),
        ((2, 3, 1), (0, 0, 0), (5, 7, 4), (1, 0, 2), (7, 8, 6)),
        ((1, 4, 3), (0, 2, 1), (1, 9, 7), (0, 3, 0), (1, 13, 8)),
    ],
)
def test_values_of_blocks_are_added_linearly_between_their_middles(steps, first, counts, corner, shape):
    rng = np.random.default_rng(0)
    blocks = [-(-(a + n) // step) for a, n, step in zip(first, counts, steps, strict=True)]
    values, before = rng.normal(size=blocks).astype(np.float32), rng.normal(size=shape).astype(np.float32)
    axes = places(steps, first, counts, blocks)
    expected = values.astype(np.float64)
    for axis, (below, part) in enumerate(axes):
        above = np.minimum(below + 1, blocks[axis] - 1)
        share = np.expand_dims(part, [i for i in range(3) if i != axis])
        expected = np.take(expected, below, axis) * (1 - share) + np.take(expected, above, axis) * share
    out = before.copy()
    add_between(out, np.float32(0.3), values, *((c, *axis) for c, axis in zip(corner, axes, strict=True)))
    whole = np.ones(shape)
    whole[tuple(slice(c, c + n) for c, n in zip(corner, counts, strict=True))] = expected
    np.testing.assert_allclose(out, before + 0.3 * whole, atol=1e-6)


@pytest.mark.parametrize("gains", [True, False])
def test_labels_change_to_one_side_alone(gains):
    rng = np.random.default_rng(1)
    force, before = (rng.uniform(-1.5, 1.5, (2, 5, 7)).astype(np.float32) for _ in range(2))
    inside, held, least = rng.random((2, 5, 7)) < 0.5, np.float32(0.3), np.float32(1e-3)
    earlier = np.clip(before, -1, 1)
    expected = force + held * (earlier - force)
    wrong = inside & (expected >= 0) if gains else ~inside & (expected < 0)
    kept = np.minimum(earlier, -least) if gains else np.maximum(earlier, least)
    hold_side(force, before, inside, held, least, gains)
    assert wrong.sum() > 5
    np.testing.assert_allclose(force, np.where(wrong, kept, expected), atol=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 2), (1, 5, 7), (3, 4, 5), (2, 1, 3), (7, 6, 8)])
@pytest.mark.parametrize("kind", ["noise", "few values", "constant"])
def test_the_median_change_is_numpys(shape, kind):
    made = np.random.default_rng(4).normal(0, 3, (9, 8, 10)).astype(np.float32)
    values = {"noise": made, "few values": np.round(made), "constant": np.ones_like(made)}[kind]
    part = values[tuple(slice(1, n + 1) for n in shape)]
    changes = np.concatenate([np.abs(np.diff(part, axis=axis)).ravel() for axis in range(3)])
    expected = float(np.median(changes)) if changes.size else 0.0
    assert median_change(part) == expected
    for least in (0.5 * expected, expected, 2.0 * expected + 0.1):
        assert median_change(part, least) == max(expected, least)
    if changes.size:
        assert tally_changes(part, -1).sum() == changes.size
        assert changes_up_to(part, np.float32(expected)) == np.count_nonzero(changes <= np.float32(expected))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("steps", [(1, 1, 1), (1, 2, 3), (3, 1, 2), (5, 9, 4)])
def test_scaled_means_are_numpys(steps):
    """Of a part of an image, blocks at its ends smaller, values cut at both ends."""
    part = np.random.default_rng(5).normal(2, 3, (7, 9, 12)).astype(np.float32)[1:6, :, 2:]
    scaled = np.clip((part.astype(np.float64) - 1.5) / 2.0, -1.2, 1.2)
    expected = scaled
    for axis, step in enumerate(steps):
        at = np.arange(0, part.shape[axis], step)
        sizes = np.diff(np.append(at, part.shape[axis]))
        expected = np.add.reduceat(expected, at, axis) / np.expand_dims(sizes, [i for i in range(3) if i != axis])
    found = scaled_means(part, np.float32(1.5), np.float32(2.0), np.float32(1.2), steps)
    assert found.dtype == np.float32 and (np.abs(scaled) == 1.2).any()
    np.testing.assert_allclose(found, expected, atol=1e-6)
