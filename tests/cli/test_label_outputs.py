"""Names, colours, further files and figures of the objects of a run."""

import csv
import json

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.image.volume import Volume
from accelsurf.io import label_tables


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """Two balls, and a table of starts in them with ids 2 and 9."""
    folder = tmp_path_factory.mktemp("scan")
    z, y, x = np.indices((24, 28, 44)).astype(np.float32)
    balls = sum(
        ((z * 1.5 - 17) ** 2 + (y - 14) ** 2 + (x - at) ** 2 < 8**2).astype(np.float32)
        for at in (12, 32)
    )
    io.write(Volume.from_array(100 * balls, (1.5, 1.0, 1.0)), folder / "a.nii.gz")
    (folder / "balls.csv").write_text("id,x,y,z,r\n2,12,14,17,5\n9,32,14,17,5\n")
    return folder


def run(scan, out, *words):
    """Segment both balls."""
    return cli.execute(
        [
            "segment",
            str(scan / "a.nii.gz"),
            "-o",
            str(out),
            "--objects",
            str(scan / "balls.csv"),
            "--threads",
            "1",
            *words,
        ]
    )


def test_a_segmentation_of_slicer_has_names_and_colours(scan, tmp_path):
    slicerio = pytest.importorskip("slicerio")
    words = (
        "--name",
        "2=left ball",
        "--color",
        "2=#c83c3c",
        "--also",
        "seg.nrrd,itk-snap,ctbl,tsv,nrrd",
    )
    assert run(scan, tmp_path, *words) == 0
    labels = io.read_labels(tmp_path / "a_seg.nii.gz").array
    found = slicerio.read_segmentation(str(tmp_path / "a_segmentation.seg.nrrd"))
    assert [(one["name"], one["labelValue"]) for one in found["segments"]] == [
        ("left ball", 2),
        ("object 9", 9),
    ]
    assert found["segments"][0]["color"] == pytest.approx([200 / 255, 60 / 255, 60 / 255], abs=1e-5)
    assert np.array_equal(found["voxels"].transpose(2, 1, 0), labels)
    assert found["ijkToLPS"] @ [0, 0, 0, 1] == pytest.approx([0, 0, 0, 1])
    for name in ("a_labels.txt", "a_labels.ctbl", "a_dseg.tsv", "a_segmentation.seg.nrrd"):
        table = label_tables.read_label_table(tmp_path / name)
        assert (
            table[2].name == "left ball"
            and table[2].color == (200, 60, 60)
            and table[9].name == "object 9"
        )
    assert np.array_equal(io.read_labels(tmp_path / "a_seg.nrrd").array, labels)
    report = json.loads((tmp_path / "a_report.json").read_text())
    kinds = {output["kind"] for output in report["outputs"]}
    assert {"seg.nrrd", "itk-snap", "ctbl", "tsv", "statistics"} <= kinds


def test_names_come_from_a_table_and_settings_go_before(scan, tmp_path):
    (tmp_path / "names.csv").write_text("id,name,color\n2,one,#010203\n9,two,#040506\n")
    words = (
        "--label-table",
        str(tmp_path / "names.csv"),
        "--name",
        "9=other",
        "--also",
        "itk-snap",
    )
    assert run(scan, tmp_path / "out", *words) == 0
    table = label_tables.read_label_table(tmp_path / "out" / "a_labels.txt")
    assert [(one.name, one.color) for one in table] == [("one", (1, 2, 3)), ("other", (4, 5, 6))]


def test_an_ome_zarr_has_names_as_properties(scan, tmp_path):
    pytest.importorskip("zarr")
    assert (
        run(scan, tmp_path, "--format", "ome.zarr", "--name", "2=left ball", "--color", "2=1,2,3")
        == 0
    )
    said = json.loads((tmp_path / "a_seg.ome.zarr" / "zarr.json").read_text())["attributes"]["ome"][
        "image-label"
    ]
    assert {"label-value": 2, "name": "left ball"} in said["properties"]
    assert {"label-value": 2, "rgba": [1, 2, 3, 255]} in said["colors"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("ending", ["nii.gz", "nii"])
def test_a_nifti_has_names_in_its_header_and_descriptions_beside(scan, tmp_path, ending):
    import nibabel

    assert run(scan, tmp_path / "plain", "--format", ending) == 0
    assert (
        run(scan, tmp_path, "--name", "2=left & right", "--color", "2=#c83c3c", "--format", ending)
        == 0
    )
    path = tmp_path / f"a_seg.{ending}"
    image, plain = nibabel.load(path), nibabel.load(tmp_path / "plain" / f"a_seg.{ending}")
    assert [one.get_code() for one in image.header.extensions] == [30]
    assert np.array_equal(np.asarray(image.dataobj), np.asarray(plain.dataobj))
    assert np.array_equal(image.affine, plain.affine) and len(plain.header.extensions) == 0
    assert np.array_equal(
        io.read_labels(path).array, io.read_labels(tmp_path / "plain" / path.name).array
    )
    for file in (path, tmp_path / "a_labels.txt"):
        table = label_tables.read_label_table(file)
        assert (
            table[2].name == "left & right"
            and table[2].color == (200, 60, 60)
            and table[9].name == "object 9"
        )


def test_figures_of_each_object(scan, tmp_path):
    assert run(scan, tmp_path, "--name", "9=right ball") == 0
    with (tmp_path / "a_statistics.csv").open() as file:
        rows = list(csv.DictReader(file))
    description = json.loads((tmp_path / "a_statistics.json").read_text())["objects"]
    assert [row["name"] for row in rows] == ["object 2", "right ball"] and [
        one["id"] for one in description
    ] == [2, 9]
    for row, one, at in zip(rows, description, (12, 32), strict=True):
        assert (
            float(row["volume_mm3"])
            == one["volume_mm3"]
            == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.05)
        )
        assert float(row["centroid_x_mm"]) == pytest.approx(at, abs=0.3)
        assert float(row["mean"]) > 90 and 15 < float(row["diameter_mm"]) < 19
        assert one["box_first"][0] < at < one["box_last"][0]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--also", "dicom-seg"), 2, "also: dicom-seg was given, and the image is no DICOM"),
        (("--also", "rtstruct"), 2, "rtstruct was given"),
        (("--also", "xyz"), 2, "also: "),
        (("--name", "0=a"), 2, "name: 0=a was given"),
        (("--color", "1=red"), 2, "color: 1=red was given"),
        (("--label-table", "absent.csv"), 3, "absent.csv: there is no such file"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_computed(
    scan, tmp_path, capsys, words, code, said
):
    assert run(scan, tmp_path, *words) == code
    assert said in capsys.readouterr().err and not (tmp_path / "a_seg.nii.gz").exists()


def test_a_coarse_mesh_beyond_its_error_leaves_the_result_and_says_so(scan, tmp_path, capsys):
    pytest.importorskip("fast_simplification")
    assert run(scan, tmp_path, "--mesh-faces", "60", "--mesh-error", "0.01") == 0
    said = capsys.readouterr().err
    assert "mesh_error: 0.01 mm was given" in said and (tmp_path / "a_seg.nii.gz").exists()
    assert run(scan, tmp_path / "fits", "--mesh-faces", "300", "--mesh-error", "5") == 0
    report = json.loads((tmp_path / "fits" / "a_report.json").read_text())
    shaped = [one for one in report["outputs"] if one["kind"] == "surface"]
    assert len(shaped) == 2 and all(290 < one["faces"] < 310 and one["closed"] for one in shaped)
    assert all(0 < one["largest_distance_mm"] < 5 for one in shaped)


@pytest.mark.slow
def test_the_same_run_writes_the_same_bytes(scan, tmp_path):
    for out in ("one", "two"):
        assert run(scan, tmp_path / out, "--also", "seg.nrrd,itk-snap,tsv,ctbl") == 0
    for name in (
        "a_segmentation.seg.nrrd",
        "a_labels.txt",
        "a_dseg.tsv",
        "a_labels.ctbl",
        "a_statistics.csv",
    ):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
