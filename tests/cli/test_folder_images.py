"""Runs whose image and label map are folders: OME-Zarr goes in and comes out as files do."""

import json
import shutil

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.batch import cases
from accelsurf.image.volume import Volume
from tests.support.folders import contents

START = ("--start", "ball:12,12,12,4", "--max-steps", "60", "--threads", "1", "--quiet")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    z, y, x = np.indices((24, 24, 24))
    ball = ((z - 12) ** 2 + (y - 12) ** 2 + (x - 12) ** 2 < 49) * 100.0
    volume = Volume.from_array(
        (ball + np.random.default_rng(0).normal(0, 5, ball.shape)).astype(np.float32)
    )
    io.write(volume, folder / "a.ome.zarr")
    io.write(volume, folder / "b.nii.gz")
    return folder


def run(*words) -> int:
    return cli.execute([str(word) for word in words])


def test_a_folder_goes_in_and_comes_out(scans, tmp_path):
    assert run("segment", scans / "a.ome.zarr", *START, "-o", tmp_path) == 0
    assert run("segment", scans / "b.nii.gz", *START, "-o", tmp_path) == 0
    labels = io.read(tmp_path / "a_seg.ome.zarr")
    np.testing.assert_array_equal(
        labels.array, io.read(tmp_path / "b_seg.nii.gz").array, strict=True
    )
    report = json.loads((tmp_path / "a_report.json").read_text())
    assert report["input"]["sha256"] == io.sha256(scans / "a.ome.zarr")
    listed = {entry["kind"]: entry["sha256"] for entry in report["outputs"]}
    assert listed["labels"] == io.sha256(tmp_path / "a_seg.ome.zarr")


def test_a_label_map_that_is_a_folder_is_replaced_and_goes_as_files_do(scans, tmp_path):
    words = ("segment", scans / "a.ome.zarr", *START, "-o", tmp_path)
    assert run(*words) == 0
    before = contents(tmp_path)
    assert run(*words) == 7
    assert contents(tmp_path) == before
    assert run(*words, "--overwrite") == 0
    after = contents(tmp_path)
    same = [name for name in before if "a_seg" in name]
    assert (
        len(same) > 2
        and all(after[name] == before[name] for name in same)
        and set(after) == set(before)
    )
    assert run(*words, "--overwrite", "--format", "nii.gz") == 0
    assert not (tmp_path / "a_seg.ome.zarr").exists() and (tmp_path / "a_seg.nii.gz").is_file()


def test_a_changed_store_has_another_hash(scans, tmp_path):
    shutil.copytree(scans / "a.ome.zarr", tmp_path / "b.ome.zarr")
    assert io.sha256(tmp_path / "b.ome.zarr") == io.sha256(scans / "a.ome.zarr")
    chunk = tmp_path / "b.ome.zarr" / "0" / "c" / "0" / "0" / "0"
    chunk.rename(chunk.with_name("1"))
    assert io.sha256(tmp_path / "b.ome.zarr") != io.sha256(scans / "a.ome.zarr")


def test_a_folder_of_images_has_those_that_are_folders(scans):
    assert ids(scans) == ["a", "b"] and ids(scans / "*") == ["a", "b"]
    assert ids(scans / "a.ome.zarr") == ["a"] and ids(scans / "a.ome.zarr", scans / "b.nii.gz") == [
        "a",
        "b",
    ]


def ids(*given):
    return [case.id for case in cases.read_cases([str(path) for path in given])[0]]
