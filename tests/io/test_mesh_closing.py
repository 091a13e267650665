"""Closed surfaces whose corners differ by rounding, or whose triangles repeat; and surfaces that really are open."""

import itertools

import numpy as np
import pytest
import trimesh

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io import meshes
from accelsurf.io.formats import surface_files
from accelsurf.measure.surface_mesh import Surface

SEEDS = range(4)
#: Size and place of a ball, mm: one beside 0, one of a cell far from 0, one of a large object.
BALLS = [
    (6.0, (3.1, -5.1, 0.0)),
    (0.03, (40.0, 12.0, -7.0)),
    (120.0, (1e3, -2e3, 500.0)),
    (1.0, (0.0, 0.0, 0.0)),
]


def ball(radius, center, subdivisions=2):
    made = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(made.vertices) + center, np.asarray(made.faces)


def soup(points, triangles):
    """Each triangle with corners of its own."""
    return points[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def exact_volume(points, triangles):
    corners = points[triangles] - points.mean(axis=0)
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6


def volume(points, triangles):
    return Surface(points - points.mean(axis=0), triangles.astype(np.int32)).volume


def rounded(points, rng, kind, ulps):
    """Corners moved by rounding, a random amount each."""
    if kind == "zeros":
        signs = rng.choice([0.0, -0.0, 1e-16, -1e-16, 3e-20], points.shape)
        return np.where(np.abs(points) < 1e-12, signs, points)
    moved = points.astype(np.float32 if kind == "float32" else np.float64)
    largest = np.spacing(np.abs(moved).max())
    # As the numbers themselves round, and as what was computed from the largest of them.
    step = np.where(rng.random(points.shape) < 0.5, np.spacing(np.abs(moved)), largest)
    return (
        (moved + rng.integers(-ulps, ulps + 1, points.shape) * step)
        .astype(moved.dtype)
        .astype(float)
    )


@pytest.mark.sampled
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "kind, ulps", [("float32", 1), ("float32", 4), ("float64", 1), ("float64", 8), ("zeros", 1)]
)
@pytest.mark.parametrize("radius, center", BALLS)
def test_corners_that_differ_by_rounding_are_one(radius, center, kind, ulps, seed):
    rng = np.random.default_rng(seed)
    points, triangles = ball(radius, np.array(center))
    if kind == "float32" and np.abs(points).max() > 100 * radius:
        ulps = 1  # more would be as large as the triangles
    single, numbers = soup(points, triangles)
    found, corners = meshes.closed_mesh(rounded(single, rng, kind, ulps), numbers)
    assert len(found) == len(points) and len(corners) == len(triangles)
    coarse = 2.0**-22 * ulps * np.abs(points).max() / radius if kind == "float32" else 1e-9
    assert volume(found, corners) == pytest.approx(
        exact_volume(points, triangles), rel=1e-9 + 20 * coarse
    )


@pytest.mark.parametrize("digits", [6, 7, 9])
def test_numbers_of_few_digits(digits):
    """Text in which corners that were nearly equal came out different in the last digit."""
    rng = np.random.default_rng(digits)
    points, triangles = ball(20.0, (150.0, -90.0, 33.0), 3)
    corners, numbers = soup(points, triangles)
    unit = 10.0 ** (3 - digits)
    corners = (np.round(corners / unit) + (rng.random(corners.shape) < 0.05)) * unit
    found, faces = meshes.closed_mesh(corners, numbers)
    assert len(faces) == len(triangles)
    assert volume(found, faces) == pytest.approx(exact_volume(points, triangles), rel=1e-3)


def test_small_triangles_stay_where_the_surface_closes_without_a_tolerance():
    """A speck of 1e-7 of the size beside a ball, in one mesh: none of its triangles is lost."""
    large, small = ball(100.0, (0.0, 0.0, 0.0)), ball(1e-5, (150.0, 0.0, 0.0), 1)
    points = np.concatenate([large[0], small[0]])
    triangles = np.concatenate([large[1], small[1] + len(large[0])])
    for given in ((points, triangles), soup(points, triangles)):
        assert len(meshes.closed_mesh(*given)[1]) == len(triangles)
    corners, numbers = soup(points, triangles)
    moved = rounded(corners, np.random.default_rng(0), "float64", 1)
    assert len(meshes.closed_mesh(moved, numbers)[1]) == len(triangles)


def test_small_triangles_stay_in_a_mesh_with_edges_near_the_tolerance():
    points, triangles = ball(3e-3, (100.0, 0.0, 0.0), 2)
    corners, numbers = soup(points, triangles)
    step = np.random.default_rng(1).uniform(-1, 1, corners.shape) * 2e-5  # a twentieth of an edge
    found, faces = meshes.closed_mesh(corners + step, numbers)
    assert len(faces) == len(triangles) and len(found) == len(points)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("share", ["one", "patch", "scattered", "all"])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", [None, "float32"])
def test_doubled_triangles_count_once(share, turned, kind, seed):
    rng = np.random.default_rng(seed)
    points, triangles = ball(6.0, (3.0, -5.0, 1.0))
    selected = {
        "one": rng.integers(0, len(triangles), 1),
        "patch": np.flatnonzero((triangles == triangles[seed, 0]).any(axis=1)),
        "scattered": rng.choice(len(triangles), 40, replace=False),
        "all": np.arange(len(triangles)),
    }[share]
    copies = np.roll(triangles[selected], seed, axis=1)[
        :, :: -1 if turned and share != "all" else 1
    ]
    order = rng.permutation(len(triangles) + len(copies))
    corners, numbers = soup(points, np.concatenate([triangles, copies])[order])
    if kind is not None:
        corners = rounded(corners, rng, kind, 1)
    found, faces = meshes.closed_mesh(corners, numbers)
    assert len(faces) == len(triangles) and len(found) == len(points)
    grid = Geometry((18, 18, 18), (0.8, 0.8, 0.8), (-3.8, -11.8, -5.8))
    inside = meshes.voxels_inside(grid.world_to_index(found), faces, grid.shape)
    assert inside.sum() * 0.8**3 == pytest.approx(exact_volume(points, triangles), rel=0.02)


def test_a_wall_between_two_bodies_is_none():
    """Two boxes that touch, each closed: together they are one body."""
    left, right = trimesh.creation.box((4.0, 4.0, 4.0)), trimesh.creation.box((4.0, 4.0, 4.0))
    points = np.concatenate([left.vertices, right.vertices + (4.0, 0.0, 0.0)])
    for shift in (0, 1):  # the wall's squares may be cut along the same diagonal, or not
        triangles = np.concatenate(
            [left.faces, (right.faces if shift else right.faces[:, [1, 2, 0]]) + 8]
        )
        found, faces = meshes.closed_mesh(points, triangles)
        grid = Geometry((6, 6, 12), (1.0, 1.0, 1.0), (-3.5, -2.5, -2.5))
        inside = meshes.voxels_inside(grid.world_to_index(found), faces, grid.shape)
        assert inside.sum() == 4 * 4 * 8


@pytest.mark.parametrize("seed", SEEDS)
def test_triangles_without_area_do_not_matter(seed):
    """A sliver across an edge, a point, a line; each with corners moved by rounding."""
    rng = np.random.default_rng(seed)
    points, triangles = ball(6.0, (3.0, -5.0, 1.0))
    corners, _ = soup(points, triangles)
    at = points[rng.integers(0, len(points), 25)]
    ends = points[triangles[rng.integers(0, len(triangles), 25)]]
    none = [np.repeat(at, 3, axis=0), ends[:, [0, 1, 1]].reshape(-1, 3)]
    corners = rounded(np.concatenate([corners, *none]), rng, "float32", 1)
    found, faces = meshes.closed_mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert len(faces) == len(triangles)
    assert volume(found, faces) == pytest.approx(exact_volume(points, triangles), rel=1e-4)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("radius, center", BALLS)
def test_a_surface_with_a_hole_stays_refused(radius, center, noisy, seed):
    rng = np.random.default_rng(seed)
    points, triangles = ball(radius, np.array(center))
    left = np.delete(triangles, rng.integers(0, len(triangles), 1 + seed), axis=0)
    if seed % 2:  # a copy beside the hole does not close it
        left = np.concatenate([left, left[:1], left[-1:, ::-1]])
    corners, numbers = soup(points, left)
    if noisy:
        corners = rounded(corners, rng, "float32", 1)
    with pytest.raises(
        InputError, match=r"\d+ triangles with \d+ open edges, expected a closed surface"
    ):
        meshes.closed_mesh(corners, numbers)


def test_a_slit_wider_than_the_tolerance_stays_refused():
    points, triangles = ball(6.0, (3.0, -5.0, 1.0))
    corners, numbers = soup(points, triangles)
    halves = points[triangles].mean(axis=1)[:, 2] > 1.0
    corners = corners + np.repeat(np.where(halves[:, np.newaxis], (0.0, 0.0, 0.01), 0.0), 3, axis=0)
    with pytest.raises(InputError, match="open edges"):
        meshes.closed_mesh(corners, numbers)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_files_of_single_triangles(tmp_path, suffix):
    """As programs for construction write them: no corner is shared, each is rounded on its own."""
    points, triangles = ball(6.0, (3.1, -5.1, 0.0))
    corners, numbers = soup(points, triangles)
    rng = np.random.default_rng(5)
    for kind, ulps in itertools.product(("float32", "zeros"), (1, 2)):
        moved = rounded(corners, rng, kind, ulps)
        write = getattr(surface_files, f"{suffix[1:]}_bytes")
        (tmp_path / f"a{suffix}").write_bytes(write(moved, numbers.astype(np.int32), "LPS"))
        found, faces = meshes.read_mesh(tmp_path / f"a{suffix}")
        assert len(faces) == len(triangles)
        assert volume(found, faces) == pytest.approx(exact_volume(points, triangles), rel=1e-4)
