"""Surfaces against analytic areas, volumes and distances; closedness; mesh files read back by VTK."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from accelsurf.errors import EmptyResultError, InputError, OutputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.measure.surface_mesh import Surface, extract_surface
from accelsurf.phantoms.recipes import Recipe, distance_at, signed_distance
from tests.support.meshes import euler_characteristic

MIRROR = np.diag([1.0, -1.0, 1.0])
GRIDS = {
    "isotropic": {"shape": (52, 48, 44)},
    "anisotropic": {"shape": (52, 48, 18), "spacing": (1.0, 1.0, 3.0)},
    "oblique": {
        "shape": (40, 48, 28),
        "spacing": (1.25, 1.0, 2.0),
        "rotation": (25.0, -40.0, 70.0),
    },
}
OBJECTS = {
    "ball": {"kind": "ball", "radius": 16.3, "center": (1.2, -0.7, 0.4)},
    "torus": {"kind": "torus", "ring_radius": 13.0, "tube_radius": 6.5, "center": (0.3, 0.2, -0.4)},
    "box": {"kind": "box", "sides": (26.6, 30.2, 23.4), "center": (0.6, 0.3, 0.2)},
    "two-balls": {"kind": "two-balls", "radius": 9.7, "gap": 4.1},
}


def surface_of(recipe: Recipe) -> Surface:
    return extract_surface(signed_distance(recipe), recipe.geometry)


def outwardness(surface: Surface, recipe: Recipe) -> float:
    """Smallest cosine between a triangle's normal and the way out, by the exact distance; slivers left out."""
    corners = surface.vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    large = areas > 1e-2 * areas.max()
    middle, step = corners[large].mean(axis=1), 1e-4
    way = np.stack(
        [
            distance_at(recipe, middle + step * e) - distance_at(recipe, middle - step * e)
            for e in np.eye(3)
        ]
    )
    return float((normals[large] * way.T / (2 * step)).sum(axis=1).min() / areas[large].max())


@pytest.mark.sampled
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("shape", OBJECTS)
def test_against_the_exact_object(shape: str, grid: str) -> None:
    recipe = Recipe(**OBJECTS[shape], **GRIDS[grid])
    surface = surface_of(recipe)
    voxel = max(recipe.spacing)
    assert surface.is_closed
    assert surface.volume == pytest.approx(recipe.solid.volume, rel=0.015 * voxel)
    # A box loses most: (2 - sqrt 2) of up to a voxel along its edges, which marching cubes cuts off.
    assert surface.area == pytest.approx(
        recipe.solid.area, rel=(0.03 if shape == "box" else 0.012) * voxel
    )
    # A triangle with edges h, h and sqrt(2) h lies (1 + 1 + 2)/24 h^2/r below the surface on average, and its vertices
    # as much above; edges and corners are rounded by less than half a voxel.
    allowed = 0.4 * voxel if shape == "box" else voxel**2 / 6 / 6.5
    assert np.abs(distance_at(recipe, surface.vertices)).max() < allowed
    assert euler_characteristic(surface) == {"torus": 0, "two-balls": 4}.get(shape, 2)
    assert outwardness(surface, recipe) > 0


def test_volume_and_area_converge_at_second_order() -> None:
    errors = []
    for n in (24, 48, 96):
        h = 48.0 / n
        recipe = Recipe(kind="ball", radius=17.3, shape=(n, n, n), spacing=(h, h, h))
        surface = surface_of(recipe)
        exact = recipe.solid
        assert exact.volume is not None and exact.area is not None
        errors.append((abs(surface.volume / exact.volume - 1), abs(surface.area / exact.area - 1)))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 1.8).all(), orders
    assert max(errors[-1]) < 5e-4


def test_left_handed_direction_keeps_the_outside_outside() -> None:
    recipe = Recipe(**OBJECTS["ball"], **GRIDS["oblique"])
    right, psi = recipe.geometry, signed_distance(recipe)
    left = Geometry(right.shape, right.spacing, right.origin, right.direction @ MIRROR)
    assert np.linalg.det(left.direction) < 0 < np.linalg.det(right.direction)
    mirrored, straight = extract_surface(psi, left), extract_surface(psi, right)
    assert mirrored.is_closed
    assert mirrored.volume == pytest.approx(straight.volume, rel=1e-9)
    assert mirrored.volume > 0


def test_world_position_follows_the_geometry() -> None:
    # One voxel alone, far from the origin, on a turned grid: the surface lies around that voxel's centre.
    recipe = Recipe(**OBJECTS["ball"], **GRIDS["oblique"])
    grid = Geometry((9, 8, 7), (2.0, 1.0, 0.5), (400.0, -300.0, 1000.0), recipe.geometry.direction)
    psi = np.full(grid.shape, 1.0, dtype=np.float32)
    psi[6, 2, 5] = -1.0
    surface = extract_surface(psi, grid)
    np.testing.assert_allclose(
        surface.vertices.mean(axis=0), grid.index_to_world((6, 2, 5)), atol=1e-6
    )
    half_axes = np.array([0.25, 0.5, 1.0])  # the octahedron through the middles of the grid edges
    assert surface.volume == pytest.approx(4 / 3 * half_axes.prod(), rel=1e-6)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (3.0, 0.5, 1.0)])
def test_full_volume_is_the_box_of_its_voxels(spacing: tuple[float, float, float]) -> None:
    grid = Geometry((4, 5, 6), spacing, (10.0, 20.0, 30.0))
    surface = extract_surface(np.full(grid.shape, -2.0, dtype=np.float32), grid)
    z, y, x = grid.extent_mm
    assert surface.is_closed and euler_characteristic(surface) == 2
    assert surface.volume == pytest.approx(x * y * z, rel=1e-12)
    assert surface.area == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-12)
    low = np.array(grid.origin) - np.array(grid.spacing_xyz) / 2
    np.testing.assert_allclose(surface.bounds, [low, low + [x, y, z]], rtol=1e-12)


def test_single_voxel_volume() -> None:
    surface = extract_surface(
        np.full((1, 1, 1), -1.0, dtype=np.float32), Geometry((1, 1, 1), (2.0, 3.0, 4.0))
    )
    assert surface.is_closed
    assert surface.volume == pytest.approx(24.0)
    assert surface.area == pytest.approx(52.0)


CUT_BALLS = [  # centre on a face, an edge, a corner of the volume, and the part of the ball that is left
    ((20.0, 0.0, 0.0), 1 / 2),
    ((0.0, -20.0, 0.0), 1 / 2),
    ((0.0, 0.0, 20.0), 1 / 2),
    ((20.0, -20.0, 0.0), 1 / 4),
    ((-20.0, 20.0, -20.0), 1 / 8),
]


@pytest.mark.parametrize(("center", "part"), CUT_BALLS)
def test_object_cut_by_the_border_is_capped_on_the_outer_faces(
    center: tuple[float, float, float], part: float
) -> None:
    recipe = Recipe(
        kind="ball", radius=14.2, center=center, shape=(40, 40, 20), spacing=(1.0, 1.0, 2.0)
    )
    surface = surface_of(recipe)
    faces_cut = sum(c != 0 for c in center)
    ball = recipe.solid
    assert ball.volume is not None and ball.area is not None
    assert surface.is_closed and euler_characteristic(surface) == 2
    assert surface.volume == pytest.approx(part * ball.volume, rel=0.02)
    cap = np.pi * 14.2**2 * {1: 1.0, 2: 0.5, 3: 0.25}[faces_cut] * faces_cut
    assert surface.area == pytest.approx(part * ball.area + cap, rel=0.02)
    reached = np.where(np.array(center) > 0, surface.bounds[1], surface.bounds[0])
    np.testing.assert_allclose(
        reached[np.array(center) != 0], np.array(center)[np.array(center) != 0], rtol=1e-12
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_slice_gives_a_prism_one_voxel_thick(axis: int) -> None:
    y, x = np.mgrid[-18:19, -16:17]
    disc = np.expand_dims((np.hypot(y, x) - 11.4).astype(np.float32), axis)
    spacing = [1.0, 1.0, 1.0]
    spacing[axis] = 2.5
    surface = extract_surface(disc, Geometry(disc.shape, tuple(spacing)))
    assert surface.is_closed and euler_characteristic(surface) == 2
    assert surface.volume == pytest.approx(2.5 * np.pi * 11.4**2, rel=4e-3)
    assert surface.area == pytest.approx(2 * np.pi * 11.4**2 + 2.5 * 2 * np.pi * 11.4, rel=4e-3)
    low, high = surface.bounds[:, 2 - axis]
    assert (low, high) == (-1.25, 1.25)


@pytest.mark.slow
def test_always_closed_on_noise_with_zeros_at_any_shape() -> None:
    random = np.random.default_rng(1)
    seen = 0
    for _ in range(150):
        shape = tuple(random.integers(1, 9, 3))
        psi = gaussian_filter(random.standard_normal(shape), random.choice([0.0, 0.5, 1.0])).astype(
            np.float32
        )
        psi[random.random(shape) < random.choice([0.0, 0.4])] = 0.0
        if not (psi < 0).any():
            continue
        seen += 1
        surface = extract_surface(psi, Geometry(shape, tuple(random.uniform(0.3, 3.0, 3))))
        corners = surface.vertices[surface.faces]
        areas = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        assert surface.is_closed and surface.volume > 0
        assert areas.min() > 0
    assert seen > 100


def test_open_or_inverted_meshes_are_told_apart() -> None:
    whole = surface_of(Recipe(kind="ball", radius=4.0, shape=(12, 12, 12)))
    assert not Surface(whole.vertices, whole.faces[1:]).is_closed
    turned = whole.faces.copy()
    turned[0] = turned[0, ::-1]
    assert not Surface(whole.vertices, turned).is_closed
    assert Surface(whole.vertices, whole.faces[:, ::-1]).volume == pytest.approx(-whole.volume)


def test_only_the_neighbourhood_of_the_surface_counts() -> None:
    recipe = Recipe(**OBJECTS["ball"], **GRIDS["isotropic"])
    psi = signed_distance(recipe)
    near = np.clip(psi, -2.0, 2.0)
    whole, banded = extract_surface(psi, recipe.geometry), extract_surface(near, recipe.geometry)
    np.testing.assert_array_equal(whole.faces, banded.faces)
    np.testing.assert_allclose(whole.vertices, banded.vertices, atol=1e-5)


def test_input_is_not_modified_and_memory_order_does_not_matter() -> None:
    recipe = Recipe(
        kind="cube", side=8.0, shape=(13, 13, 13)
    )  # voxel centres exactly on the faces: psi is 0 there
    psi = signed_distance(recipe)
    assert (psi == 0).any()
    psi.setflags(write=False)
    before = psi.copy()
    one, two = (
        extract_surface(psi, recipe.geometry),
        extract_surface(np.asfortranarray(psi), recipe.geometry),
    )
    np.testing.assert_array_equal(psi, before)
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.faces, two.faces)
    # The margin around voxel centres moves the faces by no more than itself.
    np.testing.assert_allclose(one.bounds, [[-4.0] * 3, [4.0] * 3], atol=2e-4)
    assert one.is_closed


def test_refusals() -> None:
    grid = Geometry((4, 4, 4), (1.0, 1.0, 1.0))
    with pytest.raises(EmptyResultError, match="no surface"):
        extract_surface(np.ones(grid.shape, dtype=np.float32), grid)
    with pytest.raises(InputError, match=r"\(4, 4, 5\)"):
        extract_surface(np.ones((4, 4, 5), dtype=np.float32), grid)
    psi = -np.ones(grid.shape, dtype=np.float32)
    psi[2, 2, 2] = np.nan
    with pytest.raises(InputError, match="NaN"):
        extract_surface(psi, grid)


@pytest.fixture(scope="module")
def torus() -> Surface:
    return surface_of(Recipe(**OBJECTS["torus"], **GRIDS["oblique"]))


@pytest.mark.sampled
@pytest.mark.parametrize("space", ["lps", "ras"])
@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".vtp", ".PLY"])
def test_files_read_back_by_vtk(torus: Surface, tmp_path: Path, suffix: str, space: str) -> None:
    pyvista = pytest.importorskip("pyvista")
    path = tmp_path / f"torus{suffix}"
    torus.write(path, space=space)
    mesh = pyvista.read(path)
    if suffix == ".stl":
        mesh = mesh.clean()  # STL has no shared vertices
    assert len(mesh.regular_faces) == len(torus.faces)
    assert mesh.is_manifold
    assert mesh.volume == pytest.approx(torus.volume, rel=1e-4)
    assert mesh.area == pytest.approx(torus.area, rel=1e-4)
    flip = np.array([-1, -1, 1]) if space == "ras" else np.ones(3)
    expected = np.sort((torus.bounds * flip), axis=0)
    np.testing.assert_allclose(np.reshape(mesh.bounds, (3, 2)).T, expected, atol=1e-4)
    # Outward in both spaces: the divergence theorem on the file's own triangles is positive.
    read = Surface(np.asarray(mesh.points, dtype=np.float64), mesh.regular_faces.astype(np.int32))
    assert read.volume == pytest.approx(torus.volume, rel=1e-4)
    if suffix == ".stl":
        normals = np.frombuffer(path.read_bytes()[84:], dtype="<f4,<f4,<f4,(3,3)<f4,<u2")
        first = np.cross(
            normals["f3"][0][1] - normals["f3"][0][0], normals["f3"][0][2] - normals["f3"][0][0]
        )
        given = np.array([normals[f"f{i}"][0] for i in range(3)])
        assert given @ first == pytest.approx(np.linalg.norm(first), rel=1e-4)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj"])
def test_header_states_space_and_unit(torus: Surface, tmp_path: Path, suffix: str) -> None:
    for space in ("lps", "ras"):
        path = tmp_path / f"{space}{suffix}"
        torus.write(path, space=space)
        head = path.read_bytes()[:200]
        assert f"SPACE={space.upper()}".encode() in head
        assert b"UNIT=mm" in head
        assert not (suffix == ".stl" and head.startswith(b"solid"))


def test_vtp_states_space_and_unit(torus: Surface, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    torus.write(tmp_path / "a.vtp", space="ras")
    mesh = pyvista.read(tmp_path / "a.vtp")
    assert mesh.field_data["SPACE"][0] == "RAS"
    assert mesh.field_data["UNIT"][0] == "mm"
    np.testing.assert_array_equal(
        np.asarray(mesh.points), torus.vertices * [-1, -1, 1]
    )  # float64, nothing lost


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".vtp"])
def test_same_surface_same_bytes(tmp_path: Path, suffix: str) -> None:
    recipe = Recipe(**OBJECTS["torus"], **GRIDS["oblique"])
    for name in ("a", "b"):
        surface_of(recipe).write(tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_unknown_format_or_space_is_refused_and_nothing_written(
    torus: Surface, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r"\.xyz.*\.ply, \.stl, \.obj, \.vtp"):
        torus.write(tmp_path / "a.xyz")
    with pytest.raises(UsageError, match="'scanner'.*lps, ras"):
        torus.write(tmp_path / "a.ply", space="scanner")
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file_and_no_other(
    torus: Surface, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ply"
    path.write_text("old")

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(OutputError, match="No space left"):
        torus.write(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]
    assert path.read_text() == "old"


def test_missing_folder_and_folder_in_the_way(torus: Surface, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        torus.write(tmp_path / "absent" / "a.ply")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        torus.write(tmp_path / "file" / "a.ply")
    (tmp_path / "b.stl").mkdir()
    with pytest.raises(OutputError, match="is a folder, a file name expected"):
        torus.write(tmp_path / "b.stl")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.stl", "file"]
