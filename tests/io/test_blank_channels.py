"""A channel in which nothing is seen is left out and named; where nothing is in any, the refusal names the first."""

import random

import numpy as np
import pytest
import tifffile

import accelsurf
from accelsurf.cli import execute
from accelsurf.errors import InputError
from accelsurf.io import channels


@pytest.mark.parametrize("seed", range(8))
def test_blank_channels_of_a_file_are_left_out_and_named(seed, tmp_path):
    draw, numbers = random.Random(seed), np.random.default_rng(seed)
    count = draw.randint(2, 5)
    blank = sorted(draw.sample(range(count), draw.randint(0, count - 1)))
    dtype = draw.choice(["uint8", "uint16", "float32"])
    array = numbers.integers(1, 200, (4, count, 12, 13)).astype(dtype)
    for place in blank:
        array[:, place] = draw.choice([0, 7, 255])
    if count - len(blank) > 1:  # one voxel is something
        last = max(set(range(count)) - set(blank))
        array[:, last] = 3
        array[3, last, 11, draw.randrange(13)] = 4
    tifffile.imwrite(
        tmp_path / "a.tif", array, imagej=True, metadata={"axes": "ZCYX", "spacing": 1.0}
    )
    found = channels.read_channels(tmp_path / "a.tif")
    kept = [place for place in range(count) if place not in blank]
    assert all(
        np.array_equal(v.array, array[:, place]) for v, place in zip(found, kept, strict=True)
    )
    said = found[0].metadata.get("warning", "")
    assert all(f"{place} (" in said for place in blank) and ("left out" in said) == bool(blank)


def test_a_file_with_a_blank_channel_is_segmented(tmp_path, capfd):
    z, y, x = np.indices((12, 20, 20))
    ball = ((z - 6) ** 2 + (y - 10) ** 2 + (x - 10) ** 2 < 16).astype(np.uint8) * 100
    array = np.stack(
        [np.zeros_like(ball), ball + np.random.default_rng(1).integers(0, 9, ball.shape)], 1
    )
    tifffile.imwrite(
        tmp_path / "a.tif", array.astype(np.uint8), imagej=True, metadata={"axes": "ZCYX"}
    )
    words = (
        "--spacing",
        "1",
        "--start",
        "ball:10,10,6,3",
        "--progress",
        "none",
        "--max-steps",
        "3",
    )
    assert execute(["segment", str(tmp_path / "a.tif"), "-o", str(tmp_path / "out"), *words]) == 0
    assert (
        "channel 0 (0) of 0 to 1 has one value everywhere and is left out" in capfd.readouterr().err
    )


def test_an_error_about_a_channel_names_it():
    image = np.random.default_rng(0).random((6, 8, 9)).astype(np.float32)
    holes = image.copy()
    holes[0, 0, 0] = np.nan
    for other, reason in ((np.zeros_like(image), "constant"), (holes, "not finite")):
        with pytest.raises(InputError, match=f"channel 2 of 0 to 2: .*{reason}"):
            accelsurf.segment(image, channels=[image + 1, other], start="ball:4,4,3,2")
        with pytest.raises(InputError, match=reason) as caught:
            accelsurf.segment(other, start="ball:4,4,3,2")
        assert "channel" not in str(caught.value)
