import re
import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.geometry import Geometry, axis_steps, orthonormal_deviation


def random_geometry(seed: int) -> Geometry:
    """Oblique, anisotropic, every other one left-handed."""
    rng = np.random.default_rng(seed)
    direction, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    direction *= np.sign(np.linalg.det(direction)) * (-1) ** seed
    shape = tuple(int(n) for n in rng.integers(1, 9, 3))
    return Geometry(shape, tuple(rng.uniform(0.1, 4, 3)), tuple(rng.normal(0, 200, 3)), direction)


def sitk_image(geometry: Geometry) -> sitk.Image:
    image = sitk.Image(geometry.size, sitk.sitkUInt8)
    image.SetSpacing(geometry.spacing_xyz)
    image.SetOrigin(geometry.origin)
    image.SetDirection(geometry.direction.ravel().tolist())
    return image


@pytest.mark.parametrize("seed", range(8))
def test_world_and_index_agree_with_simpleitk(seed):
    geometry = random_geometry(seed)
    image = sitk_image(geometry)
    zyx = np.random.default_rng(seed + 100).uniform(-3, 12, (20, 3))
    ours = geometry.index_to_world(zyx)
    theirs = [image.TransformContinuousIndexToPhysicalPoint(p[::-1].tolist()) for p in zyx]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)
    back = [image.TransformPhysicalPointToContinuousIndex(p)[::-1] for p in theirs]
    np.testing.assert_allclose(geometry.world_to_index(theirs), back, rtol=0, atol=1e-9)
    np.testing.assert_allclose(geometry.world_to_index(ours), zyx, rtol=0, atol=1e-9)


def test_points_keep_their_leading_axes():
    geometry = random_geometry(1)
    grid = np.zeros((2, 5, 3))
    assert geometry.index_to_world(grid).shape == (2, 5, 3)
    assert geometry.world_to_index(np.zeros(3)).shape == (3,)


@pytest.mark.parametrize("points", [1.0, [1.0, 2.0], np.zeros((3, 2))])
def test_points_of_another_dimension_are_refused(points):
    with pytest.raises(GeometryError, match="points of shape"):
        random_geometry(0).index_to_world(points)


def test_sizes_in_both_orders():
    geometry = Geometry((5, 4, 3), (3.0, 2.0, 0.5))
    assert geometry.size == (3, 4, 5)
    assert geometry.spacing_xyz == (0.5, 2.0, 3.0)
    assert geometry.voxel_volume == 3.0
    assert geometry.extent_mm == (15.0, 8.0, 1.5)
    np.testing.assert_array_equal(geometry.center_world(), [0.5, 3.0, 6.0])
    np.testing.assert_array_equal(
        geometry.corners_world()[[0, 1, -1]], [[0, 0, 0], [1, 0, 0], [1, 6, 12]]
    )


def test_sequences_of_any_kind_become_plain_numbers():
    geometry = Geometry(np.array([2, 3, 4]), [1, 2, 3], np.zeros(3), np.eye(3, dtype=int))  # type: ignore[arg-type]
    assert geometry.shape == (2, 3, 4) and all(type(n) is int for n in geometry.shape)
    assert geometry.spacing == (1.0, 2.0, 3.0) and all(type(h) is float for h in geometry.spacing)
    assert geometry.direction.dtype == np.float64


def test_the_matrix_given_is_copied_and_locked():
    matrix = np.eye(3)
    geometry = Geometry((1, 1, 1), (1, 1, 1), direction=matrix)
    matrix[0, 0] = 7
    assert geometry.direction[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        geometry.direction[0, 0] = 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": (0, 4, 3)}, "shape"),
        ({"shape": (1.5, 4, 3)}, "shape"),
        ({"shape": (4, 3)}, "shape"),
        ({"spacing": (1, 0, 1)}, "spacing"),
        ({"spacing": (1, -1, 1)}, "spacing"),
        ({"spacing": (1, np.nan, 1)}, "spacing"),
        ({"spacing": (1, np.inf, 1)}, "spacing"),
        ({"spacing": (1, 1)}, "spacing"),
        ({"spacing": 1.0}, "spacing"),
        ({"origin": (0, np.nan, 0)}, "origin"),
        ({"origin": (0, 0)}, "origin"),
        ({"direction": np.eye(2)}, "direction"),
        ({"direction": np.full((3, 3), np.nan)}, "direction"),
        ({"direction": "no matrix"}, "direction"),
        ({"direction": np.diag([1.0, 1.0, 0.0])}, "not orthonormal.*off by 1"),
        ({"direction": np.diag([1.0, 1.0, 2.0])}, "not orthonormal.*off by 3"),
        ({"direction": [[1, 0.01, 0], [0, 1, 0], [0, 0, 1]]}, "not orthonormal.*off by 0.01"),
    ],
)
def test_no_grid_is_refused_in_words(change, words):
    with pytest.raises(GeometryError, match=words):
        Geometry(**{"shape": (5, 4, 3), "spacing": (1, 1, 1), **change})


def test_rounding_of_file_formats_is_accepted():
    direction = random_geometry(3).direction.astype(np.float32)
    assert 0 < orthonormal_deviation(direction) < 1e-6
    Geometry((5, 4, 3), (1, 1, 1), direction=direction)


def test_matching_grids():
    a = random_geometry(4)
    near = Geometry(a.shape, a.spacing, tuple(np.add(a.origin, 1e-4 * min(a.spacing))), a.direction)
    assert a.matches(a) and a.matches(near) and near.matches(a)
    assert a.difference(near) == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": (5, 4, 2)}, "size (x,y,z) (3, 4, 5) against (2, 4, 5)"),
        ({"spacing": (2.0, 1.01, 1.0)}, "spacing (z,y,x) (2, 1, 1) against (2, 1.01, 1) mm"),
        ({"origin": (0.0, 0.0, 0.1)}, "origin (x,y,z) (0, 0, 0) against (0, 0, 0.1) mm"),
        ({"direction": np.diag([-1.0, 1.0, 1.0])}, "direction by 180 degrees"),
    ],
)
def test_grids_that_differ_say_in_what(change, words):
    given = {
        "shape": (5, 4, 3),
        "spacing": (2.0, 1.0, 1.0),
        "origin": (0.0, 0.0, 0.0),
        "direction": np.eye(3),
    }
    a, b = Geometry(**given), Geometry(**{**given, **change})
    assert not a.matches(b) and not b.matches(a)
    assert words in a.difference(b)
    assert "\n" not in a.difference(b)


def test_what_counts_is_where_voxels_lie():
    """A tiny angle moves the far corner of a large grid, and not that of a small one."""
    c, s = np.cos(1e-5), np.sin(1e-5)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    small, large = (8, 8, 8), (500, 500, 500)
    assert Geometry(small, (1, 1, 1)).matches(Geometry(small, (1, 1, 1), direction=turned))
    assert not Geometry(large, (1, 1, 1)).matches(Geometry(large, (1, 1, 1), direction=turned))
    assert Geometry(large, (1, 1, 1)).matches(
        Geometry(large, (1, 1, 1), direction=turned), tolerance_mm=0.1
    )


def test_spacing_across_a_single_slice_counts():
    assert not Geometry((1, 8, 8), (1, 1, 1)).matches(Geometry((1, 8, 8), (3, 1, 1)))


def test_geometry_alone_does_not_load_simpleitk():
    code = "import sys, accelsurf.grid.geometry, accelsurf.image.volume; sys.exit('SimpleITK' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_geometry_error_is_an_input_error():
    with pytest.raises(InputError):
        Geometry((0, 0, 0), (1, 1, 1))


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((4, 5, 6), (3.0, 2.0, 1.0)),
        ((1, 5, 6), (2.0, 1.0)),
        ((4, 1, 1), (3.0,)),
        ((1, 1, 1), (3.0, 2.0, 1.0)),
    ],
)
def test_steps_are_the_spacings_along_which_something_happens(shape, expected):
    assert axis_steps(shape, (3, 2, 1)) == expected == Geometry(shape, (3, 2, 1)).steps


def drawn_geometry(draw):
    turn = np.linalg.qr(draw.normal(size=(3, 3)))[0]
    return {
        "shape": tuple(int(n) for n in draw.integers(1, 9, 3)),
        "spacing": tuple(draw.uniform(0.2, 3.0, 3).tolist()),
        "origin": tuple(draw.normal(size=3).tolist()),
        "direction": turn if draw.random() < 0.5 else np.eye(3)[draw.permutation(3)] * -1.0,
    }


@pytest.mark.parametrize("seed", range(6))
def test_geometries_of_the_same_numbers_are_equal(seed):
    import copy
    import pickle

    numbers = drawn_geometry(np.random.default_rng(seed))
    one, two = (
        Geometry(**numbers),
        Geometry(**{**numbers, "direction": numbers["direction"].tolist()}),
    )
    for other in (two, copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert one == other and hash(one) == hash(other) and len({one, other}) == 1
    changed = {
        "shape": (*numbers["shape"][:2], numbers["shape"][2] + 1),
        "spacing": (numbers["spacing"][0] + 1e-6, *numbers["spacing"][1:]),
        "origin": (*numbers["origin"][:2], numbers["origin"][2] - 1e-6),
        "direction": -numbers["direction"],
    }
    for key, value in changed.items():
        assert one != Geometry(**{**numbers, key: value})
    assert one != "a grid" and one != numbers["shape"]


def test_signs_of_zeros_make_no_other_grid():
    one, two = (
        Geometry((2, 3, 4), (1.0, 1.0, 1.0), (zero, 0.0, 0.0), np.eye(3) * (1.0 + zero))
        for zero in (0.0, -0.0)
    )
    three = Geometry(
        (2, 3, 4), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), np.where(np.eye(3) == 0, -0.0, np.eye(3))
    )
    assert one == two == three and len({one, two, three}) == 1


def test_no_comparison_of_values_meets_an_array():
    """Values with arrays are compared by who they are, or have an equality of their own."""
    import importlib
    import pkgutil
    import typing
    from dataclasses import fields, is_dataclass

    import accelsurf

    bad = []
    for found in pkgutil.walk_packages(accelsurf.__path__, "accelsurf."):
        if found.name.startswith(("accelsurf.viewer", "accelsurf.napari", "accelsurf.kernels")):
            continue
        module = importlib.import_module(found.name)
        for name, kind in vars(module).items():
            if not (
                isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == found.name
            ):
                continue
            if not kind.__dataclass_params__.eq or not kind.__dataclass_params__.frozen:
                continue
            names = vars(module) | {"Any": typing.Any}
            for field in fields(kind):
                text = field.type if isinstance(field.type, str) else str(field.type)
                meant = [
                    names.get(word, word)
                    for word in re.findall(r"\w+", text.partition("Callable")[0])
                ]
                if any("NDArray" in str(word) or "numpy.ndarray" in str(word) for word in meant):
                    bad.append(f"{found.name}.{name}.{field.name}: {text}")
    assert bad == []
