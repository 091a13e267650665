"""Rendered meshes: their silhouette, what is hidden, their scale."""

import numpy as np
import pytest

from accelsurf.measure.surface_mesh import extract
from accelsurf.output.pictures.rasterizer import VIEW, render
from tests.support.shapes import ball_on_grid


def test_render_has_the_silhouette_of_a_ball():
    psi, geometry = ball_on_grid(shape=(24, 24, 24), spacing=(1.0, 1.0, 1.0), radius=8.0)
    surface = extract(psi, geometry)
    picture = render(surface.vertices, surface.faces, size=200)
    covered = picture.pixels[..., 3] > 0.5
    area = covered.sum() * picture.mm_per_pixel**2
    assert area == pytest.approx(np.pi * 8.0**2, rel=0.02)
    assert picture.pixels[100, 100, 3] == 1.0  # no holes
    inner = picture.pixels[70:130, 70:130, 3]
    assert (inner == 1.0).all()


def test_render_hides_what_lies_behind():
    toward = np.array(VIEW) / np.linalg.norm(VIEW)
    right = np.cross((0, 0, 1), toward)
    right /= np.linalg.norm(right)
    up = np.cross(toward, right)
    near = [x * right + y * up for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    far = [corner - toward for corner in near]
    faces = [[0, 1, 2], [0, 2, 3]]
    box = np.array([1.5 * sign * (right + up) for sign in (-1, 1)])
    alone = render(near, faces, size=64, box=box)
    both = render(near + far, faces + [[4, 5, 6], [4, 6, 7]], size=64, box=box)
    swapped = render(far + near, faces + [[4, 5, 6], [4, 6, 7]], size=64, box=box)
    inner = np.s_[20:44, 20:44]
    assert np.array_equal(alone.pixels[inner], both.pixels[inner])
    assert np.array_equal(both.pixels[inner], swapped.pixels[inner])


def test_render_of_nothing_is_transparent():
    picture = render(np.zeros((0, 3)), np.zeros((0, 3), int), size=16)
    assert picture.pixels.shape == (16, 16, 4) and not picture.pixels.any()


def test_same_box_gives_the_same_scale():
    psi, geometry = ball_on_grid()
    small = extract(psi, geometry)
    large = extract(psi - 2, geometry)
    scales = {
        render(s.vertices, s.faces, size=64, box=large.vertices).mm_per_pixel
        for s in (small, large)
    }
    assert len(scales) == 1
