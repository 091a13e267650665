"""TIFF stacks read a page at a time: the values of the whole stack, whatever the packing."""

import io as streams
import os

import numpy as np
import pytest
import tifffile
from PIL import Image

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.image.volume import Volume
from tests.io.test_lazy_volume import assert_same_boxes, values

OPTIONS = {
    "plain": {},
    "rows": {"rowsperstrip": 2},
    "deflate": {"compression": "zlib"},
    "predicted": {"compression": "zlib", "predictor": True, "rowsperstrip": 3},
    "bigtiff": {"bigtiff": True},
    "packed bigtiff": {"bigtiff": True, "compression": "zlib"},
    "big-endian": {"byteorder": ">"},
    "packed big-endian": {"byteorder": ">", "compression": "zlib"},
    "ImageJ": {
        "imagej": True,
        "resolution": (3.0, 4.0),
        "metadata": {"unit": "mm", "spacing": 2.5, "axes": "ZYX"},
    },
    "contiguous": {"contiguous": True},
}


@pytest.fixture(autouse=True)
def silence(capfd):
    yield
    assert capfd.readouterr() == ("", "")


@pytest.mark.sampled
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32", "uint32"])
@pytest.mark.parametrize("option", OPTIONS)
def test_boxes_are_those_of_the_whole_stack(tmp_path, dtype, option):
    if option == "ImageJ" and dtype not in ("uint8", "uint16", "float32"):
        dtype = "uint16"  # all that the program has
    if option == "predicted" and dtype == "float32":
        dtype = "int32"  # tifffile needs another package to predict floats
    array = np.abs(values("f4")).astype(dtype) * 3
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, array, photometric="minisblack", **OPTIONS[option])
    lazy = assert_same_boxes(path)
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array, strict=True)


@pytest.mark.sampled
@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "tiff_adobe_deflate", None])
@pytest.mark.parametrize("mode", ["L", "I;16", "1"])
def test_pages_packed_by_others(tmp_path, compression, mode):
    array = values("f4").astype(np.int64) % 251
    pages = [Image.fromarray(page.astype("u2" if mode == "I;16" else "u1")) for page in array]
    pages = [page.convert("1") for page in pages] if mode == "1" else pages
    path = tmp_path / "a.tif"
    pages[0].save(path, save_all=True, append_images=pages[1:], compression=compression)
    lazy = assert_same_boxes(path)
    assert len(np.unique(lazy.read(whole_box(lazy.shape)))) == (
        2 if mode == "1" else len(np.unique(array))
    )


def test_tiles_of_bytes(tmp_path):
    array = np.random.default_rng(2).integers(0, 255, (5, 40, 50)).astype(np.uint8)
    for compression in (None, "zlib"):
        tifffile.imwrite(
            tmp_path / "a.tif",
            array,
            tile=(16, 32),
            photometric="minisblack",
            compression=compression,
        )
        lazy = assert_same_boxes(tmp_path / "a.tif")
        np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array)


def test_pages_are_held_up_to_a_number_of_bytes(tmp_path):
    io.write(Volume.from_array(values("u1")), tmp_path / "a.tif")  # 63 bytes a page, deflated
    lazy = io.open_volume(tmp_path / "a.tif", cache_bytes=3 * 63)
    corner = (slice(0, 3), slice(0, 1), slice(0, 1))
    for _ in range(4):
        lazy.read(corner)
    assert lazy.bytes_read == 3 * 63
    lazy.read((slice(3, 5), slice(0, 1), slice(0, 1)))  # two that were used longest ago go
    lazy.read((slice(2, 3), slice(0, 1), slice(0, 1)))
    assert lazy.bytes_read == 5 * 63
    lazy.read((slice(0, 1), slice(0, 1), slice(0, 1)))
    assert lazy.bytes_read == 6 * 63


def test_a_rows_of_plain_pages_are_read_where_they_lie(tmp_path):
    tifffile.imwrite(
        tmp_path / "a.tif", np.zeros((4, 30, 9000), np.uint16), photometric="minisblack"
    )
    lazy = io.open_volume(tmp_path / "a.tif")
    lazy.read((slice(1, 3), slice(4, 10), slice(0, 100)))
    assert lazy.bytes_read == 2 * 6 * 100 * 2


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_thumbnails_are_no_slices(tmp_path, compression):
    """ITK returns uninitialized memory for such a stack, or never ends."""
    with tifffile.TiffWriter(tmp_path / "a.tif") as out:
        for page in values("u1"):
            out.write(page, photometric="minisblack", compression=compression)
            out.write(page[:2], photometric="minisblack", subfiletype=1)
    lazy = assert_same_boxes(tmp_path / "a.tif")
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), values("u1"))


def test_a_colour_stack_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((3, 8, 9, 3), np.uint8), photometric="rgb")
    with pytest.raises(InputError, match="colour") as caught:
        io.open_volume(tmp_path / "a.tif")
    assert "grey" in caught.value.hint


@pytest.mark.parametrize("compression", ["zlib", "lzw"])
def test_a_damaged_page_is_named_and_the_others_are_read(tmp_path, compression):
    array = np.random.default_rng(2).integers(0, 255, (5, 40, 50)).astype(np.uint8)
    stream = streams.BytesIO()
    pages = [Image.fromarray(page) for page in array]
    pages[0].save(
        stream,
        "TIFF",
        save_all=True,
        append_images=pages[1:],
        compression={"zlib": "tiff_adobe_deflate", "lzw": "tiff_lzw"}[compression],
    )
    raw = bytearray(stream.getvalue())
    with tifffile.TiffFile(streams.BytesIO(raw)) as found:
        at, length = found.pages[3].dataoffsets[0], found.pages[3].databytecounts[0]
    path = tmp_path / "a.tif"
    if compression == "zlib":
        raw[at + length // 2] ^= 0xFF
        path.write_bytes(raw)
        lazy = io.open_volume(path)
        np.testing.assert_array_equal(
            lazy.read((slice(0, 3), slice(0, 40), slice(0, 50))), array[:3]
        )
        with pytest.raises(InputError, match=r"a\.tif: page 4 is damaged"):
            lazy.read(whole_box(lazy.shape))
    path.write_bytes(raw[: at + length // 2])  # with directories beyond, or not
    with pytest.raises(InputError, match="cut short|the file has"):
        io.open_volume(path)


def test_a_file_that_goes_or_changes_is_an_error(tmp_path):
    path = tmp_path / "a.tif"
    io.write(Volume.from_array(values("u1")), path)
    lazy = io.open_volume(path, cache_bytes=0)
    os.utime(path, ns=(1, 1))
    with pytest.raises(InputError, match=r"a\.tif: the image has changed since"):
        lazy.read(whole_box(lazy.shape))
    path.unlink()
    with pytest.raises(InputError, match=r"cannot be read \(No such file"):
        lazy.read(whole_box(lazy.shape))
