"""Names of files that are odd, and data files that a header names in other folders."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError, OutputError
from accelsurf.image.volume import Volume
from accelsurf.io import channels
from accelsurf.output import document
from accelsurf.output import folder as output_folder
from accelsurf.output.pictures import canvas
from accelsurf.settings.file_formats import image_suffixes
from accelsurf.text.starts import parse_start

VALUES = np.arange(120, dtype=np.int16).reshape(4, 5, 6)
BAD = os.fsdecode(b"scan\xff\xfe")


def volume():
    return Volume.from_array(VALUES)


@pytest.mark.parametrize("suffix", image_suffixes())
def test_names_that_are_not_utf8_are_refused_by_name(tmp_path, suffix):
    """ITK ended the process."""
    path = tmp_path / f"{BAD}{suffix}"
    path.write_bytes(b"x" * 500)
    with pytest.raises(InputError, match="not valid UTF-8") as caught:
        io.read(path)
    assert caught.value.hint
    with pytest.raises(InputError, match="not valid UTF-8"):
        io.write(volume(), path)


def test_the_command_line_survives_a_name_that_is_not_utf8(tmp_path):
    (tmp_path / f"{BAD}.nii").write_bytes(b"x" * 500)
    words = ["segment", f"{BAD}.nii", "-o", "out"]
    done = subprocess.run(
        [sys.executable, "-m", "accelsurf", *words], cwd=tmp_path, capture_output=True, timeout=120
    )
    assert (
        done.returncode == 3
        and b"not valid UTF-8" in done.stderr
        and b"Traceback" not in done.stderr
    )
    for path in (tmp_path / "out").glob("*.json"):
        assert "UTF-8" in json.loads(path.read_text())["error"]["message"]


def test_a_folder_for_outputs_that_is_not_utf8_is_refused_before_the_run(tmp_path):
    with pytest.raises(OutputError, match="the name of the folder is not valid UTF-8"):
        output_folder.make_writable(tmp_path / BAD)
    assert list(tmp_path.iterdir()) == []


def test_a_report_holds_any_name():
    text = document.report_json({"path": BAD})
    assert json.loads(text.encode("utf-8").decode("utf-8"))["path"] == BAD


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha", ".mhd", ".tif"])
@pytest.mark.parametrize("letter", ["a", "\u65e5"])
def test_long_names_are_written_and_read(tmp_path, suffix, letter):
    """As long as the file system allows: 255 bytes, here with room for the .zraw of an .mhd."""
    stem = letter * ((249 - len(suffix)) // len(letter.encode()))
    io.write(volume(), tmp_path / f"{stem}{suffix}")
    np.testing.assert_array_equal(io.read(tmp_path / f"{stem}{suffix}").array, VALUES)
    back = io.read(tmp_path / f"{stem}{suffix}")
    io.write(back, tmp_path / f"{stem}{suffix}")  # with the fields of its header


def test_a_name_too_long_for_the_outputs_is_refused_before_the_run(tmp_path):
    paths = {"report": tmp_path / ("\u65e5" * 82 + "_report.json")}
    with pytest.raises(OutputError, match="258 bytes, at most 255"):
        output_folder.refuse_existing(paths, overwrite=False)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.nii")
    with pytest.raises(InputError, match="pipe"):
        io.read(tmp_path / "a.nii")


@pytest.mark.parametrize(
    ("text", "file", "ids"),
    [
        ("label:a@2.nii", "a@2.nii", ()),
        ("label:a@2.nii@3,5-9", "a@2.nii", ((3, 3), (5, 9))),
        ("label:c:d.nii.gz@7", "c:d.nii.gz", ((7, 7),)),
        ("label:a@b@2.nrrd", "a@b@2.nrrd", ()),
        ("label:map.nii@2", "map.nii", ((2, 2),)),
    ],
)
def test_file_names_with_an_at_or_a_colon(text, file, ids):
    start = parse_start(text)
    assert (start.file, start.ids) == (file, ids)


@pytest.mark.parametrize(
    "title",
    ["\u65e5\u672c\u8a9e: converged", "a$\\frac$b", BAD, "tab\tand\x07bell", "\u0939\u093f"],
)
def test_any_name_is_drawn_without_a_warning(title):
    # Warnings are errors in these tests.
    picture = canvas.Canvas(300, 200, title).png()
    assert picture.startswith(b"\x89PNG")


# ------------------------------------------------------------------------------------------- data in other folders

HEADER = (
    "ObjectType = Image\nNDims = 3\nBinaryData = True\nDimSize = 6 5 4\nElementType = MET_SHORT\n"
    "ElementDataFile = {}\n"
)
NRRD = "NRRD0004\ntype: short\ndimension: 3\nsizes: 6 5 4\nendian: little\nencoding: raw\ndata file: {}\n\n"


@pytest.fixture
def folders(tmp_path):
    """A folder for headers, with voxels in it, below it and outside of it."""
    here = tmp_path / "here"
    (here / "below").mkdir(parents=True)
    for folder in (tmp_path, here, here / "below"):
        (folder / "voxels.raw").write_bytes(VALUES.tobytes())
    (here / "link.raw").symlink_to(tmp_path / "voxels.raw")
    return here


def header(folder, suffix, data):
    path = folder / f"a{suffix}"
    path.write_text((HEADER if suffix == ".mhd" else NRRD).format(data))
    return path


@pytest.mark.parametrize("suffix", [".mhd", ".nrrd"])
@pytest.mark.parametrize("name", ["voxels.raw", "below/voxels.raw", "./voxels.raw"])
def test_data_within_the_folder_are_read(folders, suffix, name):
    np.testing.assert_array_equal(io.read(header(folders, suffix, name)).array, VALUES)


@pytest.mark.parametrize("suffix", [".mhd", ".nrrd"])
@pytest.mark.parametrize(
    "name", ["../voxels.raw", "{top}/voxels.raw", "link.raw", "below/../../voxels.raw"]
)
def test_data_outside_of_the_folder_are_refused(folders, suffix, name):
    path = header(folders, suffix, name.format(top=folders.parent))
    for read in (io.read, channels.read_channels):
        with pytest.raises(InputError, match="outside of its own folder") as caught:
            read(path)
        assert "copy it" in caught.value.hint


def test_a_header_that_is_a_link_finds_the_data_beside_it(folders, tmp_path):
    header(folders, ".mhd", "voxels.raw")
    (tmp_path / "elsewhere").mkdir()
    for name in ("a.mhd", "voxels.raw"):
        (tmp_path / "elsewhere" / name).symlink_to(folders / name)
    np.testing.assert_array_equal(io.read(tmp_path / "elsewhere" / "a.mhd").array, VALUES)


def test_a_user_without_a_home():
    """No HOME, and an id that no list of users has: neither a folder of settings nor one of compiled code."""
    program = (
        "import pwd\n"
        "def unknown(uid): raise KeyError(uid)\n"
        "pwd.getpwuid = unknown\n"
        "import accelsurf.kernels._jit as j, accelsurf.output.pictures.canvas as c\n"
        "c.Canvas(20, 20, 'a').png(); print('fine')"
    )
    environment = {
        k: v
        for k, v in os.environ.items()
        if k not in ("HOME", "NUMBA_CACHE_DIR", "MPLCONFIGDIR", "USER")
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.stdout, done.stderr) == ("fine\n", "")
