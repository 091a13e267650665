"""Names of other tools: BIDS derivatives, and a folder of label maps as of nnU-Net."""

import fnmatch
import json
import re

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.batch import pool
from accelsurf.image.volume import Volume
from accelsurf.output.layouts import BidsName
from tests.support.batch_jobs import InlinePool

#: The rule of BIDS for label maps in derivatives: entities in this order, each at most once, then the suffix.
_ORDER = (
    r"sub-[a-zA-Z0-9]+(_ses-[a-zA-Z0-9]+)?(_task-[a-zA-Z0-9]+)?(_acq-[a-zA-Z0-9]+)?(_ce-[a-zA-Z0-9]+)?"
    r"(_rec-[a-zA-Z0-9]+)?(_dir-[a-zA-Z0-9]+)?(_run-[0-9]+)?(_echo-[0-9]+)?(_part-(mag|phase|real|imag))?"
    r"(_chunk-[0-9]+)?(_seg-[a-zA-Z0-9]+)?(_res-[a-zA-Z0-9]+)?(_den-[a-zA-Z0-9]+)?(_label-[a-zA-Z0-9]+)?"
    r"(_desc-[a-zA-Z0-9]+)?_dseg\.(nii\.gz|json|tsv)"
)


def scan(path):
    """A ball."""
    path.parent.mkdir(parents=True, exist_ok=True)
    z, y, x = np.indices((20, 20, 20)) - 9.5
    io.write(
        Volume.from_array((100.0 * (x**2 + y**2 + z**2 < 36)).astype(np.float32), (1.0, 1.0, 1.0)),
        path,
    )
    return path


def segment(source, out, *words):
    """Run a few steps."""
    short = ["--max-steps", "3", "--threads", "1", "--quiet"]
    return cli.execute(["segment", str(source), "-o", str(out), *short, *words])


def files_in(folder):
    return sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    )


def test_a_data_set_of_bids_derivatives(tmp_path):
    source = scan(tmp_path / "raw/sub-01/ses-2/anat/sub-01_ses-2_run-1_T1w.nii.gz")
    out = tmp_path / "derivatives/accelsurf"
    words = ("--layout", "bids", "--name", "liver", "--color", "#c83c3c", "--keep-state", "yes")
    assert segment(source, out, *words, "--also", "seg.nrrd,itk-snap,ctbl,tsv") == 0
    found = files_in(out)
    stem = "sub-01/ses-2/anat/sub-01_ses-2_run-1_seg-accelsurf_desc-T1w_dseg"
    assert [name for name in found if "_dseg" in name] == [
        f"{stem}.json",
        f"{stem}.nii.gz",
        f"{stem}.tsv",
    ]
    assert all(re.fullmatch(_ORDER, name.rpartition("/")[2]) for name in found if "_dseg" in name)
    said = json.loads((out / f"{stem}.json").read_text())
    image = "bids:raw:sub-01/ses-2/anat/sub-01_ses-2_run-1_T1w.nii.gz"
    assert (
        said["Sources"] == [image] and said["SpatialReference"] == image and said["Manual"] is False
    )
    assert (out / f"{stem}.tsv").read_text() == "index\tname\tcolor\n1\tliver\t#c83c3c\n"
    about = json.loads((out / "dataset_description.json").read_text())
    assert about["DatasetType"] == "derivative" and about["GeneratedBy"][0]["Name"] == "accelsurf"
    assert (
        out / about["DatasetLinks"]["raw"] / image.removeprefix("bids:raw:")
    ).resolve() == source
    ignored = (out / ".bidsignore").read_text().split()
    others = [
        name
        for name in found
        if "_dseg" not in name and name not in ("dataset_description.json", ".bidsignore")
    ]
    assert len(others) > 6 and all(
        any(fnmatch.fnmatch(name, one) for one in ignored) for name in others
    )
    assert not any(
        fnmatch.fnmatch(name, one) for one in ignored for name in found if "_dseg" in name
    )
    report = json.loads((out / "sub-01/ses-2/anat/sub-01_ses-2_run-1_T1w_report.json").read_text())
    assert {"labels", "tsv", "sidecar"} <= {output["kind"] for output in report["outputs"]}


def test_a_description_that_is_there_stays(tmp_path):
    source = scan(tmp_path / "sub-01_T1w.nii.gz")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/dataset_description.json").write_text("mine")
    assert segment(source, tmp_path / "out", "--layout", "bids") == 0
    assert (tmp_path / "out/dataset_description.json").read_text() == "mine"
    assert (tmp_path / "out/sub-01/anat/sub-01_seg-accelsurf_desc-T1w_dseg.nii.gz").is_file()


def test_images_that_differ_in_their_suffix_have_two_label_maps(tmp_path):
    for suffix in ("T1w", "T2w"):
        assert (
            segment(
                scan(tmp_path / f"sub-01_{suffix}.nii.gz"), tmp_path / "out", "--layout", "bids"
            )
            == 0
        )
    assert len(list(tmp_path.glob("out/sub-01/anat/*_dseg.nii.gz"))) == 2


@pytest.mark.parametrize(
    "name", ["scan", "T1w", "ses-1_sub-01_T1w", "sub-01_T1w_brain", "sub-01_acq-a_acq-b_T1w"]
)
def test_names_that_are_none_of_bids_are_refused(tmp_path, capsys, name):
    assert segment(scan(tmp_path / f"{name}.nii.gz"), tmp_path / "out", "--layout", "bids") == 2
    assert f"layout: bids was given, and {name} is no name of BIDS" in capsys.readouterr().err
    assert not list(tmp_path.glob("out/**/*_dseg*"))


def test_another_format_than_nifti_is_refused_and_another_input_gives_nifti(tmp_path, capsys):
    source = scan(tmp_path / "sub-01_T1w.mha")
    assert segment(source, tmp_path / "out", "--layout", "bids", "--format", "nrrd") == 2
    assert "format: nrrd was given with the layout bids" in capsys.readouterr().err
    assert segment(source, tmp_path / "out", "--layout", "bids", "--overwrite") == 0
    assert list(tmp_path.glob("out/sub-01/anat/*_dseg.nii.gz"))


def test_a_description_that_bids_knows_already_is_joined():
    assert (
        BidsName.of("sub-1_desc-preproc_bold").label_map
        == "sub-1_seg-accelsurf_desc-preprocbold_dseg"
    )


def test_label_maps_of_nnunet_are_called_as_the_case(tmp_path, capsys):
    source = scan(tmp_path / "images/liver_001_0000.nii.gz")
    assert segment(source, tmp_path / "labels", "--layout", "nnunet") == 0
    assert (tmp_path / "labels/liver_001.nii.gz").is_file()
    assert (tmp_path / "labels/liver_001_0000_report.json").is_file()
    assert (
        segment(
            scan(tmp_path / "one/a.nii.gz"), tmp_path / "one", "--layout", "nnunet", "--overwrite"
        )
        == 2
    )
    assert "the label map a would lie on the image" in capsys.readouterr().err
    assert io.read(tmp_path / "one/a.nii.gz").array.max() == 100


@pytest.mark.sampled(1)
@pytest.mark.parametrize("layout", ["bids", "nnunet"])
def test_a_batch_in_a_layout_and_resumed(tmp_path, monkeypatch, layout):
    monkeypatch.setattr(pool, "LocalPool", InlinePool)
    if layout == "bids":
        for number in (1, 2):
            scan(tmp_path / f"raw/sub-0{number}/anat/sub-0{number}_T1w.nii.gz")
        wanted = [f"sub-0{n}/anat/sub-0{n}_seg-accelsurf_desc-T1w_dseg.nii.gz" for n in (1, 2)]
    else:
        for number in (1, 2):
            scan(tmp_path / f"raw/case_000{number}_0000.nii.gz")
        wanted = ["case_0001.nii.gz", "case_0002.nii.gz"]
    out = tmp_path / "out"
    words = [
        "batch",
        str(tmp_path / "raw"),
        "-o",
        str(out),
        "--output-layout",
        layout,
        "--layout",
        layout,
        "--max-steps",
        "2",
        "--quiet",
    ]
    assert cli.execute(words) == 0
    assert all((out / name).is_file() for name in wanted)
    before = {name: (out / name).stat().st_mtime_ns for name in wanted}
    for row in (out / "batch.csv").read_text().splitlines()[1:]:
        case, *_, folder = row.split(",")
        assert (out / folder / f"{case}_report.json").is_file()
    assert cli.execute([*words, "--resume"]) == 0
    assert before == {name: (out / name).stat().st_mtime_ns for name in wanted}
