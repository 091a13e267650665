"""Bad input ends with one clear line and a hint, exit 2 or 3, and nothing written but the report that tells of it."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.image.volume import Volume

START = ("--start", "ball:12,11,10,4")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """A ball; label maps that are empty, full, and on other grids."""
    folder = tmp_path_factory.mktemp("scans")
    z, y, x = np.indices((20, 22, 24))
    ball = (x - 12) ** 2 + (y - 11) ** 2 + (z - 10) ** 2 < 7**2
    io.write(Volume.from_array(100.0 * ball, 1.0), folder / "ball.nii.gz")
    io.write_labels(Volume.from_array(ball.astype(np.uint8), 1.0), folder / "truth.nii.gz")
    io.write_labels(Volume.from_array(np.zeros(ball.shape, np.uint8), 1.0), folder / "empty.nii.gz")
    io.write_labels(Volume.from_array(np.ones(ball.shape, np.uint8), 1.0), folder / "full.nii.gz")
    io.write_labels(Volume.from_array(ball[1:].astype(np.uint8), 1.0), folder / "shorter.nii.gz")
    io.write_labels(
        Volume.from_array(ball.astype(np.uint8), (1.0, 1.0, 1.5)), folder / "wider.nii.gz"
    )
    io.write(Volume.from_array(np.full(ball.shape, 7.0), 1.0), folder / "constant.nii.gz")
    return folder


@pytest.fixture
def called(scans, monkeypatch, capfd):
    """What calls the command line in the folder of the scans, and returns its exit code and what it said."""

    def call(words):
        monkeypatch.chdir(scans)
        code = execute(words)
        out, err = capfd.readouterr()
        return SimpleNamespace(returncode=code, stdout=out, stderr=err)

    return call


def test_the_program_says_what_the_command_line_says(scans, called, tmp_path):
    words = [
        "segment",
        "ball.nii.gz",
        "-o",
        str(tmp_path / "out"),
        "--quiet",
        "--start",
        "blob:1,2,3",
    ]
    command = [sys.executable, "-m", "accelsurf", *words]
    done = subprocess.run(command, cwd=scans, capture_output=True, text=True, timeout=120)
    check(done, 2, "unknown kind")
    assert called(words).stderr == done.stderr


#: What is typed after `segment ball.nii.gz -o DIR`, the exit code, and words of the line that tells.
BAD = [
    (("--energy", "0*chan-vese"), 2, "a weight greater than 0"),
    (("--energy=-1*chan-vese",), 2, "a weight greater than 0"),
    (("--energy", "x*chan-vese"), 2, "a number before the *"),
    (("--energy", "nan*chan-vese"), 2, "a number before the *"),
    (("--energy", "chan-veese"), 2, "in place of 'chan-veese'"),
    (("--energy", "chan-vese+geodesic"), 2, "a blank on either side"),
    (("--energy", "chan-vese + "), 2, "chan-vese +"),
    (("--energy", ""), 2, "nothing was given"),
    (("--energy", "balloon"), 2, "a term that sees the image"),
    (("--energy", "threshold"), 2, "at least one bound"),
    (("--energy", "threshold:9,5"), 2, "a low threshold below the high one"),
    (("--energy", "local-region:R=-3"), 2, "above 0"),
    (("--energy", "local-region:Q=3"), 2, "one of R"),
    (("--energy", "threshold:channel=2,LO=5"), 2, "expected 1 to 1"),
    (("--energy", "likelihood:yes"), 2, "gauss or histogram"),
    (("--smoothness", "-1"), 2, "at least 0"),
    (("--presmooth", "1voxel"), 2, "such as 1.5vox"),
    (("--preset", "ct-bones"), 2, "ct-skeleton, mr-brain"),
    (("--levels", "9"), 2, "expected at most"),
    (("--start", "ball:500,0,0,5"), 3, "no voxel centre is inside it"),
    (("--start", "ball:12,11,10"), 2, "4 numbers"),
    (("--start", "ball:12,11,10,-4"), 2, "expected above 0"),
    (("--start", "seed:500,0,0,5"), 3, "no voxel centre is inside it"),
    (("--start", "blob:1,2,3"), 2, "unknown kind"),
    (("--start", "threshold:500,600"), 3, "no voxel"),
    (("--start", "label:empty.nii.gz"), 3, "empty"),
    (("--start", "label:full.nii.gz"), 3, "every voxel of the volume"),
    (("--start", "label:truth.nii.gz@7"), 3, "7"),
    (("--start", "label:shorter.nii.gz"), 3, "grid"),
    (("--start", "label:wider.nii.gz"), 3, "grid"),
    (("--start", "label:nowhere.nii.gz"), 3, "no such file"),
    (("--start", "mesh:nowhere.ply"), 3, "no such file"),
    ((*START, "--mask", "empty.nii.gz"), 3, "empty"),
    ((*START, "--mask", "shorter.nii.gz"), 3, "grid"),
    ((*START, "--mask", "nowhere.nii.gz"), 3, "no such file"),
    ((*START, "--roi", "500,500,500,600,600,600"), 3, "fewer than two"),
    ((*START, "--roi", "5,5,5"), 2, "X0,Y0,Z0,X1,Y1,Z1"),
    ((*START, "--roi", "0,0,0,5,5,5"), 3, "region of interest"),
    (
        (*START, "--energy", "likelihood", "--foreground", "ball:500,0,0,5"),
        3,
        "foreground 'ball:500,0,0,5': no voxel",
    ),
    (
        (*START, "--energy", "likelihood", "--background", "label:empty.nii.gz"),
        3,
        "background 'label:empty.nii.gz'",
    ),
    (
        (*START, "--energy", "likelihood:update=yes", "--foreground", "ball:12,11,10,3"),
        2,
        "would not use",
    ),
    ((*START, "--channel", "wider.nii.gz"), 3, "grid"),
    ((*START, "--channel", "nowhere.nii.gz"), 3, "no such file"),
    ((*START, "--max-volume", "0"), 2, "greater than 0"),
]


@pytest.mark.parametrize(
    ("words", "code", "told"),
    BAD,
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_bad_words_are_one_clear_line(words, code, told, called, tmp_path):
    out = tmp_path / "out"
    done = called(["segment", "ball.nii.gz", "-o", str(out), "--quiet", *words])
    check(done, code, told)
    written = {path.name for path in out.iterdir()} if out.exists() else set()
    assert written <= {"ball_report.json"}
    for path in out.glob("*.json"):
        report = json.loads(path.read_text())
        assert (
            report["status"] == "failed"
            and report["exit_code"] == code
            and told in report["error"]["message"]
        )


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("segment", "constant.nii.gz", "-o", "{out}", *START), 3, "constant"),
        (("segment", "nowhere.nii.gz", "-o", "{out}", *START), 3, "no such file"),
        (("evaluate", "truth.nii.gz", "wider.nii.gz"), 3, "grid"),
        (("evaluate", "truth.nii.gz", "nowhere.nii.gz"), 3, "no such file"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else None,
)
def test_bad_files_are_one_clear_line(words, code, told, called, tmp_path):
    check(called([word.replace("{out}", str(tmp_path / "out")) for word in words]), code, told)
    left = set((tmp_path / "out").iterdir()) if (tmp_path / "out").exists() else set()
    assert all(path.name.endswith("_report.json") for path in left)


def check(done, code, told):
    lines = done.stderr.splitlines()
    assert done.returncode == code, done.stderr
    assert [line.partition(":")[0] for line in lines] == ["error", "hint"], done.stderr
    assert told in lines[0] and len(lines[0]) < 400 and len(lines[1]) > 10
    assert done.stdout == ""
