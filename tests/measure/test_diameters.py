"""The longest lines of an object, against boxes and ellipsoids, brute force, and turned grids."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from accelsurf.grid.geometry import Geometry
from accelsurf.measure.diameters import diameters


def turned(seed=5):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def lengths(found):
    return [float(np.linalg.norm(b - a)) for a, b in found]


def right_angle(line, other):
    return abs((line[1] - line[0]) @ (other[1] - other[0])) / np.prod(lengths([line, other]))


SPACING = (2.0, 0.5, 1.0)


def test_a_box_has_its_diagonals():
    geometry = Geometry((12, 40, 24), SPACING, (5.0, -3.0, 8.0), np.diag([-1.0, 1.0, -1.0]))
    found = diameters(np.ones((5, 20, 10), bool), (3, 10, 6), geometry)  # a cube of 10 mm
    # Across the diagonal of a cube the sections are triangles and hexagons, all of the width of a face's diagonal.
    assert lengths(found) == pytest.approx(np.sqrt([300, 200, 200, 200]), abs=1e-9)
    assert (
        right_angle(found.longest, found.across) < 1e-9
        and right_angle(found.axial, found.axial_across) < 1e-9
    )
    corners = geometry.index_to_world([[2.5, 9.5, 5.5], [7.5, 29.5, 15.5]])
    for ends in found.longest:
        inner = (ends >= corners.min(axis=0) - 1e-9) & (ends <= corners.max(axis=0) + 1e-9)
        assert inner.all()


@pytest.mark.parametrize("axes", [(18, 12, 8), (9, 20, 14), (7, 10, 15)])
def test_an_ellipsoid_has_its_axes_on_an_oblique_anisotropic_grid(axes):
    steps = (1.0, 0.5, 0.75)
    geometry = Geometry((64, 90, 60), steps, (3.0, -8.0, 1.0), turned())
    z, y, x = (
        (at - (n - 1) / 2) * h
        for at, n, h in zip(np.indices((64, 90, 60)), (64, 90, 60), steps, strict=True)
    )
    inside = (x / axes[0]) ** 2 + (y / axes[1]) ** 2 + (z / axes[2]) ** 2 < 1
    found = diameters(inside, (0, 0, 0), geometry)
    # Corners lie outside by at most half the diagonal of a voxel, 0.67 mm, at each end.
    longest, second, _ = sorted(axes, reverse=True)
    for length, true in zip(lengths(found), (2 * longest, 2 * second), strict=False):
        assert true - 0.3 < length < true + 1.35
    assert right_angle(found.longest, found.across) < 1e-9
    for line, true in zip((found.longest, found.across), np.argsort(axes)[::-1], strict=False):
        along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        assert abs(along @ geometry.direction[:, true]) > 0.97


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_the_axial_slice_is_that_of_the_patient_not_that_of_the_array(order):
    """An object long from head to foot: its axial diameter is that of its round section, however it is stored."""
    shape, spacing = np.array((40, 30, 30))[list(order)], np.array((2.0, 0.5, 0.5))[list(order)]
    columns = np.eye(3)[:, [2 - axis for axis in order][::-1]]
    geometry = Geometry(tuple(int(n) for n in shape), tuple(spacing), (0.0, 0.0, 0.0), columns)
    z, y, x = np.indices((40, 30, 30))
    tube = ((np.hypot(y - 14.5, x - 14.5) * 0.5 < 5) & (abs(z - 20) < 15)).transpose(order)
    found = diameters(tube, (0, 0, 0), geometry)
    assert lengths(found)[0] > 58
    assert 9.8 < lengths(found)[2] < 11.5 and 9.8 < lengths(found)[3] < 11.5
    for line in (found.axial, found.axial_across):
        assert line[0][2] == pytest.approx(line[1][2], abs=1e-9)  # in one slice, through its middle


def test_no_pair_is_farther_and_none_across_is_longer():
    """Brute force on ragged objects: the hull loses no pair; across, sections in many places are never wider."""
    for seed in range(6):
        random = np.random.default_rng(seed)
        inside = random.random((6, 7, 8)) < 0.15
        inside[2, 3, 4] = True
        geometry = Geometry(inside.shape, (1.5, 0.7, 1.0), (0.0, 0.0, 0.0), turned(seed))
        found = diameters(inside, (0, 0, 0), geometry)
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
        points = geometry.index_to_world((np.argwhere(inside)[:, None] + signs).reshape(-1, 3))
        assert lengths(found)[0] == pytest.approx(pdist(points).max())
        axis = (found.longest[1] - found.longest[0]) / lengths(found)[0]
        shadow = points - np.outer(points @ axis, axis)
        assert lengths(found)[1] <= pdist(shadow).max() + 1e-9
        # Convex combinations of two points that lie at one height: lines across in the hull.
        sample = points[random.integers(len(points), size=(4000, 4))]
        height = (sample[:, 0] @ axis + sample[:, 1] @ axis) / 2
        low, high = sample[:, 2] @ axis, sample[:, 3] @ axis
        share = (height - low) / np.where(high == low, 1, high - low)
        fits = (share >= 0) & (share <= 1) & (high != low)
        ends = sample[:, 2] + share[:, None] * (sample[:, 3] - sample[:, 2])
        middle = (sample[:, 0] + sample[:, 1]) / 2
        across = np.linalg.norm(ends - middle, axis=1)[fits]
        assert across.max() <= lengths(found)[1] + 1e-9


@pytest.mark.parametrize("shape", [(1, 12, 12), (12, 1, 12), (12, 12, 1)])
def test_an_image_of_one_slice_has_no_thickness(shape):
    inside = np.zeros(shape, bool)
    inside[tuple(slice(3, 9) if n > 1 else slice(None) for n in shape)] = True
    found = diameters(inside, (0, 0, 0), Geometry(shape, (1.0, 1.0, 1.0)))
    assert lengths(found) == pytest.approx([np.sqrt(72)] * 4)


def test_a_row_of_pixels_and_a_single_one():
    row = np.zeros((1, 9, 9), bool)
    row[0, 4, 2:7] = True
    found = diameters(row, (0, 0, 0), Geometry(row.shape, (1.0, 1.0, 1.0)))
    # 5 by 1: across the diagonal, through a corner, the line leaves through the long side.
    assert lengths(found)[0] == pytest.approx(np.sqrt(26))
    assert lengths(found)[1] == pytest.approx(np.sqrt(26) / 5)
    alone = np.ones((1, 1, 1), bool)
    assert lengths(diameters(alone, (2, 2, 2), Geometry((5, 5, 5), (1.0, 1.0, 1.0))))[
        0
    ] == pytest.approx(np.sqrt(3))
