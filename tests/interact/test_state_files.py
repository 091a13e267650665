"""Files of states: the same bytes for the same run, and what is refused of those that somebody has changed."""

import io as streams
import json
import pickle
import zipfile

import numpy as np
import pytest

from accelsurf import cli, io
from accelsurf.cases.case import exit_code_of_finished
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.interact import state_file
from accelsurf.io import sha256, states
from accelsurf.output.folder import OutputFolder
from accelsurf.output.reports import Report
from accelsurf.run import checkpoint as run_checkpoint
from accelsurf.settings.run_config import RunConfig

START = ("--start", "ball:8,8,7,3", "--threads", "1", "--seed", "1", "--quiet")


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    z, y, x = np.indices((14, 16, 18))
    image = 100.0 * ((z - 7) ** 2 + (y - 8) ** 2 + (x - 8) ** 2 < 5**2)
    image += np.random.default_rng(1).normal(0, 8, image.shape)
    path = tmp_path_factory.mktemp("scan") / "ball.nii"
    io.write(Volume.from_array(image.astype(np.float32)), path)
    return path


def runs(scan, folder, *words):
    assert run("segment", scan, "-o", folder, *START, "--keep-state", "yes", *words) == 0
    return folder


@pytest.fixture(scope="module")
def finished(scan, tmp_path_factory):
    return runs(scan, tmp_path_factory.mktemp("finished"))


@pytest.fixture(scope="module")
def checkpoint(scan, tmp_path_factory):
    return stopped(scan, tmp_path_factory.mktemp("stopped"))


def stopped(scan, folder, steps=6):
    """The checkpoint of a run that was ended after some steps, as by a kill."""
    import os

    from accelsurf.run import checkpoint_file

    kept = checkpoint_file.save_checkpoint

    def saved(path, state, header):
        kept(path, state, header)
        if state.step >= steps:
            raise KeyboardInterrupt

    checkpoint_file.save_checkpoint = saved
    try:
        run("segment", scan, "-o", folder, *START, "--keep-state", "yes", "--checkpoint", "3")
    finally:
        checkpoint_file.save_checkpoint = kept
    assert (folder / "ball_checkpoint.npz").exists(), os.listdir(folder)
    return folder / "ball_checkpoint.npz"


# ------------------------------------------------------------------------------------------------- the same bytes


def test_two_runs_leave_the_same_state(scan, finished, tmp_path):
    again = runs(scan, tmp_path / "again")
    assert (again / "ball_state.npz").read_bytes() == (finished / "ball_state.npz").read_bytes()


@pytest.mark.slow
def test_two_runs_leave_the_same_checkpoint_and_a_resumed_one_the_same_state(
    scan, checkpoint, tmp_path
):
    (tmp_path / "out").mkdir()
    other = stopped(scan, tmp_path / "out")
    assert other.read_bytes() == checkpoint.read_bytes()
    whole = runs(scan, tmp_path / "whole", "--checkpoint", "3")
    runs(scan, tmp_path / "out", "--checkpoint", "3", "--resume")
    assert (tmp_path / "out" / "ball_state.npz").read_bytes() == (
        whole / "ball_state.npz"
    ).read_bytes()


def test_states_do_not_say_what_steps_took(finished, checkpoint):
    assert all(
        record.seconds == 0
        for record in state_file.read_state(finished / "ball_state.npz").objects[0].history
    )
    (one,) = run_checkpoint.read_checkpoint(checkpoint)[1].objects
    assert len(one.evolution.loop.history) >= 6
    assert all(record.seconds == 0 for record in one.evolution.loop.history)
    for path in (finished / "ball_state.npz", checkpoint):
        with zipfile.ZipFile(path) as archive:
            assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


# ------------------------------------------------------------------------------------------------- changed members


class Evil:
    """What runs code where somebody unpickles it."""

    ran = False

    def __reduce__(self):
        return _run, ()


def _run():
    Evil.ran = True
    return 0


def npy(array, shape=None, pickled=False):
    """The bytes of an .npy; of another shape than it says."""
    stream = streams.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=pickled)
    content = stream.getvalue()
    if shape is not None:
        old, new = repr(np.asarray(array).shape).encode(), repr(shape).encode()
        at = content.index(b"'shape': " + old)
        end = content.index(b"\n", at)
        line = (content[at:end].replace(old, new)).rstrip().ljust(end - at)
        content = content[:at] + line + content[end:] if len(line) == end - at else content
    return content


def objects(value):
    array = np.empty(1, object)
    array[0] = value
    return npy(array, pickled=True)


#: What comes in the place of a member, of its array.
CHANGES = {
    "one number": lambda array: npy(np.float32(1.0)),
    "one number of its own": lambda array: npy(
        array.reshape(-1)[0] if array.size else array.dtype.type(0)
    ),
    "other numbers": lambda array: npy(
        np.zeros(array.shape, array.dtype) + (0 if array.any() else 1)
    ),
    "other type": lambda array: npy(array.astype(np.complex64)),
    "text": lambda array: npy(np.array(["a"] * 3)),
    "longer": lambda array: npy(
        np.concatenate([array.reshape(-1), array.reshape(-1), array.reshape(-1)[:1]])
    ),
    "empty": lambda array: npy(np.empty(0, array.dtype)),
    "of other axes": lambda array: npy(array[None, None]),
    "huge": lambda array: npy(np.zeros(1, np.uint8), (10**12,)),
    "negative": lambda array: npy(np.zeros(1, np.uint8), (-1,)),
    "pickle": lambda array: objects(Evil()),
    "bare pickle": lambda array: pickle.dumps(Evil()),
    "no array": lambda array: b"this is no array",
    "nothing": lambda array: b"",
    "deep": lambda array: npy(np.frombuffer(b'{"format": ' + b"[" * 100_000, np.uint8)),
}


def rewritten(path, target, name, change, kind=zipfile.ZIP_STORED, twice=False):
    """A copy of a state with one member changed; None takes it out."""
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    with zipfile.ZipFile(target, "w", kind) as out:
        for member, content in members.items():
            if member == name and twice:
                out.writestr(member, content)
            if member != name:
                out.writestr(member, content)
            elif change is not None:
                out.writestr(member, change(np.load(streams.BytesIO(content))))
    return target


def members(path):
    with zipfile.ZipFile(path) as archive:
        return [info.filename for info in archive.infolist()]


def refused(read, path):
    with pytest.raises(InputError) as caught:
        read(path)
    assert (
        str(caught.value).startswith(f"{path}: ")
        and "\n" not in str(caught.value)
        and caught.value.hint
    )
    assert len(str(caught.value)) < 1000 and not Evil.ran


@pytest.mark.sampled(12)
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("which", ["state", "checkpoint"])
@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_member_is_refused(which, change, finished, checkpoint, tmp_path):
    path, read = both(finished, checkpoint)[which]
    for number, name in enumerate(members(path)):
        changed = rewritten(path, tmp_path / f"{number}.npz", name, CHANGES[change])
        if changed.read_bytes() == rewritten(path, tmp_path / "same.npz", name, npy).read_bytes():
            continue  # an array without numbers stays as it is
        refused(read, changed)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("which", ["state", "checkpoint"])
def test_missing_double_and_packed_members_are_refused(which, finished, checkpoint, tmp_path):
    path, read = both(finished, checkpoint)[which]
    read(path)
    for number, name in enumerate(members(path)):
        refused(read, rewritten(path, tmp_path / f"a{number}.npz", name, None))
        refused(
            read,
            rewritten(
                path, tmp_path / f"b{number}.npz", name, lambda array: npy(array), twice=True
            ),
        )
    for kind in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        packed = rewritten(
            path, tmp_path / f"c{kind}.npz", "tree.npy", lambda array: npy(array), kind
        )
        refused(read, packed)
        content = bytearray(packed.read_bytes())
        content[len(content) // 3] ^= 0xFF
        (tmp_path / "damaged.npz").write_bytes(content)
        refused(read, tmp_path / "damaged.npz")


@pytest.mark.parametrize("which", ["state", "checkpoint"])
def test_cut_and_flipped_files_are_refused(which, finished, checkpoint, tmp_path):
    path, read = both(finished, checkpoint)[which]
    content, random = path.read_bytes(), np.random.default_rng(3)
    for number in range(60):
        changed = bytearray(content)
        if number % 3 == 0:
            del changed[int(random.integers(len(content))) :]
        else:
            changed[int(random.integers(len(content)))] ^= 1 << int(random.integers(8))
        target = tmp_path / f"{number}.npz"
        target.write_bytes(changed)
        try:
            read(target)
        except InputError as error:
            assert "\n" not in str(error) and error.hint
        else:  # a bit that says nothing, as of a date in the archive
            assert number % 3


def both(finished, checkpoint):
    return {
        "state": (finished / "ball_state.npz", state_file.read_state),
        "checkpoint": (checkpoint, run_checkpoint.read_checkpoint),
    }


def signed(path, target, types, change):
    """A state whose tree was changed by somebody who has made the digest anew."""
    arrays = states.stored_arrays(path.read_bytes())
    about = json.loads(arrays.pop("tree").tobytes())
    change(about, arrays)
    about["digest"] = states.digest_of(about["state"], arrays)
    tree = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(target, tree=tree, **arrays)
    return target


@pytest.mark.sampled(2)
@pytest.mark.parametrize("which", ["state", "checkpoint"])
@pytest.mark.parametrize(
    "value", [None, -1, "a", 1.5, [], {"list": []}, {"array": "none"}, {"dict": [[1, 2]]}]
)
def test_a_field_of_another_type_is_refused_even_with_a_digest(
    which, value, finished, checkpoint, tmp_path
):
    """One field of one record at a time; what still fits its type may be read."""
    path, read = both(finished, checkpoint)[which]
    types = {"state": state_file.TYPES, "checkpoint": run_checkpoint.TYPES}[which]
    places = [
        (name, n) for name, fields in states.layout_of(types).items() for n in range(len(fields))
    ]
    count = 0
    for name, number in places:

        def put(about, arrays, name=name, number=number):
            record = next(records(about["state"], name), None)
            if record is not None:
                record["fields"][number] = value

        target = signed(path, tmp_path / "signed.npz", types, put)
        try:
            read(target)
        except InputError as error:
            assert "\n" not in str(error) and error.hint
            count += 1
    assert count > len(places) // 4


def records(tree, name):
    """The records of a name in a tree."""
    if isinstance(tree, dict):
        if tree.get("record") == name:
            yield tree
        for value in tree.values():
            yield from records(value, name)
    elif isinstance(tree, list):
        for value in tree:
            yield from records(value, name)


@pytest.mark.parametrize("change", ["one number", "pickle", "no array", "huge"])
def test_refine_and_resume_say_it_in_one_line(change, scan, finished, checkpoint, tmp_path, capfd):
    import shutil

    folder = shutil.copytree(finished, tmp_path / "refined")
    name = next(name for name in members(folder / "ball_state.npz") if name != "tree.npy")
    rewritten(finished / "ball_state.npz", folder / "ball_state.npz", name, CHANGES[change])
    report = json.loads((folder / "ball_report.json").read_text())
    for entry in report["outputs"]:
        if entry["kind"] == "state":
            entry["sha256"] = sha256(folder / "ball_state.npz")
    (folder / "ball_report.json").write_text(json.dumps(report))
    capfd.readouterr()
    assert run("refine", folder, "--inside", "point:8,8,7") == 3
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["error", "hint"]

    (tmp_path / "resumed").mkdir()
    name = next(name for name in members(checkpoint) if name != "tree.npy")
    rewritten(checkpoint, tmp_path / "resumed" / "ball_checkpoint.npz", name, CHANGES[change])
    words = ("--keep-state", "yes", "--checkpoint", "3", "--resume")
    assert run("segment", scan, "-o", tmp_path / "resumed", *START, *words) == 3
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["error", "hint"]
    assert not Evil.ran


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "value", [None, 5, "a", [], [5], {}, {"path": 5}, [{"kind": "state"}], 10**30, float("nan")]
)
def test_reports_that_somebody_has_changed_are_no_fault(value, scan, finished, tmp_path, capfd):
    """A value of any kind in the place of each one of a report; no outputs mean that all are there."""
    folder = tmp_path / "out"
    folder.mkdir()
    whole = json.loads((finished / "ball_report.json").read_text())
    state = (finished / "ball_state.npz").read_bytes()
    (folder / "ball_state.npz").write_bytes(state[:100])  # so that no correction begins
    path, place = folder / "ball_report.json", OutputFolder(folder, "ball", scan, resume=True)
    for key in [*whole, *(("input", inner) for inner in whole["input"])]:
        report = json.loads(json.dumps(whole))
        if isinstance(key, tuple):
            report[key[0]][key[1]] = value
        else:
            report[key] = value
        path.write_text(json.dumps(report))
        assert run("refine", folder, "--inside", "point:8,8,7") == 3
        assert exit_code_of_finished(place, RunConfig(**whole["config"]), quiet=True) in (None, 0)
        assert Report(path).is_failure in (True, False)
        assert isinstance(place.holds_result(), bool)
        assert isinstance(place.resumed([path]), OutputFolder)
        capfd.readouterr()
