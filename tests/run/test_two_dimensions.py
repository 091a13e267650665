"""Images of one slice: the same result through every door, nothing along the missing axis, and their own outputs."""

import json

import numpy as np
import pytest
from matplotlib import image as mpl_image
from PIL import Image

import accelsurf
from accelsurf import cli, io
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.output.pictures import canvas, preview
from accelsurf.output.pictures.preview_content import PreviewContent
from accelsurf.settings.run_config import RunConfig

START = ("--start", "ball:20,22,0,6")
OPTIONS = {"start": "ball:20,22,0,6", "smoothness": 0.2}
Y, X = np.mgrid[:48, :56]
TRUTH = (X - 26) ** 2 + (Y - 25) ** 2 < 14**2
PICTURE = (
    (60 + 110 * TRUTH + np.random.default_rng(0).normal(0, 30, TRUTH.shape))
    .clip(0, 255)
    .astype(np.uint8)
)


def run(*words):
    return cli.execute([str(word) for word in words])


def report_of(folder, name):
    return json.loads((folder / f"{name}_report.json").read_text())


@pytest.fixture(scope="session")
def doors(tmp_path_factory):
    """The same disc in noise in every format."""
    folder = tmp_path_factory.mktemp("doors")
    for name in ("disc.png", "disc.tif", "disc.nii.gz", "disc.mha"):
        io.write(Volume.from_array(PICTURE), folder / name)
    Image.fromarray(PICTURE).convert("RGB").save(folder / "grey_as_colour.png")
    return folder


@pytest.fixture(scope="session")
def done(doors, tmp_path_factory):
    folder = tmp_path_factory.mktemp("done2d")
    assert (
        run("segment", doors / "disc.png", "-o", folder, *START, "--smoothness", 0.2, "--save-sdf")
        == 0
    )
    return folder


# ------------------------------------------------------------------------------------------------ the same result


@pytest.mark.slow
def test_the_same_labels_through_every_door(doors, done):
    expected = accelsurf.segment(PICTURE, **OPTIONS)
    assert expected.labels.shape == (1, *PICTURE.shape)
    assert (expected.labels[0] == TRUTH).mean() > 0.99
    for path in sorted(doors.iterdir()):
        result = accelsurf.segment(io.read(path), **OPTIONS)
        np.testing.assert_array_equal(result.labels, expected.labels)
        np.testing.assert_array_equal(result.psi, expected.psi)
    np.testing.assert_array_equal(io.read(done / "disc_seg.png").array, 255 * expected.labels)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "start", ["ball:20,22,0,6", "ball:20,22,0,6vox", "center", "threshold:120,300", "label"]
)
def test_nothing_depends_on_the_thickness_of_the_slice(start, tmp_path):
    results = []
    for thickness in (0.01, 1.0, 7.0):
        volume = Volume.from_array(PICTURE[np.newaxis], (thickness, 1.0, 1.0))
        io.write(volume, tmp_path / "a.nii.gz")
        io.write_labels(
            volume.with_array((np.hypot(X - 20, Y - 22) < 6)[np.newaxis]), tmp_path / "start.nii.gz"
        )
        where = f"label:{tmp_path / 'start.nii.gz'}" if start == "label" else start
        results.append(
            accelsurf.segment(io.read(tmp_path / "a.nii.gz"), **{**OPTIONS, "start": where})
        )
    for result in results[1:]:
        np.testing.assert_array_equal(result.labels, results[0].labels)
        np.testing.assert_allclose(result.psi, results[0].psi, atol=1e-4)
        assert result.stop.steps == results[0].stop.steps
        assert result.length_mm == pytest.approx(results[0].length_mm, rel=1e-5)
        assert result.enclosed_mm2 == pytest.approx(results[0].enclosed_mm2, rel=1e-5)


@pytest.mark.parametrize("axis", [1, 2])
def test_any_axis_may_be_the_missing_one(axis):
    expected = accelsurf.segment(PICTURE, **OPTIONS)
    volume = Volume.from_array(np.expand_dims(PICTURE, axis))
    x, y, z = {1: (20, 0, 22), 2: (0, 20, 22)}[axis]
    result = accelsurf.segment(volume, **{**OPTIONS, "start": f"ball:{x},{y},{z},6"})
    np.testing.assert_array_equal(np.squeeze(result.labels), expected.labels[0])
    assert result.length_mm == pytest.approx(expected.length_mm, rel=1e-5)
    assert result.contours.area == pytest.approx(expected.contours.area, rel=1e-5)


def test_measures_of_a_disc():
    clean = np.clip(14.0 - np.hypot(X - 26, Y - 25) + 0.5, 0, 1)
    result = accelsurf.segment(Volume.from_array(clean, (3.0, 0.5, 0.5)), start="ball:12,12,0,4")
    assert result.enclosed_mm2 == pytest.approx(np.pi * 7**2, rel=0.01)
    assert result.length_mm == pytest.approx(2 * np.pi * 7, rel=0.01)
    assert result.contours.area == pytest.approx(result.enclosed_mm2, rel=0.01)
    assert result.area_mm2 == pytest.approx(result.length_mm * 3.0)
    assert result.volume_mm3 == pytest.approx(result.enclosed_mm2 * 3.0)
    assert (result.report["length_mm"], result.report["enclosed_mm2"]) == (
        result.length_mm,
        result.enclosed_mm2,
    )


def test_a_volume_has_no_length():
    grid = Geometry((6, 6, 6), (1.0, 1.0, 1.0))
    image = np.zeros(grid.shape)
    image[2:4, 2:4, 2:4] = 1
    result = accelsurf.segment(Volume(image, grid), max_steps=2)
    assert result.length_mm is None and result.enclosed_mm2 is None and result.start is None
    assert result.report["length_mm"] is None and result.report["enclosed_mm2"] is None
    with pytest.raises(accelsurf.InputError, match="one slice expected"):
        _ = result.contours


# -------------------------------------------------------------------------------------------------------- outputs


def test_what_is_written(done):
    names = (
        "seg.png",
        "contour.vtp",
        "contour.csv",
        "sdf.tif",
        "report.json",
        "trace.csv",
        "preview.png",
    )
    names += ("statistics.csv", "statistics.json")
    assert sorted(path.name for path in done.iterdir()) == sorted(f"disc_{name}" for name in names)
    document = report_of(done, "disc")
    kinds = [output["kind"] for output in document["outputs"]]
    assert kinds == [
        "labels",
        "contour",
        "contour",
        "sdf",
        "trace",
        "preview",
        "statistics",
        "statistics",
    ]
    assert document["length_mm"] == pytest.approx(2 * np.pi * 14, rel=0.05)
    assert document["enclosed_mm2"] == pytest.approx(np.pi * 14**2, rel=0.05)
    assert document["warnings"] == []
    assert (
        (io.read(done / "disc_sdf.tif").array < 0) == (io.read(done / "disc_seg.png").array > 0)
    ).all()


def test_contour_lies_where_the_disc_is(done):
    rows = np.loadtxt(done / "disc_contour.csv", delimiter=",", skiprows=1)
    assert (
        abs(np.hypot(rows[:, 1] - 26, rows[:, 2] - 25) - 14).max() < 1.5 and (rows[:, 3] == 0).all()
    )


def test_labels_can_be_judged_and_start_another_run(doors, done, tmp_path, capsys):
    io.write_labels(Volume.from_array(TRUTH), tmp_path / "truth.png")
    io.write_labels(Volume.from_array(TRUTH), tmp_path / "truth.tif")
    for truth in ("truth.png", "truth.tif"):
        assert run("evaluate", done / "disc_seg.png", tmp_path / truth, "--json") == 0
        assert json.loads(capsys.readouterr().out)["dice"] > 0.97
    words = ("segment", doors / "disc.tif", "-o", tmp_path, "--max-steps", 1)
    assert run(*words, "--start", f"label:{done / 'disc_seg.png'}") == 0


def test_area_and_length_are_printed(doors, tmp_path, capsys):
    assert run("segment", doors / "disc.tif", "-o", tmp_path, *START, "--smoothness", 0.2) == 0
    out = capsys.readouterr().out
    document = report_of(tmp_path, "disc")
    assert (
        f"area {document['enclosed_mm2']:.4g} mm2, length {document['length_mm']:.4g} mm, 1 component"
        in out
    )
    assert "mm3" not in out and (tmp_path / "disc_seg.tif").is_file()


def test_colour_and_a_lost_place_are_warned_of(tmp_path, capsys):
    colours = np.stack([PICTURE, PICTURE // 2, PICTURE], axis=-1)
    Image.fromarray(colours).save(tmp_path / "cell.png")
    assert (
        run("segment", tmp_path / "cell.png", "-o", tmp_path / "a", *START, "--max-steps", 2) == 0
    )
    assert "warning: a colour image: its luminance" in capsys.readouterr().err
    moved = Volume.from_array(PICTURE[np.newaxis], 1.0, (5.0, 0.0, 0.0))
    io.write(moved, tmp_path / "moved.nii")
    words = ("segment", tmp_path / "moved.nii", "--start", "ball:25,22,0,6", "--max-steps", 2)
    assert run(*words, "-o", tmp_path / "b", "--format", "png") == 0
    assert "png keeps the size of a pixel but not where" in capsys.readouterr().err
    assert "png keeps" in " ".join(report_of(tmp_path / "b", "moved")["warnings"])
    assert run(*words, "-o", tmp_path / "c") == 0
    assert "keeps" not in capsys.readouterr().err and (tmp_path / "c" / "moved_seg.nii").is_file()


@pytest.mark.parametrize(
    ("shape", "options", "words"),
    [
        ((1, 12, 12), ("--mesh", "vtp,ply"), "mesh: ply was given for an image of one slice"),
        ((6, 12, 12), ("--mesh", "csv"), "mesh: csv was given for a volume"),
        (
            (6, 12, 12),
            ("--format", "png"),
            "format: png was given for 6 slices along z, expected one",
        ),
        ((6, 1, 12), ("--format", "png"), "format: png was given for 6 slices"),
    ],
)
def test_formats_that_do_not_suit_are_a_usage_error(shape, options, words, tmp_path, capsys):
    image = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    io.write(Volume.from_array(image), tmp_path / "a.nii")
    assert run("segment", tmp_path / "a.nii", "-o", tmp_path / "out", *options) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {words}") and "hint: " in error
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a_report.json"]


@pytest.mark.parametrize(
    "name", ["disc_seg.png", "disc_contour.vtp", "disc_contour.csv", "disc_surface.ply"]
)
def test_existing_outputs_are_refused_before_the_image_is_read(
    name, doors, tmp_path, capsys, monkeypatch
):
    (tmp_path / name).write_text("kept")
    monkeypatch.setattr(io, "read", lambda *_: pytest.fail("read"))
    assert run("segment", doors / "disc.png", "-o", tmp_path, *START) == 7
    assert f"{name}: exists already" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "kept"


def test_a_stack_is_a_volume(tmp_path):
    stack = np.repeat(PICTURE[np.newaxis], 6, axis=0)
    stack[[0, -1]] = 60
    io.write(Volume.from_array(stack, (2.0, 1.0, 1.0)), tmp_path / "stack.tif")
    assert (
        run(
            "segment",
            tmp_path / "stack.tif",
            "-o",
            tmp_path,
            "--start",
            "ball:20,22,5,6",
            "--max-steps",
            3,
        )
        == 0
    )
    assert (tmp_path / "stack_surface.ply").is_file() and not list(tmp_path.glob("*contour*"))
    assert io.read(tmp_path / "stack_seg.tif").geometry.spacing == pytest.approx((2.0, 1.0, 1.0))


@pytest.mark.pictures
def test_a_contour_that_vanishes(doors, tmp_path):
    assert run("segment", doors / "disc.png", "-o", tmp_path, *START, "--smoothness", 500) == 5
    assert sorted(path.name for path in tmp_path.glob("*")) == [
        f"disc_{name}" for name in ("preview.png", "report.json", "trace.csv")
    ]
    assert report_of(tmp_path, "disc")["length_mm"] == 0


# -------------------------------------------------------------------------------------------------------- pictures


def colours_of(path, color):
    picture = mpl_image.imread(path)[..., :3]
    wanted = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return np.abs(picture - wanted).max(axis=2) < 0.02


def test_preview_shows_image_contour_start_and_energy(done):
    path = done / "disc_preview.png"
    width = colours_of(path, canvas.ORANGE).shape[1]
    for color, left in ((canvas.ORANGE, True), (canvas.GREEN, True), (canvas.BLUE, False)):
        found = np.argwhere(colours_of(path, color))
        assert len(found) > 50
        assert ((found[:, 1] < 0.6 * width) == left).mean() > 0.95


@pytest.mark.pictures
@pytest.mark.parametrize("shape", [(1, 20, 200), (1, 200, 20), (30, 1, 40), (30, 40, 1)])
def test_preview_of_any_shape_is_of_a_sane_size(shape):
    geometry = Geometry(shape, (1.0, 1.0, 1.0))
    psi = np.ones(shape, np.float32)
    psi[tuple(slice(n // 4, n // 2 + 1) for n in shape)] = -1
    content = PreviewContent(psi, psi, geometry, [], "a title", start=psi)
    assert preview.preview_png(content).startswith(b"\x89PNG")


def test_mesh_of_the_settings():
    assert RunConfig().mesh == "auto" and RunConfig(mesh="auto").mesh == "auto"
    assert RunConfig(mesh="VTP, csv").mesh == ("vtp", "csv")
    with pytest.raises(accelsurf.UsageError, match="mesh: auto,ply was given"):
        RunConfig(mesh="auto,ply")
