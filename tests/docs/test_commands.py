"""The commands that README and the tutorial show: each is run on small inputs; each script that they name exists."""

import contextlib
import csv
import json
import os
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from accelsurf import cli, io
from accelsurf.batch import pool
from accelsurf.cli.fetch import TABLE
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.track.output.files import TrackFiles
from accelsurf.track.output.outputs import TrackOutputs
from accelsurf.viewer.scene.headless import GraphicsError, require_graphics
from tests.support.batch_jobs import InlinePool
from tests.support.dicom_series import Series, save
from tests.support.trackings import dividing_cells

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", ROOT / "docs" / "tutorial" / "first-scan.md")
#: Its commands are about public scans, which are not here.
ON_SCANS = ROOT / "docs" / "tutorial" / "by-clicks.md"
#: A file that a page tells the reader to write.
FILE = re.compile(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", re.DOTALL)
CONSOLE = re.compile(r"```console\n(.*?)```", re.DOTALL)
#: What the tutorial shows of the output: size of a surface, rows of a comparison without their seconds, measures.
SUMMARY = re.compile(r"^volume (\S+) mm3(?: \([^)]*\))?, area (\S+) mm2", re.MULTILINE)
METRIC = re.compile(r"^(dice|\w+_mm3?) +([\d.]+)$", re.MULTILINE)


def commands(page):
    """The commands of a page, in order; a prompt begins each."""
    lines = [
        line
        for block in CONSOLE.findall(page.read_text(encoding="utf-8"))
        for line in block.splitlines()
    ]
    assert all(line.startswith("$ ") for line in lines), (
        f"{page.name}: a console block has a line without '$ '"
    )
    return [shlex.split(line[2:], comments=True) for line in lines]


def grid():
    return Geometry((48, 48, 48), (2.0, 2.0, 2.0), origin=(-47.0, -47.0, -47.0))


def scan_in_place_of(path):
    """A small volume around the world's origin, in place of a scan that the page's reader has: a ball, and noise."""
    z, y, x = (2.0 * (axis - 23.5) for axis in np.indices(grid().shape))
    ball = 100.0 * (x**2 + y**2 + z**2 < 30**2)
    noisy = ball + np.random.default_rng(0).normal(0, 5, ball.shape)
    io.write(Volume(noisy.astype(np.float32), grid()), path)


def can_draw():
    """Whether there is a screen or a software renderer."""
    try:
        require_graphics()
    except GraphicsError:
        return False
    return True


@pytest.mark.parametrize(
    "page", [PAGES[0], pytest.param(PAGES[1], marks=pytest.mark.slow)], ids=lambda page: page.name
)
def test_every_command_of_the_page_succeeds(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, text in FILE.findall(page.read_text(encoding="utf-8")):
        Path(name).write_text(text)
    typed, printed = [words for words in commands(page) if words[0] == "accelsurf"], ""
    assert typed
    for words in typed:
        for word in words:
            if word.endswith(".nii.gz") and os.sep not in word and not Path(word).exists():
                scan_in_place_of(Path(word))
        if words[1] == "movie" and not can_draw():
            continue
        if page is PAGES[0] and words[1] == "segment":  # what it finds is not said
            words += ["--max-steps", "2"] if "--max-steps" not in words else []
        assert cli.execute(words[1:]) == 0, f"{shlex.join(words)}\n{capsys.readouterr().err}"
        printed += capsys.readouterr().out
    if "tutorial" in page.parts:
        check_figures(page.read_text(encoding="utf-8"), printed)


def test_commands_on_public_scans_lack_nothing_but_the_scans(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    typed = [words for words in commands(ON_SCANS) if words[0] == "accelsurf"]
    assert {words[2] for words in typed if words[1] == "fetch"} <= set(
        tomllib.loads(TABLE.read_text())
    )
    typed = [words for words in typed if words[1] != "fetch"]
    assert {words[1] for words in typed} == {"look", "segment", "refine", "evaluate"}
    for words in typed:
        assert cli.execute(words[1:]) == 3, shlex.join(words)
        missing = f"{words[2]}: there is no such file" if words[1] != "refine" else f"{words[2]}: "
        assert missing in capsys.readouterr().err, shlex.join(words)


def check_figures(text, printed):
    """What the tutorial says that its commands give is what they have printed."""
    for figure in (SUMMARY, METRIC):
        shown = set(figure.findall(text))
        assert shown and shown <= set(figure.findall(printed)), figure.pattern
    with open("cmp/batch.csv", newline="", encoding="utf-8") as table:
        found = {row["id"]: f"{float(row['dice']):.3f}" for row in csv.DictReader(table)}
    told = re.search(r"has (0\.\d+) for descent and (0\.\d+) for momentum", text)
    assert told and told.groups() == (found["descent"], found["momentum"])
    measured = {
        f"{float(value):.3f}" for value in re.findall(r"^dice +(\S+)", printed, re.MULTILINE)
    }
    said = set(re.findall(r"Dice is (0\.\d+)", text))
    assert said and said <= measured


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.name)
def test_every_script_of_the_page_exists_and_has_help(page):
    named = sorted({words[0] for words in commands(page) if words[0].startswith("scripts/")})
    named += sorted(
        set(re.findall(r"`(scripts/\w+)", page.read_text(encoding="utf-8"))) - set(named)
    )
    for name in named:
        script = ROOT / name
        assert os.access(script, os.X_OK), name
        done = subprocess.run([script, "--help"], capture_output=True, text=True, timeout=30)
        assert done.returncode == 0 and "Usage:" in done.stderr, done.stderr


@pytest.fixture(scope="module")
def readers_folder(tmp_path_factory):
    """A folder with what the how-to pages take for granted, to be copied."""
    folder = tmp_path_factory.mktemp("reader")
    with contextlib.chdir(folder):
        folder_of_a_reader()
    return folder


def folder_of_a_reader():
    """Make what the how-to pages take for granted: scans, labels, a picture, tables, a first result."""
    for name in ("scan", "ct", "t1", "t2", "cells", "nuclei", "sub-01_T1w", "LIV_001_0000"):
        scan_in_place_of(Path(f"{name}.nii.gz"))
    labels = np.zeros(grid().shape, np.uint8)
    labels[20:28, 20:28, 8:14], labels[20:28, 20:28, 32:40] = 2, 6
    for name in ("truth.nii.gz", "starts.nii.gz"):
        io.write(Volume(labels, grid()), name)
    organs = np.where(labels == 2, np.uint8(5), labels)
    organs[12:36, 12:36, 12:36] = 5
    io.write(Volume(organs, grid()), "organs.nii.gz")
    points_of_other_programs()
    y, x = np.indices((160, 200))
    io.write(
        Volume((200 * ((x - 120) ** 2 + (y - 80) ** 2 < 30**2)).astype(np.uint8)[None], PLANE),
        "cell.png",
    )
    for folder in ("predicted", "reference"):
        Path(folder).mkdir()
        for name in ("anna", "bert"):
            io.write(Volume(labels, grid()), f"{folder}/{name}.nii.gz")
    for path in (
        Path("scans/anna.nii.gz"),
        Path("scans/bert.nii.gz"),
        Path("converted/SERIES.nii.gz"),
    ):
        path.parent.mkdir(exist_ok=True)
        scan_in_place_of(path)
    z, y, x = np.indices((96, 96, 96)) - 47.5
    store = Geometry((96, 96, 96), (1.0, 1.0, 1.0), origin=(-47.5, -47.5, -47.5))
    io.write(
        Volume((100.0 * (x**2 + y**2 + z**2 < 30**2)).astype(np.float32), store), "ct.ome.zarr"
    )
    study_of_a_reader(Path("study"))
    of_a_microscope()
    tracked_cells()
    moving_cell()
    Path("seeds.csv").write_text("id,x,y,z,r\n1,-12,0,0,6\n2,12,0,0,6\n")
    Path("clicks.csv").write_text(
        "id,x,y,z,r,side\n1,-14,0,0,6,inside\n2,14,0,0,6,inside\n0,-40,-40,-40,4,inside\n"
    )
    first = "segment scan.nii.gz -o out --max-steps 2 --keep-state yes --quiet"
    assert cli.execute(first.split()) == 0
    Path("out/run.toml").write_text("max_steps = 2\n")


def points_of_other_programs():
    """Points in the middle, inside, and far from it, outside."""
    markup = {
        "type": "Fiducial",
        "coordinateSystem": "RAS",
        "controlPoints": [{"position": [1.0, -2.0, 3.0]}],
    }
    Path("F.mrk.json").write_text(json.dumps({"markups": [markup]}))
    Path("G.fcsv").write_text("# CoordinateSystem = LPS\n# columns = id,x,y,z\n1,40,40,0\n")
    Path("points.csv").write_text("index,axis-0,axis-1,axis-2\n0,24,24,24\n")


def moving_cell():
    """A disc that travels around the world's origin through four frames of one slice, and where it is in the last."""
    y, x = np.indices((40, 40)) - 19.5
    plane = Geometry((1, 40, 40), (1.0, 1.0, 1.0), origin=(-19.5, -19.5, 0.0))
    with io.SequenceWriter("moving.nii.gz", plane, (0.0, 1.0, 2.0, 3.0), "s", np.float32) as writer:
        for number in range(4):
            disc = np.hypot(x - number, y) < 8
            noise = np.random.default_rng(number).normal(0, 4, x.shape)
            writer.write(number, (100.0 * disc + noise)[None].astype(np.float32))
    shutil.copy("moving.nii.gz", "echo.nii.gz")
    io.write(Volume(disc[None].astype(np.uint8), plane), "frame3.nii.gz")


def tracked_cells():
    """A tracking of phantoms, and the same as the reference of a challenge."""
    made = dividing_cells()
    with TrackOutputs(Path(), "cells", made.sequence, TrackFiles(also=("ctc",))) as outputs:
        for result in made.results:
            outputs.add(result)
        outputs.finish(made.lineage)
    reference = Path("01_GT/TRA")
    reference.mkdir(parents=True)
    for path in Path("cells_RES").iterdir():
        name = path.name.replace("mask", "man_track").replace("res_track", "man_track")
        (reference / name).write_bytes(path.read_bytes())


def study_of_a_reader(folder):
    """A folder of DICOM with two series; the second is a ball around the world's origin."""
    Series(uid="1.2.1", changes={"SeriesNumber": 1}).stacked(4).write(folder / "thick")
    ball = Series(rows=40, columns=40, spacing=(2.0, 2.0), uid="1.2.2", changes={"SeriesNumber": 2})
    ball.stacked(40, 2.0, (-39.0, -39.0, -39.0))
    for number, position in enumerate(ball.positions):
        one = ball.dataset(number)
        far = np.linalg.norm(ball.points(position), axis=-1)
        one.PixelData = np.where(far < 24, 300, 0).astype(np.int16).tobytes()
        save(one, folder / "thin" / f"{number:03d}.dcm")


def of_a_microscope():
    """A sequence of two channels, slices in a folder, and an array."""
    z, y, x = np.indices((40, 40, 40)) - 19.5
    ball = np.where(x**2 + y**2 + z**2 < 12**2, 200, 20).astype(np.uint8)
    sizes = {f"PhysicalSize{axis}": 1.0 for axis in "XYZ"}
    tifffile.imwrite(
        "cells.ome.tif",
        np.stack([[ball, 255 - ball]] * 2),
        photometric="minisblack",
        metadata={"axes": "TCZYX", "TimeIncrement": 2.0, **sizes},
    )
    Path("slices").mkdir(exist_ok=True)
    ball = np.pad(ball, 4, mode="edge")
    for number, page in enumerate(ball):
        tifffile.imwrite(f"slices/z{number}.tif", page, photometric="minisblack")
    np.save("stack.npy", ball)


PLANE = Geometry((1, 160, 200), (1.0, 1.0, 1.0))
#: A page whose scans come over the network.
FETCHING = "sample-scans"
#: How-to pages with many or long commands.
LONG = ("large-images", "meshes", "movies", "several-objects")
HOW_TO = [
    pytest.param(page, marks=pytest.mark.slow) if page.stem in LONG else page
    for page in sorted((ROOT / "docs" / "how-to").glob("*.md"))
    if CONSOLE.search(page.read_text()) and page.stem != FETCHING
]


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.name)
def test_every_command_of_a_how_to_page_is_accepted(
    page, readers_folder, tmp_path, monkeypatch, capsys
):
    """Each runs for two steps, in place of X,Y,Z with the middle; windows, pages and servers have tests of their own.

    Cases of a batch run in this process.
    """
    shutil.copytree(readers_folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pool, "LocalPool", InlinePool)
    for name, text in FILE.findall(page.read_text(encoding="utf-8")):
        Path(name).write_text(text)
    for words in commands(page):
        words = [word.replace("X,Y,Z", "0,0,0") for word in words]
        target = words.pop(words.index(">") + 1) if ">" in words else None
        words = [word for word in words if word != ">"]
        if (
            words[0] != "accelsurf"
            or words[1] in ("view", "serve")
            or (words[1] == "movie" and not can_draw())
        ):
            continue
        if words[1] != "info" and "--resume" not in words:
            words += ["--overwrite"]
        takes_steps = words[1] in ("segment", "movie") and not Path(words[2]).is_dir()
        if takes_steps or words[1] == "batch":
            words += ["--max-steps", "2"] if "--max-steps" not in words else []
        if words[1] == "movie":
            words += ["--size", "320x180"]
        capsys.readouterr()
        assert cli.execute(words[1:]) == 0, f"{shlex.join(words)}\n{capsys.readouterr().err}"
        if target is not None:
            Path(target).write_text(capsys.readouterr().out)


PYTHON = [
    "README.md",
    *(f"docs/how-to/{name}.md" for name in ("notebooks", "several-objects", "starts-and-regions")),
]


@pytest.mark.parametrize("page", PYTHON)
def test_the_python_of_the_page_runs(page, tmp_path, monkeypatch):
    """But for what opens a window."""
    monkeypatch.chdir(tmp_path)
    scan_in_place_of(Path("scan.nii.gz"))
    names = {}
    for block in re.findall(
        r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL
    ):
        if "plot(" not in block:
            exec(compile(block, page, "exec"), names)
    assert names["result"].stop.reason == "converged"
