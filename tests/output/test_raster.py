"""Triangles in a depth buffer: against points that numpy makes, one triangle after the other."""

import numpy as np
import pytest

from accelsurf.output.pictures.kernels import raster

SIZE = 24
DEPTHS = (-3.0, 2.0**-20, 2.0**24)
LIGHTS = ((-0.45, 0.65, 0.61), (0.7, -0.1, 0.7), (0.0, 0.6, 0.8))


@pytest.fixture(scope="module")
def triangles():
    """Points in and around the picture, and triangles of them, of which about half face the viewer."""
    random = np.random.default_rng(5)
    points = np.column_stack([random.uniform(-6, SIZE + 6, (40, 2)), random.uniform(-3, 3, 40)])
    chosen = random.integers(0, 40, (60, 3))
    return points, chosen[[len(set(one)) == 3 for one in chosen]]


def levels_of(points, triangles):
    levels = np.full(len(triangles), -1, np.int64)
    raster.sample_levels(points, triangles, levels)
    return levels


def centres(level):
    """Barycentric coordinates of the centres of the level^2 triangles that a triangle is divided into."""
    i, j, up = (
        a.ravel() for a in np.meshgrid(np.arange(level), np.arange(level), (1, 2), indexing="ij")
    )
    within = i + j + up <= level
    a, b = (3 * i + up)[within], (3 * j + up)[within]
    return np.stack([a, b, 3 * level - a - b], axis=1) / (3.0 * level)


def filled(points, triangles, order, levels):
    nearest = np.full((SIZE, SIZE), -1, np.int64)
    shown = np.zeros((SIZE, SIZE), np.int64), np.zeros((SIZE, SIZE, 3))
    raster.fill_depths(points, triangles, order, levels, DEPTHS, nearest, shown)
    return nearest, shown


@pytest.mark.nojit
def test_points_are_less_than_a_pixel_apart_and_what_faces_away_is_left_out(triangles):
    points, faces = triangles
    corners = points[faces]
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    front = side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0] > 0
    longest = np.abs(corners[:, [1, 2, 0], :2] - corners[:, :, :2]).max(axis=(1, 2))
    levels = levels_of(points, faces)
    assert 10 < front.sum() < len(faces) - 10 and np.array_equal(levels > 0, front)
    np.testing.assert_array_equal(levels[front], np.ceil(1.1 * longest[front]))
    assert levels_of(0.001 * points, faces)[front].tolist() == [1] * int(front.sum())


@pytest.mark.nojit
def test_of_each_pixel_the_nearest_point_is_kept(triangles):
    points, faces = triangles
    levels = levels_of(points, faces)
    order = np.argsort(levels, kind="stable")[np.count_nonzero(levels == 0) :]
    nearest, shown = filled(points, faces, order, levels)
    best, number = {}, 0
    for t in order:
        for weights in centres(levels[t]):
            x, y, depth = weights @ points[faces[t]]
            if 0 <= x < SIZE and 0 <= y < SIZE:
                here = (int(y), int(x))
                best[here] = max(best.get(here, (-np.inf,)), (depth, number, t, *weights))
            number += 1
    assert set(best) == set(map(tuple, np.argwhere(nearest >= 0)))
    for here, (depth, number, t, *weights) in best.items():
        assert abs((nearest[here] >> 32) - (depth - DEPTHS[0]) / DEPTHS[1]) <= 1.0
        assert nearest[here] & 0xFFFFFFFF == number and shown[0][here] == t
        np.testing.assert_allclose(shown[1][here], weights, atol=1e-12)


@pytest.mark.nojit
def test_of_equal_depths_the_last_counts_and_depths_beyond_the_range_are_its_ends():
    points = np.array(
        [[1, 1, 9], [20, 1, 9], [1, 20, 9], [1, 1, -99], [20, 1, -99], [1, 20, -99]], float
    )
    near, far = [0, 1, 2], [3, 4, 5]
    levels = np.full(3, 20)
    nearest, shown = filled(points, np.array([near, far, near]), np.arange(3), levels)
    covered = nearest >= 0
    assert set(shown[0][covered]) == {2} and set(nearest[covered] >> 32) == {
        int((9 - DEPTHS[0]) / DEPTHS[1])
    }
    alone, _ = filled(points, np.array([far]), np.arange(1), levels[:1])
    assert set(alone[alone >= 0] >> 32) == {0}


@pytest.mark.nojit
def test_area_vectors_are_sums_of_cross_products(triangles):
    points, faces = triangles
    a, b, c = (points[faces[:, i]] for i in range(3))
    wanted = np.zeros_like(points)
    for i in range(3):
        np.add.at(wanted, faces[:, i], np.cross(b - a, c - a))
    out = np.zeros_like(points)
    raster.area_vectors(points, faces, out)
    np.testing.assert_allclose(out, wanted, atol=1e-10)


@pytest.mark.nojit
def test_pixels_have_the_light_of_their_normal_and_the_colour_of_their_place():
    faces = np.array([[0, 1, 2], [2, 1, 0]])
    shown = np.array([[0, 1], [1, 0]]), np.random.default_rng(2).dirichlet((1, 1, 1), (2, 2))
    normals = np.array([[0.1, 0.2, 0.9], [-0.5, 0.4, 2.0], [0.3, -0.8, -0.6]])
    colours = np.array([[0.2, 0.5, 0.9], [0.9, 0.1, 0.0], [0.4, 0.4, 0.4]])
    pixels, covered, rims = np.zeros((4, 4)), np.array([0, 2, 3]), np.array([1.0, 0.8, 1.0])
    raster.paint(covered, shown, faces, (normals, colours), rims, LIGHTS, pixels)
    assert not pixels[1].any() and (pixels[covered, 3] == 1.0).all()
    for pixel, rim in zip(covered, rims, strict=True):
        row, column = divmod(pixel, 2)
        weights, corners = shown[1][row, column], faces[shown[0][row, column]]
        n = weights @ normals[corners]
        n /= np.linalg.norm(n) * (-1 if n[2] < 0 else 1)
        key, fill, half = (max(float(n @ np.array(one)), 0.0) for one in LIGHTS)
        light = (0.36 + 0.60 * key + 0.16 * fill) * rim
        wanted = np.clip(light * (weights @ colours[corners]) + 0.18 * half**30, 0, 1)
        np.testing.assert_allclose(pixels[pixel, :3], wanted, atol=1e-12)
