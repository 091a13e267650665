"""Folders that somebody else has made, and outputs that are inputs: no file of anybody is touched by a command."""

import json
import os
import random
import shutil
import sys

import numpy as np
import pytest

from accelsurf import Volume, cli, io

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links")

BALL = ("--max-steps", "2", "--start", "ball:5,5,5,3", "--progress", "none")


def run(*words):
    return cli.execute([str(word) for word in words])


def image(path, offset=0.0):
    z, y, x = np.indices((11, 12, 13)) - 5.0
    path.parent.mkdir(parents=True, exist_ok=True)
    io.write(
        Volume.from_array((100.0 * (z * z + y * y + x * x < 14) + offset).astype(np.float32)), path
    )
    return path


def contents(folder):
    return {
        str(path.relative_to(folder)): os.readlink(path)
        if path.is_symlink()
        else path.is_file() and path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture
def received(tmp_path, monkeypatch):
    """The present folder, as somebody sent it, beside the home of who opens it."""
    home, data = tmp_path / "home" / ".ssh", tmp_path / "data"
    home.mkdir(parents=True)
    for name in ("id_rsa", "authorized_keys"):
        (home / name).write_bytes(b"mine")
    scan = image(data / "scan.nii")
    for name in ("id_rsa", "thesis.docx"):
        (data / name).write_bytes(b"theirs")
    monkeypatch.chdir(data)
    return tmp_path, home, data, scan


def journal(hidden, home, linked=("new", "old")):
    hidden.mkdir(parents=True)
    for part in ("new", "old"):
        (hidden / part).symlink_to(home) if part in linked else (hidden / part).mkdir()
    (hidden / "lock").write_bytes(b"")
    said = {
        "files": ["id_rsa"],
        "remove": ["authorized_keys", "thesis.docx", "scan.nii"],
        "last": None,
    }
    (hidden / "journal.json").write_text(json.dumps(said))


#: Commands that write in the present folder, or in one in it.
COMMANDS = {
    "look": ("look", "scan.nii"),
    "segment": ("segment", "scan.nii", "-o", ".", *BALL),
    "evaluate": ("evaluate", "scan.nii", "scan.nii", "--csv", "table.csv"),
    "synth": ("synth", "ball_small", "-o", "."),
    "track": ("track", "frames", "-o", ".", *BALL),
    "batch": ("batch", "scan.nii", "-o", ".", "--jobs", "1", *BALL),
}


LINKED = [(), ("new",), ("old",), ("new", "old")]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("command", "linked"),
    [
        *(("look", linked) for linked in LINKED),
        *zip(list(COMMANDS)[1:], [*LINKED[::-1], LINKED[3]], strict=True),
    ],
)
def test_what_looks_like_a_killed_run_is_named_and_not_obeyed(command, linked, received, capfd):
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    names = [".x.accelsurf", ".scan.accelsurf", ".scan.0123456789abcdef.accelsurf"]
    journal(data / names[len(linked) % 3], home, linked)
    before = contents(top)
    assert run(*COMMANDS[command]) == 0
    said = capfd.readouterr().err
    assert said.count("not from a run of yours") == 1 and names[len(linked) % 3] in said
    after = contents(top)
    assert {name: after.get(name) for name in before} == before


#: What a link is called that leads elsewhere, and the command that would write through it.
LINKS = {
    "the output folder": ("out", ("segment", "scan.nii", "-o", "out", *BALL)),
    "a folder above it": ("out", ("segment", "scan.nii", "-o", "out/new", *BALL)),
    "the folder of a picture": ("out", ("look", "scan.nii", "-o", "out/a.png")),
    "the folder of a case": ("scan", ("batch", "scan.nii", "-o", ".", "--jobs", "1", *BALL)),
    "the frames of a tracking": (
        "frames_frames",
        ("track", "frames", "-o", ".", "--overwrite", *BALL),
    ),
    "the frames of one that goes on": (
        "frames_frames",
        ("track", "frames", "-o", ".", "--resume", *BALL),
    ),
    "phantoms": ("out", ("synth", "ball_small", "-o", "out")),
}


@pytest.mark.parametrize("what", LINKS)
def test_nothing_is_written_or_removed_through_a_link(what, received, capfd):
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    (home / "frame_000000.npz").write_bytes(b"mine")
    name, words = LINKS[what]
    (data / name).symlink_to(home)
    before = contents(home)
    assert run(*words) in (7, 9)
    said = capfd.readouterr()
    told = (
        said.err + said.out + "".join(path.read_text() for path in data.glob("batch_report.json"))
    )
    assert "is a link to" in told and str(home) in told
    assert contents(home) == before


@pytest.mark.parametrize("words", [("--overwrite",), ("--resume",)])
def test_a_folder_that_has_the_name_of_a_trackings_frames_is_somebodys(words, received, capfd):
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    shutil.copytree(home, data / "frames_frames")
    assert run("track", "frames", "-o", ".", *BALL, *words) == 7
    assert "is not what a tracking has left" in capfd.readouterr().err
    assert contents(data / "frames_frames") == contents(home)


def test_links_in_the_places_of_files_are_replaced(received):
    top, home, data, scan = received
    for name in ("scan_seg.nii", "scan_report.json", "scan_look.png", "scan_checkpoint.npz"):
        (data / name).symlink_to(home / "id_rsa")
    before = contents(home)
    assert run("look", scan, "--overwrite") == 0
    assert run("segment", scan, "-o", ".", "--overwrite", "--checkpoint", "1", *BALL) == 0
    assert contents(home) == before and not (data / "scan_seg.nii").is_symlink()


def labels(path):
    z, y, x = np.indices((11, 12, 13)) - 5.0
    io.write_labels(Volume.from_array((z * z + y * y + x * x < 9).astype(np.uint8)), path)
    return path


#: Options with a file of the output folder, and which.
INPUTS = {
    "channel": ("scan_seg.nii", ("--channel", "out/scan_seg.nii")),
    "start": ("scan_seg.nii", ("--start", "label:out/scan_seg.nii")),
    "start, ids": ("scan_seg.nii", ("--start", "label:out/scan_seg.nii@1")),
    "mesh": ("scan_surface.ply", ("--start", "mesh:out/scan_surface.ply")),
    "mask": ("scan_seg.nii", ("--mask", "out/scan_seg.nii")),
    "objects": ("scan_seg.nii", ("--objects", "out/scan_seg.nii")),
    "foreground": (
        "scan_seg.nii",
        ("--energy", "likelihood", "--foreground", "label:out/scan_seg.nii"),
    ),
    "settings": ("scan_run.toml", ("--config", "out/scan_run.toml")),
    "removed": ("scan_seg.nii", ("--channel", "out/scan_seg.nii", "--format", "nrrd")),
    "detached": ("scan_seg.mhd", ("--channel", "out/scan_seg.mhd", "--format", "mhd")),
    "detached, removed": ("scan_seg.mhd", ("--start", "label:out/scan_seg.mhd", "--format", "nii")),
}


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("option", "how"),
    [
        *((option, "by its name") for option in INPUTS),
        ("channel", "by a link"),
        ("mesh", "by a hard link"),
    ],
)
def test_an_output_that_is_an_input_is_refused(option, how, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    image(tmp_path / "scan.nii")
    name, words = INPUTS[option]
    form = ("--format", "mhd") if name.endswith("mhd") else ()
    assert (
        run(
            "segment", "scan.nii", "-o", "out", "--keep-state", "yes", "--mesh", "ply", *form, *BALL
        )
        == 0
    )
    if how != "by its name":
        other = tmp_path / f"other{name[name.index('.') :]}"
        other.symlink_to(f"out/{name}") if how == "by a link" else os.link(
            tmp_path / "out" / name, other
        )
        words = [word.replace(f"out/{name}", other.name) for word in words]
    before = contents(tmp_path / "out")
    start = () if "--start" in words or "--objects" in words or "--config" in words else BALL[2:4]
    capfd.readouterr()
    assert (
        run(
            "segment", "scan.nii", "-o", "out", "--overwrite", "--keep-state", "yes", *words, *start
        )
        == 7
    )
    assert "is read by this command" in capfd.readouterr().err
    assert contents(tmp_path / "out") == before


def test_pictures_tables_and_movies_do_not_replace_what_they_show(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    plane = Volume.from_array(
        np.random.default_rng(0).integers(0, 255, (1, 24, 26)).astype(np.uint8)
    )
    io.write(plane, tmp_path / "a.png")
    labels(tmp_path / "a.nii")
    (tmp_path / "pairs.csv").write_text("pred,ref\na.nii,a.nii\n")
    (tmp_path / "batch.csv").write_text("image\na.png\n")
    before = contents(tmp_path)
    for words in (
        ("look", "a.png", "-o", "a.png"),
        ("movie", "a.png", "--preview", "-o", "a.png", "--start", "ball:12,12,0,5"),
        ("evaluate", "--pairs", "pairs.csv", "--csv", "pairs.csv"),
        ("evaluate", "a.nii", "a.nii", "--csv", "a.nii"),
        ("batch", "batch.csv", "-o", ".", "--jobs", "1", "--max-steps", "2"),
    ):
        assert run(*words, "--overwrite") == 7, words
        assert "is read by this command" in capfd.readouterr().err
    assert {
        name: content for name, content in contents(tmp_path).items() if name in before
    } == before


@pytest.mark.slow
def test_a_case_of_a_batch_does_not_replace_what_another_one_reads(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        image(tmp_path / f"{name}.nii")
    assert run("batch", "a.nii", "-o", "out", "--jobs", "1", *BALL) == 0
    (tmp_path / "cases.csv").write_text("image,channel\na.nii,\nb.nii,out/a/a_seg.nii\n")
    before = contents(tmp_path / "out")
    for form in ("nii", "nrrd"):  # replaced, or removed as of the earlier run
        assert (
            run(
                "batch",
                "cases.csv",
                "-o",
                "out",
                "--jobs",
                "1",
                "--overwrite",
                "--format",
                form,
                *BALL,
            )
            == 7
        )
        assert "is read by this command" in capfd.readouterr().err
    assert contents(tmp_path / "out") == before


#: Commands, after which a folder has their outputs.
WRITERS = {
    "segment": (
        "segment",
        "scan.nii",
        "-o",
        "out",
        "--checkpoint",
        "1",
        "--keep-state",
        "yes",
        *BALL,
    ),
    "segment again": ("segment", "scan.nii", "-o", "out", "--overwrite", *BALL),
    "refine": ("refine", "out", "--outside", "ball:9,5,5,1", "--progress", "none"),
    "track": ("track", "frames", "-o", "out", *BALL),
    "batch": ("batch", "scan.nii", "-o", "out", "--jobs", "1", *BALL),
    "synth": ("synth", "ball_small", "-o", "out"),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("command", WRITERS)
def test_an_output_folder_that_goes_away_during_a_command_is_a_documented_error(
    command, received, monkeypatch, capfd
):
    """Somebody removes it before the n-th change that the command makes to files."""
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    inputs = contents(data)
    draw = random.Random(command)
    real = {name: getattr(os, name) for name in ("replace", "mkdir", "fsync", "open")}
    before = ("segment again", "refine")
    codes = set()
    for _ in range(6):
        shutil.rmtree("out", ignore_errors=True)
        if command in before:
            assert run(*WRITERS["segment"]) == 0
        left = [draw.randrange(40)]

        def counted(name, left=left):
            def call(*args, **kwargs):
                left[0] -= 1
                if left[0] == 0:
                    with monkeypatch.context() as undone:
                        undone.setattr(os, "open", real["open"])
                        shutil.rmtree(data / "out", ignore_errors=True)
                return real[name](*args, **kwargs)

            return call

        with monkeypatch.context() as patch:
            for name in real:
                patch.setattr(os, name, counted(name))
            codes.add(run(*WRITERS[command]))
        said = capfd.readouterr().err
        assert "bug in accelsurf" not in said and "Traceback" not in said, said
        assert {
            name: content for name, content in contents(data).items() if name in inputs
        } == inputs
    assert codes <= {0, 3, 7, 9} and codes & {7, 9}


def report_of(name, status, *files):
    """A planted report of a case that lists files with their checksums."""
    listed = [{"path": file.name, "kind": "labels", "sha256": io.sha256(file)} for file in files]
    said = {
        "status": status,
        "exit_code": 0,
        "outputs": listed,
        "objects": [1],
        "input": {"path": "x", "sha256": "0"},
    }
    (files[0].parent / f"{name}_report.json").write_text(json.dumps(said))


@pytest.mark.sampled(6)
@pytest.mark.parametrize("status", ["ok", "failed", "interrupted"])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("scan", ("segment", "scan.nii", "-o", ".", *BALL)),
        ("scan", ("segment", "scan.nii", "-o", ".", "--overwrite", *BALL)),
        ("scan", ("segment", "scan.nii", "-o", ".", "--resume", *BALL)),
        ("scan", ("segment", "scan.nii", "-o", ".", "--flow", "none")),
        ("scan", ("track", "scan.nii", "-o", ".", *BALL)),
        ("frames", ("track", "frames", "-o", ".", "--overwrite", *BALL)),
    ],
)
def test_a_report_that_was_planted_removes_no_file(status, name, words, received, capfd):
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    (data / "empty.txt").write_bytes(b"")
    (data / f"{name}_thesis.docx").write_bytes(b"mine")
    files = [data / "thesis.docx", data / "empty.txt", data / f"{name}_thesis.docx", scan]
    report_of(name, status, *files)
    before = contents(data)
    run(*words)
    assert "Traceback" not in capfd.readouterr().err
    after = contents(data)
    for path in files:
        assert after.get(path.name) == before[path.name], path.name


def test_frames_of_a_tracking_that_goes_on_bring_no_other_files(received, monkeypatch):
    top, home, data, scan = received
    for number in range(3):
        image(data / "frames" / f"t{number}.nii", number)
    words = ("track", "frames", "-o", ".", "--mesh", "ply", *BALL)
    from accelsurf.track.track import Tracking

    real = Tracking.__iter__

    def ended(tracking):
        for result in real(tracking):
            yield result
            tracking.save()
            raise OSError("the machine stopped")

    with monkeypatch.context() as patch:
        patch.setattr(Tracking, "__iter__", ended)
        run(*words)
    meshes = data / "frames_frames" / "meshes"
    assert (data / "frames_checkpoint.npz").exists() and meshes.is_dir()
    (meshes / "thesis.docx").write_bytes(b"evil")
    (meshes / "frames_surface_1_t009.ply").symlink_to(home / "id_rsa")
    before = {
        name: content for name, content in contents(data).items() if not name.startswith("frames_")
    }
    assert run(*words, "--resume") == 0
    after = contents(data)
    assert {name: after.get(name) for name in before} == before
    assert not (data / "frames_surface_1_t009.ply").exists()


@pytest.mark.parametrize(
    "where", ["frame_000000.npz", "meshes/thesis.docx", "meshes/mine/thesis.docx"]
)
@pytest.mark.parametrize("word", ["--resume", "--overwrite"])
def test_files_among_frames_that_no_tracking_wrote_stay(where, word, received, capfd):
    top, home, data, scan = received
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    path = data / "frames_frames" / where
    path.parent.mkdir(parents=True)
    np.savez(data / "mine.npz", image=np.zeros(3))
    shutil.copyfile(data / "mine.npz", path)
    assert run("track", "frames", "-o", ".", word, *BALL) == 7
    assert "is not what a tracking has left" in capfd.readouterr().err and path.exists()


def test_label_maps_in_an_output_are_not_lost_with_it(received, capfd):
    pytest.importorskip("zarr")
    top, home, data, scan = received
    assert run("segment", "scan.nii", "-o", "out", "--format", "ome.zarr", *BALL) == 0
    store = data / "out" / "scan_seg.ome.zarr"
    labels(data / "mine.nii")
    (store / "labels" / "mine").mkdir(parents=True)
    (store / "labels" / "mine" / "zarr.json").write_text("{}")
    shutil.copyfile(data / "mine.nii", store / "labels" / "start.nii")
    start = f"label:{store / 'labels' / 'start.nii'}"
    before = contents(store)
    for words, said in (
        (("--format", "ome.zarr", *BALL), "label maps were added"),
        (("--format", "ome.zarr", "--start", start), "is read by this command"),
        (("--format", "nii", "--start", start), "is read by this command"),
    ):
        capfd.readouterr()
        code = run("segment", "scan.nii", "-o", "out", "--overwrite", *words)
        if (
            code != 0
        ):  # in another format the store with the label maps may stay beside the new files
            assert code == 7 and said in capfd.readouterr().err
        assert contents(store) == before


def test_a_folder_in_the_place_of_a_state_is_a_documented_error(received, capfd):
    top, home, data, scan = received
    (data / "scan_checkpoint.npz").mkdir()
    for word in ("--overwrite", "--resume"):
        assert run("segment", "scan.nii", "-o", ".", word, *BALL) == 7
        assert "is a folder" in capfd.readouterr().err


@pytest.mark.parametrize("plant", ["a link", "a name elsewhere", "a name of another image"])
def test_a_record_of_a_group_that_was_planted_brings_no_file(plant, tmp_path):
    from accelsurf.io import states
    from accelsurf.output import group_files

    folder = tmp_path / ".scan_objects" / "group-1-0123"
    real = folder.parent / "real" if plant == "a link" else folder
    real.mkdir(parents=True)
    names = {
        "a link": "scan_surface_1.ply",
        "a name elsewhere": "../../bashrc",
        "a name of another image": "bashrc",
    }
    name = names[plant]
    (tmp_path / "bashrc").write_bytes(b"mine")
    if plant != "a name elsewhere":
        (real / name).write_bytes(b"evil")
    places = np.zeros((1, 3), np.int64)
    record = group_files.GroupRecord(
        (),
        [{"id": 1}],
        np.zeros((1, 3, 2), np.int64),
        places,
        places,
        [],
        [{"surface-ply": name}],
        {},
        [],
    )
    states.write_state_file(real / "record.npz", record, group_files.TYPES)
    if plant == "a link":
        folder.symlink_to(real)
    assert group_files.read_group(folder) is None


#: How the path of a file is written in a planted report.
PATHS = {
    "absolute": lambda path: str(path.absolute()),
    "its name": lambda path: path.name,
    "from above": lambda path: f"../{path.parent.name}/{path.name}",
    "of Windows": lambda path: f"C:\\elsewhere\\{path.name}",
    "through a link": lambda path: str(path.parent / "linked" / path.name),
}
#: What a planted report says in the place of the seal.
SEALS = (None, "", "0" * 64, 7, [], "\udcff", "\ud800", {"seal": ""})
#: Files of the user that have the names of outputs, of one kind or another; no command below writes them.
MINE = (
    "scan.nii scan_surface.stl scan_labels.tif scan_seg.nrrd scan_failed_seg.nii scan_state.npz "
    "scan_objects.csv scan_movie.mp4 scan_tracks.csv thesis.docx notes.txt id_rsa"
).split()
#: Commands that replace or go on, of an image that lies elsewhere.
REPLACING = {
    "segment": ("segment", "../scan.nii", "-o", ".", "--overwrite", *BALL),
    "segment, in another layout": (
        *("segment", "../scan.nii", "-o", ".", "--overwrite", "--layout", "nnunet"),
        *("--format", "nrrd", *BALL),
    ),
    "segment, on and on": ("segment", "../scan.nii", "-o", ".", "--resume", *BALL),
    "segment, failed": ("segment", "../scan.nii", "-o", ".", "--overwrite", "--flow", "none"),
    "segment, vanished": (
        *("segment", "../scan.nii", "-o", ".", "--overwrite"),
        *("--start", "ball:-90,5,5,3", "--progress", "none"),
    ),
    "refine": ("refine", ".", "--outside", "ball:9,5,5,1", "--progress", "none"),
    "look": ("look", "../scan.nii", "-o", "scan_preview.png", "--overwrite"),
    "track": ("track", "../frames", "-o", ".", "--overwrite", *BALL),
    "track, on and on": ("track", "../frames", "-o", ".", "--resume", *BALL),
    "batch": ("batch", "../scan.nii", "-o", "..", "--jobs", "1", "--overwrite", *BALL),
}


@pytest.mark.sampled(10)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("command", REPLACING)
def test_no_planted_report_takes_a_file_of_the_user(command, seed, received, monkeypatch, capfd):
    """Reports are drawn: how paths are written, what stands for seals, status, which of the files are listed."""
    top, home, data, scan = received
    draw = random.Random(f"{command} {seed}")
    there = data / "scan"  # where the batch puts the case of this name
    there.mkdir()
    for number in range(2):
        image(data / "frames" / f"t{number}.nii", number)
    for name in MINE:
        (there / name).write_bytes(f"mine: {name}".encode())
    (there / "linked").symlink_to(home)
    mine = [there / name for name in MINE]
    for case in ("scan", "frames", "scan_failed"):
        listed = [
            {
                "path": PATHS[draw.choice(list(PATHS))](path),
                "kind": draw.choice(["labels", "surface", "state", "data"]),
                "sha256": io.sha256(path),
                "seal": draw.choice(SEALS),
            }
            for path in draw.sample(mine, draw.randint(4, len(mine)))
        ]
        said = {"status": draw.choice(["ok", "failed", "interrupted"]), "exit_code": 0}
        said |= {"outputs": listed, "objects": [1], "config": {}, "schema_version": "1.0"}
        said |= {"input": {"path": str(scan), "sha256": io.sha256(scan)}}
        (there / f"{case}_report.json").write_text(json.dumps(said))
    before = contents(home), {path.name: path.read_bytes() for path in mine}
    monkeypatch.chdir(there)
    code = run(*REPLACING[command])
    told = capfd.readouterr().err
    assert code in (0, 2, 3, 5, 7, 9), told
    assert "Traceback" not in told and "bug in accelsurf" not in told
    assert (contents(home), {p.name: p.exists() and p.read_bytes() for p in mine}) == before


def test_the_files_of_a_run_of_ones_own_go_with_it_also_from_another_folder(received, capfd):
    top, home, data, scan = received
    assert run("segment", scan, "-o", "out", "--mesh", "ply", *BALL) == 0
    shutil.move(data / "out", data / "moved")
    assert run("segment", scan, "-o", "moved", "--overwrite", "--format", "nrrd", *BALL) == 0
    names = {path.name for path in (data / "moved").iterdir()}
    assert "scan_surface.ply" in names and "scan_seg.nrrd" in names and "scan_seg.nii" not in names


def test_files_of_another_users_run_are_named_and_stay(received, monkeypatch, capfd):
    top, home, data, scan = received
    assert run("segment", scan, "-o", "out", *BALL) == 0
    monkeypatch.setenv("XDG_STATE_HOME", str(top / "other"))
    assert run("segment", scan, "-o", "out", "--overwrite", "--format", "nrrd", *BALL) == 0
    assert "scan_seg.nii: the earlier report lists it" in capfd.readouterr().err
    assert (data / "out" / "scan_seg.nii").exists()


@pytest.mark.parametrize(
    "where", ["notes.txt", "group-1-0123456789abcdef/notes.txt", ".draft-mine/a"]
)
def test_files_among_groups_that_no_run_wrote_stay(where, tmp_path):
    from accelsurf.output import group_files

    path = tmp_path / ".scan_objects" / where
    path.parent.mkdir(parents=True)
    path.write_bytes(b"mine")
    assert group_files.not_of_groups(tmp_path / ".scan_objects") != []
    assert group_files.not_of_groups(tmp_path / ".nothing") == []
