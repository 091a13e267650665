"""``accelsurf look``: a picture without a run."""

import shutil

import numpy as np
import pytest
from matplotlib import image as mpl_image
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo

from accelsurf import cli, io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.output.pictures import canvas
from tests.io.formats.test_ome_zarr import make_store


def run(*words):
    return cli.execute([str(word) for word in words])


def saved(path, shape=(6, 40, 50), **where):
    z, y, x = np.indices(shape)
    array = (100.0 * ((x - 30) ** 2 + (y - 12) ** 2 < 49) + z).astype(np.float32)
    io.write(Volume(array, Geometry(shape, where.pop("spacing", (4.0, 1.0, 0.5)), **where)), path)
    return path


def picture_of(path):
    return mpl_image.imread(path)[..., :3]


def test_it_writes_one_picture_and_says_what_the_image_is(tmp_path, capsys, monkeypatch):
    scan = saved(tmp_path / "scan.nii.gz")
    monkeypatch.chdir(tmp_path)
    assert run("look", scan) == 0
    shown = capsys.readouterr().out
    assert "50 x 40 x 6 voxels of 0.5 x 1 x 4 mm" in shown and "0 to 105" in shown
    assert str(tmp_path / "scan_look.png") in shown
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scan.nii.gz", "scan_look.png"]
    assert run("look", scan) == 0  # its own picture
    shutil.copy(tmp_path / "scan_look.png", tmp_path / "own.png")
    assert run("look", scan, "-o", tmp_path / "own.png") == 7  # a name that was given is somebody's
    (tmp_path / "own.png").unlink()
    assert (
        run("look", scan, "-o", tmp_path / "folder") == 0
        and (tmp_path / "folder" / "scan_look.png").is_file()
    )
    assert run("look", scan, "-o", tmp_path / "own.png") == 0 and (tmp_path / "own.png").is_file()
    assert run("look", scan, "-o", tmp_path / "own.jpg") == 2


def drawn_on(path):
    """The picture with its texts, and a line that somebody has drawn."""
    with Image.open(path) as image:
        texts = PngInfo()
        for key, value in image.info.items():
            if isinstance(value, str):
                texts.add_text(key, value)
        ImageDraw.Draw(image).line((10, 10, 60, 60), fill=(255, 0, 0))
        image.save(path, pnginfo=texts)


def cut(path):
    with Image.open(path) as image:
        image.crop((0, 0, 100, 90)).save(path)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "change",
    [
        drawn_on,
        cut,
        lambda path: path.write_bytes(path.read_bytes()[:-40]),
        lambda path: path.write_text("accelsurf look"),
        lambda path: path.write_bytes(b""),
        lambda path: (path.rename(f"{path}.png"), path.symlink_to(f"{path}.png")),
    ],
)
def test_only_a_picture_that_nobody_changed_is_replaced(tmp_path, monkeypatch, change):
    scan = saved(tmp_path / "scan.nii.gz")
    monkeypatch.chdir(tmp_path)
    picture = tmp_path / "scan_look.png"
    assert run("look", scan) == 0
    assert run("look", scan, "--at", "3,3,3vox") == 0
    change(picture)
    before = picture.read_bytes()
    assert run("look", scan) == 7 and picture.read_bytes() == before
    assert run("look", scan, "--overwrite") == 0


@pytest.mark.parametrize(
    ("shape", "spacing", "words", "asked"),
    [
        ((4, 1200, 20), (1, 1, 1), (), True),
        ((4, 1200, 20), (1, 1, 1), ("--spacing", "1mm"), False),
        ((4, 1200, 20), (1, 1, 1), ("--spacing", "1um"), False),
        ((4, 1200, 20), (1, 1, 1), ("--spacing", "0.5"), False),
        ((700, 70, 70), (1, 10, 10), ("--spacing", "10,10,1"), True),  # 343 l
        ((4, 900, 20), (1, 1, 1), (), False),
    ],
)
def test_an_image_as_wide_as_a_room_is_asked_about(
    tmp_path, monkeypatch, capsys, shape, spacing, words, asked
):
    monkeypatch.chdir(tmp_path)
    np.save("stack.npy", np.arange(np.prod(shape), dtype=np.float32).reshape(shape))
    assert run("look", "stack.npy", *words) == 0
    said = capsys.readouterr().err
    assert ("m wide: is that so?" in said) == asked
    assert not asked or "um says otherwise" in said


def test_the_place_chooses_the_slices_and_the_window_the_greys(tmp_path):
    scan = saved(tmp_path / "scan.nii.gz")

    def looked(*words):
        assert run("look", scan, "-o", tmp_path / "a.png", "--overwrite", *words) == 0
        return picture_of(tmp_path / "a.png")

    middle = looked()
    through = looked("--at", "30,12,3vox")
    assert (middle != through).any()
    assert np.array_equal(through, looked("--at", "15,12,12"))  # the same in mm
    bright = (looked("--at", "30,12,3vox", "--window", "10,20").min(axis=2) > 0.97).mean()
    assert bright > (looked("--at", "30,12,3vox", "--window", "200,390").min(axis=2) > 0.97).mean()


@pytest.mark.pictures
def test_window_sets_the_greys_of_the_preview_of_a_run(tmp_path):
    """The tube of 100 in 0 from -50 to 150: light grey on dark grey, in the picture that segment writes."""
    z, y, x = np.indices((12, 40, 50))
    array = (100.0 * ((x - 30) ** 2 + (y - 16) ** 2 < 100)).astype(np.float32)
    io.write(Volume(array, Geometry(array.shape, (2.0, 1.0, 1.0))), tmp_path / "scan.nii.gz")
    words = (
        "--start",
        "ball:30,16,12,6",
        "--max-steps",
        3,
        "--threads",
        1,
        "--overwrite",
        "--quiet",
    )

    def greys(*window):
        assert (
            run("segment", tmp_path / "scan.nii.gz", "-o", tmp_path / "out", *words, *window) == 0
        )
        picture = 255 * picture_of(tmp_path / "out" / "scan_preview.png")
        return [float((np.abs(picture - grey).max(axis=2) <= 2).mean()) for grey in (64, 191)]

    assert max(greys()) < 0.005 and min(greys("--window", "50,200")) > 0.02


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--at", "1,2"), "expected X,Y,Z in mm"),
        (("--at", "900,0,0"), "lies outside of the image"),
        (("--at", "nan,0,0"), "expected X,Y,Z in mm"),
        (("--window", "soft"), "expected auto, soft-tissue, bone, lung, brain, or level and width"),
        (
            ("--window", "40,-400"),
            "expected auto, soft-tissue, bone, lung, brain, or level and width",
        ),
    ],
)
def test_what_it_cannot_show_is_one_line(tmp_path, capsys, words, message):
    assert run("look", saved(tmp_path / "scan.nii.gz"), "-o", tmp_path / "a.png", *words) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "a.png").exists()


def test_labels_of_this_image_are_drawn_others_refused(tmp_path, capsys):
    scan = saved(tmp_path / "scan.nii.gz")
    z, y, x = np.indices((6, 40, 50))
    labels = Volume(((x - 30) ** 2 + (y - 12) ** 2 < 49).astype(np.uint8), io.read(scan).geometry)
    io.write_labels(labels, tmp_path / "labels.nii.gz")
    assert run("look", scan, "-o", tmp_path / "a.png", "--labels", tmp_path / "labels.nii.gz") == 0
    drawn = np.abs(picture_of(tmp_path / "a.png") - [0xE6 / 255, 0x9F / 255, 0]).max(axis=2) < 0.02
    assert canvas.ORANGE == "#E69F00" and drawn.sum() > 100
    other = saved(tmp_path / "other.nii.gz", shape=(6, 40, 49))
    assert run("look", scan, "-o", tmp_path / "b.png", "--labels", other) == 3
    assert "on another grid" in capsys.readouterr().err


@pytest.mark.parametrize("shape", [(1, 40, 50), (40, 1, 50), (3, 200, 200)])
def test_slices_of_any_thickness_and_oblique_ones(tmp_path, shape):
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1.0]])
    scan = saved(tmp_path / "scan.nrrd", shape=shape, direction=turn)
    assert run("look", scan, "-o", tmp_path / "a.png") == 0
    height, width = picture_of(tmp_path / "a.png").shape[:2]
    assert 300 < height < 1600 and 300 < width < 1600


def test_each_channel_has_a_row(tmp_path):
    one, two = saved(tmp_path / "one.nii.gz"), tmp_path / "two.nrrd"
    array = io.read(one).array
    stacked = np.stack([array, 200 - array], axis=-1)
    header = (
        "NRRD0004\ntype: float\ndimension: 4\nsizes: 2 50 40 6\nkinds: vector domain domain domain\n"
        "space: left-posterior-superior\nspace directions: none (0.5,0,0) (0,1,0) (0,0,4)\nspace origin: (0,0,0)\n"
        "encoding: raw\nendian: little\n\n"
    )
    two.write_bytes(header.encode() + np.ascontiguousarray(stacked, "<f4").tobytes())
    for scan in (one, two):
        assert run("look", scan, "-o", tmp_path / f"{scan.stem}.png") == 0
    heights = [picture_of(tmp_path / f"{scan.stem}.png").shape[0] for scan in (one, two)]
    assert heights[1] > 1.5 * heights[0]


def test_look_says_what_a_reader_should_know_of_the_file(tmp_path, capsys):
    array = np.random.default_rng(0).integers(1, 99, (6, 7, 8)).astype("u1")
    path = make_store(tmp_path / "a.zarr", [array], "zyx", [((1.0,) * 3,)], unit="millimeter")
    (path / "0/c/0/0/0").unlink()
    assert run("look", path, "-o", tmp_path / "a.png") == 0
    said = capsys.readouterr().err
    assert said.startswith(
        "warning: 1 of 18 chunks of the array 0 are not in the store, and 0 stands there"
    )
    assert said.count("\n") == 1
