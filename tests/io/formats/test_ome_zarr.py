"""OME-Zarr: where the metadata put the voxels, levels, channels; stores that are damaged, gone or of another kind."""

import json
import os
import subprocess
import sys
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaozarrs
import zarr

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import channels
from tests.io.test_lazy_volume import assert_same_boxes, values

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def axes(names: str, unit: str | None = "micrometer") -> list[dict]:
    kinds = {"t": "time", "c": "channel"}
    space = {"type": "space", **({"unit": unit} if unit else {})}
    return [{"name": name, **({"type": kinds[name]} if name in kinds else space)} for name in names]


def make_store(
    path: Path, arrays: list[np.ndarray], names: str, scales: list, version="0.5", **more
) -> Path:
    """Write an OME-Zarr as other programs do."""
    form = 3 if version == "0.5" else 2
    datasets = []
    for i, scale in enumerate(scales):
        transforms = [{"type": "scale", "scale": list(scale[0])}]
        if len(scale) > 1:
            transforms.append({"type": "translation", "translation": list(scale[1])})
        datasets.append({"path": str(i), "coordinateTransformations": transforms})
    multiscale = {"axes": axes(names, more.pop("unit", "micrometer")), "datasets": datasets}
    multiscale |= more.pop("multiscale", {})
    said = {"multiscales": [multiscale | ({"version": version} if form == 2 else {})]}
    said = {"ome": said | {"version": version}} if form == 3 else said
    group = zarr.create_group(path, zarr_format=form, attributes=said)
    for i, array in enumerate(arrays):
        chunks = more.get("chunks", (3,) * array.ndim)
        group.create_array(str(i), shape=array.shape, dtype=array.dtype, chunks=chunks)[:] = array
    return path


@pytest.mark.sampled
@pytest.mark.parametrize(
    "dtype", ["bool", "uint8", "<u2", ">u2", ">i2", "int32", "uint64", "float32", ">f8"]
)
@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_boxes_are_those_of_the_whole_image(tmp_path, dtype, version):
    array = np.abs(values("f4")).astype("u1").astype(dtype)
    path = make_store(
        tmp_path / "a.zarr", [array], "zyx", [((3.0, 0.5, 0.25), (10.0, 20.0, 30.0))], version
    )
    lazy = assert_same_boxes(path)
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array)
    np.testing.assert_allclose(lazy.geometry.spacing, (3e-3, 0.5e-3, 0.25e-3))
    np.testing.assert_allclose(lazy.geometry.origin, (30e-3, 20e-3, 10e-3))


@pytest.mark.parametrize(
    ("unit", "mm"),
    [
        ("nanometer", 1e-6),
        ("micrometer", 1e-3),
        ("millimeter", 1.0),
        ("meter", 1e3),
        ("angstrom", 1e-7),
    ],
)
def test_lengths_become_mm(tmp_path, unit, mm):
    path = make_store(tmp_path / "a.zarr", [values("u1")], "zyx", [((2.0, 1.0, 0.5),)], unit=unit)
    lazy = io.open_volume(path)
    np.testing.assert_allclose(lazy.geometry.spacing, (2 * mm, mm, 0.5 * mm), rtol=1e-12)
    assert io.WARNING_KEY not in lazy.metadata


def test_no_unit_is_mm_with_a_warning_and_others_are_refused(tmp_path):
    lazy = io.open_volume(
        make_store(tmp_path / "a.zarr", [values("u1")], "zyx", [((2.0, 1.0, 0.5),)], unit=None)
    )
    assert (
        lazy.geometry.spacing == (2.0, 1.0, 0.5) and "taken as mm" in lazy.metadata[io.WARNING_KEY]
    )
    with pytest.raises(InputError, match="lengths in furlong"):
        io.open_volume(
            make_store(tmp_path / "b.zarr", [values("u1")], "zyx", [((1.0,) * 3,)], unit="furlong")
        )


@pytest.mark.parametrize("names", ["xyz", "yxz", "zxy", "zyx"])
def test_axes_in_another_order_are_turned(tmp_path, names):
    array = values("i2")
    stored = array.transpose(["zyx".index(name) for name in names])
    sizes = dict(zip("zyx", (3.0, 0.5, 0.25), strict=True))
    path = make_store(
        tmp_path / "a.zarr",
        [stored],
        names,
        [([sizes[n] for n in names],)],
        unit="millimeter",
        chunks=(2, 3, 4),
    )
    lazy = assert_same_boxes(path)
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array)
    assert lazy.geometry.spacing == (3.0, 0.5, 0.25)


def test_scales_of_all_levels_act_after_those_of_each(tmp_path):
    more = {
        "coordinateTransformations": [
            {"type": "scale", "scale": [2.0, 2.0, 2.0]},
            {"type": "translation", "translation": [1.0, 2.0, 3.0]},
        ]
    }
    scales = [((3.0, 1.0, 1.0), (5.0, 6.0, 7.0))]
    path = make_store(
        tmp_path / "a.zarr", [values("u1")], "zyx", scales, unit="millimeter", multiscale=more
    )
    geometry = io.open_volume(path).geometry
    assert geometry.spacing == (6.0, 2.0, 2.0) and geometry.origin == (
        2 * 7 + 3.0,
        2 * 6 + 2.0,
        2 * 5 + 1.0,
    )


def test_channels_and_time_points_are_named(tmp_path):
    array = np.random.default_rng(0).integers(0, 99, (2, 3, 5, 7, 9)).astype("u1")
    path = make_store(
        tmp_path / "a.zarr", [array], "tczyx", [((1.0,) * 5,)], chunks=(1, 2, 3, 4, 9)
    )
    for options, words, family in (
        ({}, "2 time points given", InputError),
        ({"time_index": 0}, "3 channels given", InputError),
        ({"time_index": 2, "channel_index": 0}, "time 2 asked for, the image has 2", UsageError),
        ({"time_index": 0, "channel_index": 3}, "channel 3 asked for, the image has 3", UsageError),
        ({"time_index": 0, "channel_index": -1}, "channel -1 asked for", UsageError),
        (
            {"time_index": 0, "channel_index": 0, "level": 1},
            "level 1 asked for, the image has 1",
            UsageError,
        ),
    ):
        with pytest.raises(family, match=words) as caught:
            io.open_volume(path, **options)
        assert str(caught.value).startswith(f"{path}: ") and caught.value.hint
    lazy = io.open_volume(path, time_index=1, channel_index=2)
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array[1, 2])
    path = make_store(tmp_path / "b.zarr", [array[0]], "czyx", [((1.0,) * 4,)])
    with pytest.raises(InputError, match="3 channels given"):
        io.read(path)
    for found, channel in zip(channels.read_channels(path), array[0], strict=True):
        np.testing.assert_array_equal(found.array, channel)


def test_a_2d_image_is_one_slice(tmp_path):
    path = make_store(
        tmp_path / "a.zarr", [values("u1")[0]], "yx", [((0.5, 0.25), (4.0, 8.0))], unit="millimeter"
    )
    lazy = io.open_volume(path)
    assert lazy.geometry.difference(Geometry((1, 7, 9), (1.0, 0.5, 0.25), (8.0, 4.0, 0.0))) == ""
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), values("u1")[:1])


def test_levels_lie_where_their_metadata_say(tmp_path):
    arrays = [values("u1"), values("u1")[:, ::2, ::2]]
    scales = [((2.0, 1.0, 1.0), (0.0, 0.0, 0.0)), ((2.0, 2.0, 2.0), (0.0, 0.5, 0.5))]
    path = make_store(tmp_path / "a.zarr", arrays, "zyx", scales, unit="millimeter")
    coarse = io.open_volume(path, level=1)
    assert coarse.geometry.difference(Geometry((5, 4, 5), (2.0, 2.0, 2.0), (0.5, 0.5, 0.0))) == ""
    np.testing.assert_array_equal(coarse.read(whole_box(coarse.shape)), arrays[1])


def test_what_is_written_keeps_its_place_in_the_world_and_has_levels_of_means(tmp_path):
    """A block's mean lies at the centre of the block, also where the axes are turned."""
    grid = Geometry((70, 75, 150), (2.0, 0.5, 0.5), (-12.5, 4.0, 100.25), TURN)
    z, y, x = np.indices(grid.shape, np.float32)
    world = grid.index_to_world(np.stack([z, y, x], axis=-1).reshape(-1, 3)) @ [3.0, 1.0, 2.0]
    path = tmp_path / "a.ome.zarr"
    io.write(Volume(world.astype(np.float32).reshape(grid.shape), grid, {"a": "b"}), path)
    back = io.read(path)
    assert (
        back.geometry.difference(grid) == ""
        and back.geometry.origin == grid.origin
        and back.metadata == {"a": "b"}
    )
    yaozarrs.validate_zarr_store(path)
    for level, shape in ((1, (70, 38, 75)), (2, (70, 19, 38))):
        coarse = io.open_volume(path, level=level)
        assert coarse.shape == shape
        box = (slice(0, 70), slice(0, 18), slice(0, 37))  # whole blocks
        places = np.stack(np.indices((70, 18, 37)), axis=-1).reshape(-1, 3)
        expected = coarse.geometry.index_to_world(places) @ [3.0, 1.0, 2.0]
        np.testing.assert_allclose(coarse.read(box).ravel(), expected, atol=2e-4)


def test_means_of_whole_numbers_are_rounded_and_do_not_overflow(tmp_path):
    array = np.zeros((65, 65, 65), np.uint8)
    array[:2, :2, :2] = 255
    array[64] = 7
    io.write(Volume.from_array(array), tmp_path / "a.ome.zarr")
    coarse = io.open_volume(tmp_path / "a.ome.zarr", level=1)
    got = coarse.read(whole_box(coarse.shape))
    assert (
        got.shape == (33, 33, 33)
        and got[0, 0, 0] == 255
        and (got[32] == 7).all()
        and got[:32].sum() == 255
    )


def test_chunks_are_held_up_to_a_number_of_bytes(tmp_path):
    path = make_store(
        tmp_path / "a.zarr", [np.zeros((4, 8, 8), "u2")], "zyx", [((1.0,) * 3,)], chunks=(4, 4, 4)
    )
    corners = [tuple(slice(c, c + 1) for c in (0, y, x)) for y in (0, 4) for x in (0, 4)]
    lazy = io.open_volume(path, cache_bytes=2 * 128)
    for corner in (corners[0], corners[1], corners[0], corners[1]):
        lazy.read(corner)
    assert lazy.bytes_read == 2 * 128
    for corner in (corners[2], corners[1], corners[0]):  # the first was used longest ago
        lazy.read(corner)
    assert lazy.bytes_read == 4 * 128
    nothing_held = io.open_volume(path, cache_bytes=0)
    nothing_held.read(corners[0]), nothing_held.read(corners[0])
    assert nothing_held.bytes_read == 2 * 128


# ------------------------------------------------------------------------------------------------------ faults


def written(tmp_path: Path) -> tuple[Path, np.ndarray]:
    array = np.random.default_rng(0).integers(1, 99, (65, 20, 20)).astype("u1")
    path = tmp_path / "a.ome.zarr"
    io.write(Volume.from_array(array), path)
    return path, array


def refused(path: Path, words: str, lazy: io.LazyVolume | None = None, box=None) -> None:
    with pytest.raises(InputError, match=words) as caught:
        io.read(path) if lazy is None else lazy.read(box or whole_box(lazy.shape))
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert caught.value.hint and caught.value.exit_code == 3


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "noise"])
def test_a_damaged_chunk_is_named_and_never_zeros(tmp_path, damage):
    path, array = written(tmp_path)
    chunk = path / "0" / "c" / "0" / "0" / "0"
    raw = bytearray(chunk.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    chunk.write_bytes(
        {"flipped": bytes(raw), "cut": bytes(raw[:100]), "empty": b"", "noise": b"x" * 300}[damage]
    )
    refused(path, r"chunk \(0, 0, 0\) of the array 0 is damaged")
    lazy = io.open_volume(path)
    np.testing.assert_array_equal(
        lazy.read((slice(64, 65), slice(0, 20), slice(0, 20))), array[64:]
    )
    refused(path, "is damaged", lazy)


def test_a_store_that_goes_away_or_changes_is_an_error(tmp_path):
    path, array = written(tmp_path)
    lazy = io.open_volume(path, cache_bytes=0)
    os.utime(path / "0" / "zarr.json", ns=(1, 1))
    refused(path, "the image has changed", lazy)
    lazy = io.open_volume(path, cache_bytes=0)
    path.rename(tmp_path / "elsewhere")
    refused(path, r"cannot be read \(No such file", lazy)


def test_what_is_no_image_is_refused_by_name(tmp_path):
    zarr.create_array(tmp_path / "array.zarr", shape=(3, 3, 3), dtype="u1")
    refused(tmp_path / "array.zarr", "a Zarr array without the metadata of OME-Zarr")
    zarr.create_group(tmp_path / "plain.zarr")
    refused(tmp_path / "plain.zarr", "a Zarr group without the metadata of an OME-Zarr")
    for key, words in (
        ("plate", "plate of many"),
        ("well", "well of many"),
        ("labels", "label maps"),
    ):
        zarr.create_group(
            tmp_path / f"{key}.zarr", attributes={"ome": {"version": "0.5", key: ["one"]}}
        )
        refused(tmp_path / f"{key}.zarr", words)
    (tmp_path / "empty.zarr").mkdir()
    refused(tmp_path / "empty.zarr", "no Zarr")
    (tmp_path / "file.zarr").write_bytes(b"PK")
    refused(tmp_path / "file.zarr", "this is a file")
    refused(tmp_path / "none.zarr", "no such file")
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", "this is a folder, an image file expected")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["a.zarr", "plain"])
def test_a_plain_array_or_group_is_called_so_and_told_what_to_do(tmp_path, version, name):
    path = tmp_path / name
    zarr.create_array(path, shape=(3, 3, 3), dtype="u1", zarr_format=version)
    refused(
        path,
        "a Zarr array without the metadata of OME-Zarr given: nothing says how large a voxel is",
    )
    path = tmp_path / f"group{name}"
    zarr.create_group(path, zarr_format=version).create_array("raw", shape=(3, 3, 3), dtype="u1")
    refused(path, r"a Zarr group \(raw\) without the metadata of an OME-Zarr image given")
    make_store(
        path / "cells", [values("u1")], "zyx", [((1.0,) * 3,)], "0.5" if version == 3 else "0.4"
    )
    refused(path, "a Zarr group of the images cells given, one image expected")
    refused(path / "cells/0", "the array 0 of an OME-Zarr given, its image expected")


@pytest.mark.parametrize(
    "name", ["a.zarr.zip", "a.ome.zarr.zip", "a.zip", "a.ozx", "a.zarr", "scan"]
)
def test_a_zipped_zarr_is_told_to_be_unpacked(tmp_path, name):
    store = make_store(tmp_path / "store", [values("u1")], "zyx", [((1.0,) * 3,)], "0.5")
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        for file in sorted(store.rglob("*")):
            archive.write(file, file.relative_to(store))
    said = (
        "this is a file, the folder of an OME-Zarr"
        if name == "a.zarr"
        else "zip archives are not read"
    )
    with pytest.raises(InputError, match=said) as caught:
        io.open_volume(tmp_path / name)
    assert "unpack it" in caught.value.hint


def in_file(name: str, change):
    """A change of a file of metadata of a store."""

    def act(path: Path) -> None:
        said = json.loads((path / name).read_text())
        change(said)
        (path / name).write_text(json.dumps(said))

    return act


def image_of(said):
    return said["attributes"]["ome"]["multiscales"][0]


CLAIMS = {
    "shape": in_file("0/zarr.json", lambda said: said.update(shape=[10**9] * 3)),
    "axis": in_file("0/zarr.json", lambda said: said.update(shape=[10**18] * 3)),
    "chunk": in_file(
        "0/zarr.json",
        lambda said: said["chunk_grid"]["configuration"].update(chunk_shape=[10**9] * 3),
    ),
    "axes of the array": in_file("0/zarr.json", lambda said: said.update(shape=[1] * 10**5)),
    "codecs": in_file(
        "0/zarr.json",
        lambda said: said.update(codecs=said["codecs"] + [{"name": "crc32c"}] * 10**4),
    ),
    "levels": in_file(
        "zarr.json", lambda said: image_of(said).update(datasets=image_of(said)["datasets"] * 10**4)
    ),
    "axes": in_file(
        "zarr.json", lambda said: image_of(said).update(axes=image_of(said)["axes"] * 10**4)
    ),
    "images": in_file(
        "zarr.json",
        lambda said: said["attributes"]["ome"].update(multiscales=[image_of(said)] * 10**3),
    ),
    "labels": in_file(
        "zarr.json", lambda said: said["attributes"].update(ome={"labels": ["cells"] * 10**5})
    ),
    "depth": lambda path: (path / "zarr.json").write_text('{"attributes":' + '{"a":' * 10**5),
    "depth of the array": lambda path: (path / "0/zarr.json").write_text("[" * 10**5),
    "length": lambda path: os.truncate(path / "zarr.json", 1 << 40),
    "length of the array": lambda path: os.truncate(path / "0/zarr.json", 1 << 40),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_claims_are_checked_before_anything_is_made_of_them(tmp_path, claim):
    path, _ = written(tmp_path)
    io.read(path)
    CLAIMS[claim](path)
    began = time.thread_time()
    tracemalloc.start()
    try:
        refused(path, "expected|available|damaged|several|given")
        assert tracemalloc.get_traced_memory()[1] < 1 << 26
    finally:
        tracemalloc.stop()
    assert (
        time.thread_time() - began < 3.0
    )  # most take some ms; the limit is for machines that are busy


@pytest.mark.parametrize(
    ("width", "words"),
    [
        (
            200,
            r"chunk \(0, 0, 0\) of the array 0 is damaged \(its shard has \d+ bytes, its index alone 128000004",
        ),
        (
            10**9,
            "the index of a shard of the Zarr: 16000000000000000000000000004 bytes, at most 1073741824",
        ),
    ],
)
def test_a_shard_of_too_many_chunks_is_refused_before_its_index_is_read(tmp_path, width, words):
    path, array = written(tmp_path)
    sharding = {
        "chunk_shape": [1, 1, 1],
        "codecs": [{"name": "bytes"}],
        "index_location": "end",
        "index_codecs": [
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "crc32c"},
        ],
    }

    def change(said):
        said.update(codecs=[{"name": "sharding_indexed", "configuration": sharding}])
        said["chunk_grid"]["configuration"]["chunk_shape"] = [width] * 3

    in_file("0/zarr.json", change)(path)
    refused(path, words)


def changed(path: Path, change) -> None:
    said = json.loads((path / "zarr.json").read_text())
    change(said["attributes"]["ome"])
    (path / "zarr.json").write_text(json.dumps(said))


def first_scale(ome):
    return ome["multiscales"][0]["datasets"][0]["coordinateTransformations"][0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ome: ome.update(version="0.3"), r"OME-Zarr 0\.3 given, 0\.4 or 0\.5"),
        (lambda ome: ome["multiscales"].append(ome["multiscales"][0]), "2 images in one group"),
        (lambda ome: ome.update(multiscales=[]), "metadata are damaged"),
        (lambda ome: ome["multiscales"][0].update(datasets=[]), "0 levels"),
        (
            lambda ome: ome["multiscales"][0]["datasets"][0].update(path="../a"),
            "metadata are damaged",
        ),
        (
            lambda ome: ome["multiscales"][0]["datasets"][0].update(path="/a"),
            "metadata are damaged",
        ),
        (
            lambda ome: ome["multiscales"][0]["datasets"][0].update(path="9"),
            "array 9 is missing or damaged",
        ),
        (
            lambda ome: ome["multiscales"][0]["datasets"][0].update(coordinateTransformations=[]),
            "damaged",
        ),
        (lambda ome: ome["multiscales"][0]["axes"].pop(), "damaged"),
        (lambda ome: first_scale(ome).update(scale=[1, 1, 0]), "spacing"),
        (lambda ome: first_scale(ome).update(scale=[1, 1, 1e999]), "damaged"),
        (lambda ome: first_scale(ome).update(scale=[1, 1]), "damaged"),
    ],
)
def test_metadata_that_do_not_place_the_image_are_refused(tmp_path, change, words):
    path, _ = written(tmp_path)
    changed(path, change)
    refused(path, words)


def test_metadata_that_are_no_json_are_refused(tmp_path):
    path, _ = written(tmp_path)
    (path / "zarr.json").write_text("{")
    refused(path, "metadata of the Zarr are damaged")


@pytest.mark.parametrize(
    ("chunk", "words"),
    [
        ([4096, 4096, 4096], "a chunk of the Zarr: 68719476736 bytes, at most 1073741824"),
        ([0, 20, 20], "the array 0 is missing or damaged"),
        ([10**400, 1, 1], "the array 0 is missing or damaged"),
    ],
)
def test_chunks_that_cannot_be_held_are_refused(tmp_path, chunk, words):
    path, _ = written(tmp_path)
    said = json.loads((path / "0" / "zarr.json").read_text())
    said["chunk_grid"]["configuration"]["chunk_shape"] = chunk
    (path / "0" / "zarr.json").write_text(json.dumps(said))
    refused(path, words)


def test_an_image_larger_than_memory_is_refused_and_read_by_boxes(tmp_path):
    path = tmp_path / "a.ome.zarr"
    with io.LabelStore(path, Geometry((2000, 2000, 2000), (1.0, 1.0, 1.0)), np.uint8):
        pass
    with pytest.raises(InputError, match="2000 x 2000 x 2000 voxels needs about"):
        io.read(path, memory_bytes=1 << 30)
    lazy = io.open_volume(path)
    assert not lazy.read((slice(1999, 2000), slice(0, 65), slice(1, 2))).any()


def test_without_the_package_the_message_says_what_to_install(tmp_path):
    path, _ = written(tmp_path)
    code = (
        f"import sys; sys.modules['zarr'] = None\nfrom accelsurf import io\nio.read({str(path)!r})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[3]
    )
    assert "InputError: " in done.stderr and 'pip install "accelsurf[zarr]"' in done.stderr, (
        done.stderr
    )


@pytest.mark.parametrize("version", ["0.4", "0.5"])
@pytest.mark.parametrize("what", ["metadata", "level", "chunk"])
def test_links_out_of_a_store_are_not_followed(tmp_path, what, version):
    """A store comes from elsewhere: a link in it could show any file of the computer as an image."""
    array = np.arange(64, dtype=np.uint8).reshape(4, 4, 4)
    path = make_store(tmp_path / "a store é.zarr", [array], "zyx", [((1, 1, 1),)], version)
    mark = "zarr.json" if version == "0.5" else ".zattrs"
    chunk = path / ("0/c/1/0/0" if version == "0.5" else "0/1.0.0")
    target = {"metadata": path / mark, "level": path / "0", "chunk": chunk}[what]
    target.rename(tmp_path / "elsewhere")
    target.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="a link to a place outside of the store"):
        io.open_volume(path).read(whole_box(array.shape))
    with pytest.raises(InputError, match="a link to a place outside of the store"):
        io.read(path)
    # The store itself may be a link, and a link in it may lead to another place of it.
    (tmp_path / "elsewhere").rename(path / "within")
    target.unlink()
    target.symlink_to(path / "within")
    (tmp_path / "link.zarr").symlink_to(path)
    assert np.array_equal(
        io.open_volume(tmp_path / "link.zarr").read(whole_box(array.shape)), array
    )


def test_levels_of_other_axes_than_the_image_are_refused(tmp_path):
    arrays = [np.zeros((4, 4, 4), np.uint8), np.zeros((2, 2), np.uint8)]
    path = make_store(tmp_path / "a.zarr", arrays, "zyx", [((1, 1, 1),), ((2, 2, 2),)])
    refused(path, "level 1 of the OME-Zarr has 2 axes")
