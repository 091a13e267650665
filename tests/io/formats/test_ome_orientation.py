"""Sides of the body in OME-Zarr (RFC-4): words of axes become directions in LPS, and directions become words."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import yaozarrs

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.headers import is_anatomical
from tests.io.formats.test_ome_zarr import axes, changed, make_store

#: Sides from which to which a coordinate of LPS increases.
LINES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))
ALL_48 = [
    (order, signs)
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]


def matrix(order, signs) -> np.ndarray:
    direction = np.zeros((3, 3))
    for column, (axis, sign) in enumerate(zip(order, signs, strict=True)):
        direction[axis, column] = sign
    return direction


def words(order, signs) -> list[str]:
    """Of x, y and z, written without the code that is tested."""
    return [
        f"{LINES[axis][0]}-to-{LINES[axis][1]}"
        if sign > 0
        else f"{LINES[axis][1]}-to-{LINES[axis][0]}"
        for axis, sign in zip(order, signs, strict=True)
    ]


def oriented(path: Path, said: dict, names: str = "zyx", version: str = "0.5", **more) -> Path:
    """A store with ``said`` added to its axes, by their names."""
    array = (
        np.arange(4 * 5 * 6, dtype="u1")
        .reshape(4, 5, 6)
        .transpose(["zyx".index(name) for name in names])
    )
    sizes = {"z": 3.0, "y": 2.0, "x": 1.0}
    given = [axis | said.get(axis["name"], {}) for axis in axes(names, "millimeter")]
    scales = [([sizes[name] for name in names], [more.get("at", 0.0)] * 3)]
    return make_store(path, [array], names, scales, version, multiscale={"axes": given})


def spelled(word: str) -> dict:
    """A word as RFC-4 has it."""
    return {"orientation": {"type": "anatomical", "value": word}}


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(7))
@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_each_word_turns_its_axis_whatever_the_order_of_axes(tmp_path, seed, version):
    rng = np.random.default_rng(seed)
    for number in rng.permutation(48)[:6]:
        order, signs = ALL_48[number]
        names = "".join(rng.permutation(list("zyx")))
        said = {name: spelled(word) for name, word in zip("xyz", words(order, signs), strict=True)}
        path = oriented(tmp_path / f"{number}.zarr", said, names, version)
        whole, lazy = io.read(path), io.open_volume(path)
        for volume in (whole, lazy):
            np.testing.assert_array_equal(volume.geometry.direction, matrix(order, signs))
            assert (
                volume.geometry.spacing == (3.0, 2.0, 1.0) and io.WARNING_KEY not in volume.metadata
            )
            assert is_anatomical(volume.metadata)
        np.testing.assert_array_equal(whole.array.ravel(), np.arange(120))


@pytest.mark.sampled(9)
@pytest.mark.parametrize(("order", "signs"), ALL_48)
def test_all_directions_along_axes_are_written_in_words_and_come_back(tmp_path, order, signs):
    direction, origin = matrix(order, signs), (7.0, -8.0, 9.0)
    grid = Geometry((3, 4, 5), (3.0, 2.0, 1.0), origin, direction)
    path = tmp_path / "a.ome.zarr"
    io.write(Volume(np.arange(60, dtype="i2").reshape(3, 4, 5), grid), path)
    said = json.loads((path / "zarr.json").read_text())["attributes"]["ome"]["multiscales"][0][
        "axes"
    ]
    assert [axis["orientation"]["value"] for axis in said] == words(order, signs)[::-1]
    assert {axis["orientation"]["type"] for axis in said} == {"anatomical"}
    yaozarrs.validate_zarr_store(path)
    back = io.read(path)
    assert (
        back.geometry.difference(grid) == ""
        and back.geometry.origin == origin
        and back.metadata == {}
    )
    # What another program sees, that does not know the attribute of accelsurf: the same directions.
    node = json.loads((path / "zarr.json").read_text())
    del node["attributes"]["accelsurf"]
    (path / "zarr.json").write_text(json.dumps(node))
    alone = io.read(path)
    np.testing.assert_array_equal(alone.geometry.direction, direction)
    assert alone.geometry.origin == origin
    is_turned = not np.array_equal(direction, np.eye(3))
    assert ("place of the first voxel" in alone.metadata.get(io.WARNING_KEY, "")) == is_turned
    np.testing.assert_array_equal(alone.array, back.array)
    # And what was read so is written so.
    io.write(alone, tmp_path / "b.ome.zarr")
    again = io.read(tmp_path / "b.ome.zarr")
    assert again.geometry.difference(grid) == "" and is_anatomical(again.metadata)


def test_oblique_directions_have_no_words_and_come_back(tmp_path):
    c, s = np.cos(0.3), np.sin(0.3)
    grid = Geometry(
        (3, 4, 5), (3.0, 2.0, 1.0), direction=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    )
    io.write(Volume(np.zeros((3, 4, 5), "u1"), grid), tmp_path / "a.ome.zarr")
    assert "orientation" not in (tmp_path / "a.ome.zarr/zarr.json").read_text()
    assert io.read(tmp_path / "a.ome.zarr").geometry.difference(grid) == ""


@pytest.mark.parametrize("unit", ["um", "nm"])
def test_a_dish_under_a_microscope_gets_no_sides(tmp_path, unit):
    grid = Geometry((3, 4, 5), (1e-3, 1e-3, 1e-3))
    io.write(
        Volume(np.zeros((3, 4, 5), "u1"), grid, {"spatial_unit": unit}), tmp_path / "a.ome.zarr"
    )
    assert "orientation" not in (tmp_path / "a.ome.zarr/zarr.json").read_text()
    said = {"spatial_unit": unit, "ome_oriented": "yes"}
    io.write(Volume(np.zeros((3, 4, 5), "u1"), grid, said), tmp_path / "b.ome.zarr")
    assert "right-to-left" in (tmp_path / "b.ome.zarr/zarr.json").read_text()


@pytest.mark.parametrize(
    "word", ["dorsal-to-palmar", "left-to-left", "left-to-superior", "RAS", ""]
)
@pytest.mark.parametrize("x", ["left-to-right", "anterior-to-posterior", ""])
def test_words_that_are_no_three_lines_of_the_body_are_named_in_a_warning(tmp_path, word, x):
    said = {"x": x, "y": word, "z": "posterior-to-anterior"}
    volume = io.read(
        oriented(tmp_path / "a.zarr", {name: spelled(word) for name, word in said.items()})
    )
    np.testing.assert_array_equal(volume.geometry.direction, np.eye(3))
    noted = volume.metadata[io.WARNING_KEY]
    assert f"y: {word or 'none'}, z: posterior-to-anterior) are not lines of the body" in noted
    assert not is_anatomical(volume.metadata)


def test_words_against_the_directions_that_accelsurf_wrote_are_refused(tmp_path):
    path = tmp_path / "a.ome.zarr"
    io.write(Volume(np.zeros((3, 4, 5), "u1"), Geometry((3, 4, 5), (1.0, 1.0, 1.0))), path)
    changed(path, lambda ome: ome["multiscales"][0]["axes"][2].update(spelled("left-to-right")))
    with pytest.raises(InputError, match="contradicts .direction. in its attribute"):
        io.read(path)


@pytest.mark.parametrize(
    ("x", "y", "third"),
    [
        ("left-to-right", "posterior-to-anterior", (0, 0, 1)),
        ("anterior-to-posterior", "superior-to-inferior", (-1, 0, 0)),
    ],
)
def test_a_slice_is_turned_right_handed(tmp_path, x, y, third):
    given = [
        axis | spelled(word) for axis, word in zip(axes("yx", "millimeter"), (y, x), strict=True)
    ]
    path = make_store(
        tmp_path / "a.zarr",
        [np.ones((3, 3), "u1")],
        "yx",
        [((1.0,) * 2,)],
        multiscale={"axes": given},
    )
    direction = io.read(path).geometry.direction
    np.testing.assert_array_equal(direction[:, 2], third)
    assert np.linalg.det(direction) == 1.0


def test_coarser_levels_lie_where_the_turned_axes_put_them(tmp_path):
    given = [
        axis | spelled(word)
        for axis, word in zip(
            axes("zyx", "millimeter"),
            ("inferior-to-superior", "posterior-to-anterior", "left-to-right"),
            strict=True,
        )
    ]
    arrays = [np.ones((4, 4, 4), "u1"), np.ones((2, 2, 2), "u1")]
    scales = [((1.0,) * 3, (10.0, 20.0, 30.0)), ((2.0,) * 3, (10.5, 20.5, 30.5))]
    path = make_store(tmp_path / "a.zarr", arrays, "zyx", scales, multiscale={"axes": given})
    coarse = io.open_volume(path, level=1)
    assert coarse.geometry.origin == (29.5, 19.5, 10.5)
    assert coarse.read(whole_box(coarse.shape)).all()
