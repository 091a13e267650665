"""Tags of a TIFF that are damaged: the voxels are the true ones, or the file is refused with one clear line."""

import itertools
import struct

import numpy as np
import pytest
import tifffile
from PIL import Image

from accelsurf import io
from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box

GREY = {"photometric": "minisblack"}
RNG = np.random.default_rng(0)
#: Smooth, so that differences are small, and large enough that offsets need more than 16 bits.
STACK = (np.cumsum(RNG.integers(0, 9, (3, 45, 70)), axis=2) + 280).astype(np.uint16)
FLOATS = (STACK / 7).astype(np.float32)
BYTES = (STACK % 251).astype(np.uint8)
WIDTH, HEIGHT, BITS, COMPRESSION, PREDICTOR, FORMAT, PLANAR, SUBFILE = (
    256,
    257,
    258,
    259,
    317,
    339,
    284,
    254,
)
STRIPS, STRIP_BYTES, ROWS, TILE_WIDTH, TILE_HEIGHT, TILES, TILE_BYTES = (
    273,
    279,
    278,
    322,
    323,
    324,
    325,
)
DECODING = (
    SUBFILE,
    WIDTH,
    HEIGHT,
    BITS,
    COMPRESSION,
    262,
    266,
    STRIPS,
    274,
    277,
    ROWS,
    STRIP_BYTES,
    PLANAR,
    PREDICTOR,
    TILE_WIDTH,
    TILE_HEIGHT,
    TILES,
    TILE_BYTES,
    338,
    FORMAT,
    530,
)
NUMBERS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 16, 17, 32, 34, 255, 256, 32773, 65535)


def by_pillow(array, packing, rows=0):
    def write(path):
        pages = [Image.fromarray(page) for page in array]
        tags = {ROWS: rows} if rows else {}
        pages[0].save(
            path, compression=packing, save_all=True, append_images=pages[1:], tiffinfo=tags
        )
        return array

    return write


def colours(path):
    pages = np.repeat(BYTES[..., None], 4, axis=-1)
    pages[..., 3] = 255
    tifffile.imwrite(
        path,
        pages,
        photometric="rgb",
        extrasamples=["unassalpha"],
        rowsperstrip=13,
        compression="zlib",
    )
    return BYTES


def of(array, **options):
    def write(path):
        tifffile.imwrite(path, array, **GREY, **options)
        return array

    return write


KINDS = {
    "plain": of(STACK),
    "plain in strips": of(STACK, rowsperstrip=11, metadata=None),
    "one page": of(BYTES[:1], rowsperstrip=12),
    "lzw": by_pillow(STACK, "tiff_lzw", 11),
    "lzw, one page": by_pillow(STACK[1:2], "tiff_lzw", 19),
    "deflate": of(STACK, compression="zlib", rowsperstrip=23),
    "differences": of(STACK, compression="zlib", predictor=2),
    "packbits": by_pillow(BYTES, "packbits"),
    "colours": colours,
    "black and white": by_pillow(STACK > 400, "tiff_lzw", 9),
    "tiles": of(BYTES, tile=(16, 32)),
    "packed tiles": of(STACK, tile=(16, 32), compression="zlib", predictor=2),
    "big-endian": of(STACK, byteorder=">", compression="zlib", predictor=2, rowsperstrip=20),
    "big-endian, plain": of(STACK, byteorder=">"),
    "BigTIFF": of(STACK, bigtiff=True, compression="zlib", rowsperstrip=20),
    "BigTIFF, plain": of(FLOATS, bigtiff=True),
    "lzma": of(STACK, compression="lzma", rowsperstrip=30),
}


def entries(content):
    """Byte of each entry of the tags that count, by page, and how numbers are written."""
    order = "<" if content[:2] == b"II" else ">"
    big = struct.unpack_from(order + "H", content, 2)[0] == 43
    word, counter, size, first = ("Q", "Q", 20, 8) if big else ("I", "H", 12, 4)
    at, pages = struct.unpack_from(order + word, content, first)[0], []
    while at:
        count = struct.unpack_from(order + counter, content, at)[0]
        begin = at + struct.calcsize(counter)
        places = range(begin, begin + size * count, size)
        pages.append(
            {struct.unpack_from(order + "H", content, place)[0]: place for place in places}
        )
        at = struct.unpack_from(order + word, content, begin + size * count)[0]
    return pages, order, word


def by_boxes(path):
    lazy = io.open_volume(path)
    return lazy.read(whole_box(lazy.shape))


def is_another_image(tag, value):
    """Whether a value makes a file that is right and stores other voxels: nobody can tell it from a damage."""
    return tag in (PREDICTOR, FORMAT) and value in (1, 2, 3)


def assert_true(found, true, what):
    found = getattr(found, "array", found)
    assert found.shape == true.shape, what
    assert np.array_equal(found > 0 if true.dtype == bool else found, true), what


def test_differences_of_the_bytes_of_floats_are_refused(tmp_path):
    """Technical note 3 of Adobe: its own number of the predictor."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, FLOATS, compression="zlib", extratags=[(65000, "H", 1, 3, False)], **GREY
    )
    path.write_bytes(
        path.read_bytes().replace(
            struct.pack("<HHI", 65000, 3, 1), struct.pack("<HHI", PREDICTOR, 3, 1)
        )
    )
    with pytest.raises(InputError, match="predictor number 3"):
        io.read(path)


@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_tags_give_the_true_voxels_or_are_refused(tmp_path, kind, every, capfd):
    """Every third value of each tag by default; which ones differs from tag to tag."""
    path = tmp_path / "a.tif"
    true = KINDS[kind](path)
    raw = path.read_bytes()
    pages, order, word = entries(raw)
    assert_true(io.read(path), true, kind)
    refused = 0
    for number, (page, tag) in enumerate(itertools.product({0, len(pages) - 1}, DECODING)):
        if (place := pages[page].get(tag)) is None:
            continue
        entry_type, count = struct.unpack_from(order + "H" + word, raw, place + 2)
        value_at = place + 4 + struct.calcsize(word)
        damages = [
            (place + 2, order + "H", new)
            for new in (0, 1, 2, 3, 4, 5, 7, 9, 11, 12, 13, 16, 18, 255)
        ]
        damages += [
            (place + 4, order + word, new)
            for new in (0, count - 1, count + 1, 2 * count, 10**6, 10**9)
        ]
        if count == 1 and tag not in (STRIPS, TILES):
            code = order + {1: "B", 3: "H", 4: "I", 16: "Q"}[entry_type]
            (now,) = struct.unpack_from(code, raw, value_at)
            values = {*NUMBERS, now - 2, now - 1, now + 1, now + 2, 2 * now, now // 2}
            damages += [
                (value_at, code, new) for new in sorted(values) if not is_another_image(tag, new)
            ]
        for at, code, new in damages[number % every :: every]:
            if (
                new < 0
                or struct.unpack_from(code, raw, at)[0] == new
                or new >= 1 << 8 * struct.calcsize(code)
            ):
                continue
            content = bytearray(raw)
            struct.pack_into(code, content, at, new)
            path.write_bytes(content)
            what = f"tag {tag} of page {page}: {new} at {at - place} of the entry"
            for read in (io.read, by_boxes):
                try:
                    found = read(path)
                except InputError as error:
                    assert error.hint and "\n" not in error.message, what
                    refused += 1
                else:
                    assert_true(found, true, what)
    assert refused > 100 / every
    assert capfd.readouterr() == ("", "")
