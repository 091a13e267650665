"""Vertices on the surface, and meshes and contours that enclose its volume, whatever its size in voxels."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet
from accelsurf.measure import vertex_placement
from accelsurf.measure.contours import extract_contours
from accelsurf.measure.surface_mesh import extract_surface
from accelsurf.measure.vertex_placement import balanced, on_edges
from accelsurf.phantoms.recipes import Recipe, distance_at, signed_distance
from tests.support.meshes import euler_characteristic

MARGIN = 1e-4


def ball(radius: float, offset: np.ndarray, spacing=(1.0, 1.0, 1.0)) -> tuple[np.ndarray, Geometry]:
    """Exact distance from a ball near the middle of a grid that it fits on."""
    h = np.array(spacing)
    shape = tuple(int(np.ceil(2 * radius / step)) + 9 for step in spacing)
    at = (np.indices(shape).transpose(1, 2, 3, 0) - (np.array(shape) - 1) / 2 - offset) * h
    return (np.linalg.norm(at, axis=3) - radius).astype(np.float32), Geometry(shape, spacing)


@pytest.mark.parametrize(("radius", "most"), [(2.0, 0.02), (3.0, 0.003), (5.0, 0.0005)])
def test_mesh_and_band_have_the_volume_of_the_ball(radius: float, most: float) -> None:
    """With vertices on the linear crossings the mesh loses 15 % at R = 2, 2.4 % at R = 5."""
    rng = np.random.default_rng(3)
    exact = 4 / 3 * np.pi * radius**3
    for _ in range(4):
        psi, geometry = ball(radius, rng.uniform(-0.5, 0.5, 3))
        mesh, surface = extract_surface(psi, geometry), LevelSet(psi, geometry.spacing)
        assert mesh.is_closed and euler_characteristic(mesh) == 2
        assert mesh.volume == pytest.approx(exact, rel=most)
        assert mesh.volume == pytest.approx(
            surface.volume(surface.fraction_and_area()[0]), rel=max(most, 0.003)
        )
        # A triangle cannot have less area than its part of a surface of the same volume.
        assert 1 <= mesh.area / (4 * np.pi * radius**2) <= 1 + 0.1 / radius**2


@pytest.mark.parametrize("spacing", [(2.0, 1.0, 1.0), (1.0, 0.5, 2.0)])
def test_with_unequal_spacing(spacing: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(4)
    for _ in range(4):
        psi, geometry = ball(6.0, rng.uniform(-0.5, 0.5, 3), spacing)
        assert extract_surface(psi, geometry).volume == pytest.approx(
            4 / 3 * np.pi * 216, rel=0.002
        )


def test_vertices_lie_on_the_surface_before_they_are_balanced() -> None:
    """Third order along the edges: linear crossings are up to h^2 / 8r off, 0.025 voxel."""
    psi, geometry = ball(5.0, np.array([0.2, -0.3, 0.1]))
    mesh = extract_surface(psi, geometry)
    centre = (np.array(geometry.shape) - 1) / 2 + (0.2, -0.3, 0.1)
    zyx = geometry.world_to_index(mesh.vertices)
    # Back along the straight line to the centre, to where they came from.
    linear = centre + (zyx - centre) / np.linalg.norm(zyx - centre, axis=1)[:, None] * 5.0
    assert np.abs(np.linalg.norm(zyx - linear, axis=1)).max() < 1 / 6 / 5.0 * 1.2
    start = np.round(linear)
    axis = np.abs(linear - start).argmax(axis=1)
    rows = np.arange(len(start))
    start[rows, axis] = np.floor(linear[rows, axis]) + 0.5
    ends = [np.floor(start), np.ceil(start)]
    crossed = [psi[tuple(e.astype(int).T)] < 0 for e in ends]
    start = start[crossed[0] != crossed[1]]
    assert len(start) > 100
    placed = on_edges(start, psi, (1.0, 1.0, 1.0), MARGIN)
    assert np.abs(np.linalg.norm(placed - centre, axis=1) - 5.0).max() < 0.003


@pytest.mark.parametrize("thickness", [2.0, 2.6, 3.1])
def test_the_ridge_between_two_walls_does_not_move_them(thickness: float) -> None:
    """A cubic through nodes on both sides of the ridge would put the wall 0.06 voxel too far out."""
    x = np.arange(15.0) - 7.2
    psi = np.broadcast_to(np.abs(x) - thickness / 2, (6, 6, 15)).astype(np.float32)
    mesh = extract_surface(psi, Geometry(psi.shape, (1.0, 1.0, 1.0)))
    on_caps = ((mesh.vertices[:, 1:] == -0.5) | (mesh.vertices[:, 1:] == 5.5)).any(axis=1)
    walls = np.unique(np.round(np.abs(mesh.vertices[~on_caps, 0] - 7.2), 4))
    np.testing.assert_allclose(walls, thickness / 2, atol=2e-4)


def test_faces_of_a_box_stay_flat() -> None:
    """Beside an edge, which is cut off, there is no curvature that could be made good."""
    recipe = Recipe(kind="box", sides=(10.6, 12.2, 9.4), center=(0.1, 0.3, 0.2), shape=(20, 20, 20))
    mesh = extract_surface(signed_distance(recipe), recipe.geometry)
    distance = distance_at(recipe, mesh.vertices)
    assert distance.max() < 0.01
    assert 0.97 < mesh.volume / recipe.solid.volume < 1


def test_balancing_is_exact_for_a_paraboloid() -> None:
    """A gap of sum e.Ke/24 per triangle: the mean height of the surface above the mesh becomes 0."""
    y, x = np.meshgrid(np.arange(2.0, 18.0), np.arange(2.0, 18.0), indexing="ij")
    height = 6.0 + 0.01 * (x - 10) ** 2 + 0.006 * (y - 10) ** 2 + 0.004 * (x - 10) * (y - 10)
    zyx = np.stack([height.ravel(), y.ravel(), x.ravel()], axis=1)
    corner = np.arange(256).reshape(16, 16)[:-1, :-1].ravel()
    lower, upper = (
        np.stack([corner, corner + 1, corner + 16], 1),
        np.stack([corner + 1, corner + 17, corner + 16], 1),
    )
    faces = np.concatenate([lower, upper])
    z, yy, xx = np.indices((16, 20, 20)).astype(float)
    level = 6.0 + 0.01 * (xx - 10) ** 2 + 0.006 * (yy - 10) ** 2 + 0.004 * (xx - 10) * (yy - 10)
    moved = balanced(zyx, faces, (z - level).astype(np.float32), (1.0, 1.0, 1.0))
    # By integration over a triangle with these edges: the mean of the interpolant less the function, along z.
    second = np.array([[0.012, 0.004], [0.004, 0.02]])
    gap = sum(e @ second @ e for e in np.array([[0, 1.0], [1, 0], [1, -1]])) / 24
    inner = moved.reshape(16, 16, 3)[5:11, 5:11]
    np.testing.assert_allclose(
        inner[..., 0] - zyx.reshape(16, 16, 3)[5:11, 5:11, 0], -gap, rtol=0.05
    )


def test_contours_enclose_the_disc() -> None:
    """In one slice the same: polygons with linear crossings lose 1 % of the area at R = 5."""
    rng = np.random.default_rng(5)
    for radius, most in ((2.0, 0.02), (5.0, 0.001)):
        for _ in range(4):
            psi, geometry = ball(radius, rng.uniform(-0.5, 0.5, 3) * (0, 1, 1))
            middle = psi[psi.shape[0] // 2][None]
            contours = extract_contours(middle, Geometry(middle.shape, geometry.spacing))
            assert contours.area == pytest.approx(np.pi * radius**2, rel=most)


def test_vertices_are_the_same_however_many_are_placed_at_a_time(monkeypatch) -> None:
    psi = gaussian_filter(np.random.default_rng(4).normal(size=(14, 16, 18)), 1.2).astype(
        np.float32
    )
    geometry = Geometry(psi.shape, (1.5, 1.0, 0.7))
    whole = extract_surface(20 * psi, geometry).vertices
    monkeypatch.setattr(vertex_placement, "AT_A_TIME", 50)
    assert (extract_surface(20 * psi, geometry).vertices == whole).all()
