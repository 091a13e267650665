"""Surface Dice against values by hand, brute force, and the measures of exact shapes."""

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from accelsurf.measure.metrics import surface_dice, surface_elements

H = (3.0, 1.5, 0.5)  # mm, z y x


def mask_of(shape, *boxes):
    mask = np.zeros(shape, bool)
    for box in boxes:
        mask[tuple(slice(*one) for one in box)] = True
    return mask


def ball(centre, radius, shape, h):
    z, y, x = (h[axis] * (np.indices(shape)[axis] - centre[axis]) for axis in range(3))
    return z**2 + y**2 + x**2 < radius**2


def test_a_voxel_alone_has_eight_corners_of_a_triangle_each():
    points, areas = surface_elements(mask_of((5, 5, 5), ((2, 3), (2, 3), (2, 3))), H)
    a, b, c = (np.array(H) / 2 * np.eye(3)).tolist()
    triangle = np.linalg.norm(np.cross(np.subtract(b, a), np.subtract(c, a))) / 2
    np.testing.assert_allclose(areas, 8 * [triangle], rtol=1e-6)
    corners = [
        [H[axis] * (2 + side[axis] / 2) for axis in range(3)]
        for side in itertools.product((-1, 1), repeat=3)
    ]
    assert sorted(points.tolist()) == corners


@pytest.mark.parametrize("axis", range(3))
def test_the_faces_of_a_slab_have_their_area(axis):
    # It fills the volume across; what is beyond the volume is not object.
    n, shape = [8, 9, 10], [8, 9, 10]
    bounds = [(0, k) for k in n]
    bounds[axis] = (3, 5)
    points, areas = surface_elements(mask_of(shape, bounds), H)
    inner = np.ones(len(points), bool)
    for other in {0, 1, 2} - {axis}:
        place = points[:, other] / H[other]
        inner &= (place > 0) & (place < n[other] - 1)
    across = [other for other in range(3) if other != axis]
    face = H[across[0]] * H[across[1]]
    np.testing.assert_allclose(areas[inner], face, rtol=1e-6)
    assert inner.sum() == 2 * math.prod(n[other] - 1 for other in across)
    assert set(points[inner][:, axis] / H[axis]) == {2.5, 4.5}


@pytest.mark.parametrize(
    ("voxels", "area"),
    [
        (((0, 0, 0),), math.sqrt(3) / 8),
        (((0, 0, 0), (0, 0, 1)), math.sqrt(2) / 2),
        (((0, 0, 0), (0, 1, 1)), math.sqrt(3) / 4),  # two corners of a face across: apart
        (((0, 0, 0), (1, 1, 1)), math.sqrt(3) / 4),
        (((0, 0, 0), (0, 0, 1), (0, 1, 0)), 0.5 + 3 * math.sqrt(3) / 8),
        (((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)), 1.0),
        (((0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0)), 3 * math.sqrt(3) / 4),  # a hexagon
    ],
)
def test_a_neighbourhood_has_the_area_of_the_published_table_whichever_side_is_the_object(
    voxels, area
):
    for flip in itertools.product((0, 1), repeat=3):
        mask = np.zeros((2, 2, 2), bool)
        for voxel in voxels:
            mask[tuple(np.bitwise_xor(voxel, flip))] = True
        for one in (mask, ~mask):
            points, areas = surface_elements(one, (1.0, 1.0, 1.0))
            middle = (points == 0.5).all(axis=1)
            assert areas[middle] == pytest.approx([area], rel=1e-6)


def test_a_disc_in_one_slice_has_the_length_of_its_outline():
    mask = mask_of((1, 6, 7), ((0, 1), (2, 4), (2, 5)))
    points, lengths = surface_elements(mask, H)
    corner, along_y, along_x = math.hypot(H[1], H[2]) / 2, H[1], H[2]
    assert sorted(lengths) == pytest.approx(sorted(4 * [corner] + 2 * [along_y] + 4 * [along_x]))
    assert set(points[:, 0]) == {0.0}
    line = mask_of((1, 1, 9), ((0, 1), (0, 1), (3, 5)))
    points, ends = surface_elements(line, H)
    assert points[:, 2].tolist() == [2.5 * H[2], 4.5 * H[2]] and ends.tolist() == [1.0, 1.0]
    across = mask_of((1, 4, 4), ((0, 1), (1, 2), (1, 2)), ((0, 1), (2, 3), (2, 3)))
    assert surface_elements(across, H)[1].max() == pytest.approx(2 * corner)


@pytest.mark.parametrize("tolerance", [0.0, 1.0, 1.5, 2.9, 3.0, 6.0])
def test_it_is_the_part_of_the_area_that_is_near(tolerance):
    a, b = ball((6, 10, 20), 8.0, (13, 21, 40), H), ball((6.4, 11, 24), 7.2, (13, 21, 40), H)
    (points_a, areas_a), (points_b, areas_b) = surface_elements(a, H), surface_elements(b, H)
    apart = cdist(points_a, points_b)
    near = (
        areas_a[apart.min(axis=1) <= tolerance + 1e-6].sum()
        + areas_b[apart.min(axis=0) <= tolerance + 1e-6].sum()
    )
    expected = near / (areas_a.sum() + areas_b.sum())
    assert surface_dice(a, b, H, [tolerance]) == pytest.approx([expected], rel=1e-12)
    assert surface_dice(b, a, H, [tolerance]) == pytest.approx([expected], rel=1e-12)


def test_a_shift_counts_from_its_length_on():
    a = mask_of((12, 12, 12), ((3, 8), (3, 8), (3, 8)))
    b = np.roll(a, 1, axis=0)
    below, at, above = surface_dice(a, b, H, [2.999, 3.0, 3.001])
    assert 0 < below < 1 and at == above == 1.0
    # The four sides that lie in the shift touch; the caps and their edges do not.
    sides = surface_dice(a, b, H, [0.0])[0]
    assert 0.3 < sides < 0.9


def test_empty_objects():
    some, none = mask_of((5, 5, 5), ((1, 3), (1, 3), (1, 3))), np.zeros((5, 5, 5), bool)
    assert (
        surface_dice(some, none, H, [1.0, 100.0])
        == [0.0, 0.0]
        == surface_dice(none, some, H, [1.0, 100.0])
    )
    assert np.isnan(surface_dice(none, none, H, [1.0])).all()
    assert surface_dice(some, some, H, [0.0]) == [1.0]
