"""The fourth axis of an NRRD: which it is, what lies along it, and its times; detached headers."""

import itertools
import re

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.cli import execute
from accelsurf.errors import InputError
from accelsurf.io import channels, label_tables
from accelsurf.settings.reading import ReadOptions

FRAMES = np.random.default_rng(0).integers(0, 500, (3, 4, 5, 6)).astype("<i2")  # (t, z, y, x)
VECTORS = ["(0,2,0)", "(3,0,0)", "(0,0,4)"]
SLICER = "axis 0 index type:=numeric\naxis 0 index values:=0 0.5 2\nDataNodeClassName:=vtkMRMLScalarVolumeNode"


def header(place, kind, more="", encoding="raw", directions=True):
    """The header of an NRRD whose axis ``place`` is not of space."""
    sizes, kinds, vectors = ["6", "5", "4"], ["domain"] * 3, list(VECTORS)
    for texts, text in ((sizes, "3"), (kinds, kind), (vectors, "none")):
        texts.insert(place, text)
    space = f"space: left-posterior-superior\nspace directions: {' '.join(vectors)}\nspace origin: (1,2,3)\n"
    return (
        f"NRRD0005\ntype: short\ndimension: 4\n{space if directions else ''}sizes: {' '.join(sizes)}\n"
        f"kinds: {' '.join(kinds)}\nendian: little\nencoding: {encoding}\n"
        + (more + "\n" if more else "")
    )


def voxels(place):
    return np.ascontiguousarray(np.moveaxis(FRAMES, 0, 3 - place)).tobytes()


def saved(folder, name, text, content):
    """A file, or a header and its data file."""
    path = folder / name
    if name.endswith(".nhdr"):
        (folder / "voxels.raw").write_bytes(content)
        path.write_text(text + "data file: voxels.raw\n")
    else:
        path.write_bytes(text.encode() + b"\n" + content)
    return path


@pytest.mark.parametrize("name", ["a.nrrd", "a.nhdr", "A.NHDR", "a.seq.nrrd"])
def test_an_axis_at_the_end_is_time(tmp_path, name):
    if name == "A.NHDR":
        (tmp_path / "voxels.raw").write_bytes(voxels(3))
        (tmp_path / name).write_text(header(3, "list") + "data file: voxels.raw\n")
    else:
        saved(tmp_path, name, header(3, "list"), voxels(3))
    check_frames(tmp_path / name)


@pytest.mark.parametrize("kind", ["time", "???", "domain", "space", "none"])
def test_a_last_axis_without_a_direction_is_time(tmp_path, kind):
    check_frames(saved(tmp_path, "a.nrrd", header(3, kind), voxels(3)))


@pytest.mark.parametrize(
    "kinds",
    [
        "list vector domain domain",
        "list domain domain list",
        "domain list",
        "complex domain domain domain",
    ],
)
def test_kinds_that_leave_no_three_axes_of_space_are_refused(tmp_path, kinds):
    text = re.sub("kinds: .*", f"kinds: {kinds}", header(3, "list", directions=False))
    with pytest.raises(InputError, match="of which 2 axes are of space|complex|damaged"):
        io.read(saved(tmp_path, "a.nrrd", text, voxels(3)), options=ReadOptions(time_index=0))


@pytest.mark.parametrize("name", ["a.nrrd", "a.nhdr", "a.seq.nrrd"])
@pytest.mark.parametrize(
    "more", [SLICER, "axis 0 index type:=text", "MultiVolume.FrameLabels:=0,1,2"]
)
def test_a_list_of_slicer_is_a_sequence(tmp_path, name, more):
    path = saved(tmp_path, name, header(0, "list", more), voxels(0))
    check_frames(path)


@pytest.mark.parametrize(
    ("unit", "times"),
    [
        ("s", (0.0, 0.5, 2.0)),
        ("ms", (0.0, 0.0005, 0.002)),
        ("", (0.0, 1.0, 2.0)),
    ],
)
def test_times_of_slicer_are_read(tmp_path, unit, times):
    text = header(0, "list", f'units: "{unit}" "" "" ""\n{SLICER}')
    found = io.read_sequence(saved(tmp_path, "a.seq.nrrd", text, voxels(0)))
    assert found.times == times and found.time_unit == ("s" if unit else "frame")


@pytest.mark.parametrize(
    "values", ["0 1", "0 1 nan", "2 1 0", "0 0 0", "a b c", "0 1e400 2", "1" * 500]
)
def test_times_of_slicer_that_are_none_are_counted(tmp_path, values):
    more = f'units: "s" "" "" ""\naxis 0 index type:=numeric\naxis 0 index values:={values}'
    found = io.read_sequence(saved(tmp_path, "a.seq.nrrd", header(0, "list", more), voxels(0)))
    assert found.times == (0.0, 1.0, 2.0) and found.time_unit == "frame"


def check_frames(path):
    """It is called a sequence, each frame is what was written, and lies where the header says."""
    with pytest.raises(
        InputError, match="a sequence of 3 time points given, one image expected"
    ) as caught:
        io.read(path)
    assert "--time-index" in caught.value.hint
    found = io.read_sequence(path)
    for number, array in enumerate(FRAMES):
        for volume in (
            found.frame(number),
            io.read(path, options=ReadOptions(time_index=number)),
            io.open_volume(path, time_index=number)
            if "list" not in path.read_bytes()[:400].decode("latin1")
            else None,
        ):
            if volume is not None:
                box = (slice(0, 4), slice(0, 5), slice(0, 6))
                values = volume.array if hasattr(volume, "array") else volume.read(box)
                np.testing.assert_array_equal(values, array)
                assert volume.geometry.spacing == (4.0, 3.0, 2.0) and volume.geometry.origin == (
                    1.0,
                    2.0,
                    3.0,
                )
    every = channels.read_channels(path, ReadOptions(channels_from_time=True))
    np.testing.assert_array_equal([volume.array for volume in every], FRAMES)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["a.nrrd", "a.nhdr"])
@pytest.mark.parametrize(
    ("place", "kind"),
    [(0, "vector"), (0, "list"), (0, "RGB-color"), (3, "vector"), (3, "3-vector")],
)
def test_values_of_a_voxel_are_channels(tmp_path, name, place, kind):
    path = saved(tmp_path, name, header(place, kind), voxels(place))
    with pytest.raises(InputError, match="channels given|vector image") as caught:
        io.read(path)
    assert "--channel-index" in caught.value.hint
    np.testing.assert_array_equal([volume.array for volume in channels.read_channels(path)], FRAMES)
    for number, array in enumerate(FRAMES):
        np.testing.assert_array_equal(
            io.read(path, options=ReadOptions(channel_index=number)).array, array
        )


@pytest.mark.parametrize(
    ("place", "kind"), list(itertools.product((1, 2), ("list", "vector", "time")))
)
def test_an_axis_between_is_refused_by_name(tmp_path, place, kind):
    for directions in (True, False):
        path = saved(tmp_path, "a.nrrd", header(place, kind, directions=directions), voxels(place))
        with pytest.raises(InputError, match=f"4D NRRD whose axis {place + 1} is none of space"):
            io.read(path)


def test_detached_headers_are_read_where_others_are(tmp_path, capfd):
    text = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nspacings: 1 2 3\nendian: little\nencoding: raw\n"
    (tmp_path / "v.raw").write_bytes(FRAMES[0].tobytes())
    path = tmp_path / "a.nhdr"
    names = "Segment0_Name:=liver\nSegment0_LabelValue:=4\n"
    path.write_text(f"{text}{names}data file: v.raw\n")
    np.testing.assert_array_equal(io.read(path).array, FRAMES[0])
    np.testing.assert_array_equal(io.read_labels(path).array, FRAMES[0])
    np.testing.assert_array_equal(
        io.open_volume(path).read((slice(0, 4), slice(0, 5), slice(0, 6))), FRAMES[0]
    )
    assert label_tables.read_label_table(path)[4].name == "liver"
    words = [
        "segment",
        str(path),
        "-o",
        str(tmp_path / "out"),
        "--start",
        "ball:3,4,6,3",
        "--channel",
        str(path),
    ]
    assert execute([*words, "--mask", str(path), "--max-steps", "1", "--quiet"]) == 0, (
        capfd.readouterr().err
    )
    assert (tmp_path / "out" / "a_seg.nii.gz").exists()
    assert accelsurf.io.split_name(path) == ("a", ".nhdr")
    # A folder of frames, each with its own header.
    for number in range(3):
        (tmp_path / f"f{number}.raw").write_bytes(FRAMES[number].tobytes())
        (tmp_path / f"f{number}.nhdr").write_text(f"{text}data file: f{number}.raw\n")
    found = io.read_sequence(tmp_path / "f*.nhdr")
    np.testing.assert_array_equal([found.frame(n).array for n in range(3)], FRAMES)


@pytest.mark.parametrize("name", ["../v.raw", "missing.raw", "LIST", "v%d.raw 0 3 1"])
def test_detached_headers_name_no_file_elsewhere(tmp_path, name):
    (tmp_path / "v.raw").write_bytes(FRAMES[0].tobytes())
    (tmp_path / "in").mkdir()
    text = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nendian: little\nencoding: raw\n"
    (tmp_path / "in" / "a.nhdr").write_text(f"{text}data file: {name}\n")
    with pytest.raises(InputError, match="data file|several files"):
        io.read(tmp_path / "in" / "a.nhdr")
