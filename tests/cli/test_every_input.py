"""Each kind of image that ``segment`` takes, ``refine``, ``movie`` and ``view`` take as it was given."""

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import nibabel
import numpy as np
import pytest
from PIL import Image

from accelsurf import cli, io
from accelsurf.errors import AccelsurfError, InputError
from accelsurf.image.volume import Volume
from accelsurf.io import channels
from accelsurf.output.given_image import settings_of
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.viewer import movie_file
from accelsurf.viewer.core.opening import ImageToOpen, finished_run
from tests.support.folders import contents

SHAPE, SPACING = (12, 16, 20), (1.5, 0.75, 1.0)
CLICK, MORE, LAST = "ball:10,8,6,2vox", "ball:13,8,6,1vox", "ball:2,2,2,1vox"


def ball(shift=0, shape=SHAPE):
    z, y, x = np.indices(shape)
    inside = (z - shape[0] // 2) ** 2 + (y - 8) ** 2 + (x - 9 - shift) ** 2 < 25
    return (60 + 100 * inside + np.random.default_rng(4).normal(0, 8, shape)).astype(np.uint8)


def written(name: str, *options: str):
    """A file in a format that is written, with all that the format keeps of the grid."""

    def make(folder):
        io.write(
            Volume.from_array(ball().astype(np.int16 if "png" not in name else np.uint8), SPACING),
            folder / name,
        )
        return folder / name, options

    return make


def nhdr(folder):
    (folder / "a.raw").write_bytes(ball().tobytes())
    head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 20 16 12\nspacings: 1 0.75 1.5\n"
    head += "encoding: raw\ndata file: a.raw\n\n"
    (folder / "a.nhdr").write_text(head)
    return folder / "a.nhdr", ()


def mgz(folder):
    nibabel.save(nibabel.MGHImage(ball().T, np.diag([1.0, 0.75, 1.5, 1.0])), folder / "a.mgz")
    return folder / "a.mgz", ()


def slices(suffix, pattern):
    def make(folder):
        (folder / "stack").mkdir()
        for number, plane in enumerate(ball()):
            Image.fromarray(plane).save(folder / "stack" / f"s{number}.{suffix}")
        (folder / "stack" / "readme.txt").write_text("of the microscope")
        return folder / "stack" / (f"s*.{suffix}" if pattern else ""), ("--spacing", "1,0.75,1.5")

    return make


def flat(folder):
    Image.fromarray(ball(shape=(1, 16, 20))[0]).save(folder / "a.png")
    return folder / "a.png", ("--spacing", "0.2um")


def in_time(folder):
    four = np.stack([ball(shift) for shift in (-3, 0, 3)])
    image = nibabel.Nifti1Image(four.T, np.diag([1.0, 0.75, 1.5, 1.0]))
    image.header.set_xyzt_units("mm", "sec")
    nibabel.save(image, folder / "a.nii.gz")
    return folder / "a.nii.gz", ("--time-index", "1")


def two_channels(folder):
    four = np.stack([ball(), ball()[::-1]])
    image = nibabel.Nifti1Image(four.T[:, :, :, None, :], np.diag([1.0, 0.75, 1.5, 1.0]))
    image.header.set_intent("vector")
    nibabel.save(image, folder / "a.nii.gz")
    return folder / "a.nii.gz", ()


def level(folder):
    fine = np.repeat(np.repeat(np.repeat(ball(), 2, 0), 2, 1), 2, 2)
    zarr = pytest.importorskip("zarr")
    root = zarr.open_group(folder / "a.ome.zarr", mode="w", zarr_format=2)
    sets = []
    for number, array in enumerate((fine, ball())):
        stored = root.create_array(
            str(number), shape=array.shape, chunks=(8, 8, 8), dtype=array.dtype
        )
        stored[:] = array
        scale = [{"type": "scale", "scale": [h * (1 + number) / 2 for h in SPACING]}]
        sets.append({"path": str(number), "coordinateTransformations": scale})
    axes = [{"name": name, "type": "space", "unit": "millimeter"} for name in "zyx"]
    root.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": sets}]
    return folder / "a.ome.zarr", ("--level", "1")


def dicom(kind):
    def make(folder):
        pytest.importorskip("pydicom")
        from tests.support.dicom_series import Series, save

        for number, uid in enumerate(["1.2.3.4", "1.2.3.5"][: 2 if kind == "series" else 1]):
            (folder / f"scan{number}").mkdir()
            series = Series(rows=16, columns=20, spacing=(0.75, 1.0), uid=uid)
            series.changes = {"SeriesNumber": number + 1}
            series.stacked(12, 1.5)
            for z, plane in enumerate(ball(-3 * number).astype(np.int16)):
                one = series.dataset(z)
                one.PixelData = plane.tobytes()
                save(one, folder / f"scan{number}" / f"IM{z:03d}.dcm")
        if kind == "file":
            return folder / "scan0" / "IM004.dcm", ()
        return (folder, ("--series", "2")) if kind == "series" else (folder / "scan0", ())

    return make


KINDS: dict[str, Callable] = {
    **{
        name: written(f"a.{name}")
        for name in ("nii.gz", "nii", "nrrd", "mha", "mhd", "tif", "ome.zarr")
    },
    "npy": written("a.npy", "--spacing", "1,0.75,1.5"),
    "nhdr": nhdr,
    "mgz": mgz,
    "folder of PNG": slices("png", pattern=False),
    "pattern of TIFF": slices("tif", pattern=True),
    "PNG": flat,
    "time point": in_time,
    "two channels": two_channels,
    "level": level,
    "DICOM folder": dicom("folder"),
    "DICOM file": dicom("file"),
    "DICOM series": dicom("series"),
}


@dataclass
class Given:
    """An image as it is given, with its result."""

    root: object
    path: object
    options: tuple
    out: object

    @property
    def click(self):
        return CLICK if self.path.suffix != ".png" else "ball:10,8,0,3vox"


def run(*words):
    return cli.execute([str(word) for word in words])


@pytest.fixture(params=KINDS)
def given(request, tmp_path):
    (tmp_path / "src").mkdir()
    path, options = KINDS[request.param](tmp_path / "src")
    found = Given(tmp_path / "src", path, options, tmp_path / "out")
    words = ("--inside", found.click, "--threads", "1", "--seed", "1", "--quiet")
    assert run("segment", path, "-o", found.out, *options, *words) == 0
    return found


@pytest.mark.sampled(7)
def test_all_commands_take_an_image_as_segment_took_it(given, tmp_path, capsys):
    report = json.loads(next(given.out.glob("*_report.json")).read_text())
    asked = RunConfig(**report["config"]).reading
    volumes = channels.read_channels(given.path, asked)
    more, again = (
        (MORE, LAST) if given.path.suffix != ".png" else ("ball:13,8,0,2vox", "ball:2,2,0,1vox")
    )
    assert (
        run(
            "segment",
            given.path,
            "-o",
            given.out,
            *given.options,
            "--resume",
            "--quiet",
            "--inside",
            given.click,
            "--threads",
            "1",
        )
        == 0
    )
    assert run("refine", given.out, "--inside", more, "--quiet") == 0
    assert run("refine", given.out, "--outside", again, "--quiet") == 0
    # A movie and the viewer read the same channels.
    image, config = movie_file.run_of_folder(given.out)
    for one, other in zip(image.read(""), volumes, strict=True):
        assert one.array.tobytes() == other.array.tobytes() and not one.geometry.difference(
            other.geometry
        )
    opened = ImageToOpen(image.path, config, None, None, TrackConfig(), image).start_reading()()
    assert finished_run(given.out) == (image, config) and len(opened.channels) == len(volumes) - 1
    assert opened.volume.array.tobytes() == volumes[0].array.tobytes()
    # Moved, it is named; where it was, nothing is.
    moved = tmp_path / "moved"
    given.root.rename(moved)
    before = contents(given.out)
    capsys.readouterr()
    assert run("refine", given.out, "--inside", more, "--quiet") == 3
    assert "the image of the run is not there" in capsys.readouterr().err
    assert contents(given.out) == before | {
        name: data for name, data in contents(given.out).items() if "failed" in name
    }
    there = moved / given.path.relative_to(given.root)
    assert run("refine", given.out, "--inside", more, "--image", there, "--quiet") == 0
    assert run("refine", given.out, "--outside", again, "--quiet") == 0
    # Another image is refused, and the message says what differs.
    other = changed(moved, tmp_path / "other", there)
    capsys.readouterr()
    assert run("refine", given.out, "--inside", more, "--image", other, "--quiet") == 3
    said = capsys.readouterr().err
    assert "another image than that of the run" in said and "differ" in said


def changed(root, copy, path):
    """A copy of the images in which values of one differ; a file beside the one that is named, where there is one."""
    shutil.copytree(root, copy)
    at = copy / path.relative_to(root)
    files = sorted(
        f for f in copy.rglob("*") if f.is_file() and f.suffix in (".png", ".tif", ".dcm", ".raw")
    )
    others = [file for file in files if file != at] or files
    if others and others[-1].suffix == ".raw":
        others[-1].write_bytes(bytes(len(others[-1].read_bytes())))
    elif others and others[-1].suffix == ".dcm":
        import pydicom

        one = pydicom.dcmread(others[-1])
        one.PixelData = bytes(len(one.PixelData))
        one.save_as(others[-1])
    elif others and len(files) > 1 or at.suffix == ".png":
        Image.fromarray(np.zeros_like(np.array(Image.open(others[-1])))).save(others[-1])
    elif at.name.endswith(".nii.gz") or at.suffix == ".mgz":
        image = nibabel.load(at)
        nibabel.save(type(image)(np.asarray(image.dataobj)[::-1], image.affine, image.header), at)
    elif at.name.endswith(".zarr"):
        shutil.rmtree(at)
        level(copy) if (path / ".zgroup").exists() else None
        if (path / ".zgroup").exists():
            import zarr

            zarr.open_group(at)["1"][:] = 7
        else:
            io.write(Volume.from_array(ball(1).astype(np.int16), SPACING), at)
    else:
        volume = io.read(at)
        io.write(volume.with_array(volume.array[::-1].copy()), at)
    return at


def test_a_movie_is_made_of_a_run_whose_image_is_a_folder(tmp_path):
    (tmp_path / "src").mkdir()
    path, options = KINDS["folder of PNG"](tmp_path / "src")
    words = ("--inside", CLICK, "--threads", "1", "--max-steps", "4")
    assert run("segment", path, "-o", tmp_path / "out", *options, *words, "--quiet") == 0
    look = ("--size", "320x180", "--hold", "0", "--quiet")
    assert run("movie", tmp_path / "out", "-o", tmp_path / "a.gif", *look) == 0
    assert run("movie", path, "-o", tmp_path / "b.gif", *look, *options, *words) == 0
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_results_in_the_folder_of_the_image_do_not_change_it(tmp_path):
    (tmp_path / "src").mkdir()
    path, options = KINDS["folder of PNG"](tmp_path / "src")
    words = (
        "segment",
        path,
        "-o",
        path / "out",
        *options,
        "--inside",
        CLICK,
        "--threads",
        "1",
        "--quiet",
    )
    assert run(*words) == 0
    assert run("refine", path / "out", "--inside", MORE, "--quiet") == 0
    assert run(*words, "--resume") == 0


def test_a_result_of_an_image_read_in_parts_says_why_it_cannot_be_refined(tmp_path, capsys):
    io.write(Volume.from_array(np.tile(ball(), (8, 7, 6)), SPACING), tmp_path / "a.nii")
    words = ("--start", "ball:10,8,6,4vox", "--max-steps", "3", "--max-memory", "490MB")
    words += ("--energy", "threshold:110,", "--threads", "1")
    assert run("segment", tmp_path / "a.nii", "-o", tmp_path / "out", *words, "--quiet") == 0
    capsys.readouterr()
    assert run("refine", tmp_path / "out", "--inside", MORE) == 3
    assert "read in parts" in capsys.readouterr().err


#: Names that no file can have, and what is no file.
NO_FILE = [
    "a" * 300,
    "a" * 5000 + ".nii",
    f"x/{'b' * 300}/a.nii",
    f"{'c' * 300}/*.tif",
    "~" + "d" * 300,
]
NO_FILE += ["/".join(["e" * 200] * 25), "x\ny.nii", "x\0y.nii", "/dev/zero"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """An image with the result of a run that read a mask and a further channel."""
    folder = tmp_path_factory.mktemp("finished")
    for name, values in {"a": ball(), "more": ball(1), "mask": np.ones(SHAPE, np.uint8)}.items():
        io.write(Volume.from_array(values.astype(np.int16), SPACING), folder / f"{name}.nii")
    words = ("segment", folder / "a.nii", "-o", folder / "out", "--inside", CLICK, "--quiet")
    words += ("--mask", folder / "mask.nii", "--channel", folder / "more.nii", "--threads", "1")
    assert run(*words) == 0
    return folder, words


def no_traceback(code, said):
    assert code in (0, 2, 3, 7, 8) and "bug in accelsurf" not in said and "Traceback" not in said
    assert said.count("error:") == (code != 0)


@pytest.mark.sampled
@pytest.mark.parametrize("where", ["input", "mask", "channel", "label_table", "start", "outputs"])
@pytest.mark.parametrize("name", NO_FILE, ids=range(len(NO_FILE)))
def test_a_report_that_names_no_file_is_refused_in_a_line(finished, name, where, tmp_path, capsys):
    folder, words = finished
    out = shutil.copytree(folder / "out", tmp_path / "out")
    report = out / "a_report.json"
    document = json.loads(report.read_text())
    if where == "input":
        document["input"]["path"] = name
    elif where == "outputs":
        for entry in document["outputs"]:
            entry["path"] = name
    else:
        value = {"channel": [name], "start": [f"label:{name}"]}.get(where, name)
        document["config"][where] = value
    report.write_text(json.dumps(document))
    words = [out if word == folder / "out" else word for word in words]
    for command in (
        ("info", out),
        ("refine", out, "--inside", MORE, "--quiet"),
        ("movie", out, "-o", tmp_path / "a.png", "--preview", "--size", "320x180", "--overwrite"),
        (*words, "--resume"),
    ):
        code = run(*command)
        no_traceback(code, capsys.readouterr().err)
    with suppress(AccelsurfError):
        image, config = finished_run(out) or (None, None)
        if image is not None:
            ImageToOpen(image.path, config, None, None, TrackConfig(), image).start_reading()()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", [n for n in NO_FILE if "\0" not in n], ids=repr)
def test_a_name_that_no_file_can_have_is_refused_by_every_command(finished, name, tmp_path, capsys):
    folder, _ = finished
    scan, out = folder / "a.nii", tmp_path / "out"
    click = ("--start", "center", "--max-steps", "1", "--quiet")
    for command in (
        ("segment", name, "-o", out, *click),
        ("segment", scan, "-o", out, "--mask", name, *click),
        ("segment", scan, "-o", out, "--config", name, *click),
        ("segment", scan, "-o", out, "--start", f"label:{name}"),
        ("segment", scan, "-o", out, "--inside", f"stroke:{name}"),
        ("look", name),
        ("info", name),
        ("refine", name, "--inside", MORE),
        ("refine", folder / "out", "--inside", MORE, "--image", name),
        ("movie", name, "-o", tmp_path / "a.gif"),
        ("view", name),
        ("evaluate", name, folder / "mask.nii"),
        ("evaluate", folder / "mask.nii", name),
        ("track", name, "-o", out, *click),
    ):
        code = run(*command)
        # 7: outputs are named by it, too; 8: a window wants a screen first.
        assert code in (2, 3, 7) or (command[0], code) == ("view", 8), command[0]
        no_traceback(code, capsys.readouterr().err)


@pytest.mark.parametrize(
    "path", ["a" * 300, "a" * 300 + "*", "/dev/zero", "x\0y", "gone/*.tif", 7, None]
)
def test_a_report_may_name_any_path(tmp_path, path):
    report = {"status": "ok", "exit_code": 0, "outputs": [], "config": {}, "input": {"path": path}}
    report |= {"objects": None, "quality": None}
    (tmp_path / "a_report.json").write_text(json.dumps(report))
    found = None
    with suppress(InputError):
        found = finished_run(tmp_path)  # None where no file can have the name: it is no report then
    assert found is None
    with pytest.raises(InputError):
        movie_file.run_of_folder(tmp_path)[0].read("")


def frames(folder, suffix):
    (folder / "pngs").mkdir()
    for number in range(4):
        Image.fromarray(ball(number, (1, 16, 24))[0]).save(
            folder / "pngs" / f"s{number:02d}.{suffix}"
        )
    return folder / "pngs"


@pytest.mark.parametrize("suffix", ["nii", "ome.zarr"])
def test_a_finished_run_of_an_image_read_in_parts_is_resumed(tmp_path, suffix, capsys):
    source = tmp_path / f"a.{suffix}"
    volume = Volume.from_array(np.tile(ball(), (8, 7, 6)), SPACING)
    io.write(volume, source)
    words = (
        "segment",
        source,
        "-o",
        tmp_path / "out",
        "--start",
        "ball:10,8,6,4vox",
        "--max-steps",
    )
    words += ("3", "--max-memory", "490MB", "--energy", "threshold:110,", "--threads", "1")
    assert run(*words, "--quiet") == 0
    before = contents(tmp_path / "out")
    capsys.readouterr()
    assert run(*words, "--resume") == 0
    assert "has ended already" in capsys.readouterr().out and contents(tmp_path / "out") == before
    assert run(*words, "--smoothness", "0.9", "--resume", "--quiet") == 7
    if source.is_dir():
        shutil.rmtree(source)
    io.write(volume.with_array(volume.array + np.uint8(1)), source)
    assert run(*words, "--resume", "--quiet") == 7


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["folder", "pattern", "file"])
@pytest.mark.parametrize("also", [(), ("--also", "surfaces")])
def test_tracks_are_resumed_shown_and_made_a_movie(tmp_path, kind, also, capsys):
    path = frames(tmp_path, "png" if kind == "pattern" else "tif")
    path = path / "s*.png" if kind == "pattern" else path
    if kind == "file":
        path = tmp_path / "a.npy"
        np.save(path, np.stack([ball(n, (1, 16, 24)) for n in range(4)]))
    words = (
        "track",
        path,
        "-o",
        tmp_path / "out",
        "--start",
        "ball:9,8,0,4vox",
        "--threads",
        "1",
        "--seed",
        "1",
        *also,
    )
    assert run(*words, "--quiet") == 0
    before = contents(tmp_path / "out")
    assert run(*words, "--resume") == 0
    assert "has ended already" in capsys.readouterr().out and contents(tmp_path / "out") == before
    assert run(*words, "--resume", "--max-gap", "2", "--quiet") == 7
    assert run("movie", tmp_path / "out", "-o", tmp_path / "a.gif", "--quiet") == 0
    with Image.open(tmp_path / "a.gif") as movie:
        assert movie.n_frames >= 4 and np.asarray(movie.convert("L")).std() > 5
    assert run("movie", tmp_path / "out", "-o", tmp_path / "b.gif", "--color", "speed") == 2
    assert run("movie", tmp_path / "out", "-o", tmp_path / "b.png", "--preview") == 2
    image, config = finished_run(tmp_path / "out")
    assert image.path == path and config.friction == "auto" and config.run.seed == 1
    shown = ImageToOpen(path, config.run, None, tmp_path / "out", config, image).start_reading()()
    assert shown.frames is not None
    # A correction of a frame is a new tracking of the same sequence.
    correct = ("--correct", "frame=2 outside=ball:16,8,0,1vox", "--overwrite", "--quiet")
    assert run(*words, *correct) == 0
    assert run("refine", tmp_path / "out", "--inside", "point:9,8,0vox") == 3
    assert "track --correct" in capsys.readouterr().err


def test_every_setting_that_a_report_has_is_read_back():
    """As written by default, and each other value that a setting without a default of its own may have."""
    changed = {
        "seed": 3,
        "near": None,
        "level": "auto",
        "spacing": "1,2,3um",
        "checkpoint": 2,
        "size": "4ml",
    }
    changed = {
        key: value
        for key, value in changed.items()
        if key in RunConfig.model_fields and value is not None
    }
    for config in (RunConfig(), RunConfig(inside=["point:1,2,3"]), RunConfig(**changed)):
        written = json.loads(json.dumps(config.model_dump(mode="json")))
        assert settings_of({"config": written}, "a") == config
        for key in RunConfig.model_fields:
            assert written[key] is not None or default_of(key) is None or key in changed
    tracks = TrackConfig(
        run=RunConfig(inside=["point:1,2,3"]), correct=["frame=2 remove=3"], frame_time=0.5
    )
    for config in (TrackConfig(), tracks):
        written = json.loads(json.dumps(config.model_dump(mode="json")))
        assert settings_of({"kind": "tracking", "config": written}, "a") == config
