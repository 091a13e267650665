"""Sets of files at every point at which the process that writes them can be killed, and at every move that can fail."""

import errno
import hashlib
import json
import os
import signal
import sys

import pytest

from accelsurf.errors import OutputError
from accelsurf.io import claims, file_set
from accelsurf.io.file_set import opened, recover
from accelsurf.io.files import write_bytes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")

REPORT = "scan_report.json"
OLD = {"scan_seg.nii": b"old labels", "scan_surface.ply": b"old mesh", "scan_trace.csv": b"old trace"}
NEW = {"scan_seg.nii": b"new labels", "scan_surface.stl": b"new mesh", "scan_trace.csv": b"new trace"}
#: What changes a folder, or makes sure that a change is on the disk: the process dies before the n-th call of them.
CALLS = ("replace", "rename", "unlink", "rmdir", "mkdir", "fsync", "open")


def report(files):
    """A report that names files by their checksums."""
    return json.dumps({name: hashlib.sha256(content).hexdigest() for name, content in files.items()}).encode()


def content(folder):
    """All that is seen in a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")}


def filled(folder):
    folder.mkdir()
    for name, text in {**OLD, REPORT: report(OLD), "other.txt": b"somebody's"}.items():
        (folder / name).write_bytes(text)
    return folder


def write_new(folder):
    with opened(folder, "scan") as files:
        for name, text in NEW.items():
            (files.drafts / name).write_bytes(text)
        (files.drafts / REPORT).write_bytes(report(NEW))
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
        for name in CALLS:
            setattr(os, name, counted(getattr(os, name), left))
        try:
            work()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def test_a_kill_at_any_point_leaves_all_old_or_all_new(tmp_path):
    seen = set()
    for call in range(1000):
        folder = filled(tmp_path / str(call))
        if not dying_child(lambda folder=folder: write_new(folder), call):
            break
        found = content(folder)
        if REPORT in found:  # where a report stands, its files are those that it names, without the next run
            names = json.loads(found[REPORT])
            assert {name: hashlib.sha256(found[name]).hexdigest() for name in names} == names, call
        assert recover(folder) == []
        assert content(folder) in (BEFORE, AFTER), call
        assert not list(folder.glob(".*")), call
        seen.add(REPORT in found)
    assert call > 20 and seen == {True, False}  # the points between two renames are among them
    assert content(folder) == AFTER


def failing_replace(monkeypatch, target):
    """Make the move of one file to its place fail, as where another program has the old one open."""
    real = os.replace

    def replace(source, goal):
        if str(goal).endswith(target) and "/.scan" not in str(goal):
            raise PermissionError(13, "Permission denied", str(goal))
        real(source, goal)

    monkeypatch.setattr(os, "replace", replace)


@pytest.mark.parametrize("target", ["scan_seg.nii", "scan_surface.stl", "scan_trace.csv"])
def test_a_move_that_fails_puts_everything_back(target, tmp_path, monkeypatch):
    folder = filled(tmp_path / "out")
    real = file_set._move_back

    def move_back(*args):
        monkeypatch.undo()
        real(*args)

    monkeypatch.setattr(file_set, "_move_back", move_back)
    failing_replace(monkeypatch, target)
    with pytest.raises(PermissionError):
        write_new(folder)
    assert content(folder) == BEFORE and not list(folder.glob(".*"))


def test_a_kill_while_everything_is_put_back(tmp_path, monkeypatch):
    def work(folder):
        usual, real = os.replace, file_set._move_back

        def move_back(*args):
            os.replace = usual
            real(*args)

        failing_replace(monkeypatch, "scan_trace.csv")
        file_set._move_back = move_back
        write_new(folder)

    for call in range(1000):
        folder = filled(tmp_path / str(call))
        killed = dying_child(lambda folder=folder: work(folder), call)
        assert recover(folder) == []
        assert content(folder) in (BEFORE, AFTER), call
        assert not list(folder.glob(".*")), call
        if not killed:
            break
    assert call > 30 and content(folder) == BEFORE


def test_what_a_living_process_writes_is_left_alone(tmp_path):
    with opened(tmp_path, "scan") as files:
        (files.drafts / "a").write_bytes(b"1")
        assert recover(tmp_path) == [] and (files.drafts / "a").exists()
        with pytest.raises(OutputError, match="another run is writing there now"), opened(tmp_path, "scan"):
            pytest.fail("two owners")
        with opened(tmp_path, "other") as others:
            assert others.drafts != files.drafts
        files.commit()
    assert content(tmp_path) == {"a": b"1"} and not list(tmp_path.glob(".*"))


def test_drafts_of_an_exception_are_removed(tmp_path):
    with pytest.raises(ZeroDivisionError), opened(tmp_path, "scan") as files:
        (files.drafts / "a").write_bytes(b"1")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_folders_of_others_are_left_alone(tmp_path):
    other = tmp_path / ".notes.accelsurf"
    other.mkdir()
    (other / "precious").write_bytes(b"1")
    with opened(tmp_path, "scan"):
        pass
    assert (other / "precious").read_bytes() == b"1" and [path.name for path in tmp_path.iterdir()] == [other.name]


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
    with opened(tmp_path, name) as files:
        (files.drafts / name).write_bytes(b"1")
        files.commit()
    assert content(tmp_path) == {name: b"1"} and len(os.fsencode(claims.hidden_name(name))) < 200


def test_file_systems_without_locks_take_files(tmp_path, monkeypatch):
    """A single file has a hidden folder with a name that nobody else has: it needs no lock."""
    import fcntl

    def no_locks(number, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    write_bytes(tmp_path / "a", b"1")
    with opened(tmp_path, "scan") as files:
        write_bytes(files.drafts / "b", b"2")
        with pytest.raises(OutputError, match="another run is writing there now"), opened(tmp_path, "scan"):
            pytest.fail("two owners")
        files.commit()
    assert content(tmp_path) == {"a": b"1", "b": b"2"} and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("unique", [False, True])
def test_a_process_that_only_looks_for_dead_ones_is_waited_for(unique, tmp_path, monkeypatch):
    """Between the making of a folder and its lock, another process may take it for that of a dead one."""
    real = claims._try_lock
    looked = []

    def try_lock(lock, new):
        looked.append(lock)
        return len(looked) > 2 and real(lock, new)

    monkeypatch.setattr(claims, "_try_lock", try_lock)
    with opened(tmp_path, "scan", unique=unique) as files:
        (files.drafts / "a").write_bytes(b"1")
        files.commit()
    monkeypatch.undo()
    recover(tmp_path)
    assert content(tmp_path) == {"a": b"1"} and not list(tmp_path.glob(".*"))


def test_folders_of_other_users_are_left_alone(tmp_path, monkeypatch):
    """One cannot look into them: in a shared folder every command ended with "Permission denied"."""
    theirs = tmp_path / ".theirs.abc.accelsurf"
    theirs.mkdir()
    (theirs / "lock").write_bytes(b"")
    real_stat, real_open = os.stat, os.open

    def refuse(real):
        def call(path, *args, **kwargs):
            if ".theirs." in str(path) and not str(path).endswith(".accelsurf"):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return real(path, *args, **kwargs)

        return call

    monkeypatch.setattr(os, "stat", refuse(real_stat))
    monkeypatch.setattr(os, "open", refuse(real_open))
    assert recover(tmp_path) == []
    file_set.finish_killed_runs(tmp_path)
    write_bytes(tmp_path / "a", b"1")
    assert content(tmp_path) == {"a": b"1"}


@pytest.mark.parametrize(
    "journal",
    [
        json.dumps({"files": ["../stolen"], "remove": [], "last": None}),
        json.dumps({"files": [], "remove": ["../kept"], "last": None}),
        json.dumps({"files": ["a"], "remove": [], "last": ".."}),
        "[" * 100_000,
        "[]",
        '{"files": [1], "remove": [], "last": null}',
    ],
)
def test_a_journal_moves_no_files_of_other_folders(journal, tmp_path):
    """A hidden folder may have come with data from elsewhere."""
    (tmp_path / "kept").write_bytes(b"1")
    hidden = tmp_path / "data" / ".scan.accelsurf"
    (hidden / "new").mkdir(parents=True)
    (hidden / "lock").write_bytes(b"")
    (hidden / "stolen").write_bytes(b"2")
    (hidden / "journal.json").write_text(journal)
    assert recover(tmp_path / "data") == [hidden]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "kept"]
    assert (hidden / "stolen").exists()
