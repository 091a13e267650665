"""``accelsurf refine``: files in, files out, and what is refused."""

import json
import shlex
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

import accelsurf
from accelsurf import cli, io
from accelsurf.errors import InputError
from accelsurf.image.volume import Volume
from accelsurf.interact import state_file
from accelsurf.interact.state_file import read_state, state_bytes, surface_of
from accelsurf.io import states
from accelsurf.settings.run_config import RunConfig

CLICK = ("--outside", "point:21,14,12vox")


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """A bright ball in noise."""
    z, y, x = np.indices((24, 28, 32)) * np.array([1.5, 1, 1])[:, None, None, None]
    image = 100.0 * ((z - 18) ** 2 + (y - 14) ** 2 + (x - 14) ** 2 < 8**2)
    image += np.random.default_rng(1).normal(0, 8, image.shape)
    path = tmp_path_factory.mktemp("scan") / "ball.nii.gz"
    io.write(Volume.from_array(image.astype(np.float32), (1.5, 1.0, 1.0)), path)
    return path


@pytest.fixture(scope="module")
def finished(scan, tmp_path_factory):
    """The outputs of a run with its state."""
    folder = tmp_path_factory.mktemp("finished")
    words = ("--start", "ball:14,14,12,5vox", "--keep-state", "yes", "--threads", "1")
    assert run("segment", scan, "-o", folder, *words) == 0
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    """A copy of them."""
    return shutil.copytree(finished, tmp_path / "out")


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_state_is_written_with_clicks_or_when_asked(scan, finished, tmp_path):
    report = json.loads((finished / "ball_report.json").read_text())
    assert {"state", "config"} <= {entry["kind"] for entry in report["outputs"]}
    assert (
        run(
            "segment",
            scan,
            "-o",
            tmp_path / "plain",
            "--start",
            "ball:14,14,12,5vox",
            "--max-steps",
            "2",
        )
        == 0
    )
    assert not list((tmp_path / "plain").glob("*state*"))
    words = (
        "--inside",
        "point:14,14,12vox",
        "--max-steps",
        "2",
        "--energy",
        "chan-vese",
        "--start",
        "center",
    )
    assert run("segment", scan, "-o", tmp_path / "clicked", *words) == 0
    assert (tmp_path / "clicked" / "ball_state.npz").is_file()


def test_a_table_of_clicks_has_a_state_and_one_of_balls_has_none(scan, tmp_path):
    clicks, balls = tmp_path / "clicks.csv", tmp_path / "balls.csv"
    clicks.write_text("id,x_vox,y_vox,z_vox,r_vox,side\n2,14,14,12,3,inside\n0,28,24,4,2,inside\n")
    balls.write_text("id,x,y,z,r\n2,14,14,18,4\n")
    words = ("--max-steps", "2", "--threads", "1")
    assert run("segment", scan, "-o", tmp_path / "clicks", "--objects", clicks, *words) == 0
    assert {"ball_state.npz", "ball_run.toml"} <= {
        path.name for path in (tmp_path / "clicks").iterdir()
    }
    assert (
        run("refine", tmp_path / "clicks", "--object", "2", "--outside", "point:20,14,12vox") == 0
    )
    labels = io.read(tmp_path / "clicks" / "ball_seg.nii.gz").array
    assert labels[12, 14, 14] == 2 and labels[12, 14, 20] == 0
    assert run("segment", scan, "-o", tmp_path / "balls", "--objects", balls, *words) == 0
    assert not list((tmp_path / "balls").glob("*state*"))
    assert (
        run("segment", scan, "-o", tmp_path / "absent", "--objects", tmp_path / "no.csv", *words)
        == 3
    )
    assert (tmp_path / "absent" / "ball_report.json").is_file()


def test_a_state_has_the_same_surface_bit_for_bit(scan, finished):
    state = read_state(finished / "ball_state.npz")
    config = RunConfig.from_toml(finished / "ball_run.toml")
    result = accelsurf.segment(accelsurf.read(scan), config=config)
    assert surface_of(state.objects[0]).tobytes() == result.psi.tobytes()
    assert state.config == result.config
    assert len(state_bytes(result, "")) < result.psi.nbytes


@pytest.mark.pictures
def test_command_python_and_configuration_make_the_same_bytes(scan, finished, tmp_path):
    first, second, repeated = tmp_path / "first", tmp_path / "second", tmp_path / "repeated"
    assert run("refine", finished, *CLICK, "--near", 6, "-o", first) == 0
    assert run("refine", first, "--inside", "point:23,14,12vox", "-o", second) == 0
    assert run("segment", scan, "-o", repeated, "--config", second / "ball_run.toml") == 0
    result = accelsurf.segment(
        accelsurf.read(scan), config=RunConfig.from_toml(finished / "ball_run.toml")
    )
    result = accelsurf.refine(result, outside=CLICK[1], near=6)
    result = accelsurf.refine(result, inside="point:23,14,12vox")
    for name in ("ball_seg.nii.gz", "ball_surface.ply", "ball_run.toml", "ball_preview.png"):
        assert (second / name).read_bytes() == (repeated / name).read_bytes()
    state = read_state(second / "ball_state.npz")
    assert surface_of(state.objects[0]).tobytes() == result.psi.tobytes()
    report = json.loads((second / "ball_report.json").read_text())
    assert len(report["config"]["refine"]) == 2 and report["seconds"]["refine"] > 0


def test_in_place_all_files_are_replaced_at_once(folder, capsys):
    before = content(folder)
    assert run("refine", folder, *CLICK, "--near", 6) == 0
    after = content(folder)
    assert after.keys() == before.keys()
    assert all(
        after[name] != before[name]
        for name in ("ball_seg.nii.gz", "ball_state.npz", "ball_run.toml")
    )
    assert "moved" in capsys.readouterr().out
    assert io.read_labels(folder / "ball_seg.nii.gz").array[12, 14, 21] == 0


def test_a_correction_that_changes_nothing_says_so(folder, capsys):
    labels = (folder / "ball_seg.nii.gz").read_bytes()
    assert run("refine", folder / "ball_report.json", "--inside", "point:14,14,12vox") == 0
    assert "nothing changed" in capsys.readouterr().out
    assert (folder / "ball_seg.nii.gz").read_bytes() == labels


def test_a_failed_correction_leaves_the_result(folder):
    before = content(folder)
    assert (
        run("refine", folder, "--outside", "point:21,14,12vox", "--inside", "point:900,14,12vox")
        == 3  # of two clicks the second lies outside of the image
    )
    after = content(folder)
    assert {name: after[name] for name in before} == before
    assert (
        run("refine", folder, "--outside", "ball:14,14,12,16vox", "--near", "60") == 5
    )  # nothing is left
    after = content(folder)
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize(("number", "mends"), [(signal.SIGTERM, False), (signal.SIGINT, True)])
@pytest.mark.program
def test_an_interrupted_correction_leaves_every_byte_and_names_the_command(
    folder, scan, tmp_path, number, mends
):
    before = content(folder)
    target = (
        ("--labels", str(folder / "ball_seg.nii.gz"), "-o", str(tmp_path / "mended"))
        if mends
        else ()
    )
    words = ("refine", str(scan if mends else folder), *target, *CLICK)
    program = subprocess.Popen(
        [sys.executable, "-m", "accelsurf", *words, "--progress", "json"],
        stderr=subprocess.PIPE,
        text=True,
    )
    for line in program.stderr:
        if line.startswith("{") and json.loads(line)["event"] == "step":
            program.send_signal(number)
            break
    _, error = program.communicate(timeout=60)
    assert program.returncode == 128 + number, error
    assert content(folder) == before and not list((tmp_path / "mended").glob("*"))
    again = error.splitlines()[-1].partition(
        "interrupted: no file is changed; to begin again: accelsurf "
    )[2]
    assert shlex.split(again) == [*words, "--progress", "json"]
    assert run(*shlex.split(again)) == 0
    assert (content(folder) == before) == mends


def test_files_that_somebody_changed_are_not_replaced(folder, capsys):
    (folder / "ball_surface.ply").write_text("mine")
    assert run("refine", folder, *CLICK) == 7
    assert "changed since" in capsys.readouterr().err
    assert (folder / "ball_surface.ply").read_text() == "mine"
    assert run("refine", folder, *CLICK, "--overwrite") == 0


def test_another_folder_is_checked_as_of_segment(finished, folder, tmp_path):
    assert run("refine", finished, *CLICK, "-o", tmp_path / "new") == 0
    assert run("refine", finished, *CLICK, "-o", tmp_path / "new") == 7
    assert run("refine", finished, *CLICK, "-o", tmp_path / "new", "--overwrite") == 0


def moved_report(folder, path):
    report = json.loads((folder / "ball_report.json").read_text())
    report["input"]["path"] = str(path)
    (folder / "ball_report.json").write_text(json.dumps(report))


def test_a_moved_image_is_named_and_a_changed_one_refused(folder, scan, tmp_path, capsys):
    moved_report(folder, tmp_path / "gone.nii.gz")
    assert run("refine", folder, *CLICK) == 3
    assert "is not there" in capsys.readouterr().err
    other = shutil.copy(scan, tmp_path / "elsewhere.nii.gz")
    assert run("refine", folder, *CLICK, "--image", other) == 0
    volume = accelsurf.read(scan)
    io.write(volume.with_array(volume.array + np.float32(1)), tmp_path / "changed.nii.gz")
    before = content(folder)
    assert run("refine", folder, *CLICK, "--image", tmp_path / "changed.nii.gz") == 3
    assert "another image" in capsys.readouterr().err
    assert {name: content(folder)[name] for name in before} == before


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:200],
        lambda data: b"",
        lambda data: b"not a state",
        lambda data: data[:-100] + bytes(100),
        lambda data: (
            data[: len(data) // 2]
            + bytes([data[len(data) // 2] ^ 255])
            + data[len(data) // 2 + 1 :]
        ),
    ],
    ids=["short", "empty", "foreign", "zeros", "flipped"],
)
def test_a_damaged_state_is_one_clear_line(folder, damage, capsys):
    path = folder / "ball_state.npz"
    path.write_bytes(damage(path.read_bytes()))
    assert run("refine", folder, *CLICK) == 3
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2 and "ball_state.npz" in lines[0]
    try:
        state = read_state(path)
    except InputError as error:
        assert "state" in error.message
    else:  # the flipped byte lies in an array
        with pytest.raises((InputError, ValueError)):
            surface_of(state.objects[0])


def test_a_state_of_another_version_or_size_is_refused(finished, tmp_path, monkeypatch):
    state = read_state(finished / "ball_state.npz")
    state = state._replace(config=state.config.model_dump(mode="json"))
    path = tmp_path / "ball_state.npz"
    with monkeypatch.context() as old:
        old.setattr(states, "FORMAT", 99)
        states.write_state_file(path, state, state_file.TYPES)
    with pytest.raises(InputError, match="another version of accelsurf was given .format 99"):
        read_state(path)
    states.write_state_file(path, state._replace(shape=(4, 4, 4)), state_file.TYPES)
    with pytest.raises(InputError, match="beyond the image"):
        read_state(path)
    bomb = state.objects[0].surface.values._replace(shape=(1 << 40,))
    one = state.objects[0]._replace(surface=state.objects[0].surface._replace(values=bomb))
    states.write_state_file(path, state._replace(objects=(one,)), state_file.TYPES)
    with pytest.raises((InputError, ValueError)):
        surface_of(read_state(path).objects[0])


def test_what_cannot_be_refined_is_said(tmp_path, finished, capsys):
    assert run("refine", tmp_path / "no such", *CLICK) == 3
    assert run("refine", tmp_path, *CLICK) == 3
    assert "has no result that can be refined" in capsys.readouterr().err
    assert run("refine", finished) == 2
    assert "no click" in capsys.readouterr().err
    for number in range(2):
        for path in finished.iterdir():
            shutil.copy(path, tmp_path / path.name.replace("ball", f"ball{number}"))
    assert run("refine", tmp_path, *CLICK) == 3
    assert "several results" in capsys.readouterr().err
