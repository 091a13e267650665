"""A label map in the labels group of its image."""

import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume

yaozarrs = pytest.importorskip("yaozarrs")
zarr = pytest.importorskip("zarr")


@pytest.fixture
def image(tmp_path):
    z, y, x = np.indices((70, 66, 68)).astype(np.float32)
    ball = ((z - 34) * 1.5) ** 2 + (y - 32) ** 2 + (x - 30) ** 2 < 18**2
    io.write(
        Volume.from_array(np.where(ball, 200, 10).astype(np.uint8), (1.5, 1.0, 1.0)),
        tmp_path / "a.ome.zarr",
    )
    return tmp_path / "a.ome.zarr"


def segment(image, out, *words):
    return cli.execute(
        [
            "segment",
            str(image),
            "-o",
            str(out),
            "--start",
            "ball:30,32,51,12",
            "--threads",
            "1",
            *words,
        ]
    )


def test_labels_are_added_with_names_colours_and_levels(image, tmp_path):
    before, digest = (image / "zarr.json").read_bytes(), io.sha256(image)
    assert (
        segment(
            image, tmp_path / "out", "--label-group", "cells", "--name", "cell", "--color", "1,2,3"
        )
        == 0
    )
    added = image / "labels" / "cells"
    yaozarrs.validate_zarr_store(image)
    yaozarrs.validate_zarr_store(added)
    assert np.array_equal(
        io.read_labels(added).array, io.read_labels(tmp_path / "out" / "a_seg.ome.zarr").array
    )
    assert io.read(added).geometry.matches(io.read(image).geometry)
    said = json.loads((added / "zarr.json").read_text())["attributes"]["ome"]
    assert said["image-label"]["source"] == {"image": "../../"}
    own = json.loads(before)["attributes"]["ome"]["multiscales"][0]["datasets"]
    assert len(said["multiscales"][0]["datasets"]) == len(own) > 1
    assert said["image-label"]["properties"] == [{"label-value": 1, "name": "cell"}]
    assert json.loads((image / "labels" / "zarr.json").read_text())["attributes"]["ome"][
        "labels"
    ] == ["cells"]
    assert (image / "zarr.json").read_bytes() == before and io.sha256(image) == digest
    assert segment(image, tmp_path / "two", "--label-group", "more") == 0
    assert json.loads((image / "labels" / "zarr.json").read_text())["attributes"]["ome"][
        "labels"
    ] == ["cells", "more"]


def test_a_name_that_is_there_is_kept_unless_told(image, tmp_path, capsys):
    words = ("--label-group", "cells", "--max-steps", "3")
    assert segment(image, tmp_path / "one", *words) == 0
    first = io.read_labels(image / "labels" / "cells").array
    assert segment(image, tmp_path / "two", "--label-group", "cells") == 7
    assert (
        "exists already" in capsys.readouterr().err
        and not (tmp_path / "two" / "a_seg.ome.zarr").exists()
    )
    assert np.array_equal(io.read_labels(image / "labels" / "cells").array, first)
    assert segment(image, tmp_path / "two", "--label-group", "cells", "--overwrite") == 0
    assert not np.array_equal(io.read_labels(image / "labels" / "cells").array, first)
    assert sorted(path.name for path in (image / "labels").iterdir()) == ["cells", "zarr.json"]


@pytest.mark.parametrize(
    ("name", "said"), [("../x", "expected letters"), (".x", "expected letters"), ("", "expected")]
)
def test_names_that_leave_the_group_are_refused(image, tmp_path, capsys, name, said):
    assert segment(image, tmp_path / "out", "--label-group", name) == 2
    assert said in capsys.readouterr().err


def test_a_folder_that_is_no_store_counts_whole(tmp_path):
    (tmp_path / "scan" / "labels").mkdir(parents=True)
    (tmp_path / "scan" / "labels" / "IM1").write_bytes(b"one")
    before = io.sha256(tmp_path / "scan")
    (tmp_path / "scan" / "labels" / "IM1").write_bytes(b"two")
    assert io.sha256(tmp_path / "scan") != before


def test_other_images_are_refused(image, tmp_path, capsys):
    io.write(io.read(image), tmp_path / "a.nii")
    assert segment(tmp_path / "a.nii", tmp_path / "out", "--label-group", "cells") == 2
    assert "the image is no OME-Zarr" in capsys.readouterr().err
    outside = tmp_path / "outside"
    outside.mkdir()
    (image / "labels").symlink_to(outside)
    assert segment(image, tmp_path / "out", "--label-group", "cells") == 3
    assert "outside of the store" in capsys.readouterr().err and list(outside.iterdir()) == []
