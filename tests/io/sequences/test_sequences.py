"""Time axes: what a header says is a sequence, what are channels, and what is read of each."""

import json

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk
from PIL import Image

from accelsurf import cli, io
from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io import channels, headers
from accelsurf.io.channels import selected, single
from accelsurf.io.headers import FRAME_KEY, UNIT_KEY
from accelsurf.settings.file_formats import label_formats
from accelsurf.settings.reading import ReadOptions

FULL = np.random.default_rng(0).integers(0, 30000, (3, 4, 5, 6)).astype(np.int16)  # t z y x


def nifti(path, array=FULL, units=("mm", None), step=1.0, intent=None):
    image = nibabel.Nifti1Image(array.transpose(), np.diag([1.0, 2.0, 3.0, 1.0]))
    image.header.set_xyzt_units(*units)
    image.header["pixdim"][4] = step
    if intent:
        image.header.set_intent(intent)
    nibabel.save(image, path)
    return path


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize(
    ("unit", "step", "seconds"), [("sec", 2.0, 2.0), ("msec", 40.0, 0.04), (None, 2.5, None)]
)
def test_a_nifti_that_says_time_is_a_sequence(tmp_path, suffix, unit, step, seconds):
    path = nifti(tmp_path / f"a{suffix}", units=("mm", unit), step=step)
    for read in (io.read, channels.read_channels):
        with pytest.raises(InputError, match="sequence of 3 time points given"):
            read(path)
    for t in range(3):
        volume = io.read(path, options=ReadOptions(time_index=t))
        np.testing.assert_array_equal(volume.array, FULL[t], strict=True)
        assert volume.geometry.spacing == (3.0, 2.0, 1.0)
        if seconds:
            assert float(volume.metadata[FRAME_KEY]) == pytest.approx(seconds)
        if suffix == ".nii":
            lazy = io.open_volume(path, time_index=t)
            np.testing.assert_array_equal(
                lazy.read((slice(1, 3), slice(2, 5), slice(0, 4))), FULL[t, 1:3, 2:, :4]
            )
            assert lazy.geometry.difference(volume.geometry) == ""
    found = channels.read_channels(path, ReadOptions(channels_from_time=True))
    np.testing.assert_array_equal([one.array for one in found], FULL)
    with pytest.raises(UsageError, match="time 3 asked for, the image has 3"):
        io.read(path, options=ReadOptions(time_index=3))
    assert headers.header_counts(path) == (1, 3)


def test_a_few_volumes_of_which_nothing_is_said_are_channels_with_a_note(tmp_path):
    path = nifti(tmp_path / "a.nii")
    found = channels.read_channels(path)
    np.testing.assert_array_equal([one.array for one in found], FULL)
    assert "taken for channels" in found[0].metadata[io.WARNING_KEY]
    one = io.read(path, options=ReadOptions(channel_index=1))
    np.testing.assert_array_equal(one.array, FULL[1])
    assert io.WARNING_KEY not in one.metadata
    many = nifti(tmp_path / "b.nii", np.repeat(FULL, 6, axis=0)[:17])
    with pytest.raises(InputError, match="sequence of 17 time points"):
        channels.read_channels(many)
    with pytest.raises(InputError, match="17 channels or time points, expected at most 16"):
        channels.read_channels(many, ReadOptions(channels_from_time=True))
    np.testing.assert_array_equal(io.read(many, options=ReadOptions(time_index=16)).array, FULL[2])


def test_vectors_are_channels_whatever_is_said_of_time(tmp_path):
    path = nifti(tmp_path / "a.nii", units=("micron", "sec"), intent="vector")
    found = channels.read_channels(path)
    np.testing.assert_array_equal([one.array for one in found], FULL)
    assert io.WARNING_KEY not in found[0].metadata and found[0].metadata[UNIT_KEY] == "um"
    five = np.stack([FULL, FULL + 7], axis=0)  # channel, time
    path = nifti(tmp_path / "b.nii", five, units=("mm", "sec"))
    found = channels.read_channels(path, ReadOptions(time_index=2))
    np.testing.assert_array_equal([one.array for one in found], five[:, 2])
    found = channels.read_channels(path, ReadOptions(channels_from_time=True, channel_index=1))
    np.testing.assert_array_equal([one.array for one in found], five[1])
    with pytest.raises(InputError, match="2 channels at 3 time points"):
        channels.read_channels(path, ReadOptions(channels_from_time=True))
    assert (
        headers.header_counts(path) == (2, 3)
        and channels.count_values(path, ReadOptions(time_index=1)) == 2 * 120
    )


@pytest.mark.parametrize("suffix", [".nrrd", ".mha"])
@pytest.mark.parametrize("packed", [False, True])
def test_a_fourth_axis_of_nrrd_and_metaimage_is_time(tmp_path, suffix, packed):
    volumes = [sitk.GetImageFromArray(one) for one in FULL]
    for one in volumes:
        one.SetSpacing((1.0, 2.0, 3.0))
        one.SetOrigin((5.0, 6.0, 7.0))
    path = tmp_path / f"a{suffix}"
    sitk.WriteImage(sitk.JoinSeries(volumes), str(path), packed)
    for read in (io.read, channels.read_channels, *(() if packed else (io.open_volume,))):
        with pytest.raises(InputError, match="sequence of 3 time points given"):
            read(path)
    for t in range(3):
        volume = io.read(path, options=ReadOptions(time_index=t))
        np.testing.assert_array_equal(volume.array, FULL[t], strict=True)
        assert volume.geometry.spacing == (3.0, 2.0, 1.0) and volume.geometry.origin == (
            5.0,
            6.0,
            7.0,
        )
        if not packed:
            lazy = io.open_volume(path, time_index=t)
            np.testing.assert_array_equal(
                lazy.read((slice(1, 3), slice(2, 5), slice(0, 4))), FULL[t, 1:3, 2:, :4]
            )
    found = channels.read_channels(path, ReadOptions(channels_from_time=True))
    np.testing.assert_array_equal([one.array for one in found], FULL)


NRRD = (
    "NRRD0004\ntype: short\ndimension: 4\nsizes: {sizes}\nkinds: {kinds}\nendian: little\nencoding: raw\n"
    "space: left-posterior-superior\nspace origin: (5,6,7)\nspace directions: {directions}\n{more}\n"
)
LIST = {
    "sizes": "3 6 5 4",
    "kinds": "list domain domain domain",
    "directions": "none (1,0,0) (0,2,0) (0,0,3)",
}


def test_a_list_axis_of_nrrd_is_channels_unless_it_says_time(tmp_path):
    path, voxels = tmp_path / "a.nrrd", FULL.transpose(1, 2, 3, 0).tobytes()
    path.write_bytes(NRRD.format(**LIST, more="").encode() + voxels)
    found = channels.read_channels(path)
    np.testing.assert_array_equal([one.array for one in found], FULL)
    np.testing.assert_array_equal(
        io.read(path, options=ReadOptions(channel_index=2)).array, FULL[2]
    )
    path.write_bytes(NRRD.format(**LIST, more="axis 0 index type:=time\n").encode() + voxels)
    with pytest.raises(InputError, match="sequence of 3 time points given"):
        channels.read_channels(path)
    volume = io.read(path, options=ReadOptions(time_index=1))
    np.testing.assert_array_equal(volume.array, FULL[1])
    assert volume.geometry.spacing == (3.0, 2.0, 1.0) and volume.geometry.origin == (5.0, 6.0, 7.0)
    first = NRRD.format(**LIST | {"kinds": "time domain domain domain"}, more="")
    path.write_bytes(first.encode() + voxels)
    with pytest.raises(InputError, match="time axis of the NRRD comes first"):
        channels.read_channels(path)


def test_units_of_a_time_axis_of_nrrd_are_seconds(tmp_path):
    text = NRRD.replace(
        "space: left-posterior-superior\nspace origin: (5,6,7)\nspace directions: {directions}\n",
        "",
    )
    more = 'spacings: 1 2 3 500\nunits: "mm" "mm" "mm" "ms"\n'
    path = tmp_path / "a.nrrd"
    head = text.format(sizes="6 5 4 3", kinds="domain domain domain time", more=more)
    path.write_bytes(head.encode() + FULL.tobytes())
    volume = io.read(path, options=ReadOptions(time_index=1))
    np.testing.assert_array_equal(volume.array, FULL[1])
    assert volume.geometry.spacing == (3.0, 2.0, 1.0) and float(
        volume.metadata[FRAME_KEY]
    ) == pytest.approx(0.5)


def test_commands_refuse_a_sequence_and_take_a_time_point(tmp_path, capsys):
    path = nifti(tmp_path / "a.nii.gz", units=("mm", "sec"), step=2.0)
    run = ["segment", "-o", str(tmp_path / "out"), "--start", "ball:2,2,2,2vox"]
    for words in (run, ["look", "-o", str(tmp_path)]):
        assert cli.execute([words[0], str(path), *words[1:]]) == 3
        assert "sequence of 3 time points given" in capsys.readouterr().err
    assert cli.execute(["look", str(path), "-o", str(tmp_path), "--time-index", "1"]) == 0
    assert f"values   {FULL[1].min()} to {FULL[1].max()}" in capsys.readouterr().out
    assert cli.execute(["info", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (
        said["time_points"] == 3 and said["channels"] == 1 and said["seconds_per_time_point"] == 2.0
    )


def test_places_of_channels_and_time_points():
    assert selected(2, 1, ReadOptions()) == [(0, 0), (0, 1)]
    assert single(1, 4, ReadOptions(time_index=3)) == (3, 0)


@pytest.mark.parametrize("name", [*label_formats(), "mgz", "colour.png"])
@pytest.mark.parametrize("by_pattern", [False, True])
def test_a_folder_of_frames_may_have_any_format(tmp_path, name, by_pattern):
    """Each frame has the grid and values that the file has by itself."""
    folder, form = tmp_path / "frames", name.rpartition(".")[2]
    folder.mkdir()
    is_2d = form == "png"
    random = np.random.default_rng(5)
    for number in (1, 2, 4):
        values = random.integers(0, 200, (1 if is_2d else 3, 6, 7)).astype(np.uint8)
        file = folder / f"s{number}.{name}"
        if form == "mgz":
            nibabel.save(nibabel.MGHImage(values.T, np.diag([1.0, 2.0, 3.0, 1.0])), file)
        elif name == "colour.png":
            Image.fromarray(np.stack([values[0]] * 3, -1)).save(file)
        else:
            io.write(Volume.from_array(values, (2.0, 0.5, 0.25)), file)
    path = folder / f"s*.{name}" if by_pattern else folder
    sequence = io.read_sequence(path)
    assert list(sequence.times) == [0.0, 1.0, 3.0]
    for place, number in enumerate((1, 2, 4)):
        alone = io.read(folder / f"s{number}.{name}")
        np.testing.assert_array_equal(sequence.frame(place).array, alone.array, strict=True)
        assert sequence.geometry.difference(alone.geometry) == ""
