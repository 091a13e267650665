"""What is a label map: whole numbers, rounded ones, large ones; NaN and infinity are refused, and named where shown."""

import re
import struct

import numpy as np
import pytest

import accelsurf
from accelsurf import io
from accelsurf.cli import execute
from accelsurf.errors import InputError
from accelsurf.image.check import as_labels
from accelsurf.image.volume import Volume

SHAPE = (6, 7, 8)


def scaled(path, values, slope, dtype="<i2"):
    """A NIfTI whose header scales whole numbers."""
    io.write(Volume.from_array(values.astype(dtype)), path)
    content = bytearray(path.read_bytes())
    struct.pack_into("<2f", content, 112, slope, 0.0)
    path.write_bytes(content)
    return path


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("slope", [1.0000001, 0.9999999, 1.0000002, 0.99998, 1.00003])
def test_labels_of_a_slope_near_one_are_those_that_are_stored(tmp_path, slope, seed):
    values = np.random.default_rng(seed).integers(0, 900, SHAPE)
    np.testing.assert_array_equal(
        io.read_labels(scaled(tmp_path / "a.nii", values, slope)).array, values
    )


@pytest.mark.parametrize("slope", [1.0000001, 0.9999999])
def test_large_whole_numbers_stay_exact_under_a_slope_of_one(tmp_path, slope):
    values = np.random.default_rng(1).integers(2**24, 2**31 - 1, SHAPE)
    found = io.read(scaled(tmp_path / "a.nii", values, slope, "<i4"))
    assert found.array.dtype == np.int32
    np.testing.assert_array_equal(found.array, values)


@pytest.mark.sampled
@pytest.mark.parametrize("largest", [2**31 - 1, 2**31, 2**40 + 1, 2**52 + 1, 2**53])
@pytest.mark.parametrize("suffix", [".nrrd", ".nii", ".npy"])
def test_floats_are_labels_as_long_as_they_are_exact(tmp_path, suffix, largest):
    values = np.random.default_rng(2).integers(0, 5, SHAPE).astype(np.int64)
    values[1, 2, 3] = largest
    io.write(Volume.from_array(values.astype(np.float64)), tmp_path / f"a{suffix}")
    found = io.read_labels(tmp_path / f"a{suffix}").array
    assert found.dtype.kind == "i"
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("value", [0.5, 1.01, 254.6, 5000.4, 2.0**53 + 2, -0.2, 0.001])
def test_other_numbers_are_refused_with_their_place(value):
    array = np.zeros(SHAPE)
    array[3, 4, 5] = value
    with pytest.raises(InputError, match=r"first at index x=5, y=4, z=3.* not: the first is"):
        as_labels(array)


@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize("values", [[np.nan], [np.inf], [-np.inf], [np.nan, np.inf, 0.5]])
def test_nan_and_infinity_are_refused_with_a_command_that_exists(tmp_path, capfd, values, dtype):
    array = np.zeros(SHAPE, dtype)
    array.reshape(-1)[17 : 17 + len(values)] = values
    path = tmp_path / "a.nii"
    io.write(Volume.from_array(array), path)
    with pytest.raises(InputError, match="NaN or infinite") as caught:
        io.read_labels(path)
    check_hint(caught.value.hint, path, capfd, tmp_path)
    image = Volume.from_array(np.random.default_rng(0).normal(size=SHAPE).astype(dtype))
    broken = image.with_array(np.where(np.isfinite(array), image.array, array))
    with pytest.raises(InputError, match="not finite") as caught:
        accelsurf.segment(broken, start="center")
    check_hint(caught.value.hint, path, capfd, tmp_path)


def check_hint(hint, path, capfd, folder):
    """The command in a hint runs."""
    words = re.search(r"accelsurf (look (?:FILE|IMAGE) --at \S+vox)", hint).group(1).split()
    words[1] = str(path)
    assert execute([*words, "-o", str(folder / "look.png"), "--overwrite"]) == 0
    assert not capfd.readouterr().err


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([np.nan] * 336, "336 voxels are NaN"),
        ([np.inf] * 336, "336 voxels are infinite"),
        ([np.nan, 2.0] + [1.0] * 334, "1 to 2, 1 voxel is NaN"),
        (
            [np.nan, -np.inf, np.inf] + [1.5] * 333,
            "1.5 to 1.5, 1 voxel is NaN, 2 voxels are infinite",
        ),
    ],
)
def test_look_says_values_that_there_are(tmp_path, capfd, values, said):
    io.write(Volume.from_array(np.array(values, np.float32).reshape(SHAPE)), tmp_path / "a.nii")
    assert execute(["look", str(tmp_path / "a.nii"), "-o", str(tmp_path / "a.png")]) == 0
    out, err = capfd.readouterr()
    assert not err and f"values   {said}\n" in out
    assert (
        execute(
            [
                "look",
                str(tmp_path / "a.nii"),
                "--labels",
                str(tmp_path / "a.nii"),
                "-o",
                str(tmp_path),
            ]
        )
        == 3
    )
    assert [line.partition(":")[0] for line in capfd.readouterr().err.splitlines()] == [
        "error",
        "hint",
    ]


@pytest.mark.parametrize("offset", [2**31, 2**40, 2**52, -(2**45)])
def test_whole_numbers_that_single_precision_does_not_tell_apart(tmp_path, capfd, offset):
    """They are no constant image: the line has their range, and what to subtract."""
    z, y, x = np.indices(SHAPE)
    values = 100 * ((x - 4) ** 2 + (y - 3) ** 2 + (z - 3) ** 2 < 6).astype(np.int64) + offset
    io.write(Volume.from_array(values), tmp_path / "a.nrrd")
    words = [
        "segment",
        str(tmp_path / "a.nrrd"),
        "-o",
        str(tmp_path / "out"),
        "--start",
        "ball:4,3,3,2",
    ]
    assert execute(words) == 3
    err = capfd.readouterr().err
    assert (
        f"from {offset} to {offset + 100}" in err
        and f"subtract {offset}" in err
        and "constant" not in err
    )
    assert execute(["look", str(tmp_path / "a.nrrd"), "-o", str(tmp_path / "a.png")]) == 0
    assert f"values   {offset} to {offset + 100}\n" in capfd.readouterr().out
    volume = Volume.from_array(values - offset)
    assert accelsurf.segment(volume, start="ball:4,3,3,2", max_steps=2).history


@pytest.mark.parametrize(
    ("dtype", "low"),
    [
        ("u1", 0),
        ("i2", -1000),
        ("u2", 65000),
        ("i4", 10**7),
        ("f4", 1e6),
        ("f4", 16777214),
        ("f8", 1e6),
        ("i8", -(10**7)),
    ],
)
def test_plain_images_of_two_values_are_none_of_these(dtype, low):
    values = np.full(SHAPE, low, dtype)
    values[2:4, 2:5, 2:5] = low + 1
    assert accelsurf.segment(Volume.from_array(values), start="ball:3,3,3,2", max_steps=2).history
