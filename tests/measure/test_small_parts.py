"""Meshes and contours of parts a few voxels across have the volume of the part, and stay closed."""

import numpy as np
import pytest

from accelsurf.grid.geometry import Geometry
from accelsurf.measure.contours import extract_contours
from accelsurf.measure.surface_mesh import extract_surface
from accelsurf.measure.vertex_placement import cubic_at
from tests.support.meshes import euler_characteristic


def drawn_capsule(draw, radius, spacing, length):
    """Exact distance from a capsule (a ball if ``length`` is 0) of drawn direction and place, and its volume."""
    h, direction = np.array(spacing), draw.normal(size=3)
    direction /= np.linalg.norm(direction)
    shape = tuple(np.ceil((2 * radius + length * np.abs(direction)) / h).astype(int) + 9)
    centre = (np.array(shape) - 1) / 2 + draw.uniform(-0.5, 0.5, 3)
    at = (np.indices(shape).transpose(1, 2, 3, 0) - centre) * h
    along = np.clip(at @ direction, -length / 2, length / 2)
    psi = np.linalg.norm(at - along[..., None] * direction, axis=3) - radius
    return (
        psi.astype(np.float32),
        Geometry(shape, spacing),
        np.pi * radius**2 * (length + 4 / 3 * radius),
    )


def ellipsoid(half_axes, spacing, centre, shape):
    """Exact distance from an ellipsoid along the axes of the grid: by bisection of Lagrange's condition."""
    at = np.abs((np.indices(shape).transpose(1, 2, 3, 0) - centre) * np.array(spacing)).reshape(
        -1, 3
    )
    low, high = (
        np.full(len(at), -(half_axes.min() ** 2) + 1e-9),
        np.linalg.norm(at * half_axes, axis=1) + 1,
    )
    for _ in range(60):
        middle = 0.5 * (low + high)
        beyond = ((half_axes * at / (half_axes**2 + middle[:, None])) ** 2).sum(axis=1) > 1
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    distance = np.linalg.norm(at - half_axes**2 * at / (half_axes**2 + high[:, None]), axis=1)
    inside = ((at / half_axes) ** 2).sum(axis=1) < 1
    return np.where(inside, -distance, distance).reshape(shape).astype(np.float32)


SPACINGS = [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 3.0, 1.0), (1.0, 0.7, 2.5)]


@pytest.mark.sampled
@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize(
    ("radius", "most"), [(1.0, 0.06), (1.25, 0.03), (1.5, 0.02), (2.0, 0.01), (3.0, 0.003)]
)
def test_small_balls_and_thin_cylinders_have_their_volume(radius, most, spacing):
    """In voxels of the coarsest axis; a ball of radius 1 lacked up to half of it. Below 15 voxels nothing is kept."""
    draw = np.random.default_rng(int(100 * radius))
    for length in (0.0, 0.0, 5.0, 9.0):
        psi, geometry, volume = drawn_capsule(
            draw, radius * max(spacing), spacing, length * max(spacing)
        )
        mesh = extract_surface(psi, geometry)
        assert mesh.is_closed and euler_characteristic(mesh) == 2
        if np.count_nonzero(psi < 0) > 14:
            assert mesh.volume == pytest.approx(volume, rel=most)


@pytest.mark.parametrize("spacing", SPACINGS)
def test_small_ellipsoids_have_their_volume(spacing):
    draw = np.random.default_rng(8)
    for shortest, most in ((1.0, 0.06), (1.5, 0.02)):
        half_axes = shortest * max(spacing) * draw.permutation([1.0, 1.6, 2.2])
        shape = tuple(np.ceil(2 * half_axes / np.array(spacing)).astype(int) + 9)
        psi = ellipsoid(
            half_axes, spacing, (np.array(shape) - 1) / 2 + draw.uniform(-0.5, 0.5, 3), shape
        )
        mesh = extract_surface(psi, Geometry(shape, spacing))
        assert mesh.is_closed and euler_characteristic(mesh) == 2
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * half_axes.prod(), rel=most)


def test_what_is_small_beside_something_large_is_as_exact_and_the_large_keeps_its_vertices():
    draw = np.random.default_rng(2)
    shape, spacing = (20, 40, 24), (2.0, 1.0, 1.0)
    at = np.indices(shape).transpose(1, 2, 3, 0) * np.array(spacing)
    large = np.linalg.norm(at - (19, 11, 12), axis=3) - 8
    small = np.linalg.norm(at - (19, 30, 12) - draw.uniform(-1, 1, 3), axis=3) - 2.2
    geometry = Geometry(shape, spacing)
    both, alone, little = (
        extract_surface(psi.astype(np.float32), geometry)
        for psi in (np.minimum(large, small), large, small)
    )
    assert both.volume == pytest.approx(4 / 3 * np.pi * (8**3 + 2.2**3), rel=0.002)
    assert little.volume == pytest.approx(4 / 3 * np.pi * 2.2**3, rel=0.04)
    assert (
        np.isin(
            alone.vertices.round(9).view("f8,f8,f8"), both.vertices.round(9).view("f8,f8,f8")
        ).mean()
        > 0.9
    )


def test_cavities_have_their_volume():
    """The same mesh, turned inside out."""
    psi, geometry, volume = drawn_capsule(np.random.default_rng(5), 2.4, (2.0, 1.0, 1.0), 0.0)
    box = np.prod(np.array(geometry.shape) * geometry.spacing)
    mesh = extract_surface(-psi, geometry)
    assert mesh.is_closed
    assert box - mesh.volume == pytest.approx(volume, rel=0.04)


@pytest.mark.parametrize("thickness", [1.5, 1.7])
def test_walls_of_a_thin_sheet_stay_where_they_are(thickness):
    x = np.arange(15.0) - 7.2
    psi = np.broadcast_to(np.abs(x) - thickness / 2, (6, 6, 15)).astype(np.float32)
    mesh = extract_surface(psi, Geometry(psi.shape, (1.0, 1.0, 1.0)))
    assert mesh.volume == pytest.approx(36 * thickness, rel=0.04)


def test_small_discs_of_one_slice_have_their_area():
    draw = np.random.default_rng(9)
    for radius, most in ((1.0, 0.06), (1.25, 0.03), (1.5, 0.02), (2.0, 0.01)):
        for _ in range(3):
            at = np.indices((14, 14)).transpose(1, 2, 0) - 6.5 - draw.uniform(-0.5, 0.5, 2)
            psi = (np.linalg.norm(at, axis=2) - radius).astype(np.float32)[None]
            contours = extract_contours(psi, Geometry((1, 14, 14), (5.0, 1.0, 1.0)))
            assert contours.area == pytest.approx(np.pi * radius**2, rel=most)


@pytest.mark.parametrize("shape", [(7, 8, 9), (1, 8, 9), (7, 8, 1)])
def test_the_interpolant_is_exact_for_cubics_and_mirrored_at_the_border(shape):
    draw = np.random.default_rng(3)
    sizes = np.array(shape)
    coefficients = draw.normal(size=(3, 4)) * (sizes > 1)[:, None]

    def function(at):
        return sum(np.polyval(coefficients[a], (at[..., a] - 3) / 5) for a in range(3))

    psi = function(np.indices(shape).transpose(1, 2, 3, 0)).astype(np.float32)
    within = np.where(sizes > 1, draw.uniform(1.01, np.maximum(sizes - 2.01, 1.02), (40, 3)), 0.0)
    np.testing.assert_allclose(cubic_at(psi, within), function(within), atol=1e-5)
    mirrored = np.where(sizes > 1, -1.0 - within, 0.0)
    np.testing.assert_allclose(
        cubic_at(psi, mirrored + 0.0), cubic_at(psi, -1.0 - mirrored * (sizes > 1)), atol=1
    )
