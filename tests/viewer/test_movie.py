"""Movies: the frames decode, differ, and show the surface grow; repeated from a result folder; no incomplete file."""

import importlib.util
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image, ImageSequence

from accelsurf import cli, io
from accelsurf.errors import InputError, UsageError
from accelsurf.output.pictures import movies
from accelsurf.run.run import Run
from accelsurf.viewer import movie_file
from tests.support import viewing

START = "ball:{},{},{},5"
needs_ffmpeg = pytest.mark.skipif(
    importlib.util.find_spec("imageio_ffmpeg") is None,
    reason='no mp4 encoder: pip install "accelsurf[viewer]"',
)


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


@pytest.fixture
def image(tmp_path):
    """A ball in a file, and the options that start in it and end soon."""
    volume, center = viewing.ball_image()
    path = tmp_path / "ball.nii.gz"
    io.write(volume, path)
    start = START.format(*(f"{v:g}" for v in center))
    return path, ["--start", start, "--threads", "1", "--max-steps", "25", "--levels", "1"]


def decoded(path):
    """Frames of a movie (n, height, width, 3)."""
    if path.suffix == ".mp4":
        import imageio_ffmpeg

        ppm = ["-f", "image2pipe", "-c:v", "ppm", "-"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path), *ppm]
        data = subprocess.run(command, capture_output=True, check=True).stdout
        width, height = (int(v) for v in data.split(b"\n", 2)[1].split())
        header = len(f"P6\n{width} {height}\n255\n")
        raw = np.frombuffer(data, np.uint8).reshape(-1, header + 3 * width * height)
        return list(raw[:, header:].reshape(-1, height, width, 3))
    with Image.open(path) as opened:
        return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(opened)]


def surface_pixels(frame):
    """How many pixels of the tile in 3D are of the surface's orange."""
    left = frame[:, : frame.shape[1] // 2].astype(int)
    return int(((left[..., 0] > 90) & (left[..., 0] > left[..., 2] + 60)).sum())


@pytest.mark.sampled(1)
@pytest.mark.parametrize("suffix", [pytest.param(".mp4", marks=needs_ffmpeg), ".gif", ".webp"])
@pytest.mark.program
def test_frames_differ_and_the_surface_grows(image, tmp_path, suffix, capsys):
    path, options = image
    out = tmp_path / f"evolution{suffix}"
    size = ["--size", "480x270", "--orbit", "0", "--hold", "0.2", "--every", "3", "--fps", "10"]
    assert cli.execute(["movie", str(path), "-o", str(out), *options, *size]) == 0
    assert "frames" in capsys.readouterr().out
    frames = decoded(out)
    assert {frame.shape for frame in frames} == {(270, 480, 3)}
    assert len(frames) >= 9
    for one, other in zip(frames[:4], frames[1:5], strict=True):
        assert (np.abs(one.astype(int) - other) > 24).sum() > 50
    grown = [surface_pixels(frame) for frame in frames]
    assert grown[-1] > 1.8 * grown[0] > 100, grown
    assert grown[:5] == sorted(grown[:5]), grown  # later momentum may carry it too far and back
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.nii.gz", out.name]


@pytest.mark.slow
@pytest.mark.program
def test_the_camera_turns(image, tmp_path):
    path, options = image
    pictures = {}
    for orbit in ("0", "90"):
        out = tmp_path / f"{orbit}.gif"
        look = [
            "--size",
            "320x180",
            "--orbit",
            orbit,
            "--hold",
            "0.5",
            "--every",
            "1000",
            "--fps",
            "10",
        ]
        look += ["--view", "front"]
        assert cli.execute(["movie", str(path), "-o", str(out), *options, *look, "--quiet"]) == 0
        pictures[orbit] = decoded(out)
    # Pillow leaves out frames in which nothing changed, and shows the last one longer.
    assert len(pictures["90"]) > len(pictures["0"]) >= 2
    assert (pictures["90"][-1] != pictures["90"][-2]).any()


@pytest.mark.slow
def test_a_preview_is_the_last_frame(image, tmp_path, capsys):
    path, options = image
    look = ["--theme", "light", "--color", "force", "--size", "640x360", "--planes"]
    out = tmp_path / "last.png"
    assert cli.execute(["movie", str(path), "--preview", "-o", str(out), *options, *look]) == 0
    assert "picture" in capsys.readouterr().out
    with Image.open(out) as picture:
        assert picture.size == (640, 360)
        assert np.median(np.asarray(picture)) == 255


@pytest.mark.program
def test_a_preview_of_a_folder_draws_what_is_there_without_a_step(
    image, tmp_path, monkeypatch, capsys
):
    path, options = image
    results, look = tmp_path / "out", ["--size", "320x180", "--overwrite"]
    assert (
        cli.execute(["segment", str(path), "-o", str(results), "--keep-state", "yes", *options])
        == 0
    )
    live, made = tmp_path / "live.png", tmp_path / "made.png"
    assert cli.execute(["movie", str(path), "--preview", "-o", str(live), *options, *look]) == 0

    def refused(run):
        pytest.fail("it makes a step")

    monkeypatch.setattr(Run, "step", refused)
    folder = ["movie", str(results), "--preview", "-o", str(made), *look]
    assert cli.execute(folder) == 0
    assert made.read_bytes() == live.read_bytes()
    monkeypatch.undo()
    # A folder is one for the file, as of other commands.
    assert cli.execute(["movie", str(results), "--preview", "-o", str(tmp_path), *look]) == 0
    assert (tmp_path / "ball_movie.png").read_bytes() == live.read_bytes()
    # What a correction has moved is in the picture.
    assert cli.execute(["refine", str(results), "--inside", "ball:4,4,4,3vox"]) == 0
    assert cli.execute(folder) == 0
    assert made.read_bytes() != live.read_bytes()
    # Without a state it is the label map.
    assert (
        cli.execute(
            [
                "segment",
                str(path),
                "-o",
                str(results),
                "--keep-state",
                "no",
                "--overwrite",
                *options,
            ]
        )
        == 0
    )
    assert cli.execute(folder) == 0
    difference = np.abs(decoded(made)[0].astype(int) - decoded(live)[0].astype(int)).max(axis=-1)
    assert 0 < (difference > 30).mean() < 0.05
    (results / "ball_seg.nii.gz").write_bytes(b"other")
    capsys.readouterr()
    assert (
        cli.execute(folder) == 3 and "was changed since it was written" in capsys.readouterr().err
    )
    assert cli.execute([*folder, "--color", "speed"]) == 2


def test_a_result_folder_is_run_again_with_its_settings(image, tmp_path, capsys):
    path, options = image
    results = tmp_path / "out"
    assert (
        cli.execute(["segment", str(path), "-o", str(results), "--smoothness", "0.3", *options])
        == 0
    )
    source, config = movie_file.run_of_folder(results)
    assert (source.path, config.smoothness, config.max_steps, config.levels) == (path, 0.3, 25, 1)
    look = ["--size", "320x180", "--hold", "0", "--every", "5"]
    again, live = tmp_path / "again.gif", tmp_path / "live.gif"
    assert cli.execute(["movie", str(results), "-o", str(again), *look]) == 0
    assert (
        cli.execute(["movie", str(path), "-o", str(live), "--smoothness", "0.3", *options, *look])
        == 0
    )
    assert again.read_bytes() == live.read_bytes()
    capsys.readouterr()
    assert cli.execute(["movie", str(results), "-o", str(tmp_path / "b.gif"), "--cfl", "0.4"]) == 2
    assert "--cfl was given for a folder of results" in capsys.readouterr().err
    volume = io.read(path)
    io.write(volume.with_array(volume.array + np.float32(1)), path)
    assert cli.execute(["movie", str(results), "-o", str(tmp_path / "b.gif"), *look]) == 3
    assert "another image than that of the run" in capsys.readouterr().err
    path.unlink()
    with pytest.raises(InputError, match="is not there"):
        movie_file.run_of_folder(results)


def test_edits_are_made_again_too(image, tmp_path):
    path, options = image
    results = tmp_path / "out"
    edit = ["--edit", "step=5 smoothness=0.5", "--edit", "step=9 flow=gradient"]
    assert cli.execute(["segment", str(path), "-o", str(results), "--quiet", *options, *edit]) == 0
    report = json.loads((results / "ball_report.json").read_text())
    run = Run(io.read(path), movie_file.run_of_folder(results)[1])
    ((frame, histories),) = movie_file.frames(run, every=None)
    assert frame.volume_mm3 == report["volume_mm3"]
    assert frame.step == report["stop"]["steps"] == histories[0][-1].step


#: A file that a report lists.
FILE = {"kind": "labels", "path": "a_seg.nii.gz", "sha256": "0"}


def test_folders_without_a_run_are_refused(tmp_path):
    with pytest.raises(InputError, match="no report"):
        movie_file.run_of_folder(tmp_path)
    report = tmp_path / "a_report.json"
    for text in (
        "",
        "[]",
        '{"config": null, "input": null}',
        '{"config": 3, "input": {"path": "a", "sha256": null}}',
    ):
        report.write_text(text)
        with pytest.raises(InputError, match="no report of a run"):
            movie_file.run_of_folder(tmp_path)
    own = {"status": "ok", "exit_code": 0, "outputs": [FILE], "config": {"energy": "custom: Mine"}}
    report.write_text(json.dumps({**own, "input": {"path": str(tmp_path), "sha256": None}}))
    with pytest.raises(InputError, match="one of your own"):
        movie_file.run_of_folder(tmp_path)
    (tmp_path / "b_report.json").write_text(report.read_text())
    with pytest.raises(InputError, match="several results"):
        movie_file.run_of_folder(tmp_path)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["-o", "a.avi"], "a.avi: .avi was given, expected .mp4, .gif, .webp"),
        (["-o", "a"], "no suffix was given"),
        (["-o", "a.png"], "expected .mp4, .gif, .webp"),
        (["-o", "a.gif", "--preview"], "expected .png with --preview"),
        (["-o", "a.gif", "--size", "big"], "size: big was given"),
        (["-o", "a.gif", "--size", "10x10"], "size: 10x10 was given"),
        (["-o", "a.gif", "--size", "99999x9999"], "size: 99999x9999 was given"),
        pytest.param(["-o", "a.mp4", "--size", "321x180"], "expected even numbers for mp4"),
        (["-o", "a.gif", "--fps", "0"], "fps: 0 was given"),
        (["-o", "a.gif", "--fps", "nan"], "fps: nan was given"),
        (["-o", "a.gif", "--every", "0"], "every: 0 was given"),
        (["-o", "a.gif", "--hold", "-1"], "hold: -1 was given"),
        (["-o", "a.gif", "--start", "nowhere"], "start"),
        ([], "-o FILE, the movie, is missing"),
    ],
)
def test_bad_options_cost_one_line_and_no_file(
    image, tmp_path, capsys, monkeypatch, given, message
):
    path, _ = image
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["movie", str(path), *given]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("error:") == 1 and len(error.splitlines()) <= 2
    assert [p.name for p in tmp_path.iterdir()] == ["ball.nii.gz"]


def test_files_are_not_replaced_unless_asked_for(image, tmp_path, capsys):
    path, options = image
    out = tmp_path / "a.gif"
    out.write_bytes(b"mine")
    assert cli.execute(["movie", str(path), "-o", str(out), *options]) == 7
    assert "exists already" in capsys.readouterr().err and out.read_bytes() == b"mine"
    look = ["--size", "320x180", "--every", "1000", "--hold", "0", "--overwrite", "--quiet"]
    assert cli.execute(["movie", str(path), "-o", str(out), *options, *look]) == 0
    assert out.read_bytes()[:3] == b"GIF"


def test_nothing_is_left_when_a_frame_fails(tmp_path):
    def frames():
        yield np.zeros((180, 320, 3), np.uint8)
        raise InputError("the disk is full")

    for name in (
        "a.gif",
        "a.webp",
        *(["a.mp4"] if importlib.util.find_spec("imageio_ffmpeg") else []),
    ):
        with pytest.raises(InputError, match="disk is full"):
            movies.write_movie(tmp_path / name, frames(), (320, 180), 15.0)
        assert list(tmp_path.iterdir()) == []


def test_mp4_without_its_encoder_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UsageError, match="imageio-ffmpeg is not installed") as caught:
        movies.check_target(tmp_path / "a.mp4", (320, 180))
    assert "accelsurf[viewer]" in caught.value.hint
    movies.check_target(tmp_path / "a.gif", (320, 180))


# -- grey values --------------------------------------------------------------------------------------------


def share_of_grey(picture, grey):
    """How much of a picture is of this grey, with what drawing rounds."""
    return float((np.abs(np.asarray(picture)[..., :3].astype(int) - grey).max(axis=2) <= 2).mean())


@pytest.mark.slow
@pytest.mark.program
def test_window_sets_the_greys_of_movies_and_their_pictures(image, tmp_path):
    """The ball of 100 in 0 is white on black by itself; from -50 to 150 it is light grey on dark grey."""
    path, options = image
    look = ["--size", "640x360", "--max-steps", "2", "--hold", "0", "--quiet"]
    for window, share in (([], 0.0), (["--window", "50,200"], 0.02)):
        words = ["movie", str(path), "--overwrite", *options[:-4], "--levels", "1", *look, *window]
        assert cli.execute([*words, "-o", str(tmp_path / "a.png"), "--preview"]) == 0
        assert cli.execute([*words, "-o", str(tmp_path / "a.webp")]) == 0
        with Image.open(tmp_path / "a.png") as opened:
            greys = [share_of_grey(opened, grey) for grey in (64, 191)]
        assert (min(greys) > share) if share else (max(greys) < 0.005)
        moved = [share_of_grey(decoded(tmp_path / "a.webp")[-1], grey) for grey in (64, 191)]
        assert moved == pytest.approx(greys, abs=0.05)  # webp loses some


def test_a_reference_on_another_grid_is_refused(image, tmp_path, capsys):
    path, options = image
    other = tmp_path / "other.nii.gz"
    io.write(viewing.ball_image((10, 12, 14))[0], other)
    words = ["movie", str(path), "-o", str(tmp_path / "a.gif"), "--reference", str(other), *options]
    assert cli.execute(words) == 3
    assert "the reference is not on the image's grid" in capsys.readouterr().err
    assert not (tmp_path / "a.gif").exists()


# -- without a screen ---------------------------------------------------------------------------------------


def alone(arguments, **environment):
    """Run the command line in a process without a screen."""
    env = {
        k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")
    } | environment
    command = [sys.executable, "-m", "accelsurf", *map(str, arguments)]
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=240)


@pytest.mark.program
def test_pictures_need_no_screen(image, tmp_path):
    path, options = image
    out = tmp_path / "a.png"
    done = alone(["movie", path, "--preview", "-o", out, *options])
    assert done.returncode == 0, done.stderr
    assert (
        out.is_file() and done.stderr == ""
    )  # no word of VTK's about the screen that it did not find


@pytest.mark.program
def test_without_any_driver_one_line_says_what_is_missing(image, tmp_path):
    path, options = image
    nowhere = str(tmp_path / "nowhere")
    none = {"__EGL_VENDOR_LIBRARY_DIRS": nowhere, "LIBGL_DRIVERS_PATH": nowhere}
    done = alone(["movie", path, "--preview", "-o", tmp_path / "a.png", *options], **none)
    if done.returncode == 0:
        pytest.skip("this machine draws without EGL: it has OSMesa, or a driver elsewhere")
    assert done.returncode == 8 and len(done.stderr.splitlines()) == 2, done.stderr
    assert (
        "neither a screen nor EGL nor OSMesa" in done.stderr
        and "apt install libosmesa6" in done.stderr
    )
    assert not (tmp_path / "a.png").exists()


def test_a_report_that_names_an_image_no_system_can_have(tmp_path):
    config = {
        "config": {},
        "input": {"path": "v" * 5000, "sha256": None},
        "status": "ok",
        "outputs": [FILE],
    }
    (tmp_path / "a_report.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="no report of a run"):
        movie_file.run_of_folder(tmp_path)
