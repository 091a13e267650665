"""Colours that ImageJ shows an image in change no value; a palette of another program is refused."""

import random
from pathlib import Path

import numpy as np
import pytest
import tifffile

from accelsurf import io
from accelsurf.errors import InputError


def tables(draw, bits):
    """Tables of colours as ImageJ has them: red, grey, inverted, and any."""
    steps = np.linspace(0, 65535, 1 << bits).astype(np.uint16)
    none = np.zeros_like(steps)
    drawn = np.random.default_rng(draw.randrange(1 << 30))
    return {
        "red": np.stack([steps, none, none]),
        "grey": np.stack([steps] * 3),
        "inverted": np.stack([steps[::-1]] * 3),
        "any": drawn.integers(0, 65536, (3, 1 << bits)).astype(np.uint16),
    }


def write(path, array, text, draw, table):
    options = {
        "byteorder": draw.choice("<>"),
        "compression": draw.choice([None, "deflate"]),
        "metadata": None,
        "description": text,
        "resolution": (2.0, 2.0),
        "rowsperstrip": draw.choice([3, 24]),
    }
    if table is None:  # 0 is shown as white
        tifffile.imwrite(path, array, photometric="miniswhite", **options)
    else:
        tifffile.imwrite(path, array, photometric="palette", colormap=table, **options)


def text_of_imagej(slices):
    return f"ImageJ=1.53t\nimages={slices}\nslices={slices}\nunit=micron\nspacing=1.0\nloop=false\n"


@pytest.mark.parametrize("seed", range(12))
def test_tables_of_imagej_are_for_the_display(seed, tmp_path):
    draw = random.Random(seed)
    bits = draw.choice([8, 8, 16])
    array = np.random.default_rng(seed).integers(0, 1 << bits, (5, 24, 20)).astype(f"uint{bits}")
    kind = draw.choice(["red", "grey", "inverted", "any", None])
    path: Path = tmp_path / "a.tif"
    write(path, array, text_of_imagej(5), draw, kind and tables(draw, bits)[kind])
    volume = io.read(path)
    assert volume.array.dtype == array.dtype and np.array_equal(volume.array, array)
    assert volume.geometry.spacing == pytest.approx((1e-3, 5e-4, 5e-4))
    boxes = io.open_volume(path)
    assert np.array_equal(boxes.read((slice(1, 3), slice(2, 9), slice(0, 20))), array[1:3, 2:9])


@pytest.mark.parametrize("text", [None, "", "a picture; ImageJ=1.53t", '{"shape": [5, 24, 20]}'])
def test_a_palette_of_another_program_is_refused(text, tmp_path):
    draw = random.Random(1)
    array = np.random.default_rng(1).integers(0, 256, (5, 24, 20)).astype(np.uint8)
    write(tmp_path / "a.tif", array, text, draw, tables(draw, 8)["any"])
    with pytest.raises(InputError, match="colours from a palette") as caught:
        io.read(tmp_path / "a.tif")
    assert "if its numbers are labels or values" in caught.value.hint
