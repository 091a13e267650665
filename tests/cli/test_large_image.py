"""``segment`` on an image that does not fit into the memory that it may take."""

import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume

#: A run may take 450 MiB and 36 bytes a voxel: of the image's 1.2 million voxels a third.
LITTLE = "490MB"


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """A ball of radius 13 in noise, as files of which parts can be read."""
    folder = tmp_path_factory.mktemp("scans")
    z, y, x = np.indices((96, 112, 112)).astype(np.float32)
    ball = (((z - 50) * 1.2) ** 2 + (y - 60) ** 2 + (x - 60) ** 2) < 13**2
    noise = np.random.default_rng(1).normal(0, 9, ball.shape)
    image = Volume.from_array(
        np.clip(100 * ball + noise + 30, 0, 255).astype(np.uint8), (1.2, 1.0, 1.0)
    )
    for name in ("a.nii", "a.nii.gz", "a.ome.zarr"):
        io.write(image, folder / name)
    return folder


def segment(image, out, *words):
    return cli.execute(
        [
            "segment",
            str(image),
            "-o",
            str(out),
            "--start",
            "ball:57,57,57,5",
            "--threads",
            "1",
            *words,
        ]
    )


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["a.nii", "a.ome.zarr"])
def test_files_are_the_same_as_of_an_image_in_memory(scans, tmp_path, name):
    if name.endswith("zarr"):
        pytest.importorskip("zarr")
    assert segment(scans / name, tmp_path / "whole") == 0
    assert segment(scans / name, tmp_path / "parts", "--max-memory", LITTLE) == 0
    whole, parts = (
        json.loads((tmp_path / way / "a_report.json").read_text()) for way in ("whole", "parts")
    )
    assert whole["window"] is None and parts["window"]["size"] != [112, 112, 96]
    assert parts["input"]["size"] == [112, 112, 96]
    labels = [
        io.read_labels(tmp_path / way / f"a_seg.{name.partition('.')[2]}")
        for way in ("whole", "parts")
    ]
    assert np.array_equal(labels[0].array, labels[1].array) and labels[0].geometry.matches(
        labels[1].geometry
    )
    meshes = [(tmp_path / way / "a_surface.ply").read_bytes() for way in ("whole", "parts")]
    assert meshes[0] == meshes[1]
    assert whole["volume_mm3"] == parts["volume_mm3"]


def test_what_needs_more_memory_is_refused_with_the_estimate(scans, tmp_path, capsys):
    assert segment(scans / "a.nii", tmp_path, "--max-memory", "475MB") == 3
    said = capsys.readouterr().err
    assert "window of" in said and "475 MB are allowed" in said and "--level" in said
    report = json.loads((tmp_path / "a_report.json").read_text())
    assert report["status"] == "failed" and not (tmp_path / "a_seg.nii").exists()


@pytest.mark.parametrize(
    ("name", "words", "code", "said"),
    [
        ("a.nii.gz", (), 3, "packed"),
        ("a.nii", ("--format", "nrrd"), 2, "expected ome.zarr or nii"),
        ("a.nii", ("--save-sdf",), 2, "save-sdf: it was given"),
        ("a.nii", ("--energy", "local-region"), 2, "local-region looks at the whole image"),
        ("a.nii", ("--level", "1"), 2, "level: 1 was given"),
    ],
)
def test_what_cannot_be_done_in_parts_is_said_in_one_line(
    scans, tmp_path, capsys, name, words, code, said
):
    assert segment(scans / name, tmp_path, "--max-memory", LITTLE, *words) == code
    lines = capsys.readouterr().err.splitlines()
    assert said in lines[0] and lines[1].startswith("hint: ")


def test_a_size_that_is_none_is_refused(scans, tmp_path, capsys):
    assert segment(scans / "a.nii", tmp_path, "--max-memory", "much") == 2
    assert "--max-memory: much was given" in capsys.readouterr().err


def test_a_level_of_the_pyramid(scans, tmp_path):
    pytest.importorskip("zarr")
    assert segment(scans / "a.ome.zarr", tmp_path, "--level", "1") == 0
    labels = io.read_labels(tmp_path / "a_seg.ome.zarr")
    assert labels.geometry.shape == (48, 56, 56) and labels.geometry.spacing == (2.4, 2.0, 2.0)
    volume = json.loads((tmp_path / "a_report.json").read_text())["volume_mm3"]
    assert volume == pytest.approx(4 / 3 * np.pi * 13**3, rel=0.03)


def test_a_run_in_parts_that_was_interrupted_goes_on(scans, tmp_path):
    words = ("--max-memory", LITTLE, "--checkpoint", "5", "--max-steps")
    assert segment(scans / "a.nii", tmp_path / "once", *words, "200") == 0
    assert segment(scans / "a.nii", tmp_path / "twice", *words, "12", "--resume") == 0
    assert (
        segment(scans / "a.nii", tmp_path / "twice", *words, "200", "--resume", "--overwrite") == 0
    )
    once, twice = (io.read_labels(tmp_path / way / "a_seg.nii").array for way in ("once", "twice"))
    assert np.array_equal(once, twice)


def test_a_file_of_a_further_channel_counts_once(scans, tmp_path):
    pytest.importorskip("zarr")
    image = scans / "a.ome.zarr"
    assert (
        segment(image, tmp_path, "--level", "1", "--channel", str(image), "--max-steps", "3") == 0
    )
    report = json.loads((tmp_path / "a_report.json").read_text())
    assert len(report["resolved_settings"]["scale"]) == 2


def test_look_shows_a_level_that_is_not_too_large(scans, tmp_path, capsys, monkeypatch):
    pytest.importorskip("zarr")
    look = ["look", str(scans / "a.ome.zarr"), "--at", "60,60,50vox", "--overwrite", "-o"]
    assert cli.execute([*look, str(tmp_path / "fine.png")]) == 0
    assert (
        "level    0 of 0 to 1" in (said := capsys.readouterr().out)
        and "size     112 x 112 x 96" in said
    )
    monkeypatch.setattr("accelsurf.cli.look.MAX_VOXELS", 200_000)
    assert cli.execute([*look, str(tmp_path / "coarse.png")]) == 0
    assert (
        "level    1 of 0 to 1" in (said := capsys.readouterr().out)
        and "size     56 x 56 x 48" in said
    )
    assert cli.execute([*look, str(tmp_path / "coarse.png"), "--level", "1"]) == 2
    assert "60,60,50vox lies outside" in capsys.readouterr().err
    assert cli.execute([*look, str(tmp_path / "coarse.png"), "--level", "5"]) == 2


@pytest.mark.slow
def test_a_run_in_parts_reads_no_byte_for_a_checksum(scans, tmp_path, monkeypatch):
    pytest.importorskip("zarr")
    hashed = []
    for name in (
        "accelsurf.cases.case.sha256",
        "accelsurf.output.reports.sha256",
        "accelsurf.io.sha256",
    ):
        monkeypatch.setattr(name, lambda path: hashed.append(path) or "x")
    assert segment(scans / "a.ome.zarr", tmp_path / "good", "--max-memory", LITTLE) == 0
    assert segment(scans / "a.ome.zarr", tmp_path / "none", "--max-memory", "475MB") == 3
    assert (
        segment(
            scans / "a.ome.zarr",
            tmp_path / "good",
            "--max-memory",
            LITTLE,
            "--resume",
            "--overwrite",
        )
        == 0
    )
    assert scans / "a.ome.zarr" not in hashed
    assert json.loads((tmp_path / "good" / "a_report.json").read_text())["input"]["sha256"] is None
