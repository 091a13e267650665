"""SPACE=RAS and SPACE=LPS in the headers of meshes: what says RAS is turned to LPS, other words are refused."""

import numpy as np
import pytest

from accelsurf import cli
from accelsurf import io as images
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.io import meshes
from accelsurf.io.formats import surface_files
from accelsurf.io.meshes import MESH_READERS
from accelsurf.measure.surface_mesh import Surface

CORNERS = np.array([[10.0, 20, 30], [11, 20, 30], [10, 22, 30], [10, 20, 33]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
TURNED = CORNERS * (-1.0, -1.0, 1.0)
SUFFIXES = list(MESH_READERS)
RAS = [
    "SPACE=RAS",
    "space=ras",
    "SPACE = RAS",
    "Space= Ras",
    "SPACE=R-A-S",
    'SPACE="RAS"',
    "SPACE\t=\tRAS",
    "SPACE=right-anterior-superior",
    "space = Right Anterior Superior",
    "UNIT=mm SPACE=RAS",
]
LPS = ["SPACE=LPS", "space = lps", "SPACE=left-posterior-superior", "SPACE=LPS+", ""]
OTHERS = [
    "SPACE=XYZ",
    "SPACE=LAS",
    "space = scanner",
    "SPACE=scanner-RAS",
    "SPACE=MNI152",
    "SPACE=3D-RAS-time",
    "SPACE=RA",
    "SPACE=LPS SPACE=RAS",
]


def ply(said):
    body = surface_files.ply_bytes(CORNERS, FACES, "LPS")
    return body.replace(b"comment SPACE=LPS\n", f"comment 3D Slicer output. {said}\n".encode())


def ply_info(said):
    return ply(said).replace(b"comment 3D", b"obj_info 3D")


def stl(said):
    head = f"3D Slicer output. {said}".encode().ljust(80, b"\0")
    return head + surface_files.stl_bytes(CORNERS, FACES, "LPS")[80:]


def stl_solid(said):
    """Binary, though its first word is that of the text format."""
    return f"solid {said}".encode().ljust(80) + stl(said)[80:]


def stl_text(said, end="endsolid"):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[face])
        + "endloop\nendfacet\n"
        for face in FACES
    )
    return f"solid 3D Slicer output. {said}\n{facets}{end}\n".encode()


def obj(said):
    return surface_files.obj_bytes(CORNERS, FACES, "LPS").replace(b"SPACE=LPS", said.encode())


def obj_late(said):
    return b"# a tetrahedron\n" + obj("").partition(b"\n")[2] + f"  # {said}\n".encode()


#: Writers whose points stand in the file as they are.
PLAIN = {
    "a.ply": ply,
    "b.ply": ply_info,
    "a.stl": stl,
    "b.stl": stl_solid,
    "c.stl": stl_text,
    "a.obj": obj,
    "b.obj": obj_late,
}


def written(folder, name, said):
    path = folder / name
    path.write_bytes(PLAIN[name](said))
    return path


def is_there(path, corners, space=""):
    """Whether a mesh is read with these corners and its triangles facing outward."""
    points, triangles = meshes.read_mesh(path, space)
    # Exact, with the corners of each triangle in the order that the file has.
    assert Surface(points, triangles.astype(np.int32)).volume == pytest.approx(1.0, rel=1e-5)
    np.testing.assert_allclose(points, np.unique(corners, axis=0), atol=1e-5)


@pytest.mark.sampled
@pytest.mark.parametrize("said", RAS)
@pytest.mark.parametrize("name", PLAIN)
def test_ras_is_turned(name, said, tmp_path):
    is_there(written(tmp_path, name, said), TURNED)
    is_there(tmp_path / name, TURNED, "ras")
    with pytest.raises(InputError, match=r"says SPACE=RAS, @lps was given") as caught:
        meshes.read_mesh(tmp_path / name, "lps")
    assert caught.value.hint == "leave @lps out"


@pytest.mark.sampled
@pytest.mark.parametrize("said", LPS)
@pytest.mark.parametrize("name", PLAIN)
def test_lps_and_nothing_are_taken_as_they_are(name, said, tmp_path):
    is_there(written(tmp_path, name, said), CORNERS)
    is_there(tmp_path / name, CORNERS, "lps")
    if said:
        with pytest.raises(InputError, match=r"says SPACE=LPS, @ras was given"):
            meshes.read_mesh(tmp_path / name, "ras")
    else:
        is_there(tmp_path / name, TURNED, "ras")


@pytest.mark.sampled
@pytest.mark.parametrize("said", OTHERS)
@pytest.mark.parametrize("name", PLAIN)
def test_other_spaces_are_refused_unless_the_user_says_which_they_are(name, said, tmp_path):
    path = written(tmp_path, name, said)
    with pytest.raises(
        InputError, match=r"its header says SPACE=.*SPACE=LPS or SPACE=RAS expected"
    ) as caught:
        meshes.read_mesh(path)
    assert "FILE@lps or FILE@ras" in caught.value.hint and "\n" not in str(caught.value)
    is_there(path, CORNERS, "lps")
    is_there(path, TURNED, "ras")


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("space", ["lps", "ras"])
def test_what_accelsurf_writes_says_its_space_and_comes_back_in_place(suffix, space, tmp_path):
    path = tmp_path / f"a{suffix}"
    Surface(CORNERS, FACES).write(path, space)
    is_there(path, CORNERS)
    is_there(path, CORNERS, space)
    with pytest.raises(InputError, match=f"says SPACE={space.upper()}, @"):
        meshes.read_mesh(path, "ras" if space == "lps" else "lps")


@pytest.mark.sampled
@pytest.mark.parametrize(
    "said",
    [
        "color space = sRGB",
        "ColorSpace=RAS",
        "my_space=XYZ",
        "a free space",
        "SPACE=",
        "SPACE= UNIT=mm",
    ],
)
@pytest.mark.parametrize("name", ["a.ply", "a.stl", "c.stl", "a.obj"])
def test_words_that_say_no_space(name, said, tmp_path):
    is_there(written(tmp_path, name, said), CORNERS)


@pytest.mark.parametrize("name", ["a.ply", "a.stl", "c.stl", "a.obj"])
def test_another_unit_is_refused(name, tmp_path):
    is_there(written(tmp_path, name, "SPACE=RAS UNIT=Millimeter"), TURNED)
    for word in ("um", "cm", "inch"):
        with pytest.raises(InputError, match=f"says UNIT={word}, mm expected"):
            meshes.read_mesh(written(tmp_path, name, f"SPACE=LPS UNIT={word}"))


@pytest.mark.parametrize(
    "said, given, place",
    [
        ("SPACE=RAS", "", (-2.5, -1.8, -2.25)),
        ("SPACE=RAS", "@ras", (-2.5, -1.8, -2.25)),
        ("", "@ras", (-2.5, -1.8, -2.25)),
        ("", "", (2.5, 1.8, -2.25)),
        ("SPACE=LPS", "@lps", (2.5, 1.8, -2.25)),
    ],
)
def test_a_start_lies_where_its_mesh_says(said, given, place, tmp_path, monkeypatch):
    """A run of no step: the object is the start."""
    import trimesh

    monkeypatch.chdir(tmp_path)
    made = trimesh.creation.icosphere(2, 3.0)
    points = np.asarray(made.vertices) + (2.5, 1.8, -2.25)
    content = surface_files.stl_bytes(points, np.asarray(made.faces, np.int32), "LPS")
    (tmp_path / "a.stl").write_bytes(
        f"3D Slicer output. {said}".encode().ljust(80, b"\0") + content[80:]
    )
    index = np.stack(np.indices((24, 24, 24)), axis=-1)
    volume = Volume.from_array(
        np.zeros((24, 24, 24), np.float32), (0.7, 0.7, 0.7), (-8.0, -8.0, -10.0)
    )
    bright = np.linalg.norm(volume.geometry.index_to_world(index) - place, axis=-1) < 3.0
    images.write(volume.with_array(bright.astype(np.float32) * 100), tmp_path / "a.nii.gz")
    words = [
        "segment",
        "a.nii.gz",
        "-o",
        "out",
        "--start",
        f"mesh:a.stl{given}",
        "--max-steps",
        "1",
        "--quiet",
    ]
    assert cli.execute(words) == 0
    found = images.read_labels(tmp_path / "out" / "a_seg.nii.gz")
    middle = found.geometry.index_to_world(np.argwhere(found.array > 0)).mean(axis=0)
    np.testing.assert_allclose(middle, place, atol=0.3)
