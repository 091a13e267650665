"""The plug-in of napari: its manifest, what it opens, and its widget, driven on napari's model of a viewer."""

import ast
import json
import os
import random
import re
import shutil
import tomllib
import warnings
from importlib import import_module, util
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import accelsurf
from accelsurf import napari as plugin
from accelsurf.cli import execute

#: Napari's own.
pytestmark = pytest.mark.filterwarnings("ignore::pydantic.PydanticDeprecatedSince20")
ROOT = Path(__file__).parents[2]
MANIFEST = Path(plugin.__file__).with_name("napari.yaml")
NAMES = re.findall(r"python_name: (\S+):(\S+)", MANIFEST.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_each_command_of_the_manifest_is_there(module, name):
    source = util.find_spec(module).origin
    defined = {
        getattr(node, "name", "")
        for node in ast.parse(Path(source).read_text(encoding="utf-8")).body
    }
    assert name in defined
    if module == "accelsurf.napari" or util.find_spec("napari") is not None:
        assert callable(getattr(import_module(module), name))


def test_the_manifest_is_found_and_its_commands_are_used():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["napari.manifest"] == {
        "accelsurf": "accelsurf.napari:napari.yaml"
    }
    text = MANIFEST.read_text(encoding="utf-8")
    ids = re.findall(r"- id: (\S+)", text)
    assert len(NAMES) == len(ids) == len(set(ids)) and set(
        re.findall(r"- command: (\S+)", text)
    ) == set(ids)


def test_napari_says_that_the_manifest_is_valid():
    npe2 = pytest.importorskip("npe2", reason="npe2 is not installed")
    manifest = npe2.PluginManifest.from_file(MANIFEST)
    manifest.validate_imports()
    assert manifest.name == "accelsurf"


def test_samples_are_images_with_their_truth():
    for make in (plugin.torus, plugin.two_balls, plugin.vessel):
        (image, settings, kind), (truth, _, truths) = make()
        assert (
            (kind, truths) == ("image", "labels")
            and image.shape == truth.shape
            and settings["units"] == ("mm",) * 3
        )
        assert image[truth > 0].mean() > image[truth == 0].mean()


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder with the result of a run, and the image beside it."""
    folder = tmp_path_factory.mktemp("results")
    accelsurf.write(accelsurf.phantom("ball_small").image, folder / "ball.nii.gz")
    words = [
        "segment",
        folder / "ball.nii.gz",
        "-o",
        folder / "out",
        "--inside",
        "ball:0,0,0,4",
        "--quiet",
    ]
    assert execute([str(word) for word in words]) == 0
    return folder / "out"


def test_a_result_opens_with_its_image_and_the_doubtful_place(results):
    opened = plugin.reader(str(results))(str(results))
    assert [kind for _, _, kind in opened] == ["image", "labels", "points"]
    (image, settings, _), (labels, on, _), (places, points, _) = opened
    assert image.shape == labels.shape and settings["scale"] == on["scale"] and labels.any()
    assert ((places >= 0) & (places < labels.shape)).all() and 0 < points["features"][
        "probability"
    ][0] < 1
    image_of = plugin.reader("a.nii.gz")(str(results.parent / "ball.nii.gz"))
    assert image_of[0][2] == "image" and (image_of[0][0] == image).all()


def test_the_image_of_a_result_is_read_as_its_run_read_it(tmp_path):
    ball = accelsurf.phantom("ball_small").image
    pytest.importorskip("nibabel")
    import nibabel

    frames = np.stack([ball.array[::-1], ball.array], axis=-1).astype(np.float32)
    stored = nibabel.Nifti1Image(frames.transpose(2, 1, 0, 3), np.eye(4))
    stored.header.set_xyzt_units("mm", "sec")
    nibabel.save(stored, tmp_path / "a.nii")
    words = ["segment", tmp_path / "a.nii", "-o", tmp_path / "out", "--time-index", "1"]
    words += ["--start", "ball:20,20,20,6vox", "--max-steps", "2", "--quiet"]
    assert execute([str(word) for word in words]) == 0
    opened = plugin.open_results(str(tmp_path / "out"))
    assert [kind for _, _, kind in opened][:2] == ["image", "labels"]
    assert (opened[0][0] == ball.array.astype(np.float32)).all()


def test_other_folders_are_left_to_others(results, tmp_path):
    assert (
        plugin.reader(str(tmp_path)) is None and plugin.reader([str(results), str(results)]) is None
    )
    (tmp_path / "a_report.json").write_text("[1, 2")
    (tmp_path / "b_report.json").write_text('{"status": "ok"}')
    (tmp_path / "c_report.json").write_text('{"schema_version": 3, "status": "failed"}')
    assert plugin.reader(str(tmp_path)) is None


def plants(report, draw, home):
    """A report of a result that somebody has changed: a value of it is of another kind, or leads elsewhere."""
    odd = draw.choice(
        [None, 7, -1.5, "x", [], {}, [[]], {"a": 1}, "/dev/zero", "n" * 300, "\0", "\ud800", True]
    )
    where = draw.choice(
        [
            *(("outputs", 0, key) for key in ("path", "kind")),
            *((key,) for key in ("outputs", "input", "objects", "quality", "config", "exit_code")),
            ("outputs", 0),
            ("input", "path"),
            *(("quality", key) for key in ("next_click", "probability")),
        ]
    )
    report = json.loads(json.dumps(report))
    at = report
    for key in where[:-1]:
        at = at[key]
    at[where[-1]] = odd
    return json.dumps(report)


def test_reports_that_somebody_has_changed_are_left_out_or_named(results, tmp_path):
    report = json.loads((results / "ball_report.json").read_text())
    report["outputs"].sort(key=lambda entry: entry["kind"] != "labels")
    shutil.copy(results / "ball_seg.nii.gz", tmp_path)
    draw = random.Random(62)
    for _ in range(60):
        text = plants(report, draw, tmp_path)
        (tmp_path / "ball_report.json").write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            read = plugin.reader(str(tmp_path))
            try:
                layers = [] if read is None else read(str(tmp_path))
            except accelsurf.InputError as error:  # what the report names as labels is none
                assert str(tmp_path) in str(error)
                layers = []
        assert all(kind in ("image", "labels", "points") for _, _, kind in layers), text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "loop", "deep", "large"])
def test_a_report_that_is_no_file_of_text_is_left_out(kind, tmp_path):
    report = tmp_path / "a_report.json"
    if kind == "device":
        report.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(report)
    elif kind == "folder":
        report.mkdir()
    elif kind == "loop":
        report.symlink_to(report)
    elif kind == "deep":
        report.write_text("[" * 100_000)
    else:
        with report.open("wb") as file:
            file.truncate(1 << 27)
    assert plugin.reader(str(tmp_path)) is None


def test_a_report_leads_to_no_labels_outside_of_its_folder(results, tmp_path):
    report = json.loads((results / "ball_report.json").read_text())
    report["outputs"] = [{"kind": "labels", "path": str(results / "ball_seg.nii.gz")}]
    (tmp_path / "ball_report.json").write_text(json.dumps(report))
    with pytest.raises(accelsurf.InputError, match=re.escape(str(tmp_path / "ball_seg.nii.gz"))):
        plugin.open_results(str(tmp_path))


def test_a_result_without_its_image_says_so(results, tmp_path):
    report = json.loads((results / "ball_report.json").read_text())
    report["input"]["path"] = str(tmp_path / "gone.nii.gz")
    (tmp_path / "ball_report.json").write_text(json.dumps(report))
    (tmp_path / "ball_seg.nii.gz").write_bytes((results / "ball_seg.nii.gz").read_bytes())
    with pytest.warns(UserWarning, match="ball: its image cannot be opened"):
        opened = plugin.open_results(str(tmp_path))
    assert [kind for _, _, kind in opened] == ["labels", "points"]


# ------------------------------------------------------------------------------------------------------ the widget


class Driven:
    """The widget on a viewer without a window; presses are events as napari's canvas sends them."""

    def __init__(self, layers, monkeypatch):
        monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
        from napari.components import ViewerModel
        from qtpy.QtWidgets import QApplication

        from accelsurf.napari.widget import ClickWidget

        self.app = QApplication.instance() or QApplication([])
        self.viewer = ViewerModel()
        for data, settings, kind in layers:
            getattr(self.viewer, f"add_{kind}")(data, **settings)
        self.widget = ClickWidget(self.viewer)
        self.viewer.layers.events.inserted.connect(self.widget.reset_choices)
        self.viewer.layers.events.removed.connect(self.widget.reset_choices)

    def press(self, mode, place, end=None):
        self.widget._press.setCurrentText(mode)
        event = SimpleNamespace(type="mouse_press", button=1, position=place)
        drag = self.viewer.mouse_drag_callbacks[-1](self.viewer, event)
        moves = [("mouse_move", end)] if end else []
        for kind, at in [("mouse_press", place), *moves, ("mouse_release", end or place)]:
            event.type, event.position = kind, at
            next(drag, None)
        self.wait()
        return self.said

    def undo(self):
        self.widget._undo.click()
        self.wait()

    def wait(self):
        from qtpy.QtCore import QEventLoop, QTimer

        loop, timer = QEventLoop(), QTimer()
        timer.timeout.connect(lambda: self.widget._worker is None and loop.quit())
        timer.start(20)
        loop.exec()

    @property
    def said(self):
        return self.widget._said.text()

    @property
    def labels(self):
        return self.viewer.layers[self.widget._labels.currentText()].data


@pytest.fixture
def driven(monkeypatch):
    pytest.importorskip("napari", reason="napari is not installed")
    return Driven(plugin.two_balls(), monkeypatch)


IN, OUT, SIZE = "clicks inside", "clicks outside", "and a drag say the size"


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def test_two_objects_by_clicks_and_back_again(driven):
    left, right = (28, 28, 30), (28, 28, 66)
    truth = driven.viewer.layers["two_balls truth"].data > 0
    assert "likely to be good" in driven.press(IN, left)
    first = driven.labels == 1
    assert dice(first[..., :48], truth[..., :48]) > 0.97
    driven.widget._new.click()
    driven.press(IN, right)
    assert ((driven.labels == 1) == first).all() and driven.labels[right] == 2
    before = driven.labels.copy()
    driven.press(OUT, (28, 28, 80))
    assert driven.labels[28, 28, 80] == 0 and driven.labels[left] == 1
    driven.undo()
    assert (driven.labels == before).all()
    driven.undo()
    assert ((driven.labels > 0) == first).all()


def test_presses_that_come_quickly_are_all_answered(driven):
    from accelsurf.napari.widget import Press

    widget, viewer = driven.widget, driven.viewer
    driven.press(IN, (28, 28, 30))
    for place in ((28, 28, 66), (28, 20, 66)):
        widget.ask(Press("inside", np.array(place, float), 3.0))
    driven.wait()
    assert widget._object.count == 3 and driven.labels[28, 28, 66] == driven.labels[28, 20, 66] == 1
    widget.ask(Press("outside", np.array((28, 28, 66.0)), 3.0))
    widget._undo.click()  # while that is under way: it is taken back
    driven.wait()
    assert (
        widget._object.count == 3
        and viewer.layers[widget._labels.currentText()].data[28, 28, 66] == 1
    )


def test_a_drag_says_the_size_and_the_answers_are_offered(driven):
    driven.press(SIZE, (28, 28, 30), (28, 28, 40))
    small = np.count_nonzero(driven.labels)
    driven.press(SIZE, (28, 28, 30), (28, 28, 47))
    assert small < 8000 < np.count_nonzero(driven.labels) and driven.widget._object.count == 1
    driven.press(SIZE, (28, 28, 30))  # a press alone: no size
    shown = [button.text() for button in driven.widget._answers if not button.isHidden()]
    assert len(shown) > 1 and shown[0].endswith(" ml") and shown[-1] == "all that is alike"
    driven.widget._answers[2].click()
    driven.wait()
    assert driven.widget._object.result.config.answer == 3


def test_the_doubtful_place_is_shown_in_its_slice(driven):
    driven.press(IN, (28, 28, 30))
    driven.widget._go.click()
    place = driven.viewer.layers["most doubtful place"].data[0]
    assert driven.viewer.dims.point == tuple(place)
    driven.widget._go.click()
    assert [layer.name for layer in driven.viewer.layers].count("most doubtful place") == 1


def test_a_labels_layer_is_mended_and_its_other_labels_stay(driven):
    truth = driven.viewer.layers["two_balls truth"].data > 0
    mask = 7 * truth.astype(np.uint8)
    mask[20:37, 20:37, 22:38], mask[2:6, 2:6, 2:6] = 0, 3
    layer = driven.viewer.add_labels(mask.copy(), name="mask", scale=(1, 1, 1), units=("mm",) * 3)
    driven.widget._labels.setCurrentText("mask")
    layer.selected_label = 7
    driven.widget.begin_object()
    layer.data[50:54, 50:54, 50:54] = 9  # painted by hand
    driven.press(IN, (28, 28, 30))
    assert dice(layer.data == 7, truth) > dice(mask == 7, truth) and layer.data[28, 28, 30] == 7
    assert ((layer.data == 3) == (mask == 3)).all()
    assert "a size is that of a new object" in driven.press(SIZE, (28, 28, 30), (28, 28, 40))
    layer.data[2:4, 50:54, 50:54] = 9  # and again meanwhile
    driven.undo()
    mask[50:54, 50:54, 50:54], mask[2:4, 50:54, 50:54] = 9, 9
    assert (layer.data == mask).all()


def test_what_cannot_be_done_is_said(driven):
    assert "no voxel centre" in driven.press(IN, (28, 28, 900))
    assert not driven.widget._object.count
    assert "Nothing is inside yet" in driven.press(OUT, (28, 28, 30)) and not driven.labels.any()
    driven.viewer.layers[driven.widget._labels.currentText()].selected_label = 0
    driven.widget.begin_object()
    assert "cannot be the label" in driven.press(IN, (28, 28, 30))
    driven.viewer.add_image(np.zeros((2, 3, 4, 5)), name="in time")
    driven.widget._image.setCurrentText("in time")
    driven.widget.begin_object()
    assert "two or three dimensions" in driven.press(IN, (0, 0, 0, 0))
    for name in [layer.name for layer in driven.viewer.layers]:
        driven.viewer.layers.remove(name)
    assert "no image" in driven.press(IN, (0, 0, 0))


def test_a_slice_in_micrometres(monkeypatch):
    pytest.importorskip("napari", reason="napari is not installed")
    y, x = np.indices((60, 80))
    disc = (y - 30) ** 2 + (x - 40) ** 2 < 15**2
    image = 100.0 * disc + np.random.default_rng(0).normal(0, 5, disc.shape)
    driven = Driven(
        [(image, {"name": "cell", "scale": (2.0, 2.0), "units": ("um", "um")}, "image")],
        monkeypatch,
    )
    driven.press(IN, (60.0, 80.0))
    assert driven.labels.shape == disc.shape and dice(driven.labels > 0, disc) > 0.95
    assert driven.widget._object.geometry.spacing == pytest.approx((0.002, 0.002, 0.002))
