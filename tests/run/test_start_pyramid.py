"""Boxes of objects on the levels of a run."""

import numpy as np
import pytest

from accelsurf.grid.pyramid import levels, restrict
from accelsurf.run.start_pyramid import StartPyramid, coarser_box, finer_box, touched_box
from accelsurf.starts.objects import ObjectStart


@pytest.mark.parametrize("shape", [(17, 18, 21), (16, 15, 1)])
def test_a_box_has_the_blocks_of_the_whole_grid(shape):
    fine, coarse = levels(shape, (1.0, 1.0, 1.0), 2, 2)
    image = np.random.default_rng(2).normal(size=shape).astype(np.float32)
    whole = restrict(image, fine, coarse)
    for corner, size in (((2, 3, 0), (4, 5, 1)), ((0, 0, 0), (3, 4, 1)), ((4, 4, 0), (4, 4, 1))):
        if shape[2] > 1:
            corner, size = (*corner[:2], 5), (*size[:2], 6)
        box = touched_box(corner, size, coarse, fine)
        part = fine.on_box([s.start for s in box], [s.stop - s.start for s in box])
        small = restrict(np.ascontiguousarray(image[box]), part, coarse.on_box(corner, size))
        there = tuple(slice(c, c + n) for c, n in zip(corner, size, strict=True))
        np.testing.assert_array_equal(small, whole[there])


def test_boxes_of_blocks_and_of_voxels_belong_together():
    fine, coarse = levels((17, 18, 21), (1.0, 1.0, 1.0), 2, 2)
    for corner, shape in (
        ((3, 4, 5), (6, 7, 8)),
        ((0, 0, 0), (17, 18, 21)),
        ((9, 9, 9), (8, 9, 12)),
    ):
        at, counts = coarser_box(corner, shape, coarse, fine)
        box = touched_box(at, counts, coarse, fine)
        assert all(
            s.start <= c and s.stop >= c + n for s, c, n in zip(box, corner, shape, strict=True)
        )
        assert all(s.stop <= n for s, n in zip(box, fine.shape, strict=True))
    assert finer_box((0, 0, 0), coarse.shape, coarse, fine) == ((0, 0, 0), fine.shape)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_start_of_an_object_is_the_same_from_either_side(axis):
    grids = levels((17, 18, 21), (1.0, 1.0, 1.0), 2, 2)
    # At the border of the grid: what is beyond the box is outside, what is beyond the grid goes on.
    psi = np.where(np.random.default_rng(4).random((6, 7, 8)) < 0.6, -0.5, 0.5).astype(np.float32)
    corner = (0, 5, 13)
    flipped = tuple(
        n - c - m if i == axis else c
        for i, (n, c, m) in enumerate(zip((17, 18, 21), corner, (6, 7, 8), strict=True))
    )
    at, one = StartPyramid(ObjectStart(1, corner, psi), grids).current()
    there, other = StartPyramid(ObjectStart(1, flipped, np.flip(psi, axis)), grids).current()
    np.testing.assert_array_equal(one, np.flip(other, axis))
    assert at[axis] + there[axis] + one.shape[axis] == grids[1].shape[axis]
