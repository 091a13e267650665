"""The end of the window, driven for real: by each way of closing it, and by signals; what is kept, and offered next."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from accelsurf import io
from accelsurf.image.volume import Volume
from tests.support.window_manager import ask_to_close
from tests.viewer.test_desktop import ROOT, needs_screen, screen  # noqa: F401
from tests.viewer.test_opening_window import Visitor

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), needs_screen]

QUESTION = "Save what was done in first?"


@pytest.fixture
def images(tmp_path):
    z, y, x = np.indices((20, 24, 28))
    inside = (z - 10) ** 2 + (y - 12) ** 2 + (x - 14) ** 2 < 64
    io.write(Volume.from_array((inside * 100).astype(np.float32)), tmp_path / "first.nii.gz")
    # By the list, not by a dialog: nothing that is typed is lost on a loaded machine.
    (tmp_path / "recent.json").write_text(json.dumps([str(tmp_path / "first.nii.gz")]))
    return tmp_path


class Leaver(Visitor):
    """Hands that close the window."""

    def open_first(self):
        self.click("recent-0")
        self.until(lambda now: now.get("name") == "first" and now["ready"], 120)
        self.focus()

    def leave(self, way):
        self.focus()
        if way == "key":
            self.key("ctrl+q")
        elif way == "menu":
            self.do("key", "alt+f", "sleep", "0.5", "key", "Up", "sleep", "0.3", "key", "Return")
        else:
            found = subprocess.run(
                ["xdotool", "search", "--onlyvisible", "--name", "^accelsurf"],
                env=self.env,
                capture_output=True,
                text=True,
                check=True,
            )
            ask_to_close(self.env["DISPLAY"], int(found.stdout.split()[0]))

    def ended(self):
        said = self.process.communicate(timeout=120)[0].strip()
        assert said.endswith("closed") and "Traceback" not in said and self.process.returncode == 0

    def kept(self):
        return sorted((self.folder / "unsaved").glob("*.json"))


@pytest.fixture
def leaver(screen, images):  # noqa: F811
    made = []

    def begin(**options):
        made.append(Leaver(screen, images, start="ball:14,12,10,3", **options))
        return made[-1]

    yield begin
    for one in made:
        if one.process.poll() is None:
            one.process.kill()
            one.process.communicate()


WAYS = ("key", "cross", "menu")


@pytest.mark.parametrize("way", WAYS)
def test_nothing_is_asked_where_nothing_was_done_or_all_is_saved(leaver, images, way):
    person = leaver(result=images / "out")
    person.open_first()
    person.leave(way)
    person.ended()
    person = leaver(result=images / "out")
    person.open_first()
    person.key("Right")
    person.until(lambda now: now["step"] == 1)
    person.key("ctrl+s")
    person.until(lambda now: now["message"].startswith("saved in"))
    person.leave(way)
    person.ended()
    assert person.kept() == [] and (images / "out" / "first_seg.nii.gz").exists()


@pytest.mark.parametrize("way", WAYS)
def test_what_is_not_saved_is_asked_about(leaver, images, way):
    person = leaver(result=images / "out")
    person.open_first()
    person.key("Right")
    person.until(lambda now: now["step"] == 1)
    for answer in ("answer-cancel", "Escape"):
        person.leave(way)
        assert person.until(lambda now: now["dialog"])["dialog"] == QUESTION
        if answer == "Escape":
            person.do("search", "--sync", "--onlyvisible", "--name", "^accelsurf$", "windowfocus")
            person.key("Escape")
        else:
            person.click(answer)
        now = person.until(lambda now: not now["dialog"])
        assert now["alive"] and now["step"] == 1
    assert len(person.kept()) == 1  # also a kill would lose nothing
    person.leave(way)
    person.until(lambda now: now["dialog"])
    person.click("answer-save")
    person.ended()
    assert (images / "out" / "first_seg.nii.gz").exists() and person.kept() == []


@pytest.mark.parametrize("way", WAYS)
def test_what_is_discarded_is_gone(leaver, images, way):
    person = leaver(result=images / "out")
    person.open_first()
    person.key("Right")
    person.until(lambda now: now["step"] == 1)
    person.leave(way)
    person.until(lambda now: now["dialog"])
    person.click("answer-discard")
    person.ended()
    assert person.kept() == [] and not (images / "out").exists()


def test_a_save_that_fails_leaves_the_window_open(leaver, images):
    (images / "out").write_text("a file where the folder should be")
    person = leaver(result=images / "out")
    person.open_first()
    person.key("space")  # the run moves
    person.until(lambda now: now["step"] >= 1)
    person.leave("cross")
    person.until(lambda now: now["dialog"])
    person.click("answer-save")
    now = person.until(lambda now: not now["dialog"] and "cannot be written to" in now["message"])
    assert now["alive"]
    (images / "out").unlink()
    person.leave("cross")
    assert person.until(lambda now: now["dialog"])["dialog"] == QUESTION
    person.click("answer-save")
    person.ended()
    assert (images / "out" / "first_seg.nii.gz").exists()


@pytest.mark.parametrize("end", ["kill", "signal"])
def test_what_was_not_saved_is_offered_at_the_next_start(leaver, images, end):
    person = leaver(result=images / "out")
    person.open_first()
    for _ in range(2):
        person.key("Right")
    before = person.until(lambda now: now["step"] == 2)
    end_by = time.monotonic() + 30
    while not person.kept() or json.loads(person.kept()[0].read_text())["step"] != 2:
        assert time.monotonic() < end_by  # a step is noted within seconds
        time.sleep(0.2)
    person.process.kill()
    person.process.communicate()
    # The start page offers it; not now: it is offered again with the image, whatever its name.
    (images / "renamed.nii.gz").write_bytes((images / "first.nii.gz").read_bytes())
    (images / "recent.json").write_text(json.dumps([str(images / "renamed.nii.gz")]))
    person = leaver(result=images / "out")
    now = person.until(lambda now: now["dialog"])
    assert now["dialog"].startswith("first: ") and "was not saved. Go on with it?" in now["dialog"]
    person.click("answer-later")
    person.until(lambda now: not now["dialog"])
    person.click("recent-0")
    person.until(lambda now: now["dialog"], 120)
    if end == "kill":
        person.click("answer-resume")
        now = person.until(lambda now: now.get("step") == 2 and now["drawn"], 120)
        assert now["settings"] == before["settings"] and now["folder"] == str(images / "out")
        person.leave("cross")
        person.until(lambda now: now["dialog"])
        person.click("answer-save")
    else:
        person.click("answer-discard")
        person.until(lambda now: not now["dialog"])
        person.leave("cross")
    person.ended()
    assert person.kept() == []


# ----------------------------------------------------------------------------------------------------------- signals


class Program:
    """The command itself; the title of its window says where it stands."""

    def __init__(self, screen, folder, *options):  # noqa: F811
        self.env = {
            **os.environ,
            "DISPLAY": screen,
            "QT_QPA_PLATFORM": "xcb",
            "XDG_STATE_HOME": str(folder / "state"),
        }
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, "-m", "accelsurf", "view", *options],
            env=self.env,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def do(self, *words):
        return subprocess.run(
            ["xdotool", *words], env=self.env, timeout=60, capture_output=True, text=True
        ).stdout.split()

    def until_titled(self, pattern, seconds=180):
        end = time.monotonic() + seconds
        while not (found := self.do("search", "--onlyvisible", "--name", pattern)):
            assert self.process.poll() is None, self.process.communicate()[0]
            assert time.monotonic() < end, pattern
            time.sleep(0.2)
        self.do("windowfocus", "--sync", found[-1])
        time.sleep(0.5)

    def signalled(self, number):
        """What is printed after a signal to all its processes, as a terminal sends it."""
        began = time.monotonic()
        os.killpg(self.process.pid, number)
        said = self.process.communicate(timeout=60)[0]
        assert "Traceback" not in said and self.process.returncode == 128 + number, said
        assert time.monotonic() - began < 30
        return said.splitlines()

    def kept(self):
        return sorted((self.folder / "state" / "accelsurf" / "unsaved").glob("*.json"))


@pytest.fixture
def program(screen, images):  # noqa: F811
    made = []

    def begin(*options):
        made.append(Program(screen, images, *options))
        return made[-1]

    yield begin
    for one in made:
        if one.process.poll() is None:
            one.process.kill()
            one.process.communicate()


SIGNALS = (signal.SIGINT, signal.SIGTERM)
START = ("--start", "ball:14,12,10,3")
KEPT = "interrupted: what was not saved of first is kept: the next accelsurf view offers it"


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("at", ["start page", "image", "step", "run", "folder dialog", "question"])
def test_a_signal_ends_it_in_order(program, images, number, at):
    if at == "start page":
        one = program()
        one.until_titled("^accelsurf$")
        assert one.signalled(number) == ["interrupted: nothing was unsaved"]
        return
    slow = ("--max-steps", "100000", "--cfl", "0.001") if at == "run" else ()
    one = program(str(images / "first.nii.gz"), *START, *slow)
    one.until_titled("first - step 0 - paused")
    if at == "image":
        assert one.signalled(number) == ["interrupted: nothing was unsaved"]
        return
    one.do("key", "space" if at == "run" else "Right")
    one.until_titled("step [1-9][0-9]* - " + ("running" if at == "run" else "paused"))
    if at == "folder dialog":
        one.do("key", "ctrl+s")
        one.until_titled("^Save labels")
    if at == "question":
        one.do("key", "ctrl+q")
        one.until_titled("^accelsurf$")
    assert one.signalled(number) == [KEPT]
    (kept,) = one.kept()
    assert json.loads(kept.read_text())["step"] >= 1 and kept.stat().st_mode & 0o077 == 0


def test_a_note_of_a_window_that_is_open_is_not_offered_to_another(program, images):
    first = program(str(images / "first.nii.gz"), *START)
    first.until_titled("first - step 0 - paused")
    first.do("key", "Right")
    first.until_titled("step 1 - paused")
    second = program()
    second.until_titled("^accelsurf$")
    time.sleep(2.0)
    found = second.do("search", "--onlyvisible", "--name", "^accelsurf$")
    assert len(found) == 1  # the start page, and no question
    assert second.signalled(signal.SIGTERM) == ["interrupted: nothing was unsaved"]
    assert first.signalled(signal.SIGTERM) == [KEPT]
