"""Sets of files: a process that is killed at any point, a move that fails at any point, folders of somebody else."""

import errno
import hashlib
import json
import os
import random
import signal
import sys
import warnings
from pathlib import Path

import pytest

from accelsurf.errors import AccelsurfWarning, OutputError
from accelsurf.io import file_set, seals
from accelsurf.io.file_set import is_unfinished, open_set, recover, refuse_unfinished
from accelsurf.io.files import write_bytes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")

REPORT = "scan_report.json"
OLD = {
    "scan_seg.nii": b"old labels",
    "scan_surface.ply": b"old mesh",
    "scan_trace.csv": b"old trace",
}
NEW = {
    "scan_seg.nii": b"new labels",
    "scan_surface.stl": b"new mesh",
    "scan_trace.csv": b"new trace",
}
#: What changes a folder, or makes sure that a change is on the disk: the process dies before the n-th call of them.
CALLS = ("replace", "rename", "unlink", "rmdir", "mkdir", "fsync", "open")


@pytest.fixture(autouse=True)
def only_the_key_stays(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
        assert set(os.listdir(seals.state_folder())) <= {"seal.key"}


def report(files):
    """A report that names files by their checksums."""
    return json.dumps(
        {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    ).encode()


def content(folder):
    """All that is seen in a folder."""
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")
    }


def filled(folder):
    folder.mkdir()
    for name, text in {**OLD, REPORT: report(OLD), "other.txt": b"somebody's"}.items():
        (folder / name).write_bytes(text)
    return folder


def write_new(folder, mend=False):
    with open_set(folder, "scan", mend=mend) as files:
        for name, text in NEW.items():
            (files.staging / name).write_bytes(text)
        (files.staging / REPORT).write_bytes(report(NEW))
        files.commit(last=REPORT, remove=["scan_surface.ply", "never_there"])


BEFORE = {**OLD, REPORT: report(OLD), "other.txt": b"somebody's"}
AFTER = {**NEW, REPORT: report(NEW), "other.txt": b"somebody's"}


def counted(real, left):
    """A function that kills its process at one of its calls, or at one of those that share the counter."""

    def call(*args, **kwargs):
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1
        return real(*args, **kwargs)

    return call


def dying_child(work, call):
    """Do some work in another process that is killed before its n-th change; return whether it was."""
    child = os.fork()
    if child == 0:
        left = [call]
        seals.unavailable()  # the key is made
        for name in CALLS:
            setattr(os, name, counted(getattr(os, name), left))
        try:
            work()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def is_whole(found):
    """Test if the files of a folder are those that its report names."""
    names = json.loads(found[REPORT])
    return {name: hashlib.sha256(found[name]).hexdigest() for name in names} == names


def named_as_unfinished(folder):
    """Test if readers and writers refuse an unfinished set, without any change, and say what to do."""
    before = folder_contents(folder)
    for refused in (lambda: refuse_unfinished(folder), lambda: write_new(folder)):
        with pytest.raises(OutputError, match="scan: is unfinished") as said:
            refused()
        assert "--overwrite" in said.value.hint
    assert is_unfinished(folder, "scan") and folder_contents(folder) == before
    return True


def test_a_kill_at_any_point_leaves_all_old_or_all_new_or_a_set_without_a_report(tmp_path):
    seen = set()
    for call in range(1000):
        folder = filled(tmp_path / str(call))
        if not dying_child(lambda folder=folder: write_new(folder), call):
            break
        found = content(folder)
        if REPORT in found:  # without the next command
            assert is_whole(found), call
        if recover(folder):
            assert REPORT not in found or found == BEFORE, call
            assert content(folder) == found and named_as_unfinished(folder)
            seen.add("unfinished")
            write_new(folder, mend=True)
        else:
            assert content(folder) in (BEFORE, AFTER), call
            seen.add("old" if content(folder) == BEFORE else "new")
        assert not list(folder.glob(".*")) and not is_unfinished(folder, "scan"), call
        assert content(folder) in (BEFORE, AFTER), call
    assert call > 20 and seen == {"old", "unfinished", "new"}
    assert content(folder) == AFTER


def test_a_kill_while_an_unfinished_set_is_mended(tmp_path):
    left = killed_in_mid_move(tmp_path / "first")
    for call in range(1000):
        folder = tmp_path / str(call)
        killed_in_mid_move(tmp_path / f"parts {call}").parent.rename(folder)
        killed = dying_child(lambda folder=folder: write_new(folder, mend=True), call)
        found = content(folder)
        if REPORT in found:
            assert is_whole(found) and not recover(folder), call
        else:
            assert named_as_unfinished(folder), call
        write_new(folder, mend=True)
        assert content(folder) == AFTER and not list(folder.glob(".*")), call
        if not killed:
            break
    assert call > 20 and left.is_dir()


@pytest.mark.parametrize("how", ["a failed run", "an exception"])
def test_an_unfinished_set_stays_so_where_a_run_that_might_mend_it_fails(how, tmp_path):
    folder = killed_in_mid_move(tmp_path).parent
    before = content(folder)
    with pytest.raises(ZeroDivisionError), open_set(folder, "scan", mend=True) as files:
        (files.staging / "scan_seg.nii").write_bytes(b"half")
        if how == "an exception":
            raise ZeroDivisionError
        files.discard()
        for name in ("scan_failed_report.json", "scan_failed_trace.csv"):
            (files.staging / name).write_bytes(b"{}")
        files.commit(last="scan_failed_report.json", mends=False)
        raise ZeroDivisionError
    failed = dict.fromkeys(("scan_failed_report.json", "scan_failed_trace.csv"), b"{}")
    assert content(folder) == before | (failed if how == "a failed run" else {})
    assert named_as_unfinished(folder)


def failing_replace(monkeypatch, target):
    """Make the move of one file to its place fail, as where another program has the old one open."""
    real = os.replace

    def replace(source, goal):
        if str(goal).endswith(target) and "/.scan" in str(source) and "/.scan" not in str(goal):
            if "/new/" in str(source):
                raise PermissionError(13, "Permission denied", str(goal))
        real(source, goal)

    monkeypatch.setattr(os, "replace", replace)


@pytest.mark.parametrize("target", ["scan_seg.nii", "scan_surface.stl", "scan_trace.csv", REPORT])
def test_a_move_that_fails_puts_everything_back(target, tmp_path, monkeypatch):
    folder = filled(tmp_path / "out")
    failing_replace(monkeypatch, target)
    with pytest.raises(PermissionError):
        write_new(folder)
    assert content(folder) == BEFORE and not list(folder.glob(".*"))


def test_a_kill_while_everything_is_put_back(tmp_path):
    def work(folder):
        with pytest.MonkeyPatch.context() as patch:
            failing_replace(patch, "scan_trace.csv")
            write_new(folder)

    seen = set()
    for call in range(1000):
        folder = filled(tmp_path / str(call))
        killed = dying_child(lambda folder=folder: work(folder), call)
        unfinished = bool(recover(folder))
        assert unfinished or content(folder) == BEFORE, call
        assert REPORT not in content(folder) or is_whole(content(folder)), call
        seen.add(unfinished)
        if not killed:
            break
    assert call > 20 and content(folder) == BEFORE and seen == {True, False}


def test_what_a_living_process_writes_is_left_alone(tmp_path):
    with open_set(tmp_path, "scan") as files:
        (files.staging / "a").write_bytes(b"1")
        assert recover(tmp_path) == [] and (files.staging / "a").exists()
        with (
            pytest.raises(OutputError, match="another run is writing there now"),
            open_set(tmp_path, "scan"),
        ):
            pytest.fail("two owners")
        with open_set(tmp_path, "other") as others:
            assert others.staging != files.staging
        files.commit()
    assert content(tmp_path) == {"a": b"1"} and not list(tmp_path.glob(".*"))


def test_staging_files_of_an_exception_are_removed(tmp_path):
    with pytest.raises(ZeroDivisionError), open_set(tmp_path, "scan") as files:
        (files.staging / "a").write_bytes(b"1")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_signals_wait_until_all_files_are_in_place(tmp_path, monkeypatch):
    folder = filled(tmp_path / "out")
    real = os.replace
    moved = []

    def replace(source, goal):
        if len(moved) == 3:
            signal.raise_signal(signal.SIGINT)
        moved.append(goal)
        real(source, goal)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        write_new(folder)
    assert content(folder) == AFTER and not list(folder.glob(".*"))


def test_long_names_have_a_short_hidden_folder(tmp_path):
    name = "名" * 80  # 240 bytes
    with open_set(tmp_path, name) as files:
        (files.staging / name).write_bytes(b"1")
        files.commit()
    assert content(tmp_path) == {name: b"1"}
    for text in (name, "a" * 255, "名" * 66):
        with open_set(tmp_path, text) as files:
            assert len(os.fsencode(files.staging.parent.name)) < 255


def test_file_systems_without_locks_take_files(tmp_path, monkeypatch):
    """It cannot be known there if a writer lives: sets are written as where no key can be kept."""
    import fcntl

    def no_locks(number, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    write_bytes(tmp_path / "a", b"1")
    for _ in range(2):  # the second after a kill
        with (
            pytest.warns(AccelsurfWarning, match="No locks available"),
            open_set(tmp_path, "scan") as files,
        ):
            write_bytes(files.staging / "b", b"2")
            write_bytes(files.staging / "c", b"3")
            files.commit(last="c")
    assert content(tmp_path) == {"a": b"1", "b": b"2", "c": b"3"} and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("name", [".accelsurf", ".data.accelsurf", ".a.b.accelsurf"])
def test_folders_that_are_called_like_the_program_are_folders(name, tmp_path):
    folder = filled(tmp_path / name)
    with open_set(folder, "scan") as files:
        assert file_set.is_sealed(folder, files.staging.parent)


def test_the_state_folder_of_another_user_is_not_made_by_root(tmp_path, monkeypatch):
    if os.geteuid() != 0:
        pytest.skip("only root can be another user")
    home = tmp_path / "home"
    home.mkdir()
    os.chown(home, 1234, 1234)
    folder = filled(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(home / ".local" / "state"))
        with pytest.warns(AccelsurfWarning, match="another user"):
            write_new(folder)
    assert not list(home.iterdir()) and content(folder) == AFTER


def test_a_state_folder_that_is_a_link_is_none(tmp_path, monkeypatch):
    planted, state = tmp_path / "planted", tmp_path / "state"
    planted.mkdir()
    state.mkdir(mode=0o700)
    (state / "accelsurf").symlink_to(planted)
    folder = filled(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(state))
        with pytest.warns(AccelsurfWarning, match="runs cannot be told apart"):
            write_new(folder)
    assert not list(planted.iterdir())


@pytest.mark.parametrize("unique", [False, True])
def test_a_process_that_only_looks_for_dead_ones_is_waited_for(unique, tmp_path, monkeypatch):
    """Between the making of a folder and its lock, another process may take it for that of a dead one."""
    real = file_set.try_lock
    looked = []

    def try_lock(lock):
        looked.append(lock)
        return len(looked) > 2 and real(lock)

    monkeypatch.setattr(file_set, "try_lock", try_lock)
    with open_set(tmp_path, "scan", unique=unique) as files:
        (files.staging / "a").write_bytes(b"1")
        files.commit()
    monkeypatch.undo()
    recover(tmp_path)
    assert content(tmp_path) == {"a": b"1"} and not list(tmp_path.glob(".*"))


#: What a received folder may hold: made by a function of the hidden folder, a folder of somebody else, and its files.
def _linked(name):
    def plant(hidden, elsewhere, given):
        hidden.mkdir()
        for part in ("new", "old"):
            (hidden / part).symlink_to(elsewhere) if name in (part, "both") else (
                hidden / part
            ).mkdir()
        journal(hidden, given)

    return plant


def journal(hidden, given):
    (hidden / "lock").write_bytes(b"")
    text = json.dumps(given)
    for name in ("journal.json", "record.json", "x.json"):
        (hidden / name).write_text(text)


def _plain(hidden, elsewhere, given):
    (hidden / "new").mkdir(parents=True)
    (hidden / "new" / "a").write_bytes(b"evil")
    journal(hidden, given)


def _itself_a_link(hidden, elsewhere, given):
    hidden.symlink_to(elsewhere)


def _lock_a_link(hidden, elsewhere, given):
    _plain(hidden, elsewhere, given)
    (hidden / "lock").unlink()
    (hidden / "lock").symlink_to(elsewhere / "key")


def _empty(hidden, elsewhere, given):
    hidden.mkdir()


def _a_file(hidden, elsewhere, given):
    hidden.write_bytes(b"1")


PLANTS = [
    _linked("new"),
    _linked("old"),
    _linked("both"),
    _plain,
    _itself_a_link,
    _lock_a_link,
    _empty,
    _a_file,
]
NAMES = [
    ".x.accelsurf",
    ".scan.accelsurf",
    ".scan.0123456789abcdef01234567.accelsurf",
    ".scan.00000000" + "0" * 16 + ".accelsurf",
    "..accelsurf",
    ".a.b.c.accelsurf",
]


def folder_contents(folder):
    """All files below a folder by name, links as what they say."""
    return {
        str(path.relative_to(folder)): os.readlink(path)
        if path.is_symlink()
        else path.is_file() and path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


@pytest.mark.sampled
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("seed", range(4))
def test_nothing_in_an_output_folder_orders_a_move_or_a_deletion(plant, seed, tmp_path):
    """A folder may have come with somebody's data, and hold what looks like a run that was killed."""
    draw = random.Random(seed)
    elsewhere, folder = tmp_path / "home" / ".ssh", tmp_path / "data"
    elsewhere.mkdir(parents=True)
    folder.mkdir()
    for name in ("key", "known"):
        (elsewhere / name).write_bytes(b"mine")
    for name in ("thesis", "key", "scan_seg.nii"):
        (folder / name).write_bytes(b"theirs")
    given = draw.choice(
        [
            {"files": ["key"], "remove": ["thesis"], "last": None, "undo": draw.random() < 0.5},
            {"files": ["a", "key"], "remove": ["scan_seg.nii"], "last": "key"},
            {
                "staging": NAMES[seed],
                "moves": {"files": ["key"], "remove": ["thesis"], "last": "known"},
            },
            {"files": ["../stolen"], "remove": ["../home"], "last": ".."},
        ]
    )
    name = draw.choice(NAMES)
    plant(folder / name, elsewhere, given)
    before = folder_contents(tmp_path)
    with pytest.warns(AccelsurfWarning, match="not from a run of yours") as said:
        assert recover(folder) == []
    assert len(said) == 1 and name in str(said[0].message)
    with pytest.warns(AccelsurfWarning):
        write_bytes(folder / "new.txt", b"1")
    with pytest.warns(AccelsurfWarning), open_set(folder, "scan") as files:
        (files.staging / "b").write_bytes(b"2")
        (files.staging / "c").write_bytes(b"3")
        files.commit(last="c")
    after = folder_contents(tmp_path)
    assert {key: after.pop(f"data/{key}") for key in ("new.txt", "b", "c")} == {
        "new.txt": b"1",
        "b": b"2",
        "c": b"3",
    }
    assert after == before


#: The first change to die before, for a set to be put in place by half; found by the first test that needs it.
MID_MOVE = [0]


def killed_in_mid_move(folder):
    """A folder whose set was put in place by half when its process was killed; the staging folder."""
    folder.mkdir(exist_ok=True)
    for call in range(MID_MOVE[0], 1000):
        filled(folder / str(call))
        assert dying_child(lambda call=call: write_new(folder / str(call)), call)
        if b"new labels" in content(folder / str(call)).values():
            MID_MOVE[0] = call
            assert REPORT not in content(folder / str(call))
            return next((folder / str(call)).glob(".*"))
        recover(folder / str(call))
    raise AssertionError


@pytest.mark.parametrize("part", ["", "new", "old"])
def test_a_link_in_place_of_a_staging_folder_is_not_followed(part, tmp_path):
    staging = killed_in_mid_move(tmp_path)
    folder = staging.parent
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "scan_seg.nii").write_bytes(b"mine")
    (staging / part).rename(tmp_path / "kept")
    (staging / part).symlink_to(tmp_path / "elsewhere")
    before = folder_contents(tmp_path / "elsewhere")
    with pytest.warns(AccelsurfWarning, match="not from a run of yours"):
        assert recover(folder) == []
    with pytest.warns(AccelsurfWarning):  # names it; nothing in it is used
        write_new(folder)
    assert content(folder).items() >= AFTER.items() - {("other.txt", b"")}
    assert folder_contents(tmp_path / "elsewhere") == before and (staging / part).is_symlink()


def test_a_copy_of_a_folder_with_a_killed_run_is_not_that_folder(tmp_path):
    import shutil

    staging = killed_in_mid_move(tmp_path)
    shutil.copytree(staging.parent, tmp_path / "copy")
    with pytest.warns(AccelsurfWarning, match="not from a run of yours"):
        assert recover(tmp_path / "copy") == []
    assert (tmp_path / "copy" / staging.name / "new").is_dir()
    assert recover(staging.parent) == [staging]


def test_a_staging_folder_of_another_user_or_of_another_set_is_left_alone(tmp_path, monkeypatch):
    """The seal is of the key, of the output folder and of the name of the set: a renamed one has none."""
    staging = killed_in_mid_move(tmp_path)
    folder = staging.parent
    renamed = folder / staging.name.replace(".scan.", ".other.")
    staging.rename(renamed)
    before = folder_contents(folder)
    with pytest.warns(AccelsurfWarning, match="not from a run of yours"):
        assert recover(folder) == [] and not is_unfinished(folder, "other")
    renamed.rename(staging)
    with monkeypatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path / "other state"))
        with pytest.warns(AccelsurfWarning, match="not from a run of yours"):
            assert recover(folder) == []
    assert recover(folder) == [staging] and len(folder_contents(folder)) == len(before)


#: What stands in the place of the key.
NO_KEYS = {
    "others may write it": lambda path, mine: path.chmod(0o666),
    "a link": lambda path, mine: (path.rename(mine), path.symlink_to(mine)),
    "a link to a device": lambda path, mine: (path.unlink(), path.symlink_to("/dev/zero")),
    "a pipe": lambda path, mine: (path.unlink(), os.mkfifo(path, 0o600)),
    "a folder": lambda path, mine: (path.unlink(), path.mkdir()),
    "cut short": lambda path, mine: path.write_bytes(b"1"),
    "too much": lambda path, mine: os.truncate(path, 1 << 40),
}


@pytest.mark.parametrize("how", NO_KEYS)
def test_what_is_no_key_seals_nothing_and_stops_nothing(how, tmp_path):
    staging = killed_in_mid_move(tmp_path)
    folder, key = staging.parent, seals.state_folder() / "seal.key"
    NO_KEYS[how](key, tmp_path / "mine")
    assert seals.signed(b"a") == "" and seals.unavailable()
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        assert recover(folder) == []
        write_new(folder)
    assert content(folder).items() >= AFTER.items() and staging.is_dir()
    key.rmdir() if how == "a folder" else key.unlink()


def test_outputs_are_not_written_through_links(tmp_path, monkeypatch):
    (tmp_path / "home").mkdir()
    (tmp_path / "link").symlink_to("home")
    monkeypatch.chdir(tmp_path)
    for folder in (tmp_path / "link", Path("link"), Path("link/new"), Path("./home/../link")):
        with pytest.raises(OutputError, match="is a link to") as refused:
            file_set.refuse_links(folder)
        assert str(tmp_path / "home") in refused.value.hint
    with pytest.raises(OutputError, match="is a link to"):
        write_bytes(tmp_path / "link" / "a", b"1")
    (tmp_path / "home" / "a").symlink_to(tmp_path / "target")
    write_bytes(tmp_path / "home" / "a", b"1")  # the link itself is replaced
    assert not (tmp_path / "target").exists() and not (tmp_path / "home" / "a").is_symlink()


def test_links_of_the_system_are_followed(tmp_path, monkeypatch):
    (tmp_path / "private").mkdir()
    (tmp_path / "tmp").symlink_to("private")
    if os.lstat(tmp_path / "tmp").st_uid != 0:
        pytest.skip("only root makes such links")
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: 1234)
        file_set.refuse_links(tmp_path / "tmp")
    with pytest.raises(OutputError, match="is a link to"):
        file_set.refuse_links(tmp_path / "tmp")


@pytest.mark.parametrize("state", ["a file", "not to be written", "for all to write", "no home"])
def test_without_a_place_for_a_key_a_set_is_written_and_a_line_says_so(
    state, tmp_path, monkeypatch
):
    place = tmp_path / "state"
    if state == "a file":
        place.write_bytes(b"1")
    elif state == "for all to write":
        (place / "accelsurf").mkdir(parents=True)
        (place / "accelsurf").chmod(0o777)
    folder = filled(tmp_path / "out")

    def refused(path):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    with monkeypatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", "" if state == "no home" else str(place))
        if state == "not to be written":
            patch.setattr(seals, "_make", refused)
        if state == "no home":
            patch.setattr(os.path, "expanduser", lambda path: path)
        with pytest.warns(AccelsurfWarning, match="runs cannot be told apart"):
            write_new(folder)
        write_bytes(folder / "other.txt", b"somebody's")  # a single file needs none
    assert content(folder) == AFTER and not list(folder.glob(".*"))


def test_an_output_folder_that_goes_away_is_an_error_of_its_name(tmp_path):
    import shutil

    from accelsurf.output.folder import OutputFolder, naming_final

    folder = tmp_path / "out"
    with (
        pytest.raises(OutputError, match="out"),
        OutputFolder(folder, "scan").stage() as files,
        naming_final(files),
    ):
        shutil.rmtree(folder)
        files.discard()
        write_bytes(files.staging / "a", b"1")
    assert not folder.exists()
