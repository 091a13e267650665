"""The finest level whose run fits into the memory: of an OME-Zarr and of a TIFF, by what the run itself needs."""

import json

import numpy as np
import pytest
import tifffile

from accelsurf import cli, io
from accelsurf.cli.large_image import ImageParts, with_level
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.run.memory import run_bytes
from accelsurf.settings.run_config import RunConfig

SHAPE = (96, 96, 96)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("a") / "a.ome.zarr"
    z, y, x = np.indices(SHAPE) - 47.5
    ball = np.where(z**2 + y**2 + x**2 < 30**2, 200, 20).astype(np.uint8)
    io.write(Volume(ball, Geometry(SHAPE, (1.0, 1.0, 1.0))), path)
    return path


@pytest.mark.parametrize("clicks", [False, True])
def test_the_level_is_that_whose_run_fits(store, clicks):
    config = RunConfig(
        level="auto", **({"inside": "point:48,48,48", "energy": "seeded"} if clicks else {})
    )
    for bytes, level in (
        (run_bytes(96**3, clicks), 0),
        (run_bytes(96**3, clicks) - 1, 1),
        (1 << 20, 1),
    ):
        found = with_level(store, config, ImageParts(f"{bytes / 1000:.3f}KB"), quiet=True)
        assert found.level == level and found.replace(level="auto") == config
    assert with_level(store, RunConfig(level=1), ImageParts("1MB"), quiet=True).level == 1


def test_a_format_without_levels_has_one(tmp_path):
    io.write(Volume.from_array(np.zeros((3, 4, 5), np.uint8)), tmp_path / "a.nii")
    assert (
        with_level(tmp_path / "a.nii", RunConfig(level="auto"), ImageParts("1MB"), quiet=True).level
        == 0
    )


def test_the_run_says_which_level_it_took(store, tmp_path, capsys):
    limit = f"{(run_bytes(96**3, False) - 1) / 1000:.3f}KB"
    words = [
        "--level",
        "auto",
        "--max-memory",
        limit,
        "--start",
        "ball:48,48,48,28",
        "--max-steps",
        "3",
    ]
    assert (
        cli.execute(["segment", str(store), "-o", str(tmp_path), "--format", "nii.gz", *words]) == 0
    )
    assert (
        "level 1 of 0 to 1 is read, the finest that fits into the memory: 48 x 48 x 48"
        in capsys.readouterr().out
    )
    assert json.loads((tmp_path / "a_report.json").read_text())["config"]["level"] == 1
    assert io.read(tmp_path / "a_seg.nii.gz").geometry.spacing == (2.0, 2.0, 2.0)


def test_levels_of_a_tiff(tmp_path):
    array, path = np.zeros((4, 64, 64), np.uint8), tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as out:
        out.write(array, subifds=1, photometric="minisblack")
        out.write(array[:, ::2, ::2], subfiletype=1, photometric="minisblack")
    for less, level in ((0, 0), (1, 1)):
        parts = ImageParts(f"{(run_bytes(array.size, False) - less) / 1000:.3f}KB")
        assert with_level(path, RunConfig(level="auto"), parts, quiet=True).level == level
