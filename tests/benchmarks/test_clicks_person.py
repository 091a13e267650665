"""The simulated person's rules, on cases small enough to be done by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from accelsurf.grid.geometry import Geometry
from benchmarks.clicks.person import (
    PersonClick,
    ball_voxels,
    click_in_box,
    click_of_challenge,
    drawn_box,
    first_stroke,
    next_click,
)

UNIT = (1.0, 1.0, 1.0)


def block(shape: tuple[int, int, int], *boxes: Any) -> np.ndarray:
    """True within boxes, each ((z, z), (y, y), (x, x))."""
    out = np.zeros(shape, bool)
    for box in boxes:
        out[tuple(slice(*side) for side in box)] = True
    return out


def click(
    truth: np.ndarray, labels: np.ndarray | None = None, spacing: Any = UNIT, **more: Any
) -> PersonClick:
    made = next_click(truth, labels, Geometry(truth.shape, spacing), **more)
    assert made is not None
    return made


def test_the_first_click_is_in_the_middle_with_half_the_depth() -> None:
    # A cube of 9: the middle is 5 voxels from the nearest voxel outside.
    made = click(block((15, 16, 17), ((2, 11), (3, 12), (4, 13))))
    assert made == PersonClick("inside", (6, 7, 8), (8.0, 7.0, 6.0), 2.5)


def test_ties_go_to_the_lowest_index() -> None:
    two = block((9, 9, 20), ((2, 5), (2, 5), (12, 15)), ((2, 5), (2, 5), (3, 6)))
    assert click(two).index == (3, 3, 4)
    # A cube of even width has eight deepest voxels.
    assert click(block((10, 10, 10), ((3, 7), (3, 7), (3, 7)))).index == (4, 4, 4)


def test_spacings_that_differ_by_rounding_do_not_decide_ties() -> None:
    two = block((9, 9, 20), ((2, 5), (2, 5), (12, 15)), ((2, 5), (2, 5), (3, 6)))
    assert click(two, spacing=(1.0, 1.0, 0.9999999)).index == (3, 3, 4)


def test_depth_is_in_mm_not_in_voxels() -> None:
    # In voxels the cube of 5 is the deeper one; with slices of 8 mm the plate of one slice, 11 voxels wide, is.
    both = block((9, 30, 30), ((2, 3), (3, 14), (3, 14)), ((2, 7), (20, 25), (20, 25)))
    assert click(both).index == (4, 22, 22)
    assert click(both, spacing=(8.0, 1.0, 1.0)).index == (2, 8, 8)


def test_the_border_of_the_scan_is_no_end_of_the_object() -> None:
    # It ends at y = 5 only, so the deepest voxels are those at y = 0; the lowest index counts.
    made = click(block((6, 10, 6), ((0, 6), (0, 5), (0, 6))))
    assert made.index == (0, 0, 0) and made.radius == 2.5


def test_what_is_missing_gets_an_inside_click_and_too_much_an_outside_one() -> None:
    truth = block((12, 12, 30), ((2, 9), (2, 9), (2, 9)))
    missing = block(truth.shape, ((2, 9), (2, 9), (2, 6)))
    small = block(truth.shape, ((3, 6), (3, 6), (15, 18)))
    large = block(truth.shape, ((2, 9), (2, 9), (15, 24)))
    assert click(truth, (truth & ~missing) | small)[:2] == ("inside", (3, 3, 3))
    assert click(truth, (truth & ~missing) | large)[:2] == ("outside", (5, 5, 18))


def test_at_equal_depth_the_lowest_index_counts_whatever_the_side() -> None:
    truth = block((9, 9, 30), ((2, 5), (2, 5), (20, 23)))
    assert click(truth, block(truth.shape, ((2, 5), (2, 5), (3, 6))))[:2] == ("outside", (3, 3, 4))
    truth, labels = (
        block((9, 9, 30), ((2, 5), (2, 5), (3, 6))),
        block(truth.shape, ((2, 5), (2, 5), (20, 23))),
    )
    assert click(truth, labels)[:2] == ("inside", (3, 3, 4))


def test_nothing_wrong_no_click() -> None:
    truth = block((9, 9, 9), ((2, 5), (2, 5), (2, 5)))
    assert next_click(truth, truth.copy(), Geometry(truth.shape, UNIT)) is None


def test_the_radius_has_bounds_by_the_spacings() -> None:
    # 25 voxels of half-width 13 ask for 6.5 mm; with a smallest spacing of 0.5 mm no more than 4 mm.
    wide = block((40, 40, 60), ((5, 30), (5, 30), (5, 58)))
    assert click(wide).radius == 6.5
    assert click(wide, spacing=(1.0, 1.0, 0.5)).radius == 4.0
    # A rod of 3 x 3 voxels, 1 mm wide, with slices of 3 mm: half the depth is 1, the least ball 1.5 mm.
    rod = block((20, 11, 11), ((2, 18), (4, 7), (4, 7)))
    assert click(rod, spacing=(3.0, 1.0, 1.0)).radius == 1.5


def test_a_ball_that_would_paint_over_the_edge_is_one_voxel() -> None:
    line = block((20, 9, 9), ((2, 18), (4, 5), (4, 5)))
    made = click(line, spacing=(3.0, 1.0, 1.0))
    assert made.radius == 0.5
    box, ball = ball_voxels(made, Geometry(line.shape, (3.0, 1.0, 1.0)))
    assert ball.sum() == 1 and line[box].all()


def test_a_ball_at_the_border_is_cut_there() -> None:
    made = PersonClick("inside", (0, 5, 9), (9.0, 5.0, 0.0), 2.0)
    box, ball = ball_voxels(made, Geometry((10, 10, 10), (2.0, 1.0, 1.0)))
    assert box == (slice(0, 2), slice(3, 8), slice(7, 10))
    assert ball[0].sum() == 9 and ball[1].sum() == 1


def test_the_world_position_follows_the_geometry() -> None:
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    geometry = Geometry((9, 9, 9), (1.0, 2.0, 3.0), (10.0, 20.0, 30.0), turned)
    made = next_click(block((9, 9, 9), ((3, 6), (2, 5), (4, 7))), None, geometry)
    assert made is not None and made.centre == tuple(geometry.index_to_world(made.index))


def test_jittered_clicks_fall_where_the_depth_is_above_half_and_repeat_with_their_seed() -> None:
    truth = block((15, 15, 30), ((2, 13), (2, 13), (2, 13)), ((3, 8), (3, 8), (20, 25)))
    seen = [click(truth, random=np.random.default_rng(seed)) for seed in range(40)]
    assert seen == [click(truth, random=np.random.default_rng(seed)) for seed in range(40)]
    # The cube of 11 is 6 deep: more than 3 deep is the middle 5^3, and nothing of the cube of 5, which is 3 deep.
    at = np.array([made.index for made in seen])
    assert at.min() >= 5 and at.max() <= 9 and len(set(map(tuple, at))) > 20
    depths = 6 - np.abs(at - 7).max(axis=1)
    assert [made.radius for made in seen] == [0.5 * depth for depth in depths]


# -- boxes, strokes, and the challenge ----------------------------------------------------------------------


def test_a_stroke_runs_along_the_middle_of_the_slice_with_most_of_the_object() -> None:
    # An arm of 5 x 5 voxels along x and one along y, in slices of 2 mm: the arm along x has more.
    truth = block((9, 40, 60), ((2, 7), (18, 23), (4, 54)), ((4, 5), (18, 36), (4, 9)))
    made = first_stroke(truth, Geometry(truth.shape, (2.0, 1.0, 1.0)))
    assert made.side == "inside" and {z for z, _, _ in made.line} == {4}
    along = [x for _, _, x in made.line]
    assert max(along) - min(along) > 30 and 1 <= made.radius <= 1.5
    box, pen = ball_voxels(made, Geometry(truth.shape, (2.0, 1.0, 1.0)))
    assert truth[box][pen].all() and pen.sum() > 60


def test_the_voxels_of_a_stroke_are_those_of_its_balls() -> None:
    geometry = Geometry((9, 9, 20), UNIT)
    made = PersonClick("inside", (4, 4, 6), (6.0, 4.0, 4.0), 1.0, ((4, 4, 5), (4, 4, 6), (4, 4, 7)))
    box, pen = ball_voxels(made, geometry)
    # Three balls of 7 voxels in a row share their middles.
    assert box == (slice(3, 6), slice(3, 6), slice(4, 9)) and pen.sum() == 5 + 3 * 4


def test_a_click_in_a_box_is_the_deep_place_nearest_to_its_middle() -> None:
    # Two cubes in the corners: the middle of the box is in none of them, the larger cube is the deeper one.
    truth = block((24, 24, 40), ((2, 11), (2, 11), (2, 11)), ((15, 20), (15, 20), (30, 35)))
    made = click_in_box(truth, Geometry(truth.shape, UNIT))
    assert drawn_box(truth) == (slice(2, 20), slice(2, 20), slice(2, 35))
    # Deep are the places within two voxels of the cube's middle (6, 6, 6), 3 and more voxels deep.
    assert made.side == "inside" and made.index == (8, 8, 8) and made.radius == 1.5


def test_the_challenge_clicks_a_voxel_of_the_part_with_most_voxels() -> None:
    geometry = Geometry((20, 20, 40), UNIT)
    truth = block((20, 20, 40), ((2, 9), (2, 9), (2, 9)))
    # Too much: a plate of 200 voxels; missing: a cube of 125, which is deeper.
    labels = (truth & ~block(truth.shape, ((3, 8), (3, 8), (3, 8)))) | block(
        truth.shape, ((15, 17), (5, 15), (20, 30))
    )
    assert click(truth, labels)[:2] == ("inside", (5, 5, 5))
    made = click_of_challenge(truth, labels, geometry)
    assert (
        made is not None
        and made.side == "outside"
        and made.index[0] in (15, 16)
        and made.radius == 0.5
    )
    # Parts of either side are apart, even where they touch.
    first = click_of_challenge(truth, None, geometry)
    assert first is not None and first[:2] == ("inside", (5, 5, 5))
    assert click_of_challenge(truth, truth.copy(), geometry) is None
