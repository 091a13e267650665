"""Meshes of other programs: read in every encoding, checked, and refused in one line where they are damaged."""

import struct
import subprocess
import sys

import numpy as np
import pytest
import pyvista

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io import meshes
from accelsurf.io.meshes import MESH_READERS
from accelsurf.measure.surface_mesh import extract_surface

#: Of meshes that can be read.
SUFFIXES = list(MESH_READERS)
GRID = Geometry((14, 15, 16), (1.0, 0.9, 0.8), (-3.0, 4.0, 5.0))
CENTRE, RADIUS = GRID.index_to_world((6.6, 7.2, 8.1)), 4.5


@pytest.fixture(scope="module")
def ball():
    index = np.moveaxis(np.indices(GRID.shape), 0, -1)
    distance = np.linalg.norm(GRID.index_to_world(index) - CENTRE, axis=-1) - RADIUS
    return extract_surface(distance.astype(np.float32), GRID)


@pytest.fixture(scope="module")
def polydata(ball):
    return pyvista.PolyData.from_regular_faces(ball.vertices, ball.faces)


@pytest.fixture(scope="module")
def voxels(ball, tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "a.obj"
    ball.write(path)
    found = meshes.voxels_in_mesh(path, GRID)
    assert 400 < found.sum() < 700
    return found


def refuse(path, words):
    with pytest.raises(InputError, match=words) as caught:
        meshes.voxels_in_mesh(path, GRID)
    assert (
        str(caught.value).startswith(f"{path}: ")
        and "\n" not in str(caught.value)
        and caught.value.hint
    )
    assert len(str(caught.value)) < 400 + len(str(path))


@pytest.mark.sampled
@pytest.mark.parametrize("space", ["lps", "ras"])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_accelsurf_writes_it_reads(ball, voxels, tmp_path, suffix, space):
    path = tmp_path / f"a{suffix}"
    ball.write(path, space=space)
    np.testing.assert_array_equal(meshes.voxels_in_mesh(path, GRID), voxels)
    np.testing.assert_array_equal(meshes.voxels_in_mesh(path, GRID, space), voxels)
    points, triangles = meshes.read_mesh(path)
    assert len(points) == len(ball.vertices) and len(triangles) == len(ball.faces)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("suffix", [".ply", ".stl"])
def test_what_vtk_writes_is_read(polydata, voxels, tmp_path, suffix, binary):
    path = tmp_path / f"a{suffix}"
    polydata.save(path, binary=binary)
    np.testing.assert_array_equal(meshes.voxels_in_mesh(path, GRID), voxels)


def test_polygons_become_triangles(tmp_path):
    cube = pyvista.Cube(center=CENTRE, x_length=5, y_length=6, z_length=7)
    found = []
    for suffix in (".ply",):
        cube.save(tmp_path / f"a{suffix}")
        found.append(meshes.voxels_in_mesh(tmp_path / f"a{suffix}", GRID))
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in cube.points)
    faces = "".join("f " + " ".join(str(n + 1) for n in face) + "\n" for face in cube.regular_faces)
    (tmp_path / "a.obj").write_text(f"mtllib nowhere.mtl\no one\n{corners}{faces}")
    found.append(meshes.voxels_in_mesh(tmp_path / "a.obj", GRID))
    x, y, z = np.moveaxis(
        np.abs(GRID.index_to_world(np.moveaxis(np.indices(GRID.shape), 0, -1)) - CENTRE), -1, 0
    )
    for voxels in found:
        np.testing.assert_array_equal(voxels, (x < 2.5) & (y < 3) & (z < 3.5))


def test_several_objects_in_one_obj_file(ball, voxels, tmp_path):
    ball.write(tmp_path / "a.obj")
    text = (tmp_path / "a.obj").read_text()
    points, faces = text[: text.index("\nf ")], text[text.index("\nf ") :]
    half = faces.index("\nf ", len(faces) // 2)
    (tmp_path / "b.obj").write_text(
        f"{points}\no first\nusemtl x{faces[:half]}\no second\nusemtl y{faces[half:]}"
    )
    np.testing.assert_array_equal(meshes.voxels_in_mesh(tmp_path / "b.obj", GRID), voxels)


@pytest.mark.parametrize("face", ["-4 -2 -3", "-4/1/1 -2/2/2 -3/3/3", "-4//1 -2//1 -3//1"])
def test_numbers_of_an_obj_that_count_back(tmp_path, face):
    """Two tetrahedra, each with its points before its faces; a negative number counts from where it stands."""
    corners = [(0, 0, 0), (6, 0, 0), (0, 6, 0), (0, 0, 6)]
    text = "mtllib nowhere.mtl\n"
    for n, name in enumerate("ab"):
        text += f"o {name}\nusemtl {name}\n" + "".join(
            f"v {x + 10 * n} {y} {z}\n" for x, y, z in corners
        )
        text += f"f {face}\n" + "f -4 -3 -1\nf -4 -1 -2\nf -3 \\\n -2 -1\n"
    (tmp_path / "a.obj").write_text(text)
    points, triangles = meshes.read_mesh(tmp_path / "a.obj")
    sides = np.linalg.det(points[triangles]) / 6
    assert len(points) == 8 and sides.sum() == pytest.approx(72.0) and points[:, 0].max() == 16


# -------------------------------------------------------------------------------------------------- damaged files


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_truncation_is_one_clear_error(ball, tmp_path, suffix, caplog, capfd):
    ball.write(tmp_path / f"a{suffix}")
    raw = (tmp_path / f"a{suffix}").read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / f"cut{suffix}"
    for keep in {*range(0, 400, 7), *rng.integers(400, len(raw) - 60, 30).tolist()}:
        path.write_bytes(raw[:keep])
        refuse(path, "cannot be read as a mesh|open edges|name points|no triangle|its header says")
    assert capfd.readouterr() == ("", "")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damage_is_refused_or_read_but_never_anything_else(ball, tmp_path, suffix, capfd):
    ball.write(tmp_path / f"a{suffix}")
    raw = (tmp_path / f"a{suffix}").read_bytes()
    rng = np.random.default_rng(1)
    path, refused = tmp_path / f"bad{suffix}", 0
    for trial in range(150):
        damaged = bytearray(raw)
        for place in rng.integers(0, len(raw) if trial % 2 else 500, 3):
            damaged[place] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            meshes.read_mesh(path)
        except InputError as error:
            refused += 1
            assert str(error).startswith(f"{path}: ") and error.hint and "\n" not in str(error)
    assert refused > 40 and capfd.readouterr() == ("", "")


PLY = "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face {m}\nproperty list uchar int vertex_indices\nend_header\n"
CORNERS = "0 0 0\n9 0 0\n0 9 0\n0 0 9\n"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        (
            "a.ply",
            PLY.format(n=4, m=4) + CORNERS + "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 7\n",
            "name points 0 to 7, it has 4",
        ),
        (
            "a.ply",
            PLY.format(n=4, m=4) + CORNERS + "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 -3\n",
            "name points -3 to 3",
        ),
        (
            "a.ply",
            PLY.format(n=4, m=3) + CORNERS + "3 0 2 1\n3 0 1 3\n3 0 3 2\n",
            "3 triangles with 3 open edges",
        ),
        (
            "a.ply",
            PLY.format(n=10**12, m=4) + CORNERS,
            "cannot be read as a mesh|open edges|no triangle",
        ),
        (
            "a.ply",
            PLY.format(n=4, m=4)
            + "0 0 nan\n"
            + CORNERS[6:]
            + "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n",
            "not finite",
        ),
        ("a.ply", PLY.format(n=0, m=0), "no triangle"),
        ("a.obj", "v 0 0 0\nv 9 0 0\nv 0 9 0\n", "no triangle"),
        ("a.obj", "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 9\n", "cannot be read as a mesh|name points"),
        ("a.obj", "", "no triangle"),
        ("a.obj", "v 0 0\nv 9 0\nv 0 9\nf 1 2 3\n", "points of 2 coordinates"),
        ("a.stl", "solid a\nendsolid a\n", "no triangle"),
    ],
)
def test_meshes_that_are_none(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    refuse(tmp_path / name, words)


def test_an_stl_that_claims_more_triangles_than_it_has(ball, tmp_path):
    ball.write(tmp_path / "a.stl")
    raw = bytearray((tmp_path / "a.stl").read_bytes())
    struct.pack_into("<I", raw, 80, 2**32 - 1)
    (tmp_path / "a.stl").write_bytes(raw)
    refuse(tmp_path / "a.stl", "no triangle")


def test_nothing_is_printed_about_damage(tmp_path):
    """In a process of its own: pytest takes what is logged, which Python would print."""
    corners = "vertex 0 0 0\nvertex 9 0 0\nvertex 0 9 0\n"
    facet = f"facet normal x y z\nouter loop\n{corners}endloop\nendfacet\n"
    (tmp_path / "a.stl").write_text(f"solid a\n{facet}endsolid a\n")
    code = "import sys; from accelsurf.io import meshes; from accelsurf.errors import InputError\n"
    code += "try: meshes.read_mesh(sys.argv[1])\nexcept InputError as error: print(error.kind)"
    words = [sys.executable, "-c", code, str(tmp_path / "a.stl")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("input\n", "")
