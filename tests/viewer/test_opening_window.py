"""The start page and the opening of images in the window, driven for real: Xvfb, xdotool."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import io
from accelsurf.image.volume import Volume
from tests.support.dicom_series import Series
from tests.viewer.test_desktop import ROOT, Person, needs_screen, screen  # noqa: F401

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture
def images(tmp_path):
    """Two images, labels of the first, a file that is none; a study in DICOM of two series."""
    z, y, x = np.indices((20, 24, 28))
    inside = (z - 10) ** 2 + (y - 12) ** 2 + (x - 14) ** 2 < 64
    volume = Volume.from_array((inside * 100).astype(np.float32))
    io.write(volume, tmp_path / "first.nii.gz")
    io.write(volume.with_array(inside.astype(np.uint8)), tmp_path / "labels.nii.gz")
    io.write(Volume.from_array((inside[:, :, :20] * 50).astype(np.int16)), tmp_path / "second.nrrd")
    (tmp_path / "broken.nii").write_bytes(b"nothing that is an image" * 30)
    for number, columns in ((1, 9), (2, 12)):
        series = Series(
            rows=10, columns=columns, uid=f"1.2.3.{number}", changes={"SeriesNumber": number}
        )
        series.stacked(6).write(tmp_path / "study" / str(number))
    return tmp_path


class Visitor(Person):
    """Hands at the window that opens images."""

    def __init__(self, screen, folder, **options):  # noqa: F811
        self.env = {
            **os.environ,
            "DISPLAY": screen,
            "QT_QPA_PLATFORM": "xcb",
            "QT_SCALE_FACTOR": "1",
        }
        self.state_file, self.folder = folder / "state.json", folder
        words = [f"{key}={value}" for key, value in {"threads": "1", **options}.items()]
        driver = ROOT / "tests" / "support" / "opening_driver.py"
        self.process = subprocess.Popen(
            [
                sys.executable,
                str(driver),
                str(self.state_file),
                str(folder / "recent.json"),
                *words,
            ],
            env=self.env,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.until(lambda now: now["title"] == "accelsurf", 180)
        self.focus()

    def focus(self):
        """What a window manager does, which this screen has not."""
        self.do(
            "search", "--sync", "--onlyvisible", "--name", "^accelsurf", "windowfocus", "--sync"
        )

    def click(self, name):
        x, y = self.until(lambda now: name in now["places"])["places"][name]
        self.do("mousemove", str(x), str(y), "sleep", "0.2", "click", "1")

    def type_path(self, path):
        """Type into the dialog that opens."""
        self.do(
            "search", "--sync", "--onlyvisible", "--name", "Open|Labels", "windowfocus", "--sync"
        )
        self.do("sleep", "0.3", "type", "--delay", "2", str(path))
        self.do("sleep", "0.3", "key", "Return")

    def drop(self, *paths):
        source = subprocess.Popen(
            [sys.executable, str(ROOT / "tests" / "support" / "drag_source.py"), *map(str, paths)],
            env=self.env,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert source.stdout.readline() == "shown\n"
        self.do("search", "--sync", "--onlyvisible", "--name", "drag source")
        x, y = self.now()["places"]["middle"]
        self.do("mousemove", "1230", "670", "sleep", "0.3", "mousedown", "1", "sleep", "0.3")
        for share in (0.3, 0.6, 0.9, 1.0):
            place = [str(round(a + share * (b - a))) for a, b in ((1230, x), (670, y))]
            self.do("mousemove", *place, "sleep", "0.2")
        self.do("mouseup", "1")
        assert source.stdout.readline() == "dropped CopyAction\n"
        self.do("sleep", "0.5")
        source.terminate()
        source.communicate(timeout=20)
        self.focus()

    def until_open(self, name):
        return self.until(lambda now: now.get("name") == name, 120)

    def close(self):
        self.focus()
        self.key("ctrl+q")
        assert self.process.communicate(timeout=60)[0].strip().endswith("closed")


@pytest.fixture
def visitor(screen, images):  # noqa: F811
    made = Visitor(screen, images, result=images / "out")
    yield made
    if made.process.poll() is None:
        made.process.kill()
        made.process.communicate()


@needs_screen
def test_a_phantom_then_a_file_then_another_with_questions(visitor, images):
    names = [one["name"] for one in visitor.now()["opening"]["phantoms"]]
    visitor.click(f"phantoms-{names.index('ball_small')}")
    now = visitor.until_open("ball_small")
    assert now["dice"] > 0.5 and now["shape"] == [32, 32, 32]
    # Nothing was done: nothing is asked.
    visitor.focus()
    visitor.key("ctrl+o")
    visitor.type_path(images / "first.nii.gz")
    now = visitor.until_open("first")
    assert (
        now["dice"] is None and now["title"].startswith("accelsurf - first") and now["dialog"] == ""
    )
    visitor.focus()
    visitor.key("ctrl+r")
    visitor.type_path(images / "labels.nii.gz")
    assert visitor.until(lambda now: now["dice"])["dice"] > 0.3
    visitor.focus()
    visitor.key("Right")
    visitor.until(lambda now: now["step"] == 1)
    visitor.key("ctrl+o")
    visitor.type_path(images / "second.nrrd")
    now = visitor.until(lambda now: now["dialog"])
    assert now["dialog"] == "Open second.nrrd; what was done here and is not saved will be lost?"
    visitor.click("answer-cancel")
    assert visitor.until(lambda now: not now["dialog"])["name"] == "first"
    visitor.focus()
    visitor.key("ctrl+o")
    visitor.type_path(images / "second.nrrd")
    visitor.click("answer-open")
    now = visitor.until_open("second")
    assert (
        now["step"] == 0
        and now["shape"] == [20, 24, 20]
        and now["folder"] == str(images / "out" / "second-3")
    )
    visitor.close()
    recent = json.loads((images / "recent.json").read_text())
    assert recent == [str(images / "second.nrrd"), str(images / "first.nii.gz")]


@needs_screen
def test_what_cannot_be_opened_leaves_the_image(visitor, images):
    visitor.click("open_file")
    visitor.type_path(images / "broken.nii")
    now = visitor.until(lambda now: now["message"].startswith("Error"))
    assert "broken.nii" in now["message"] and "\n" not in now["message"] and "name" not in now
    visitor.drop(images / "first.nii.gz")
    visitor.until_open("first")
    visitor.drop(images / "broken.nii")
    assert visitor.until(lambda now: now["dialog"])["dialog"] == "Open broken.nii?"
    visitor.click("answer-open")
    now = visitor.until(lambda now: "broken.nii" in now["message"])
    assert now["name"] == "first" and now["alive"] and now["message"].startswith("Error: ")
    visitor.drop(images / "labels.nii.gz")
    visitor.click("answer-reference")
    visitor.until(lambda now: now["dice"])
    visitor.drop(images / "first.nii.gz", images / "second.nrrd")
    assert (
        "2 files were dropped" in visitor.until(lambda now: "dropped" in now["message"])["message"]
    )
    visitor.close()


@needs_screen
def test_one_of_several_in_a_folder_of_dicom(visitor, images):
    visitor.drop(images / "study")
    now = visitor.until(lambda now: now["opening"]["choices"])
    assert (
        len(now["opening"]["choices"]) == 2 and "12 x 10 x 6 voxels" in now["opening"]["choices"][1]
    )
    visitor.click("choice-1")
    visitor.click("open")
    now = visitor.until_open("study")
    assert now["shape"] == [6, 10, 12] and now["settings"]["series"] == "2"
    visitor.close()
