"""Folders and patterns of slices, arrays of numpy: order, gaps, spacing, and files that are hostile."""

import os
import shutil
import struct

import numpy as np
import pytest
import tifffile
from PIL import Image

from accelsurf import cli, io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import channels
from accelsurf.settings.reading import ReadOptions
from tests.io.test_lazy_volume import assert_same_boxes, values

SPACING = ReadOptions(spacing=(0.1, 0.2, 0.5))
GREY = {"photometric": "minisblack"}


def folder_of(tmp_path, names, array=None, suffix=".tif"):
    """A folder with a slice under each name."""
    folder = tmp_path / "slices"
    folder.mkdir()
    for name, page in zip(names, values("u1") if array is None else array, strict=True):
        if suffix == ".tif":
            tifffile.imwrite(folder / f"{name}.tif", page, **GREY)
        else:
            Image.fromarray(page).save(folder / f"{name}.png")
    return folder


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_slices_are_in_the_order_of_their_numbers(tmp_path, suffix):
    names = ["a1", "a2", "a3", "a10", "a11"]
    folder = folder_of(tmp_path, names, suffix=suffix)
    (folder / "notes.txt").write_text("none of them")
    for path in (folder, folder / f"*{suffix}", folder / "a*"):
        volume = io.read(path, options=SPACING)
        np.testing.assert_array_equal(volume.array, values("u1"), strict=True)
        assert volume.geometry.spacing == (0.5, 0.2, 0.1)
        assert (
            "gaps at 4;" in volume.metadata[io.WARNING_KEY]
            and "1 mm" not in volume.metadata[io.WARNING_KEY]
        )
    one = io.read(folder / "a1?.*", options=SPACING)
    np.testing.assert_array_equal(one.array, values("u1")[3:])
    assert channels.count_values(folder) == values("u1").size
    if suffix == ".tif":
        lazy = io.open_volume(folder, spacing=(0.1, 0.2, 0.5))
        np.testing.assert_array_equal(
            lazy.read((slice(1, 5), slice(2, 6), slice(0, 3))), values("u1")[1:5, 2:6, :3]
        )
        assert_same_boxes(folder)


def test_a_size_that_is_not_said_is_said(tmp_path):
    folder = folder_of(tmp_path, ["1", "2", "3", "4", "5"])
    volume = io.read(folder)
    assert (
        volume.geometry.spacing == (1.0, 1.0, 1.0)
        and "1 x 1 x 1 mm are taken" in volume.metadata[io.WARNING_KEY]
    )
    for name in os.listdir(folder):
        page = tifffile.imread(folder / name)
        tifffile.imwrite(
            folder / name,
            page,
            imagej=True,
            resolution=(4, 2),
            metadata={"unit": "um", "spacing": 2.0},
        )
    volume = io.read(folder)
    assert (
        volume.geometry.spacing == pytest.approx((2e-3, 0.5e-3, 0.25e-3))
        and io.WARNING_KEY not in volume.metadata
    )


def test_slices_that_do_not_fit_together_are_refused(tmp_path):
    folder = folder_of(tmp_path, "12345")
    tifffile.imwrite(folder / "6.tif", np.zeros((8, 9), np.uint8), **GREY)
    with pytest.raises(InputError, match="6.tif has 9 x 8 x 1 pixels, the first slice 9 x 7 x 1"):
        io.read(folder)
    tifffile.imwrite(folder / "6.tif", np.zeros((7, 9), np.uint16), **GREY)
    for read in (io.read, io.open_volume):
        with pytest.raises(InputError, match="type"):
            read(folder)
    tifffile.imwrite(folder / "6.tif", np.zeros((2, 7, 9), np.uint8), **GREY)
    with pytest.raises(InputError, match="9 x 7 x 2"):
        io.read(folder)
    (folder / "6.tif").write_bytes((folder / "5.tif").read_bytes()[:-20])
    with pytest.raises(InputError, match=r"6\.tif: "):
        io.read(folder)
    shutil.copy(folder / "5.tif", folder / "6.png")
    with pytest.raises(InputError, match="TIFF and PNG"):
        io.read(folder)
    (folder / "7.jpg").write_bytes(b"x")
    with pytest.raises(InputError, match="JPEG"):
        io.read(folder)
    with pytest.raises(InputError, match="no TIFF or PNG fits"):
        io.read(folder / "none*")
    with pytest.raises(UsageError, match="time-index: 1 was given"):
        io.read(folder / "?.tif", options=ReadOptions(time_index=1))


def test_a_folder_and_a_pattern_are_segmented_and_named_after_the_folder(tmp_path):
    z, y, x = np.indices((16, 16, 16)) - 7.5
    ball = (100 * (z**2 + y**2 + x**2 < 25)).astype(np.uint8)
    folder = folder_of(tmp_path, [f"s{n}" for n in range(16)], ball)
    options = [
        "--spacing",
        "0.5um",
        "--start",
        "ball:8,8,8,3vox",
        "--max-steps",
        "3",
        "--quiet",
        "--threads",
        "1",
    ]
    for source in (folder, folder / "s*.tif"):
        out = tmp_path / source.name.replace("*", "_")
        assert (
            cli.execute(["segment", str(source), "-o", str(out), "--format", "nii.gz", *options])
            == 0
        )
        labels = io.read(out / "slices_seg.nii.gz")
        assert labels.array.shape == ball.shape and labels.geometry.spacing == pytest.approx(
            (0.5e-3,) * 3
        )


# ------------------------------------------------------------------------------------------------------------- arrays


@pytest.mark.parametrize("dtype", ["bool", "u1", ">u2", "<i4", "f4", ">f8", "f2"])
def test_an_array_is_read_as_it_is(tmp_path, dtype):
    array = np.abs(values("f4")).astype("u1").astype(dtype)
    np.save(tmp_path / "a.npy", array)
    lazy = assert_same_boxes(tmp_path / "a.npy")
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array)
    np.save(tmp_path / "f.npy", np.asfortranarray(array))
    for name in ("a.npy", "f.npy"):
        volume = io.read(tmp_path / name, options=SPACING)
        np.testing.assert_array_equal(volume.array, array)
        assert volume.geometry.spacing == (0.5, 0.2, 0.1) and volume.metadata == {}
    assert "1 mm is taken" in io.read(tmp_path / "a.npy").metadata[io.WARNING_KEY]


def test_labels_are_written_as_an_array(tmp_path):
    labels = Volume(
        (values("u1") % 3).astype(np.uint8), Geometry((5, 7, 9), (2.0, 1.0, 1.0), (5.0, 6.0, 7.0))
    )
    io.write_labels(labels, tmp_path / "a.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), labels.array, strict=True)


def npy(shape="(4, 5)", descr="'<i2'", more="", body=40):
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}{more}}}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(body)


HOSTILE = {
    "code": (npy("__import__('os').system('true')"), "or damaged"),
    "objects": (npy(descr="'|O'"), "object given"),
    "fields": (npy(descr="[('a', '<i2')]"), "of type .* given"),
    "huge": (npy("(1000000, 1000000)"), "announces 20000000000.. bytes"),
    "overflow": (npy(f"({2**47}, {2**47}, {2**47})"), "an axis of the array"),
    "negative": (npy("(-4, 5)"), "of shape"),
    "of one axis": (npy("(20,)"), "of shape"),
    "empty": (npy("(0, 5)"), "of shape"),
    "cut": (npy(body=39), "announces"),
    "more keys": (npy(more=", 'x': 1"), "damaged"),
    "deep": (npy("(" * 9000), "damaged"),
    "text": (b"PK not", "not a NumPy array"),
    "complex": (npy(descr="'<c8'"), "complex64 given"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_arrays_are_refused(tmp_path, name):
    content, words = HOSTILE[name]
    (tmp_path / "a.npy").write_bytes(content)
    for read in (io.read, channels.count_values):
        with pytest.raises(InputError, match=words) as caught:
            read(tmp_path / "a.npy")
        assert caught.value.hint


def test_an_archive_is_told_to_be_unpacked(tmp_path):
    np.savez(tmp_path / "a.npz", image=values("u1"))
    with pytest.raises(InputError, match="zip archives are not read") as caught:
        io.read(tmp_path / "a.npz")
    assert "unpack it" in caught.value.hint


def test_an_array_of_four_axes_is_a_sequence(tmp_path):
    frames = np.arange(3 * 2 * 4 * 5, dtype=np.int16).reshape(3, 2, 4, 5)
    np.save(tmp_path / "moving.npy", frames)
    sequence = io.read_sequence(tmp_path / "moving.npy", frame_time=0.5)
    assert sequence.times == (0.0, 0.5, 1.0) and sequence.geometry.shape == (2, 4, 5)
    for number in (2, 0, 1):
        np.testing.assert_array_equal(sequence.frame(number).array, frames[number])
    with pytest.raises(InputError, match="a sequence of 3 time points"):
        io.read(tmp_path / "moving.npy")
    one = io.read(tmp_path / "moving.npy", options=ReadOptions(time_index=2))
    np.testing.assert_array_equal(one.array, frames[2])
    box = (slice(1, 2), slice(0, 3), slice(2, 5))
    lazily = io.open_volume(tmp_path / "moving.npy", time_index=1)
    np.testing.assert_array_equal(lazily.voxels.read(box), frames[1][box])
    np.save(tmp_path / "fortran.npy", np.asfortranarray(frames))
    with pytest.raises(InputError, match="expected"):
        io.read_sequence(tmp_path / "fortran.npy")
