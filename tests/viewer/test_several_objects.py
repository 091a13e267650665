"""Several objects in one scene: each in its own colour, in 3D, in slices, in the chart, in the legend and in pages."""

import dataclasses
import json
import re
from io import BytesIO

import numpy as np
import pytest
import pyvista as pv
from PIL import Image
from skimage import color

from accelsurf import cli, io, segment_objects, show
from accelsurf.grid import pyramid
from accelsurf.levelset import LevelSet
from accelsurf.output import outputs
from accelsurf.output.label_files import given_labels
from accelsurf.output.pictures import canvas, preview
from accelsurf.run.run import Run
from accelsurf.settings.labels import LabelTable
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.frame import Frame, ObjectState
from accelsurf.viewer.export import write_html
from accelsurf.viewer.scene import colors
from tests.support import two_balls, viewing


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


# What people without cones for long or middle wavelengths see, on linear RGB (Machado, Oliveira and Fernandes 2009).
DICHROMATS = {
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "normal": np.eye(3),
}


@pytest.mark.parametrize("name", DICHROMATS)
def test_objects_and_reference_are_told_apart_with_any_colour_vision(name):
    codes = [*canvas.OBJECT_COLORS, colors.REFERENCE]
    rgb = np.array([[int(code[i : i + 2], 16) for i in (1, 3, 5)] for code in codes])
    linear = (rgb / 255) ** 2.2 @ np.array(DICHROMATS[name]).T
    lab = color.rgb2lab(np.clip(linear, 0, 1)[None] ** (1 / 2.2))[0]
    distances = np.linalg.norm(lab[:, None] - lab, axis=2)[np.triu_indices(len(lab), 1)]
    assert distances.min() > 10  # 2.3 is just noticeable


def two_objects(volume):
    """A frame of two balls, each on a box of the image's grid, and a history for each."""
    frames, history = viewing.run_frames(
        volume, volume.geometry.center_world(), levels=1, max_steps=8
    )
    changed = [
        record._replace(potential=0.5 * record.potential, volume_mm3=9.0) for record in history
    ]
    objects = []
    for number, middle, record in ((4, 11, history[-1]), (7, 31, changed[-1])):
        z, y, x = np.indices((16, 30, 20)).astype(np.float32)
        corner = (2, 5, middle - 10)
        psi = np.sqrt((2.0 * (z - 8)) ** 2 + (y - 15) ** 2 + (x - 10) ** 2) - 7
        objects.append(ObjectState(number, record, LevelSet(psi, volume.geometry.spacing), corner))
    level = pyramid.levels(volume.geometry.shape, volume.geometry.spacing, 1)[0]
    return Frame.of(objects, level), (history, changed)


def count(picture, code):
    """Pixels that are nearly of this colour."""
    wanted = [int(code[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - wanted).max(axis=2) < 12).sum())


def test_several_objects_have_their_own_colours(scene_of):
    volume, _ = viewing.ball_image(direction=viewing.TURN)
    frame, histories = two_objects(volume)
    first, second = canvas.OBJECT_COLORS[:2]
    scene = scene_of(volume, theme="light", size=(960, 540))
    empty = scene.screenshot()
    assert count(empty, first) == count(empty, second) == 0
    scene.update(frame, histories)
    scene.cursor = volume.geometry.index_to_world((10, 20, 21))
    picture = scene.screenshot()
    assert scene.legend == ("object 4", "object 7")
    for mesh, middle in zip(scene.space.meshes, (11, 31), strict=True):
        center = volume.geometry.index_to_world((10, 20, middle))
        assert np.abs(np.linalg.norm(mesh.points - center, axis=1) - 7).max() < 0.3
    space, slices, chart = picture[:, :480], picture[:270, 480:720], picture[270:, 720:]
    for part in (space, slices, chart):
        assert count(part, first) > 10 and count(part, second) > 10
    one = Frame(frame.surfaces[:1])
    scene.update(one, histories[:1])
    alone = scene.screenshot()
    assert scene.legend == () and len(scene.space.meshes) == 1
    assert count(alone, first) > 10 and count(alone, second) == 0


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_legend_can_be_read_in_either_theme(scene_of, theme):
    """Its text has the colour of all text; the colours that it names stand beside it."""
    volume, _ = viewing.ball_image()
    frame, histories = two_objects(volume)
    scene = scene_of(
        volume, theme=theme, size=(960, 540), reference=volume.with_array(volume.array > 0)
    )
    scene.update(frame, histories)
    names = (*canvas.OBJECT_COLORS[:2], colors.REFERENCE)
    for shown in (theme, "dark", "light"):
        scene.paint(shown)
        corner = scene.screenshot()[:60, 300:480]
        assert all(count(corner, code) > 40 for code in names)
        ink = pv.Color(colors.theme_named(shown).ink).float_rgb
        texts = [prop for prop in scene.space.renderer.GetViewProps() if prop.IsA("vtkTextActor")]
        legend = [prop for prop in texts if prop.GetInput() in scene.legend]
        assert len(legend) == 3
        assert all(
            prop.GetTextProperty().GetColor() == pytest.approx(ink, abs=1e-6) for prop in legend
        )
    scene.update(Frame(frame.surfaces[:1]), histories[:1])
    corner = scene.screenshot()[:60, 300:480]
    assert (
        count(corner, names[1]) == 0 and count(corner, names[0]) > 40
    )  # one object and the reference


def test_dice_of_several_objects_counts_them_all(scene_of):
    volume, _ = viewing.ball_image()
    frame, histories = two_objects(volume)
    truth = np.zeros(volume.array.shape, np.uint8)
    for surface in frame.surfaces:
        box = tuple(slice(o, o + n) for o, n in zip(surface.offset, surface.psi.shape, strict=True))
        truth[box][surface.psi < 0] = surface.id
    scene = scene_of(volume, reference=volume.with_array(truth))
    scene.update(frame, histories)
    assert scene.dice == 1.0 and scene.legend == ("object 4", "object 7", "reference, Dice 1.000")
    scene.update(Frame(frame.surfaces[1:]), histories[1:])
    assert scene.dice == pytest.approx(2 / 3)


def test_objects_without_a_quantity_keep_their_colour(scene_of, tmp_path):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1)
    (moving,), (_, still) = frames[3].surfaces, two_objects(volume)[0].surfaces
    scene = scene_of(volume, theme="light", size=(960, 540))
    scene.color_by("speed")
    scene.update(Frame((moving, still)), (history[:4], history[:4]))
    first, second = canvas.OBJECT_COLORS[:2]
    space = scene.screenshot()[60:, :480]
    assert scene.space.color == "speed" and "speed" not in scene.space.meshes[1].point_data
    assert count(space, first) < 10 < count(space, second)
    write_html(scene, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    meshes = json.loads(re.search(r'application/json">(.*?)</script>', page).group(1))["meshes"]
    assert ["colors" in mesh for mesh in meshes] == [
        False,
        True,
        False,
    ]  # the box, and both objects
    assert meshes[2]["color"] == pytest.approx(
        [int(second[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    )


# -- of a run -------------------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path):
    """An image of two balls that touch, and the label map to start from."""
    image, starts = tmp_path / "balls.nii.gz", tmp_path / "starts.nii.gz"
    io.write(two_balls.image(two_balls.TOUCHING), image)
    io.write_labels(two_balls.starts(two_balls.TOUCHING), starts)
    return image, starts


@pytest.mark.parametrize("levels", [1, 2])
def test_a_frame_of_a_run_lies_where_the_labels_are(files, levels):
    volume, config = io.read(files[0]), RunConfig(objects=str(files[1]), threads=1, levels=levels)
    with Run(volume, config) as run:
        while run.step():
            frame = Frame.of_run(run)
            assert [surface.id for surface in frame.surfaces] == [3, 8]
            assert {surface.level for surface in frame.surfaces} == {run.grid}
    result = segment_objects(volume, config=config)
    final = Frame.of_result(result)
    for surface, same in zip(frame.surfaces, final.surfaces, strict=True):
        inside = result.labels == surface.id
        common, own = same.overlap(inside)
        assert common == own == inside.sum()
        assert np.linalg.norm(surface.middle() - same.middle()) < 0.1
        assert surface.record._replace(seconds=0) == same.record._replace(seconds=0)


def test_a_preview_of_a_run_has_both_colours(files, tmp_path, capsys):
    image, starts = files
    out = tmp_path / "last.png"
    options = ["--objects", str(starts), "--threads", "1", "--theme", "light", "--size", "960x540"]
    assert cli.execute(["movie", str(image), "--preview", "-o", str(out), *options]) == 0
    assert "of 2 objects 2 converged; up to" in capsys.readouterr().out
    with Image.open(out) as opened:
        picture = np.asarray(opened.convert("RGB"))
    for part in (picture[:, :480], picture[:270, 480:720], picture[270:, 720:]):
        assert all(count(part, code) > 10 for code in canvas.OBJECT_COLORS[:2])


def test_a_movie_is_made_again_from_a_folder(files, tmp_path):
    image, starts = files
    look = ["--size", "320x180", "--hold", "0", "--every", "10", "--quiet"]
    run = ["--objects", str(starts), "--threads", "1", "--max-steps", "30"]
    assert cli.execute(["segment", str(image), "-o", str(tmp_path / "out"), *run, "--quiet"]) == 0
    assert cli.execute(["movie", str(tmp_path / "out"), "-o", str(tmp_path / "a.gif"), *look]) == 0
    assert cli.execute(["movie", str(image), "-o", str(tmp_path / "b.gif"), *run, *look]) == 0
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_a_result_is_shown_with_both_colours(files, tmp_path):
    result = segment_objects(io.read(files[0]), str(files[1]), threads=1, max_steps=20)
    show(result, to=tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as opened:
        picture = np.asarray(opened.convert("RGB"))
    assert all(count(picture, code) > 100 for code in canvas.OBJECT_COLORS[:2])


#: Names and colours that a person gives; the colours are none of the palette.
NAMED = {"name": ("3=left lobe", "8=right lobe"), "color": ("3=#aa00ff", "8=#b4ff00")}
SELECTED = "#aa00ff", "#b4ff00"


@pytest.fixture
def named(files):
    return segment_objects(io.read(files[0]), str(files[1]), threads=1, max_steps=20, **NAMED)


def has_selected(picture, least=10):
    """Whether both selected colours are seen, and neither of the palette in their place."""
    return all(count(picture, code) > least for code in SELECTED) and not any(
        count(picture, code) > least for code in canvas.OBJECT_COLORS[:2]
    )


@pytest.mark.pictures
def test_the_preview_has_the_names_and_colours_that_were_given(named):
    content = outputs.preview_content(named, "balls")
    assert [content.name(place) for place in (0, 1)] == ["left lobe", "right lobe"]
    picture = np.asarray(Image.open(BytesIO(preview.preview_png(content))).convert("RGB"))
    assert has_selected(picture[:460])
    unnamed = dataclasses.replace(content, labels=LabelTable())
    other = np.asarray(Image.open(BytesIO(preview.preview_png(unnamed))).convert("RGB"))
    assert not has_selected(other) and all(
        count(other, code) > 10 for code in canvas.OBJECT_COLORS[:2]
    )


def test_a_shown_result_has_the_names_and_colours_that_were_given(named, tmp_path):
    for kind in ("png", "html"):
        show(named, to=tmp_path / f"a.{kind}")
    with Image.open(tmp_path / "a.png") as opened:
        assert has_selected(np.asarray(opened.convert("RGB")), 100)
    page = (tmp_path / "a.html").read_text()
    assert "left lobe\nright lobe" in page
    meshes = json.loads(re.search(r'application/json">(.*?)</script>', page).group(1))["meshes"]
    rgb = [[int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)] for code in SELECTED]
    assert [mesh["color"] for mesh in meshes[1:]] == [pytest.approx(one) for one in rgb]


def test_a_page_has_what_the_scene_shows(scene_of, tmp_path):
    """An object that is hidden there is not in the page; one that is translucent is so in it."""
    volume, _ = viewing.ball_image()
    frame, histories = two_objects(volume)
    scene = scene_of(volume)
    scene.update(frame, histories)
    scene.name_objects(
        given_labels(RunConfig(name=["4=a", "7=b"], color=["4=#112233", "7=#112233"]))
    )
    scene.styles.show(4, False)
    scene.styles.fade(7, 0.4)
    scene.restyle()
    write_html(scene, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    _, surface = json.loads(re.search(r'application/json">(.*?)</script>', page).group(1))["meshes"]
    assert surface["opacity"] == 0.4 and surface["color"] == pytest.approx(
        [17 / 255, 34 / 255, 51 / 255]
    )


def test_a_movie_has_the_colours_that_were_given(files, tmp_path):
    image, starts = files
    options = [
        "--objects",
        str(starts),
        "--threads",
        "1",
        "--max-steps",
        "20",
        "--theme",
        "light",
        "--quiet",
    ]
    config, out = tmp_path / "run.toml", tmp_path / "last.png"
    config.write_text(
        RunConfig(**NAMED).to_toml()
    )  # --color is what a movie colours the surfaces by
    words = ["movie", str(image), "--preview", "-o", str(out), "--config", str(config), *options]
    assert cli.execute(words) == 0
    with Image.open(out) as opened:
        assert has_selected(np.asarray(opened.convert("RGB")), 100)


def test_one_object_with_a_name_is_called_so_beside_the_reference(scene_of):
    volume, center = viewing.ball_image()
    frames, history = viewing.run_frames(volume, center, levels=1, max_steps=8)
    scene = scene_of(volume, reference=volume.with_array(volume.array > 0))
    scene.update(frames[-1], [history])
    assert scene.legend[0] == "surface"
    scene.name_objects(given_labels(RunConfig(name=["liver"], color=["#aa00ff"])))
    assert scene.legend[0] == "liver"


def test_the_legend_of_many_objects_ends(scene_of):
    volume, _ = viewing.ball_image()
    frame, histories = two_objects(volume)
    scene = scene_of(volume)
    scene.update(Frame(frame.surfaces * 15), histories * 15)
    assert len(scene.legend) == 21 and scene.legend[-1] == "and 10 more"
