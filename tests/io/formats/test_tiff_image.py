"""TIFF of several channels, time points, files and levels: each voxel where the file says, whatever unpacks it."""

import itertools
import struct

import numpy as np
import pytest
import tifffile

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.io import channels
from accelsurf.io.headers import FRAME_KEY, UNIT_KEY
from accelsurf.settings.reading import ReadOptions
from tests.io.test_lazy_volume import assert_same_boxes

GREY = {"photometric": "minisblack"}
#: By time point, channel, z, y, x.
FULL = np.random.default_rng(0).integers(0, 60000, (2, 3, 4, 5, 6)).astype(np.uint16)
ORDERS = ["".join(order) for order in itertools.permutations("TCZ")]


def write(path, kind, order="TZC", **more):
    """Write `FULL` with its axes in an order, as the program says that writes this kind."""
    array = FULL.transpose([*("TCZ".index(axis) for axis in order), 3, 4])
    metadata = {"axes": f"{order}YX"}
    if kind == "ome":
        sizes = {
            "PhysicalSizeX": 0.25,
            "PhysicalSizeY": 0.5,
            "PhysicalSizeZ": 2.0,
            "TimeIncrement": 3.0,
        }
        metadata |= sizes | {"PhysicalSizeZUnit": "µm"}
    if kind == "imagej":
        metadata |= {"unit": "um", "spacing": 2.0, "finterval": 3.0}
        more["resolution"] = (4.0, 2.0)
    named = {kind: True} if kind != "tifffile" else {}
    tifffile.imwrite(path, array, metadata=metadata, **GREY, **named, **more)
    return path


@pytest.mark.parametrize(
    ("kind", "order"),
    [*(("ome", o) for o in ORDERS), *(("tifffile", o) for o in ORDERS), ("imagej", "TZC")],
)
def test_each_channel_and_time_point_is_where_the_axes_say(tmp_path, kind, order):
    path = write(tmp_path / "a.tif", kind, order)
    for t in range(2):
        found = channels.read_channels(path, ReadOptions(time_index=t))
        for c, one in enumerate(found):
            np.testing.assert_array_equal(one.array, FULL[t, c], strict=True)
            lazy = io.open_volume(path, time_index=t, channel_index=c)
            np.testing.assert_array_equal(
                lazy.read((slice(1, 3), slice(0, 4), slice(2, 6))), FULL[t, c, 1:3, :4, 2:]
            )
        assert len(found) == 3
        if kind != "tifffile":
            assert found[0].geometry.spacing == pytest.approx((2e-3, 0.5e-3, 0.25e-3))
            assert found[0].metadata == {UNIT_KEY: "um", FRAME_KEY: "3.0"}
        else:
            assert "1 mm is taken" in found[0].metadata[io.WARNING_KEY]


def test_a_sequence_is_refused_until_a_time_point_is_named(tmp_path):
    path = write(tmp_path / "a.tif", "imagej")
    for read in (io.read, io.open_volume, channels.read_channels):
        with pytest.raises(InputError, match="sequence of 2 time points given") as caught:
            read(path)
        assert (
            "--time-index 0 to 1" in caught.value.hint
            and "--channels-from-time" in caught.value.hint
        )
    with pytest.raises(InputError, match="3 channels given, one expected"):
        io.read(path, options=ReadOptions(time_index=1))
    found = channels.read_channels(path, ReadOptions(channels_from_time=True, channel_index=2))
    np.testing.assert_array_equal([one.array for one in found], FULL[:, 2])
    for wrong, words in (
        (ReadOptions(time_index=2), "time 2 asked for"),
        (ReadOptions(time_index=0, channel_index=3), "channel 3 asked for"),
        (ReadOptions(time_index=0, channels_from_time=True), "exclude each other"),
        (ReadOptions(time_index=0, level=1), "level 1 asked for, the image has 1"),
        (ReadOptions(series="1"), "series"),
    ):
        with pytest.raises(UsageError, match=words):
            channels.read_channels(path, wrong)


@pytest.mark.parametrize(
    ("dtype", "options"),
    [
        ("uint16", {"tile": (16, 16)}),
        ("uint16", {"tile": (16, 32), "compression": "zlib"}),
        ("float32", {"tile": (16, 16), "bigtiff": True}),
        ("float64", {}),
        (">f8", {"compression": "zlib", "byteorder": ">"}),
        ("float16", {}),
        ("uint64", {"compression": "zlib"}),
        ("int64", {}),
    ],
)
def test_what_itk_would_change_is_unpacked_by_tifffile(tmp_path, dtype, options):
    array = (
        np.random.default_rng(1)
        .normal(0, 1000, (5, 40, 50))
        .astype("i8" if "i" in dtype else dtype)
        .astype(dtype)
    )
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, array, **GREY, **options)
    lazy = assert_same_boxes(path)
    np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array)
    assert lazy.dtype == np.dtype(dtype).newbyteorder("=")
    whole = path.read_bytes()
    for size in (len(whole) // 2, len(whole) * 3 // 4, len(whole) - 300):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError):
            io.read(path)


@pytest.mark.parametrize("planar", ["contig", "separate"])
@pytest.mark.parametrize("tile", [None, (16, 16)])
def test_several_grey_values_of_a_pixel_are_channels(tmp_path, planar, tile):
    array = np.random.default_rng(1).integers(0, 60000, (4, 2, 20, 30)).astype(np.uint16)  # z c y x
    stored = array if planar == "separate" else array.transpose(0, 2, 3, 1)
    tifffile.imwrite(
        tmp_path / "a.tif", stored, planarconfig=planar, tile=tile, metadata=None, **GREY
    )
    found = channels.read_channels(tmp_path / "a.tif")
    np.testing.assert_array_equal([one.array for one in found], array.transpose(1, 0, 2, 3))


def test_an_imagej_stack_with_one_directory_has_all_its_pages(tmp_path):
    """So ImageJ writes what is beyond 4 GiB."""
    path = tmp_path / "a.tif"
    array = FULL[:, :, 0].reshape(6, 5, 6)
    text = "ImageJ=1.53\nimages=6\nchannels=3\nframes=2\nhyperstack=true\n"
    tifffile.imwrite(path, array[0], description=text, metadata=None, byteorder=">", **GREY)
    path.write_bytes(path.read_bytes() + array[1:].astype(">u2").tobytes())
    found = channels.read_channels(path, ReadOptions(time_index=1))
    np.testing.assert_array_equal([one.array[0] for one in found], FULL[1, :, 0])
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="bytes of voxels"):
        channels.read_channels(path, ReadOptions(time_index=1))


def test_levels_cover_the_same_rectangle(tmp_path):
    array = np.random.default_rng(2).integers(0, 255, (3, 64, 96)).astype(np.uint8)
    path = tmp_path / "a.tif"
    options = {"tile": (16, 16), **GREY}
    with tifffile.TiffWriter(path) as out:
        more = {"axes": "ZYX", "PhysicalSizeX": 1.0, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 2.0}
        out.write(array, subifds=2, metadata=more, **options)
        out.write(array[:, ::2, ::2], subfiletype=1, **options)
        out.write(array[:, ::4, ::4], subfiletype=1, **options)
    finest = io.read(path)
    for level, step in enumerate((1, 2, 4)):
        lazy = io.open_volume(path, level=level)
        np.testing.assert_array_equal(lazy.read(whole_box(lazy.shape)), array[:, ::step, ::step])
        np.testing.assert_array_equal(
            io.read(path, options=ReadOptions(level=level)).array, array[:, ::step, ::step]
        )
        first = lazy.geometry.index_to_world(np.array([-0.5, -0.5, -0.5]))
        np.testing.assert_allclose(
            first, finest.geometry.index_to_world(np.array([-0.5, -0.5, -0.5]))
        )
        last = lazy.geometry.index_to_world(np.array(lazy.shape) - 0.5)
        np.testing.assert_allclose(
            last, finest.geometry.index_to_world(np.array(finest.array.shape) - 0.5)
        )
    assert len(lazy.layout.levels) == 3 and io.open_volume(path, level="auto").layout.level == 0


# ------------------------------------------------------------------------------------------------ OME of several files

XML = """<?xml version="1.0"?>{head}<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1">
<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="6" SizeY="5" SizeZ="4" SizeC="3"
SizeT="2" PhysicalSizeX="1" PhysicalSizeY="1">{data}</Pixels></Image></OME>"""


def ome_of_files(folder, name=lambda t, z: f"t{t}z{z}.ome.tif", head=""):
    """A file for each time point and slice, with the channels as its pages; the first has the XML."""
    data = "".join(
        f'<TiffData IFD="{c}" FirstT="{t}" FirstC="{c}" FirstZ="{z}">'
        f'<UUID FileName="{name(t, z)}">urn:uuid:{t}{z}</UUID></TiffData>'
        for t in range(2)
        for c in range(3)
        for z in range(4)
    )
    for t in range(2):
        for z in range(4):
            first = t == z == 0
            text = (
                XML.format(data=data, head=head)
                if first
                else "<OME><BinaryOnly MetadataFile='t0z0.ome.tif'/></OME>"
            )
            tifffile.imwrite(
                folder / f"t{t}z{z}.ome.tif",
                FULL[t, :, z],
                description=text.encode(),
                metadata=None,
                **GREY,
            )
    return folder / "t0z0.ome.tif"


def test_the_files_of_a_set_are_one_image(tmp_path):
    path = ome_of_files(tmp_path)
    found = channels.read_channels(path, ReadOptions(time_index=1))
    np.testing.assert_array_equal([one.array for one in found], FULL[1])
    lazy = io.open_volume(path, time_index=0, channel_index=2)
    np.testing.assert_array_equal(
        lazy.read((slice(1, 4), slice(0, 2), slice(3, 5))), FULL[0, 2, 1:4, :2, 3:5]
    )
    with pytest.raises(InputError, match="t0z0.ome.tif says what they are"):
        io.read(tmp_path / "t1z0.ome.tif")
    (tmp_path / "t1z3.ome.tif").unlink()
    with pytest.raises(InputError, match="names the file t1z3.ome.tif, which is missing"):
        channels.read_channels(path, ReadOptions(time_index=0))


def test_files_of_a_set_lie_in_its_folder(tmp_path):
    (tmp_path / "here").mkdir()
    ome_of_files(tmp_path)
    path = ome_of_files(
        tmp_path / "here", name=lambda t, z: f"../t{t}z{z}.ome.tif" if t else f"t{t}z{z}.ome.tif"
    )
    with pytest.raises(InputError, match="outside of its own folder"):
        channels.read_channels(path, ReadOptions(time_index=0))


BOMB = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("data", "head", "words"),
    [
        ("", BOMB, "document type"),
        ('<TiffData IFD="0" PlaneCount="99999999999"/>', "", "go beyond its sizes, or overlap"),
        (
            '<TiffData IFD="0" PlaneCount="24"/><TiffData IFD="0"/>',
            "",
            "go beyond its sizes, or overlap",
        ),
        (
            '<TiffData IFD="0" PlaneCount="3"/>',
            "",
            "no page for slice 3 of channel 0 at time point 0",
        ),
        ('<TiffData IFD="3" PlaneCount="24"/>', "", "announces page 27, and has 24"),
        ('<TiffData IFD="x"/>', "", "damaged"),
        ("<TiffData>", "", "XML of the TIFF is damaged"),
        ("</Pixels></Image><Image><Pixels/><Pixels>", "", "3 images given"),
    ],
)
def test_xml_that_says_what_cannot_be_is_refused(tmp_path, data, head, words):
    text = XML.format(data=data, head=head)
    tifffile.imwrite(
        tmp_path / "a.ome.tif", FULL.reshape(24, 5, 6), description=text, metadata=None, **GREY
    )
    with pytest.raises(InputError, match=words):
        channels.read_channels(tmp_path / "a.ome.tif", ReadOptions(time_index=0))


def test_huge_sizes_of_xml_cost_nothing(tmp_path):
    text = XML.format(data="", head="").replace('SizeT="2"', 'SizeT="2000000000"')
    tifffile.imwrite(
        tmp_path / "a.ome.tif", FULL.reshape(24, 5, 6), description=text, metadata=None, **GREY
    )
    with pytest.raises(
        InputError, match="pages that an OME-TIFF or an ImageJ stack announces: 24000000000"
    ):
        io.read(tmp_path / "a.ome.tif")


def test_a_level_in_a_circle_ends(tmp_path):
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as out:
        out.write(np.zeros((40, 40), np.uint8), subifds=1, metadata=None, **GREY)
        out.write(np.zeros((20, 20), np.uint8), subfiletype=1, metadata=None, **GREY)
    content = bytearray(path.read_bytes())
    place = next(
        n
        for n in range(0, len(content) - 8, 2)
        if struct.unpack_from("<HHI", content, n)[0::2] == (330, 1)
    )
    for at in (8, 0, 5, len(content) - 3):
        content[place + 8 : place + 12] = struct.pack("<I", at)
        path.write_bytes(content)
        try:
            assert io.read(path, options=ReadOptions(level=1)).array.shape[0] == 1
        except (InputError, UsageError) as error:
            assert error.hint


# ------------------------------------------------------------------------------------------------------------- spacing


def test_spacing_that_was_given_counts_and_a_contradiction_is_said(tmp_path):
    plain, said = tmp_path / "plain.tif", write(tmp_path / "said.tif", "ome")
    tifffile.imwrite(plain, FULL[0, 0], **GREY)
    given = ReadOptions(spacing=(0.1, 0.2, 0.3))
    volume = io.read(plain, options=given)
    assert volume.geometry.spacing == (0.3, 0.2, 0.1) and volume.metadata == {}
    both = ReadOptions(spacing=(0.1, 0.2, 0.3), time_index=0, channel_index=0)
    volume = io.read(said, options=both)
    assert volume.geometry.spacing == (0.3, 0.2, 0.1)
    assert "the file says 0.00025 x 0.0005 x 0.002 mm" in volume.metadata[io.WARNING_KEY]
    assert io.open_volume(plain, spacing=(0.1, 0.2, 0.3)).geometry.spacing == (0.3, 0.2, 0.1)
    same = ReadOptions(spacing=(0.25e-3, 0.5e-3, 2e-3), time_index=0, channel_index=0)
    assert io.WARNING_KEY not in io.read(said, options=same).metadata


def test_pages_with_other_tiles_are_refused(tmp_path):
    """Libtiff ends the process by a signal for a second page whose tag has another length."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((2, 32, 32), np.uint8), tile=(16, 16), **GREY)
    with tifffile.TiffFile(path) as found:
        at = found.pages[1].tags["TileLength"].offset
    content = bytearray(path.read_bytes())
    for count, value in ((33, 8), (1, 8), (1, 0)):
        content[at + 4 : at + 12] = struct.pack("<II", count, value)
        path.write_bytes(content)
        with pytest.raises(InputError, match="page 2 of the TIFF differs|TileLength|cut short"):
            io.read(path)
