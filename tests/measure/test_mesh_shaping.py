"""Meshes made smoother or coarser, and the distance to the surface that is reported of them."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.mesh_distance import TriangleIndex, largest_distance, sides
from accelsurf.measure.mesh_shaping import MeshOptions, is_sound, shape_mesh, smoothed
from accelsurf.measure.surface_mesh import Surface, extract_surface

CENTRE = np.array([12.0, 13.0, 14.0])


@pytest.fixture(scope="module")
def ball() -> Surface:
    """Of radius 8 mm on voxels of 1 x 1 x 1.5 mm."""
    z, y, x = np.indices((20, 26, 26)) * np.array([1.5, 1, 1]).reshape(3, 1, 1, 1)
    psi = np.sqrt((x - 12) ** 2 + (y - 13) ** 2 + (z - 14) ** 2) - 8
    return extract_surface(psi.astype(np.float32), Geometry((20, 26, 26), (1.5, 1.0, 1.0)))


def grown(surface: Surface, factor: float) -> Surface:
    return Surface(CENTRE + factor * (surface.vertices - CENTRE), surface.faces)


def test_the_distance_of_concentric_balls_is_the_difference_of_their_radii(ball: Surface) -> None:
    for one, other in ((ball, grown(ball, 1.1)), (grown(ball, 1.1), ball)):
        assert largest_distance(one, other) == pytest.approx(0.8, abs=0.02)
    assert largest_distance(ball, ball) == pytest.approx(0.0, abs=1e-9)


def test_a_spike_is_found_from_either_side(ball: Surface) -> None:
    """Only one of the two meshes has points near it."""
    top = int(ball.vertices[:, 2].argmax())
    points = ball.vertices.copy()
    points[top, 2] += 5.0
    spiked = Surface(points, ball.faces)
    assert largest_distance(ball, spiked) == pytest.approx(5.0, abs=0.1)
    assert largest_distance(spiked, ball) == pytest.approx(5.0, abs=0.1)


def test_nearest_triangles_are_those_of_a_plain_search(ball: Surface) -> None:
    from accelsurf.measure.mesh_distance import nearest_in

    coarse = shape_mesh(ball, MeshOptions(faces=60)).surface
    points = CENTRE + np.random.default_rng(1).normal(0, 7, (200, 3))
    corners = coarse.vertices[coarse.faces]
    plain = [
        np.linalg.norm(
            nearest_in(np.repeat(p[None], len(corners), axis=0), corners) - p, axis=1
        ).min()
        for p in points
    ]
    np.testing.assert_allclose(TriangleIndex(coarse).closest(points)[0], plain, rtol=1e-9)


def test_a_number_of_triangles_and_the_distance_that_it_costs(ball: Surface) -> None:
    shaped = shape_mesh(ball, MeshOptions(faces=300))
    assert len(shaped.surface.faces) == 300 and is_sound(shaped.surface)
    assert 0.02 < shaped.distance_mm < 0.5
    assert shaped.distance_mm == largest_distance(ball, shaped.surface)
    again = shape_mesh(ball, MeshOptions(faces=300))
    assert again.surface.vertices.tobytes() == shaped.surface.vertices.tobytes()
    assert shape_mesh(ball, MeshOptions(faces=10**6)).warnings


def test_an_error_holds_and_is_used(ball: Surface) -> None:
    fine, coarse = (
        shape_mesh(ball, MeshOptions(error=0.05)),
        shape_mesh(ball, MeshOptions(error=0.4)),
    )
    for shaped, error in ((fine, 0.05), (coarse, 0.4)):
        assert error / 4 < largest_distance(ball, shaped.surface) <= error
        assert is_sound(shaped.surface)
    assert 2 * len(coarse.surface.faces) < len(fine.surface.faces) < len(ball.faces)


def test_what_contradicts_the_error_is_refused_with_one_that_does_not(ball: Surface) -> None:
    with pytest.raises(UsageError, match="20 triangles") as caught:
        shape_mesh(ball, MeshOptions(faces=20, error=0.1))
    offered = float(caught.value.hint.split()[1].rstrip(","))
    assert shape_mesh(ball, MeshOptions(faces=20, error=offered)).distance_mm <= offered
    with pytest.raises(UsageError, match="mesh-smooth"):
        shape_mesh(ball, MeshOptions(smooth=6.0, error=1e-3))


def halved(surface: Surface) -> Surface:
    """The same surface with each side halved."""
    edges, n = sides(surface), len(surface.vertices)
    keys = edges[:, 0] * n + edges[:, 1]
    ends = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].astype(np.int64), axis=2)
    ab, bc, ca = (n + np.searchsorted(keys, ends[..., 0] * n + ends[..., 1])).T
    a, b, c = surface.faces.T
    parts = [np.stack(one, axis=1) for one in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    points = np.concatenate([surface.vertices, surface.vertices[edges].mean(axis=1)])
    return Surface(points, np.concatenate(parts).astype(np.int32))


def test_short_bumps_are_flattened_and_the_volume_stays(ball: Surface) -> None:
    fine = halved(ball)
    out = (fine.vertices - CENTRE) / np.linalg.norm(fine.vertices - CENTRE, axis=1, keepdims=True)
    left = {}
    for length in (2.0, 12.0):  # mm, along z
        bumpy = Surface(
            fine.vertices + 0.1 * np.sin(2 * np.pi / length * fine.vertices[:, 2:]) * out,
            fine.faces,
        )
        smooth = smoothed(bumpy, 4.0)
        assert smooth.volume == pytest.approx(bumpy.volume, rel=1e-4)
        belt = np.abs(out[:, 2]) < 0.4
        wave = np.sin(2 * np.pi / length * fine.vertices[belt, 2])
        radii = np.linalg.norm(smooth.vertices[belt] - CENTRE, axis=1)
        left[length] = np.polyfit(wave, radii, 1)[0] / 0.1
    assert left[2.0] < 0.25 < 0.8 < left[12.0] < 1.2


def test_an_open_or_turned_mesh_is_not_sound(ball: Surface) -> None:
    assert is_sound(ball)
    assert not is_sound(Surface(ball.vertices, ball.faces[1:]))
    assert not is_sound(Surface(ball.vertices, ball.faces[:, ::-1]))
    one_turned = ball.faces.copy()
    one_turned[0] = one_turned[0, ::-1]
    assert not is_sound(Surface(ball.vertices, one_turned))
