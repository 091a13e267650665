"""Boxes of voxels, against sets of voxels."""

import numpy as np
import pytest

from accelsurf.grid import boxes
from accelsurf.grid.boxes import (
    bounding_box,
    box_at,
    corner_of,
    meeting,
    shared,
    whole_box,
    widened,
)

SHAPE = (7, 9, 8)


def random_boxes(count, seed):
    rng = np.random.default_rng(seed)
    low = np.array([rng.integers(0, n - 1, count) for n in SHAPE]).T
    high = np.array([rng.integers(low[:, axis] + 1, n + 1) for axis, n in enumerate(SHAPE)]).T
    return low, high


def mask_of(box):
    mask = np.zeros(SHAPE, bool)
    mask[box] = True
    return mask


@pytest.mark.parametrize("seed", range(10))
def test_the_bounding_box_has_every_voxel_and_a_voxel_on_each_face(seed):
    mask = np.random.default_rng(seed).random(SHAPE) < 0.02
    mask[3, 4, 5] = True
    box = bounding_box(mask)
    assert not (mask & ~mask_of(box)).any()
    inner = mask[box]
    for axis in range(3):
        assert np.take(inner, 0, axis).any() and np.take(inner, -1, axis).any()


def test_an_empty_mask_has_no_box_and_a_full_one_the_whole_grid():
    assert bounding_box(np.zeros(SHAPE, bool)) is None
    assert bounding_box(np.zeros(SHAPE, bool), 3) is None
    assert bounding_box(np.ones(SHAPE, bool), 3) == whole_box(SHAPE)


def test_a_margin_ends_at_the_border_of_the_grid():
    mask = np.zeros(SHAPE, bool)
    mask[0, 4, 7] = True
    assert bounding_box(mask, 2) == (slice(0, 3), slice(2, 7), slice(5, 8))
    assert widened((slice(0, 1), slice(4, 5), slice(7, 8)), SHAPE, (0, 9, 1)) == (
        slice(0, 1),
        slice(0, 9),
        slice(6, 8),
    )


def test_boxes_meet_where_they_have_a_voxel_in_common():
    low, high = random_boxes(12, 1)
    masks = [
        mask_of(tuple(slice(a, b) for a, b in zip(*ends, strict=True)))
        for ends in zip(low, high, strict=True)
    ]
    found = meeting(low, high)
    want = [[j for j in range(12) if j != i and (masks[i] & masks[j]).any()] for i in range(12)]
    assert found == want and any(found) and not all(len(others) == 11 for others in found)


def test_shared_voxels_are_counted_from_the_first_voxel_of_each_box():
    low, high = random_boxes(12, 2)
    numbers = np.arange(np.prod(SHAPE)).reshape(SHAPE)
    boxes = [
        tuple(slice(a, b) for a, b in zip(*ends, strict=True))
        for ends in zip(low, high, strict=True)
    ]
    assert all(box_at(corner_of(box), numbers[box].shape) == box for box in boxes)
    compared = 0
    for i, others in enumerate(meeting(low, high)):
        for j in others:
            one, other = numbers[boxes[i]], numbers[boxes[j]]
            mine, theirs = shared(corner_of(boxes[i]), one.shape, corner_of(boxes[j]), other.shape)
            np.testing.assert_array_equal(one[mine], other[theirs])
            np.testing.assert_array_equal(np.sort(one[mine].ravel()), np.intersect1d(one, other))
            compared += 1
    assert compared > 10


def test_no_boxes_meet():
    assert boxes.meeting(np.array([]), np.array([])) == []


@pytest.mark.parametrize(
    "sizes", [(1, 9), (0, 9), (0, 140)], ids=["alike", "some empty", "some large"]
)
def test_many_boxes_meet_as_few_do(sizes):
    rng = np.random.default_rng(3)
    low = rng.integers(-20, 80, (400, 3))
    extent = rng.integers(sizes[0], 9, (400, 3))
    extent[::80] = rng.integers(max(sizes[1] - 40, 1), sizes[1] + 1, (5, 3))
    found = boxes.meeting(low, low + extent)
    assert sum(map(len, found)) > 20
    touch = ((low < (low + extent)[:, None]) & (low + extent > low[:, None])).all(axis=2)
    np.fill_diagonal(touch, False)
    assert found == [np.flatnonzero(row).tolist() for row in touch]
