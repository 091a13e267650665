"""Windows of a grid: their faces, and blocks of a pyramid that are those of the whole."""

import numpy as np
import pytest

from accelsurf.grid import pyramid
from accelsurf.grid.boxes import box_at
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import GUARD, LeavesWindow, Window, aligned, enlarged

WHOLE = Geometry((97, 110, 123), (1.2, 1.0, 1.0))


def test_pyramids_of_an_aligned_window_have_the_blocks_of_the_whole():
    rng = np.random.default_rng(3)
    image = rng.normal(size=WHOLE.shape).astype(np.float32)
    grids = pyramid.levels(WHOLE.shape, WHOLE.spacing)
    box = aligned((slice(13, 50), slice(22, 71), slice(31, 90)), WHOLE, grids[-1].factors)
    assert all(
        s.start <= a and s.stop >= b
        for s, (a, b) in zip(box, ((13, 50), (22, 71), (31, 90)), strict=True)
    )
    shape = tuple(s.stop - s.start for s in box)
    mine = pyramid.levels(shape, WHOLE.spacing, len(grids), min_voxels=1)
    whole, part = image, image[box]
    corner = [s.start for s in box]
    for fine, coarse, own_fine, own in zip(grids, grids[1:], mine, mine[1:], strict=False):
        whole, part = pyramid.restrict(whole, fine, coarse), pyramid.restrict(part, own_fine, own)
        assert own.factors == coarse.factors and own.spacing == coarse.spacing
        first = [c // f for c, f in zip(corner, own.factors, strict=True)]
        there = whole[box_at((first[0], first[1], first[2]), part.shape)]
        inner = tuple(slice(2, -2) for _ in range(3))
        assert np.array_equal(there[inner], part[inner])


def test_a_window_that_is_not_aligned_has_other_blocks():
    image = np.random.default_rng(3).normal(size=WHOLE.shape).astype(np.float32)
    fine, coarse = pyramid.levels(WHOLE.shape, WHOLE.spacing)[:2]
    whole = pyramid.restrict(image, fine, coarse)
    part = image[16:64, 16:64, 17:65]
    mine = pyramid.levels(part.shape, WHOLE.spacing, 2, min_voxels=1)
    assert not np.array_equal(
        whole[9:30, 9:30, 9:30], pyramid.restrict(part, *mine)[1:22, 1:22, 1:22]
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("end", ["low", "high"])
def test_a_window_is_left_at_open_faces_alone(axis, end):
    size = WHOLE.shape[axis]
    sides = [slice(0, n) for n in WHOLE.shape]
    low, high = [20, 20, 20], [40, 40, 40]
    if end == "low":
        sides[axis] = slice(30, size)
        low[axis], nearer = GUARD, GUARD - 1
    else:
        sides[axis] = slice(0, 60)
        high[axis], nearer = 60 - GUARD, 60 - GUARD + 1
    window = Window(WHOLE, tuple(sides))
    window.check(low, high)
    (low if end == "low" else high)[axis] = nearer
    with pytest.raises(LeavesWindow) as left:
        window.check(low, high)
    assert [left.value.low[axis], left.value.high[axis]] == [end == "low", end == "high"]
    assert sum(left.value.low) + sum(left.value.high) == 1
    # Of the whole volume's own faces nothing is said.
    Window(WHOLE, tuple(slice(0, n) for n in WHOLE.shape)).check([0, 0, 0], WHOLE.shape)


def test_faces_are_as_far_on_coarse_levels_in_voxels_of_those():
    wide = Window(WHOLE, (slice(8, 96), slice(16, 64), slice(16, 64)))
    wide.check([GUARD, GUARD, GUARD], [14, 12, 12], (4, 1, 1))
    with pytest.raises(LeavesWindow):
        wide.check([GUARD - 1, GUARD, GUARD], [14, 12, 12], (4, 1, 1))
    with pytest.raises(LeavesWindow):
        wide.check([GUARD, GUARD, GUARD], [15, 12, 12], (4, 1, 1))


def test_a_window_grows_where_it_was_left_and_stays_aligned():
    grids = pyramid.levels(WHOLE.shape, WHOLE.spacing)
    blocks = grids[-1].factors
    window = Window(WHOLE, aligned((slice(40, 60), slice(40, 60), slice(40, 60)), WHOLE, blocks))
    box = enlarged(window, LeavesWindow((True, False, False), (False, False, True)), blocks, 1.0)
    assert box == aligned(box, WHOLE, blocks)
    assert box[0].start < window.box[0].start and box[0].stop == window.box[0].stop
    assert box[1] == window.box[1]
    assert box[2].start == window.box[2].start and box[2].stop > window.box[2].stop
    assert all(isinstance(n, int) for s in box for n in (s.start, s.stop))
