"""How large a voxel of a TIFF is, as ImageJ, Micro-Manager and Bio-Formats write it: as they mean it, or said."""

import itertools

import numpy as np
import pytest
import tifffile

from accelsurf import io
from accelsurf.errors import InputError

SHAPE = (3, 4, 5)
MICRO = (
    "um",
    "micron",
    "microns",
    "Micron",
    "micrometer",
    b"\xb5m",
    "\u00b5m",
    "\u03bcm",
    "\\u00B5m",
    "\\u03bcm",
)
UNITS = {
    **dict.fromkeys(MICRO, 1e-3),
    **dict.fromkeys(("nm", "nanometer"), 1e-6),
    **dict.fromkeys(("mm", "MM"), 1.0),
    **dict.fromkeys(("cm", "centimeter"), 10.0),
    **dict.fromkeys(("inch", "in"), 25.4),
    "m": 1e3,
    "\u00c5": 1e-7,
}
UNKNOWN = ("pixel", "pixels", "", " ", "frame", "mic", "Mm")


def imagej(path, lines, resolution=(2.0, 4.0), resolution_unit="NONE"):
    """A stack with lines of ImageJ, in which a text may be bytes."""
    pieces = ["ImageJ=1.53q", f"images={SHAPE[0]}", f"slices={SHAPE[0]}"]
    text = (
        b"\n".join(line if isinstance(line, bytes) else line.encode() for line in [*pieces, *lines])
        + b"\n"
    )
    tifffile.imwrite(
        path,
        np.zeros(SHAPE, np.uint8),
        description=text,
        metadata=None,
        photometric="minisblack",
        resolution=resolution,
        resolutionunit=resolution_unit,
    )
    return io.read(path)


def line(key, value):
    return key.encode() + b"=" + (value if isinstance(value, bytes) else value.encode())


@pytest.mark.sampled
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("resolution_unit", ["NONE", "INCH"])
def test_each_spelling_of_a_unit_counts_and_a_sign_does_not(tmp_path, unit, resolution_unit):
    for text, depth in (
        ("1.5", 1.5),
        ("-1.5", 1.5),
        ("1,5", 1.5),
        ("-0,25", 0.25),
        ("3", 3.0),
        (" 1.5e0 ", 1.5),
    ):
        found = imagej(
            tmp_path / "a.tif",
            [line("unit", unit), line("spacing", text)],
            resolution_unit=resolution_unit,
        )
        expected = np.array([depth, 0.25, 0.5]) * UNITS[unit]
        np.testing.assert_allclose(found.geometry.spacing, expected, rtol=1e-6)
        assert io.WARNING_KEY not in found.metadata


def test_each_axis_has_its_own_unit(tmp_path):
    for x, y, z in itertools.product(
        ("nm", "micron", "mm"), ("", "nm", b"\xb5m"), ("", "mm", "inch")
    ):
        lines = [line("unit", x), line("spacing", "-2,5")]
        lines += [line(key, unit) for key, unit in (("yunit", y), ("zunit", z)) if unit]
        spacing = imagej(tmp_path / "a.tif", lines).geometry.spacing
        expected = (2.5 * UNITS[z or x], 0.25 * UNITS[y or x], 0.5 * UNITS[x])
        np.testing.assert_allclose(spacing, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        (key, unit)
        for key in ("unit", "yunit", "zunit")
        for unit in UNKNOWN
        if key == "unit" or unit.strip()
    ],
)
def test_what_is_no_unit_is_said_with_what_to_do(tmp_path, key, unit):
    said = {"unit": "um", "spacing": "1.5", key: unit}
    found = imagej(tmp_path / "a.tif", [line(*pair) for pair in said.items()])
    note = found.metadata[io.WARNING_KEY]
    assert "1 mm is taken; give --spacing" in note and (not unit.strip() or f"{key}={unit}" in note)
    assert found.geometry.spacing == (
        pytest.approx((1.0, 0.25e-3, 0.5e-3)) if key == "zunit" else (1.0, 1.0, 1.0)
    )


@pytest.mark.parametrize("text", ["0", "0.0", "-0", "nan", "inf", "-inf", "1e-400", None])
def test_a_distance_that_is_none_is_said(tmp_path, text):
    lines = [line("unit", "micron"), *([] if text is None else [line("spacing", text)])]
    found = imagej(tmp_path / "a.tif", lines)
    note = found.metadata[io.WARNING_KEY]
    assert (
        note.startswith("the TIFF does not say how far apart its slices are")
        and "give --spacing" in note
    )
    assert found.geometry.spacing == pytest.approx((1.0, 0.25e-3, 0.5e-3))


@pytest.mark.sampled
@pytest.mark.parametrize("text", ["1.5.5", "1,500.0", "1,5,0", "one", "", "0x10"])
@pytest.mark.parametrize("key", ["spacing", "finterval"])
def test_what_is_no_number_is_refused_by_name(tmp_path, text, key):
    with pytest.raises(InputError, match=f"{key} = .*a number expected") as caught:
        imagej(tmp_path / "a.tif", [line("unit", "um"), line(key, text)])
    assert caught.value.hint


def test_micro_manager_gives_um_and_pixels_per_cm(tmp_path):
    found = imagej(
        tmp_path / "a.tif",
        [line("unit", "um"), line("spacing", "2.0")],
        (20000.0, 40000.0),
        "CENTIMETER",
    )
    np.testing.assert_allclose(found.geometry.spacing, (2e-3, 0.25e-3, 0.5e-3), rtol=1e-6)


def ome(path, **sizes):
    said = " ".join(f'{key}="{value}"' for key, value in sizes.items())
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
        f'<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="{SHAPE[2]}" '
        f'SizeY="{SHAPE[1]}" SizeZ="{SHAPE[0]}" SizeC="1" SizeT="1" {said}><TiffData/></Pixels></Image></OME>'
    )
    tifffile.imwrite(
        path,
        np.zeros(SHAPE, np.uint8),
        description=text.encode(),
        metadata=None,
        photometric="minisblack",
    )
    return io.read(path)


@pytest.mark.parametrize(
    "unit", ["um", "\u00b5m", "\u03bcm", "nm", "mm", "cm", "inch", "in", "\u00c5", "micron", None]
)
def test_ome_lengths_have_their_units_and_marks(tmp_path, unit):
    more = {f"PhysicalSize{axis}Unit": unit for axis in "XYZ"} if unit else {}
    found = ome(
        tmp_path / "a.tif", PhysicalSizeX="0.5", PhysicalSizeY="0,25", PhysicalSizeZ="1.5", **more
    )
    np.testing.assert_allclose(
        found.geometry.spacing, np.array([1.5, 0.25, 0.5]) * UNITS[unit or "um"], rtol=1e-12
    )
    assert io.WARNING_KEY not in found.metadata


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        (
            {"PhysicalSizeZ": "-1.5"},
            "unknown (PhysicalSizeZ=-1.5): voxels of 0.0005 x 0.0005 x 0.0015 mm are taken",
        ),
        ({"PhysicalSizeX": "-0,5"}, "unknown (PhysicalSizeX=-0,5)"),
        ({"PhysicalSizeZ": "0"}, "how far apart its slices are (PhysicalSizeZ=0)"),
        ({"PhysicalSizeZ": "NaN"}, "how far apart its slices are (PhysicalSizeZ=NaN)"),
        ({"PhysicalSizeY": "0"}, "how large a voxel is (PhysicalSizeY=0)"),
        ({"PhysicalSizeXUnit": "pixel"}, "how large a voxel is (PhysicalSizeXUnit=pixel)"),
        (
            {"PhysicalSizeZUnit": "reference frame"},
            "how far apart its slices are (PhysicalSizeZUnit=reference frame)",
        ),
    ],
)
def test_ome_lengths_that_are_none_are_said(tmp_path, sizes, words):
    plain = {"PhysicalSizeX": "0.5", "PhysicalSizeY": "0.5", "PhysicalSizeZ": "1.5"}
    found = ome(tmp_path / "a.tif", **plain | sizes)
    assert words in found.metadata[io.WARNING_KEY]


def test_an_ome_length_that_is_no_number_is_refused(tmp_path):
    for text in ("1.2.3", "a", "1,000.5"):
        with pytest.raises(InputError, match="PhysicalSizeY = .*a number expected"):
            ome(tmp_path / "a.tif", PhysicalSizeX="1", PhysicalSizeY=text)


@pytest.mark.parametrize("keep", [5, 9, 20, 34])
def test_a_description_that_is_cut_is_refused(tmp_path, keep):
    """Without its end it would say other channels, or none."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((2, 3, 4, 5), np.uint8), imagej=True, metadata={"axes": "ZCYX"})
    with tifffile.TiffFile(path) as found:
        at = found.pages[0].tags[270].offset
    content = bytearray(path.read_bytes())
    content[at + 4 : at + 8] = keep.to_bytes(4, "little" if content[:2] == b"II" else "big")
    path.write_bytes(content)
    with pytest.raises(InputError, match="no end mark"):
        io.read(path)
