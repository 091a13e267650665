"""PNG and TIFF: written and read back, colour, sizes of pixels, and what is refused."""

import struct
import time
import zlib

import numpy as np
import pytest
import SimpleITK as sitk
import tifffile
from PIL import Image

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.channels import LUMINANCE
from accelsurf.io.formats import tiff_file
from accelsurf.io.writing import stored_grid
from accelsurf.settings.file_formats import IMAGE_FORMATS

SUFFIXES = (".png", ".tif", ".tiff")
GREY = {"photometric": "minisblack"}
RNG = np.random.default_rng(0)
SMALL = RNG.integers(0, 200, (6, 7)).astype(np.uint8)
LARGE = RNG.integers(0, 255, (60, 70)).astype(np.uint8)
STACK = RNG.integers(0, 4000, (3, 6, 7)).astype(np.uint16)


def refuse(path, words, **options):
    with pytest.raises(InputError, match=words) as caught:
        io.read(path, **options)
    assert (
        str(caught.value).startswith(f"{path}: ")
        and "\n" not in str(caught.value)
        and caught.value.hint
    )
    return caught.value


# ------------------------------------------------------------------------------------------------- round trip


@pytest.mark.sampled
@pytest.mark.parametrize("dtype", IMAGE_FORMATS["tif"].types)
@pytest.mark.parametrize("slices", [1, 3])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(tmp_path, suffix, slices, dtype):
    grid = Geometry((slices, 6, 7), (2.4, 0.81, 1 / 3))
    volume = Volume(RNG.integers(0, 100, grid.shape).astype(dtype), grid)
    path = tmp_path / f"a{suffix}"
    if suffix == ".png" and (slices > 1 or not dtype.startswith("uint") or dtype == "uint32"):
        with pytest.raises(UsageError, match=r"a \.png holds"):
            io.write(volume, path)
        assert not list(tmp_path.iterdir())
        return
    io.write(volume, path)
    back = io.read(path)
    assert back.array.dtype == dtype and back.source == path and back.metadata == {}
    np.testing.assert_array_equal(back.array, volume.array)
    assert back.geometry.matches(stored_grid(grid, suffix), 1e-6)
    io.write(back, tmp_path / f"b{suffix}")
    assert io.read(tmp_path / f"b{suffix}").geometry.spacing == back.geometry.spacing


@pytest.mark.sampled
@pytest.mark.parametrize("spacing", [1e-5, 2e-4, 6.5e-4, 0.0254, 0.1, 2 / 7, 1.0, 25.4, 3000.0])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sizes_of_pixels_are_kept(tmp_path, suffix, spacing):
    io.write(Volume.from_array(SMALL, spacing), tmp_path / f"a{suffix}")
    assert io.read(tmp_path / f"a{suffix}").geometry.spacing[1:] == pytest.approx(
        (spacing, spacing), rel=1e-6
    )


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_others_read_the_same_from_our_files(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    io.write(Volume.from_array(LARGE, (0.5, 0.25)), path)
    image = sitk.ReadImage(str(path))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), LARGE)
    assert image.GetSpacing() == pytest.approx((0.25, 0.5))
    with Image.open(path) as opened:
        np.testing.assert_array_equal(np.asarray(opened), LARGE)


def test_others_read_our_stacks(tmp_path):
    io.write(Volume.from_array(STACK, (2.5, 0.5, 0.25)), tmp_path / "a.tif")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        np.testing.assert_array_equal(file.asarray(), STACK)
        assert (
            file.is_imagej
            and file.imagej_metadata["spacing"] == 0.25
            and file.imagej_metadata["unit"] == "cm"
        )


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    def written():
        io.write(Volume.from_array(LARGE), tmp_path / "a.png")
        io.write(Volume.from_array(STACK), tmp_path / "a.tif")
        return [file.read_bytes() for file in sorted(tmp_path.iterdir())]

    first = written()
    time.sleep(1.1)
    assert written() == first and len(first) == 2 and len(first[0]) < 1.1 * LARGE.size


def test_booleans_become_bytes_and_doubles_are_refused(tmp_path):
    io.write(Volume.from_array(SMALL > 50), tmp_path / "a.tif")
    assert io.read(tmp_path / "a.tif").array.dtype == np.uint8
    with pytest.raises(UsageError, match=r"float64 given, a \.tif holds .*float32"):
        io.write(Volume.from_array(SMALL.astype(float)), tmp_path / "b.tif")


def test_a_tiff_beyond_4_gib_is_refused(monkeypatch):
    monkeypatch.setattr(tiff_file, "MAX_FILE_BYTES", 200)
    with pytest.raises(UsageError, match="4 GiB"):
        tiff_file.tiff_bytes(SMALL[None], (1.0, 1.0, 1.0))


# ----------------------------------------------------------------------------------------------------- labels


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_labels_of_one_object_are_black_and_white(tmp_path, suffix):
    io.write_labels(Volume.from_array(SMALL > 50), tmp_path / f"a{suffix}")
    labels = io.read_labels(tmp_path / f"a{suffix}").array
    np.testing.assert_array_equal(labels[0], np.where(SMALL > 50, 255, 0))
    io.write_labels(Volume.from_array(SMALL % 3), tmp_path / f"b{suffix}")
    np.testing.assert_array_equal(io.read_labels(tmp_path / f"b{suffix}").array[0], SMALL % 3)


# ----------------------------------------------------------------------------------- what other programs write


@pytest.mark.sampled
@pytest.mark.parametrize("mode", ["1", "L", "I;16", "P", "RGB", "RGBA"])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_grey_is_grey_however_it_was_saved(tmp_path, suffix, mode):
    values = np.where(SMALL > 50, 255, 0).astype(np.uint8) if mode == "1" else SMALL
    path = tmp_path / f"a{suffix}"
    image = (
        Image.fromarray(values.astype(np.uint16))
        if mode == "I;16"
        else Image.fromarray(values).convert(mode)
    )
    image.save(path, dpi=(72, 72))
    if (mode, suffix) == ("P", ".tif"):
        refuse(path, "colours from a palette")
        return
    volume = io.read(path)
    np.testing.assert_array_equal(volume.array[0], values)
    assert volume.metadata == {} and volume.array.dtype.kind == "u"
    assert volume.geometry.spacing == (1.0, 1.0, 1.0)  # dots per inch are not the object's


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("scale", [1, 256])
def test_colour_becomes_its_luminance_and_says_so(tmp_path, name, scale):
    colours = (
        np.stack([SMALL, SMALL[::-1], SMALL[:, ::-1]], axis=-1).astype("u2" if scale > 1 else "u1")
        * scale
    )
    sitk.WriteImage(sitk.GetImageFromArray(colours, isVector=True), str(tmp_path / name))
    if name == "a.png" and scale > 1:
        refuse(tmp_path / name, "a colour PNG of 16 bits given")
        return
    volume = io.read(tmp_path / name)
    assert volume.array.dtype == np.float32
    np.testing.assert_allclose(volume.array[0], colours @ LUMINANCE, rtol=1e-6)
    assert "luminance" in volume.metadata[io.WARNING_KEY]


def test_transparency_is_ignored_and_said(tmp_path):
    opacity = np.full_like(SMALL, 255)
    opacity[2:4] = 7
    Image.fromarray(np.stack([SMALL, SMALL, SMALL, opacity], axis=-1)).save(tmp_path / "a.png")
    volume = io.read(tmp_path / "a.png")
    np.testing.assert_array_equal(volume.array[0], SMALL)
    assert volume.metadata[io.WARNING_KEY] == "the image is transparent in places, which is ignored"


@pytest.mark.parametrize(
    "packing", [None, "tiff_lzw", "packbits", "tiff_deflate", "tiff_adobe_deflate"]
)
def test_compressed_tiffs(tmp_path, packing):
    Image.fromarray(LARGE).save(tmp_path / "a.tif", compression=packing)
    np.testing.assert_array_equal(io.read(tmp_path / "a.tif").array[0], LARGE)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"bigtiff": True},
        {"byteorder": ">"},
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"rowsperstrip": 2},
    ],
)
def test_stacks(tmp_path, options):
    tifffile.imwrite(tmp_path / "a.tif", STACK, **GREY, **options)
    volume = io.read(tmp_path / "a.tif")
    np.testing.assert_array_equal(volume.array, STACK)
    assert volume.array.dtype == np.uint16


def test_a_stack_in_colour(tmp_path):
    tifffile.imwrite(
        tmp_path / "a.tif", np.stack([STACK, STACK, 2 * STACK], axis=-1), photometric="rgb"
    )
    volume = io.read(tmp_path / "a.tif")
    np.testing.assert_allclose(volume.array, STACK * (1 + LUMINANCE[2]), rtol=1e-6)


def test_tiles_of_bytes(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", LARGE, tile=(16, 32), **GREY)
    np.testing.assert_array_equal(io.read(tmp_path / "a.tif").array[0], LARGE)
    pages = np.stack([LARGE, LARGE[::-1], LARGE[:, ::-1]])
    tifffile.imwrite(tmp_path / "b.tif", pages, tile=(16, 32), **GREY)
    np.testing.assert_array_equal(io.read(tmp_path / "b.tif").array, pages)


def test_a_stack_of_masks_of_one_bit(tmp_path):
    masks = [LARGE > 100, LARGE > 200]
    first, second = (Image.fromarray(mask) for mask in masks)
    first.save(tmp_path / "a.tif", save_all=True, append_images=[second])
    np.testing.assert_array_equal(io.read_labels(tmp_path / "a.tif").array > 0, masks)


def test_thumbnails_are_not_slices(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        writer.write(LARGE, **GREY)
        writer.write(SMALL, subfiletype=1, **GREY)
    np.testing.assert_array_equal(io.read(tmp_path / "a.tif").array[0], LARGE)


@pytest.mark.parametrize(
    ("options", "spacing"),
    [
        ({"resolution": (4, 2), "resolutionunit": "CENTIMETER"}, (1.0, 5.0, 2.5)),
        ({"resolution": (300, 300), "resolutionunit": "INCH"}, (1.0, 1.0, 1.0)),
        ({"resolution": (4, 2), "resolutionunit": "NONE"}, (1.0, 1.0, 1.0)),
        *(
            (
                {
                    "imagej": True,
                    "resolution": (4, 2),
                    "metadata": {"axes": "ZYX", "unit": unit, "spacing": 3},
                },
                spacing,
            )
            for unit, spacing in [
                ("um", (3e-3, 5e-4, 2.5e-4)),
                ("\\u00B5m", (3e-3, 5e-4, 2.5e-4)),
                ("micron", (3e-3, 5e-4, 2.5e-4)),
                ("mm", (3.0, 0.5, 0.25)),
                ("pixel", (1.0, 1.0, 1.0)),
            ]
        ),
        (
            {
                "ome": True,
                "metadata": {
                    "axes": "ZYX",
                    "PhysicalSizeX": 0.1,
                    "PhysicalSizeY": 0.2,
                    "PhysicalSizeZ": 1,
                },
            },
            (1e-3, 2e-4, 1e-4),
        ),
        ({"ome": True, "metadata": {"axes": "ZYX"}}, (1.0, 1.0, 1.0)),
    ],
)
def test_sizes_of_pixels_as_other_programs_give_them(tmp_path, options, spacing):
    tifffile.imwrite(tmp_path / "a.tif", STACK, **({} if "imagej" in options else GREY), **options)
    assert io.read(tmp_path / "a.tif").geometry.spacing == pytest.approx(spacing)


# -------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("values", "options", "words"),
    [
        (SMALL.astype("c8"), GREY, "64-bit complex values"),
        (SMALL, {"photometric": "miniswhite"}, "grow towards black"),
        (LARGE, {"tile": (8192, 16), **GREY}, "tiles of 16 x 8192"),
        (
            STACK.astype("u1"),
            {"photometric": "rgb", "planarconfig": "separate"},
            "one after the other",
        ),
        (SMALL, {"extratags": [(274, "H", 1, 3, True)], **GREY}, "orientation"),
        (
            np.stack([STACK] * 2, 1),
            {"imagej": True, "metadata": {"axes": "ZCYX"}},
            "2 channels given, one expected",
        ),
        (
            np.stack([STACK] * 2),
            {"imagej": True, "metadata": {"axes": "TZYX"}},
            "2 time points given",
        ),
        (STACK, {"ome": True, "metadata": {"axes": "CYX"}, **GREY}, "3 channels given"),
        (
            SMALL,
            {"description": "ImageJ=1.5\nimages=9\n", "metadata": None, **GREY},
            "announces .* bytes of voxels",
        ),
    ],
)
def test_tiffs_that_would_be_read_wrongly_are_refused(tmp_path, values, options, words):
    tifffile.imwrite(tmp_path / "a.tif", values, **options)
    refuse(tmp_path / "a.tif", words)


@pytest.mark.parametrize(
    ("name", "mode", "words"),
    [
        ("a.png", "LA", "transparency"),
        ("a.tif", "LA", "2 channels"),
        ("a.tif", "CMYK", "4 channels of colour kind 5"),
    ],
)
def test_other_colours_are_refused(tmp_path, name, mode, words):
    Image.fromarray(SMALL).convert("RGBA" if mode == "LA" else "RGB").convert(mode).save(
        tmp_path / name
    )
    refuse(tmp_path / name, words)


def test_pages_that_differ_are_refused(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        writer.write(LARGE, **GREY)
        writer.write(SMALL, **GREY)
    refuse(tmp_path / "a.tif", "page 2 of the TIFF differs")


def test_pages_in_a_circle_are_refused(tmp_path):
    io.write(Volume.from_array(STACK), tmp_path / "a.tif")
    raw = bytearray((tmp_path / "a.tif").read_bytes())
    first = struct.unpack_from("<I", raw, 4)[0]
    count = struct.unpack_from("<H", raw, first)[0]
    struct.pack_into("<I", raw, first + 2 + count * 12, first)
    (tmp_path / "a.tif").write_bytes(raw)
    refuse(tmp_path / "a.tif", "circle")


def test_a_picture_larger_than_memory_is_refused_with_the_estimate(tmp_path):
    io.write(Volume.from_array(STACK), tmp_path / "a.tif")
    needed = STACK.size * (2 + 12)
    io.read(tmp_path / "a.tif", memory_bytes=needed)
    refuse(tmp_path / "a.tif", r"7 x 6 x 3 voxels needs about 0\.00 GiB", memory_bytes=needed - 1)
    Image.fromarray(np.stack([SMALL] * 3, axis=-1)).save(tmp_path / "a.png")
    needed = SMALL.size * (3 + 12)
    io.read(tmp_path / "a.png", memory_bytes=needed)
    refuse(tmp_path / "a.png", "7 x 6 x 1 voxels", memory_bytes=needed - 1)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_huge_claim_is_refused_before_anything_is_read(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    io.write(Volume.from_array(SMALL), path)
    raw = bytearray(path.read_bytes())
    if suffix == ".png":
        struct.pack_into(">II", raw, 16, 10**6, 10**6)
        struct.pack_into(">I", raw, 29, zlib.crc32(raw[12:29]))
    else:
        first = struct.unpack_from("<I", raw, 4)[0]
        for entry in (0, 1, 8):  # width, length, rows of a strip
            struct.pack_into("<I", raw, first + 2 + 12 * entry + 8, 10**6)
    path.write_bytes(raw)
    words = r"1000000 x 1000000 x 1 voxels needs about 12107\.19 GiB|voxels: 1000000000000 bytes"
    refuse(path, words)


def png_of(rows, height, width):
    """A grey PNG, packed here, that may hold fewer rows than it announces."""
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in parts
    )


def test_parts_of_a_png_beside_its_pixels_change_no_value(tmp_path, capfd):
    """ITK divides values by what the number of significant bits leaves over, and prints about wrong profiles."""
    io.write(Volume(SMALL[None], Geometry((1, *SMALL.shape), (1.0, 0.25, 0.5))), tmp_path / "a.png")
    plain = (tmp_path / "a.png").read_bytes()
    at = plain.index(b"IDAT") - 4
    for name, body in (
        (b"sBIT", b"\x05"),
        (b"iCCP", b"a\0\0abc"),
        (b"gAMA", bytes(4)),
        (b"PLTE", b"abc"),
    ):
        part = (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )
        (tmp_path / "b.png").write_bytes(plain[:at] + part + plain[at:])
        found = io.read(tmp_path / "b.png")
        np.testing.assert_array_equal(found.array[0], SMALL)
        assert found.geometry.spacing == (1.0, 0.25, 0.5)
    part = struct.pack(">I", 2) + b"tRNS" + b"\0\5" + struct.pack(">I", zlib.crc32(b"tRNS\0\5"))
    (tmp_path / "b.png").write_bytes(plain[:at] + part + plain[at:])
    refuse(tmp_path / "b.png", "transparency")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "scale", [b"\x010\x001", b"\x01-1\x001", b"\x01a\x00b", b"\x01nan\x001", b"\x011", b""]
)
def test_a_scale_of_a_png_that_is_none_is_one_mm(tmp_path, scale):
    io.write(Volume.from_array(SMALL), tmp_path / "a.png")
    plain = (tmp_path / "a.png").read_bytes()
    begin, end = plain.index(b"sCAL") - 4, plain.index(b"IDAT") - 4
    part = (
        struct.pack(">I", len(scale))
        + b"sCAL"
        + scale
        + struct.pack(">I", zlib.crc32(b"sCAL" + scale))
    )
    (tmp_path / "a.png").write_bytes(plain[:begin] + part + plain[end:])
    assert io.read(tmp_path / "a.png").geometry.spacing == (1.0, 1.0, 1.0)


def test_a_png_with_missing_rows_is_refused(tmp_path):
    """Its checksums are right, and Pillow reads the missing rows as zeros."""
    rows = np.concatenate([np.zeros((6, 1), np.uint8), SMALL], axis=1).tobytes()
    (tmp_path / "a.png").write_bytes(png_of(rows, 6, 7))
    np.testing.assert_array_equal(io.read(tmp_path / "a.png").array[0], SMALL)
    (tmp_path / "b.png").write_bytes(png_of(rows[: 8 * 4], 6, 7))
    with Image.open(tmp_path / "b.png") as opened:
        assert not np.asarray(opened)[4:].any()
    refuse(tmp_path / "b.png", "announces 48 bytes of rows, 32 are there")


def test_a_stack_with_missing_pages_is_refused(tmp_path):
    """tifffile reads the pages before."""
    tifffile.imwrite(tmp_path / "a.tif", STACK, compression="zlib", metadata=None, **GREY)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        last = file.pages[2].offset
    (tmp_path / "b.tif").write_bytes((tmp_path / "a.tif").read_bytes()[: last + 1])
    refuse(tmp_path / "b.tif", "header is cut short or damaged")


def samples(folder):
    """A file of every build: name -> bytes."""
    io.write(Volume.from_array(LARGE), folder / "ours.png")
    io.write(Volume.from_array(STACK), folder / "ours.tif")
    Image.fromarray(LARGE).save(folder / "lzw.tif", compression="tiff_lzw")
    Image.fromarray(LARGE).save(folder / "packbits.tif", compression="packbits")
    Image.fromarray(np.stack([LARGE] * 3, axis=-1)).save(folder / "colour.png")
    tifffile.imwrite(folder / "plain.tif", STACK, **GREY)
    tifffile.imwrite(folder / "big.tif", STACK, bigtiff=True, **GREY)
    tifffile.imwrite(folder / "tiled.tif", LARGE, tile=(16, 16), **GREY)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_every_truncation_is_one_clear_error(tmp_path):
    rng = np.random.default_rng(1)
    for name, raw in samples(tmp_path).items():
        path = tmp_path / f"cut-{name}"
        last = len(raw) - 17  # up to 16 bytes at the end are padding, which nothing needs
        for keep in {*range(1, 60, 3), *rng.integers(1, last, 40).tolist(), last}:
            path.write_bytes(raw[:keep])
            refuse(path, "header|ends? before|cut short|damaged|not a PNG|not a TIFF|holds no page")


def test_damage_is_refused_or_read_but_never_anything_else(tmp_path, capfd):
    rng = np.random.default_rng(2)
    refused = 0
    for name, raw in samples(tmp_path).items():
        path = tmp_path / f"bad-{name}"
        for _ in range(100):
            damaged = bytearray(raw)
            for place in rng.integers(0, min(len(raw), 300), 3):
                damaged[place] = rng.integers(0, 256)
            path.write_bytes(damaged)
            try:
                io.read(path, memory_bytes=10**8)
            except InputError as error:
                refused += 1
                assert str(error).startswith(f"{path}: ") and error.hint
    assert capfd.readouterr() == ("", "")
    assert refused > 400
