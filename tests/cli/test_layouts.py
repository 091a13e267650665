"""Files named and laid out as BIDS and nnU-Net have them."""

import json
import re

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.grid.volume import Volume

#: The names that BIDS has for a discrete segmentation and what goes with it.
DSEG = re.compile(
    r"sub-[0-9A-Za-z]+/(ses-[0-9A-Za-z]+/)?anat/sub-[0-9A-Za-z]+(_ses-[0-9A-Za-z]+)?(_acq-[0-9A-Za-z]+)?"
    r"(_run-[0-9]+)?_dseg\.(nii\.gz|json|tsv)"
)


@pytest.fixture
def raw(tmp_path):
    """A ball in an image named as BIDS does, and as nnU-Net does."""
    z, y, x = np.indices((20, 20, 20))
    ball = ((z - 9) ** 2 + (y - 9) ** 2 + (x - 9) ** 2 < 36).astype(np.float32)
    folder = tmp_path / "raw" / "sub-01" / "ses-2" / "anat"
    folder.mkdir(parents=True)
    for path in (folder / "sub-01_ses-2_acq-x_run-1_T1w.nii.gz", tmp_path / "raw" / "LIV_001_0000.nii.gz"):
        io.write(Volume.from_array(ball), path)
    return tmp_path / "raw"


def segment(image, out, *words):
    return cli.execute(["segment", str(image), "-o", str(out), "--start", "center", "--threads", "1", *words])


def test_a_bids_derivative(raw, tmp_path):
    image = next(raw.glob("sub-01/ses-2/anat/*.nii.gz"))
    assert segment(image, tmp_path / "out", "--layout", "bids", "--name", "ball") == 0
    files = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*"))
    described = [name for name in files if DSEG.fullmatch(name)]
    assert len(described) == 3
    ignored = (tmp_path / "out" / ".bidsignore").read_text().split()
    others = [name for name in files if name not in described]
    patterns = [re.compile(re.escape(one).replace(r"\*", ".*")) for one in ignored]
    others = [name for name in others if not any(one.fullmatch(name.rpartition("/")[2]) for one in patterns)]
    assert others == [".bidsignore", "dataset_description.json"]
    dataset = json.loads((tmp_path / "out" / "dataset_description.json").read_text())
    assert dataset["DatasetType"] == "derivative" and dataset["GeneratedBy"][0]["Name"] == "accelsurf"
    stem = tmp_path / "out" / "sub-01" / "ses-2" / "anat" / "sub-01_ses-2_acq-x_run-1_dseg"
    assert stem.with_suffix(".tsv").read_text().splitlines()[:2] == ["index\tname\tcolor", "1\tball\t#4078ff"]
    assert json.loads(stem.with_suffix(".json").read_text())["Sources"] == [image.name]


def test_nnunet_labels(raw, tmp_path):
    assert segment(raw / "LIV_001_0000.nii.gz", tmp_path / "out", "--layout", "nnunet") == 0
    assert (tmp_path / "out" / "LIV_001.nii.gz").exists() and (tmp_path / "out" / "LIV_001_report.json").exists()
    assert segment(raw / "LIV_001_0000.nii.gz", tmp_path / "out", "--layout", "nnunet") == 7


def test_a_name_that_is_not_of_bids_is_refused(raw, tmp_path, capsys):
    assert segment(raw / "LIV_001_0000.nii.gz", tmp_path / "out", "--layout", "bids") == 2
    assert "expected an image named as BIDS does" in capsys.readouterr().err
