"""Sessions that were not saved: what is kept of them, known by their voxels; and whatever else stands in the folder."""

import json
import os
import random
import time

import numpy as np
import psutil
import pytest

from accelsurf import io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.keeping import Keeper
from accelsurf.viewer.actions.opening import Opening
from accelsurf.viewer.core.opening import OpenedImage
from accelsurf.viewer.core.recent_files import RecentFiles
from accelsurf.viewer.core.unsaved import MAX_NOTES, UnsavedSessions, fingerprint
from accelsurf.viewer.window import display


def image(seed=0, shape=(20, 22, 24), **grid):
    z, y, x = np.indices(shape)
    ball = (z - 10) ** 2 + (y - 11) ** 2 + (x - 12) ** 2 < 49
    noise = np.random.default_rng(seed).normal(0, 3, shape)
    return Volume(
        (ball * 100 + noise).astype(np.float32),
        Geometry(shape, **{"spacing": (1.0, 1.0, 1.0), **grid}),
    )


CONFIG = RunConfig(
    start="ball:12,11,10,3",
    smoothness=0.3,
    edit=[{"step": 3, "smoothness": 0.5}],
    refine=[
        {"inside": ["ball:12,11,10,2"]},
        {"outside": ["ball:2,2,2,1"]},
        {"inside": ["point:12,11,10"]},
    ],
)


@pytest.fixture
def sessions(tmp_path):
    return UnsavedSessions(tmp_path / "unsaved")


def end_programs(folder, drop=()):
    """Have all notes be of programs that are no more."""
    for path in folder.glob("*.json"):
        if path not in drop:
            note = json.loads(path.read_text())
            note["process"] = [note["process"][0], note["process"][1] - 1000.0]
            path.write_text(json.dumps(note))


def test_what_is_kept_comes_back(sessions, tmp_path):
    assert sessions.is_empty()
    file, volume = sessions.new_file(), image()
    sessions.store(file, fingerprint(volume), "scan", tmp_path / "scan.nii", CONFIG, 7)
    assert sessions.is_empty()  # this program runs
    end_programs(tmp_path / "unsaved")
    found = sessions.of_image(fingerprint(image()))
    assert found.config == CONFIG and (found.step, found.name) == (7, "scan")
    assert found.path == tmp_path / "scan.nii"
    assert found.line.startswith("scan: 3 clicks of ") and found.line.endswith("were not saved")
    assert file.stat().st_mode & 0o077 == 0 and file.parent.stat().st_mode & 0o077 == 0
    sessions.forget(found.file)
    assert sessions.is_empty()


@pytest.mark.parametrize(
    "other",
    [
        image(seed=1),
        image(origin=(0.0, 0.0, 1e-9)),
        image(spacing=(1.0, 1.0, 1.0 + 1e-12)),
        image(direction=np.diag([1.0, 1.0, -1.0])),
        image().with_array(image().array.astype(np.float64)),
        Volume.from_array(image().array.reshape(22, 20, 24)),
    ],
    ids=["voxels", "origin", "spacing", "direction", "type", "shape"],
)
def test_an_image_is_known_by_its_voxels_and_their_place(other):
    assert fingerprint(other) != fingerprint(image())
    assert fingerprint(image(), [other]) != fingerprint(image())
    transposed = np.ascontiguousarray(image().array.T).T
    assert fingerprint(image().with_array(transposed)) == fingerprint(image())


def test_the_oldest_goes_first(sessions, tmp_path):
    for number in range(MAX_NOTES + 5):
        file = sessions.new_file()
        sessions.store(file, f"image {number}", "scan", None, CONFIG, 0)
        os.utime(file, (1e9 + number, 1e9 + number))
    end_programs(tmp_path / "unsaved")
    assert len(list((tmp_path / "unsaved").iterdir())) == MAX_NOTES
    assert sessions.of_image("image 0") is None


def hostile(drawn, path, good):
    """Put something at a path that is no session of ours, or hardly."""
    kind = drawn.randrange(12)
    note = json.loads(json.dumps(good))
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to("/dev/zero")
    elif kind == 2:
        path.symlink_to(path)
    elif kind == 3:
        path.mkdir()
    elif kind == 4:
        with path.open("wb") as file:
            file.truncate(1 << 34)  # huge, of no bytes on the disk
    elif kind == 5:
        path.write_bytes(drawn.randbytes(drawn.randrange(2000)))
    elif kind == 6:
        path.write_text(drawn.choice("[{") * drawn.randrange(1, 90000))
    elif kind == 7:
        path.write_text(drawn.choice(["", "null", "[]", "{}", "1e999", '"x"', "NaN", "[[1]]"]))
    else:
        odd = [
            None,
            True,
            -5,
            1e308,
            10**30,
            "x" * 9000,
            "\x00",
            "\ud800",
            [],
            {},
            [[]],
            ["a"],
            {"a": 1},
        ]
        odd += [float("nan"), float("inf"), "ball:1", [1, float("nan")], ["1", "2"], [10**40, 0.0]]
        target = note["config"] if drawn.random() < 0.4 else note
        for key in drawn.sample(sorted(target), drawn.randrange(1, 4) if target is note else 1):
            target[key] = drawn.choice(odd)
        if drawn.random() < 0.3:
            note.pop(drawn.choice(sorted(note)))
        path.write_text(json.dumps(note))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize("seed", range(6))
def test_whatever_stands_in_the_folder_the_program_starts(tmp_path, seed):
    drawn = random.Random(seed)
    sessions = UnsavedSessions(tmp_path / "unsaved")
    file = sessions.new_file()
    sessions.store(file, "the image", "scan", tmp_path / "none.nii", CONFIG, 3)
    end_programs(tmp_path / "unsaved")
    good = json.loads(file.read_text())
    for number in range(30):
        hostile(drawn, file.with_name(f"{number:016x}.json"), good)
    hostile(drawn, tmp_path / "recent.json", good)
    began = time.monotonic()
    opening = Opening(RunConfig(), RecentFiles(tmp_path / "recent.json"))
    for _ in range(3):
        assert opening.fetch() is None
    assert opening.state()["recent"] is not None and time.monotonic() - began < 10.0
    assert sessions.of_image("the image") is not None
    opening.close()


@pytest.mark.parametrize("there", ["a file", "a link to nothing", "a link to a file"])
def test_a_folder_that_is_none_is_no_error(tmp_path, there):
    folder = tmp_path / "unsaved"
    if there == "a file":
        folder.touch()
    else:
        (tmp_path / "a").touch()
        folder.symlink_to(tmp_path / there[-1:].replace("g", "none").replace("e", "a"))
    assert UnsavedSessions(folder).is_empty()
    opening = Opening(RunConfig(), RecentFiles(tmp_path / "recent.json"))
    assert opening.fetch() is None and not opening.failed


def test_a_path_that_is_too_long_is_listed_as_one_that_is_not_there(tmp_path):
    (tmp_path / "recent.json").write_text(json.dumps(["/" + "a" * 300, "/b"]))
    found = RecentFiles(tmp_path / "recent.json").entries()
    assert [one.exists for one in found] == [False, False]


# ------------------------------------------------------------------------------------------------------------- keeper


class Shown:
    """What a keeper needs of the actions: the session, and whether something is unsaved."""

    def __init__(self, session):
        self.session, self.notes = session, []
        self.files = FilesFeature(self)

    def feature(self, kind):
        return self.files

    def note(self, line, seconds=8.0):
        self.notes.append(line)


def kept_by(sessions, opened, work):
    """Do something in a session that is being kept, and end the program."""
    with opened.session() as session:
        keeper = Keeper(sessions, Shown(session), opened)
        session.ready.result(120)
        work(session)
        assert session.wait(120)
        keeper.store(at_once=True)
        end_programs(sessions.new_file().parent)
        return keeper, session.status, sessions.of_image(fingerprint(opened.volume))


def went_on(session):
    session.play(3).result()
    session.wait(120)
    session.add_click("inside", "ball:12,11,10,2").result(120)
    session.play(5).result()


def ended(session):
    session.play().result()
    assert session.wait(120)
    session.add_click("outside", "ball:12,11,16,1").result(120)


def clicked(session):
    session.add_click("inside", "ball:12,11,10,2").result(120)
    session.wait(120)


@pytest.mark.parametrize("work", [went_on, ended, clicked])
def test_the_next_start_goes_on_where_the_last_one_was(sessions, work):
    volume = image()
    config = (
        RunConfig(max_steps=8)
        if work is clicked
        else RunConfig(start="ball:12,11,10,3", max_steps=8)
    )
    opened = OpenedImage(volume, config, "scan")
    _, before, found = kept_by(sessions, opened, work)
    again = OpenedImage(volume, found.config, "scan", unsaved=found)
    keeper, after, later = kept_by(sessions, again, lambda session: None)
    assert not after.failed, after.message
    assert (after.step, after.refinements) == (before.step, before.refinements)
    assert after.edits == before.edits and after.settings.at(0) == before.settings.at(0)
    assert (after.stop is None) == (before.stop is None)
    assert keeper.is_stored and later.file == found.file  # it is not saved yet


def test_nothing_is_kept_of_a_session_in_which_nothing_was_done_or_undone_again(sessions):
    opened = OpenedImage(image(), RunConfig(start="ball:12,11,10,3"), "scan")
    keeper, _, found = kept_by(sessions, opened, lambda session: None)
    assert found is None and not keeper.is_stored

    def undone(session):
        session.change(smoothness=0.7).result()
        session.undo().result()

    assert kept_by(sessions, opened, undone)[2] is None


def test_a_result_that_is_made_again_is_unsaved_when_it_is_changed(sessions):
    opened = OpenedImage(
        image(), RunConfig(start="ball:12,11,10,3", max_steps=4), "scan", is_result=True
    )
    _, status, found = kept_by(sessions, opened, lambda session: session.wait(120))
    assert status.stop is not None and found is None
    _, _, found = kept_by(sessions, opened, ended)
    assert found is not None and found.config.refine


def test_what_cannot_be_kept_is_said_once(tmp_path):
    (tmp_path / "unsaved").touch()
    opened = OpenedImage(image(), RunConfig(start="ball:12,11,10,3"), "scan")
    with opened.session() as session:
        shown = Shown(session)
        keeper = Keeper(UnsavedSessions(tmp_path / "unsaved"), shown, opened)
        for step in (1, 2):
            session.play(step).result(120)
            session.wait(120)
            keeper.store(at_once=True)
    assert not keeper.is_stored and len(shown.notes) == 1
    assert shown.notes[0].startswith("unsaved clicks cannot be kept for the next start")


def test_in_private_nothing_is_kept(tmp_path):
    sessions = RecentFiles(None).unsaved
    assert not sessions.keeps and sessions.is_empty()
    opened = OpenedImage(image(), RunConfig(start="ball:12,11,10,3"), "scan")
    with opened.session() as session:
        shown = Shown(session)
        keeper = Keeper(sessions, shown, opened)
        session.play(1).result(120)
        session.wait(120)
        keeper.store(at_once=True)
        assert keeper.found() is None and not keeper.is_stored and not shown.notes


# --------------------------------------------------------------------------------------------------------- start page


def test_the_start_page_offers_what_was_not_saved_unless_the_image_has_changed(tmp_path):
    path = tmp_path / "scan.nii"
    io.write(image(), path)
    recent = RecentFiles(tmp_path / "recent.json")
    sessions, read = recent.unsaved, io.read(path)
    sessions.store(sessions.new_file(), fingerprint(read), "scan", path, CONFIG, 3)
    end_programs(tmp_path / "unsaved")
    opening = Opening(RunConfig(), recent)
    opening.fetch()
    assert opening.state()["question"].startswith("scan: 3 clicks of")
    assert [name for name, _ in opening.state()["answers"]] == ["resume", "discard", "later"]
    opening.request("answer", "resume")
    found = waited(opening)
    assert found.config == CONFIG and found.unsaved.step == 3 and found.source == path
    io.write(image(seed=5), path)
    opening = Opening(RunConfig(), recent)
    opening.fetch()
    opening.request("answer", "resume")
    assert waited(opening) is None and "has changed since it was clicked" in opening.message
    assert len(list((tmp_path / "unsaved").iterdir())) == 1
    opening = Opening(RunConfig(), recent)
    opening.fetch()
    opening.request("answer", "discard")
    opening.fetch()
    assert not list((tmp_path / "unsaved").iterdir()) and opening.state()["question"] == ""


def waited(opening):
    end = time.monotonic() + 60
    while opening.is_busy:
        assert time.monotonic() < end
        if (found := opening.fetch()) is not None:
            return found
        time.sleep(0.01)
    return None


def test_of_a_missing_image_nothing_is_offered_nor_of_one_outside_of_the_served_folder(tmp_path):
    from accelsurf.viewer.core.opening import ServedFolder

    recent = RecentFiles(tmp_path / "recent.json")
    (tmp_path / "served").mkdir()
    path = tmp_path / "scan.nii"
    recent.unsaved.store(recent.unsaved.new_file(), "an image", "scan", path, CONFIG, 3)
    end_programs(tmp_path / "unsaved")
    opening = Opening(RunConfig(), recent)
    opening.fetch()
    assert opening.state()["question"] == ""
    io.write(image(), path)
    opening = Opening(RunConfig(), recent, ServedFolder(tmp_path / "served"))
    opening.fetch()
    assert opening.state()["question"] == ""


def test_the_process_of_a_note_is_this_one(sessions, tmp_path):
    sessions.store(sessions.new_file(), "an image", "scan", None, CONFIG, 0)
    (file,) = (tmp_path / "unsaved").iterdir()
    pid, began = json.loads(file.read_text())["process"]
    assert (pid, began) == (os.getpid(), psutil.Process().create_time())


@pytest.mark.parametrize("seed", range(20))
def test_the_reason_that_qt_gives_is_cut_between_words(seed):
    drawn = random.Random(seed)
    words = ["w" * drawn.randrange(1, 14) + str(number) for number in range(drawn.randrange(60))]
    said = display.shortened("qt.qpa.xcb: " + " ".join(words))
    kept = said.removesuffix(" ...").split()
    assert len(said) <= 160 and (kept == words[: len(kept)] or said == "Qt gives no reason")
    assert said.endswith("...") or len(kept) == len(words) or not words
