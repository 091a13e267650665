"""Measuring by actions: with the mouse, by requests, from a state of the run, into files, onto the clipboard."""

import csv
import io
import json

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.io import write
from accelsurf.io.headers import UNIT_KEY, VALUE_UNIT_KEY
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.files import FilesFeature
from accelsurf.viewer.actions.measure import MeasureFeature, table_of
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


def ellipsoid():
    """A bright ellipsoid of 18, 12 and 8 mm half axes along the grid's axes of an oblique, anisotropic image."""
    volume = Volume.from_array(np.zeros((30, 44, 60), np.float32), (1.5, 1.0, 0.8), (5.0, -3.0, 7.0), viewing.TURN)
    sides, steps = (30, 44, 60), (1.5, 1.0, 0.8)
    z, y, x = ((at - (n - 1) / 2) * h for at, n, h in zip(np.indices(sides), sides, steps, strict=True))
    inside = (x / 18) ** 2 + (y / 12) ** 2 + (z / 8) ** 2 < 1
    noise = np.random.default_rng(0).normal(0, 5, inside.shape)
    return volume.with_array((inside * 100 + noise).astype(np.float32))


@pytest.fixture(scope="module")
def scene_and_session():
    volume = ellipsoid()
    volume.metadata[VALUE_UNIT_KEY] = "HU"
    center = volume.geometry.center_world()
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    scene = Scene(volume, size=(1280, 720))
    with Session(volume, RunConfig(start=start, threads=1, smoothness=0.05), name="egg") as session:
        session.play().result(60)
        session.wait(120)
        yield scene, session
    scene.close()


@pytest.fixture
def actions(scene_and_session, tmp_path):
    scene, session = scene_and_session
    made = Actions(session, scene, tmp_path)
    scene.measures.show(())
    scene.cursor = scene.geometry.center_world()
    scene.render()
    return made


def ask(actions, *request):
    actions.request(*request)
    assert actions.session.wait(120)
    actions.collect_results()
    return actions.state()


def place(actions, tile, right, up):
    """Parts of the picture's width, and height from the top, of a place in a tile."""
    left, bottom, far, top = actions.scene.tiles.renderer(tile).GetViewport()
    return left + right * (far - left), 1 - (bottom + up * (top - bottom))


def drag(actions, tile, *places):
    first, *rest = [place(actions, tile, *at) for at in places]
    actions.request("press", *first)
    for at in rest:
        actions.request("move", *at)
    actions.request("release")
    assert not actions.message, actions.message


def world(actions, tile, right, up):
    scene = actions.scene
    width, height = scene.plotter.render_window.GetSize()
    x, y = place(actions, tile, right, up)
    return scene.pick(x * width, (1 - y) * height).world


def test_a_length_is_dragged_moved_listed_and_deleted(actions):
    actions.request("tool", "distance")
    drag(actions, "axial", (0.35, 0.4), (0.5, 0.5), (0.6, 0.55))
    ends = [world(actions, "axial", *at) for at in ((0.35, 0.4), (0.6, 0.55))]
    (row,) = actions.state()["measurements"]
    length = np.linalg.norm(ends[1] - ends[0])
    assert row == [1, "distance", f"{length:.4g} mm"]
    # An end is taken up from some pixels away, and no second line begins.
    drag(actions, "axial", (0.602, 0.552), (0.5, 0.7))
    moved = world(actions, "axial", 0.5, 0.7)
    (row,) = actions.state()["measurements"]
    assert row == [1, "distance", f"{np.linalg.norm(moved - ends[0]):.4g} mm"]
    drag(actions, "coronal", (0.4, 0.5), (0.6, 0.5))
    assert [row[0] for row in actions.state()["measurements"]] == [1, 2]
    actions.request("measure_delete", 1)
    assert [row[0] for row in actions.state()["measurements"]] == [2]
    actions.request("measure_clear")
    assert actions.state()["measurements"] == []
    actions.request("tool", "look")
    json.dumps(actions.state())


def test_clicks_make_a_length_and_an_angle_over_tiles(actions):
    actions.request("tool", "distance")
    drag(actions, "axial", (0.4, 0.4))
    assert actions.state()["measurements"] == [[1, "distance", ""]]
    drag(actions, "coronal", (0.6, 0.6))
    ends = world(actions, "axial", 0.4, 0.4), world(actions, "coronal", 0.6, 0.6)
    assert actions.state()["measurements"] == [[1, "distance", f"{np.linalg.norm(ends[1] - ends[0]):.4g} mm"]]
    actions.request("tool", "angle")
    for at in ((0.7, 0.5), (0.5, 0.5), (0.5, 0.7)):
        drag(actions, "axial", at)
    assert actions.state()["measurements"][1] == [2, "angle", "90.0°"]
    drag(actions, "axial", (0.3, 0.3), (0.4, 0.3))  # an arm, and the corner
    assert actions.state()["measurements"][2] == [3, "angle", ""]
    actions.request("tool", "look")  # what is not finished is forgotten
    assert [row[0] for row in actions.state()["measurements"]] == [1, 2]


def test_an_end_may_lie_on_the_surface(actions):
    session, scene = actions.session, actions.scene
    view = session.next_view()
    while view is None:
        view = session.next_view()
    actions.update(view)
    scene.screenshot()
    actions.request("tool", "distance")
    drag(actions, "space", (0.45, 0.5), (0.55, 0.52))
    one = next(iter(actions.feature(MeasureFeature).measurements))
    mesh = scene.space.meshes[0]
    for point in one.points:
        assert np.linalg.norm(np.asarray(mesh.points) - point, axis=1).min() < 1.0
    assert scene.measures.marks["space"].texts == (one.text(),)
    actions.request("tool", "look")


def test_the_table_has_the_figures_of_an_ellipsoid(actions):
    state = ask(actions, "measure_table")
    assert state["figures_current"] and state["figures_step"] == actions.session.status.step
    figures = actions.feature(MeasureFeature).figures
    (row,) = figures.rows
    assert row["volume_mm3"] == pytest.approx(4 / 3 * np.pi * 18 * 12 * 8, rel=0.03)
    for key, true in (("diameter_mm", 36), ("diameter_across_mm", 24), ("diameter_axial_mm", 36),
                      ("diameter_axial_across_mm", 24)):  # fmt: skip
        assert row[key] == pytest.approx(true, abs=2.2), key  # a diagonal of a voxel is 2 mm
    assert row["mean"] == pytest.approx(100, abs=1.5) and row["sd"] < 12
    assert row["centroid_mm"] == pytest.approx(actions.scene.geometry.center_world().tolist(), abs=0.2)
    lines = {line[0]: line[1] for line in state["figures"]}
    assert lines[""] == "object" and lines["Volume"] == f"{row['volume_ml']:.4g} ml"
    assert lines["Volume, mm3"].replace(" ", "") == f"{row['volume_mm3']:.0f}mm3"
    assert lines["Mean, SD"].endswith(" HU") and lines["Diameter"] == f"{row['diameter_mm']:.4g} mm"
    json.dumps(state)


def test_the_table_is_known_to_be_of_another_step(actions):
    ask(actions, "measure_table")
    last = actions.session.status.step
    ask(actions, "go_to", last - 2)
    view = actions.session.next_view()
    while view is None or view.status.step == last:
        view = actions.session.next_view()
    actions.update(view)
    assert not actions.state()["figures_current"] and actions.state()["figures_step"] == last
    ask(actions, "go_to", last)


def test_diameters_are_drawn_with_the_lengths_of_the_table(actions):
    ask(actions, "measure_table")
    state = ask(actions, "measure_diameters")
    assert [row[1] for row in state["measurements"]] == ["distance"] * 4
    (row,) = actions.feature(MeasureFeature).figures.rows
    names = ("diameter_mm", "diameter_across_mm", "diameter_axial_mm", "diameter_axial_across_mm")
    assert [one[2] for one in state["measurements"]] == [f"{row[name]:.4g} mm" for name in names]
    # The slices go to where the long and the short axis lie.
    assert actions.scene.measures.marks["axial"].texts == tuple(f"{row[name]:.4g} mm" for name in names[2:])


def test_tables_are_copied_and_saved_with_the_run(actions, tmp_path):
    actions.request("measure_copy")
    assert "nothing has been measured" in actions.message
    ask(actions, "measure_table")
    ask(actions, "measure_diameters", 1)
    state = ask(actions, "measure_copy")
    rows = [line.split("\t") for line in state["copied"][1].split("\n")]
    table = dict(zip(rows[0], rows[1], strict=True))
    assert table["name"] == "object" and float(table["volume_ml"]) * 1000 == pytest.approx(float(table["volume_mm3"]))
    assert rows[2] == [""] and rows[3][:4] == ["number", "kind", "value", "unit"]
    ask(actions, "save")
    saved = actions.feature(FilesFeature).files
    assert {"egg_measurements.csv", "egg_statistics.csv"} <= set(saved)
    drawn = list(csv.DictReader(io.StringIO((tmp_path / "egg_measurements.csv").read_text())))
    assert len(drawn) == 4 and float(drawn[0]["value"]) == pytest.approx(float(table["diameter_mm"]))
    # One source: what is copied is what the run's own table has.
    (own,) = csv.DictReader(io.StringIO((tmp_path / "egg_statistics.csv").read_text()))
    assert {key: own[key] for key in table} == table
    ask(actions, "measure_save")
    assert (tmp_path / "egg_figures.csv").read_text().split("\n")[0].split(",") == rows[0]
    assert "egg_figures.csv" in actions.state()["saved"]


def test_a_file_of_others_is_not_replaced(actions, tmp_path):
    (tmp_path / "egg_measurements.csv").write_text("mine")
    ask(actions, "measure_diameters")
    ask(actions, "measure_save")
    assert "exists already" in actions.message and (tmp_path / "egg_measurements.csv").read_text() == "mine"
    other = Actions(actions.session, actions.scene, tmp_path, overwrite=True)
    ask(other, "measure_diameters")
    ask(other, "measure_save")
    assert (tmp_path / "egg_measurements.csv").read_text().startswith("number,kind")


@pytest.mark.parametrize(
    "request_", [("measure_delete", 7), ("measure_delete", "x"), ("measure_delete", None), ("measure_delete",),
                 ("measure_diameters", 9), ("measure_diameters", "nan"), ("measure_diameters", [1]),
                 ("measure_table", 1), ("measure_copy", 1), ("measure_clear", 0), ("measure_save", "/tmp/x")]
)  # fmt: skip
def test_wrong_values_change_nothing_and_are_said_in_one_line(actions, request_, tmp_path):
    before = actions.state()
    after = ask(actions, *request_)
    assert actions.message and "\n" not in actions.message and "internal" not in actions.message
    assert {key: after[key] for key in ("measurements", "figures")} == {
        key: before[key] for key in ("measurements", "figures")
    }
    assert list(tmp_path.iterdir()) == []


def test_a_flat_image_has_area_and_outline_and_a_small_one_its_unit():
    y, x = np.indices((60, 60))
    disc = (np.hypot(y - 29.5, x - 29.5) < 20) * 100.0
    image = Volume.from_array(disc[None].astype(np.float32), (0.001, 0.0005, 0.0005))
    image.metadata[UNIT_KEY] = "um"
    with Session(image, RunConfig(start="ball:0.014,0.014,0,0.008", threads=1), name="disc") as session:
        session.play().result(60)
        session.wait(120)
        lines = dict(table_of(session.figures().result(60), "um", 0.001))
    area = float(lines["Area"].split(" ")[0])
    assert lines["Area"].endswith(" um2") and area == pytest.approx(np.pi * 10**2, rel=0.05)
    assert lines["Outline"].endswith(" um") and lines["Diameter"].endswith(" um")
    assert float(lines["Diameter"].split()[0]) == pytest.approx(20, abs=0.8)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_flat_image_is_measured_with_the_mouse(scene_of, tmp_path, axis):
    y, x = np.indices((60, 60))
    disc = ((np.hypot(y - 29.5, x - 29.5) < 20) * 100.0).astype(np.float32)
    image = Volume.from_array(np.expand_dims(disc, axis), (2.0, 0.5, 0.5) if axis == 0 else (0.5, 2.0, 0.5))
    scene = scene_of(image, size=(960, 540))
    center = ",".join(f"{v:g}" for v in image.geometry.center_world())
    with Session(image, RunConfig(start=f"ball:{center},6", threads=1), name="disc") as session:
        session.play().result(60)
        session.wait(60)
        actions = Actions(session, scene, tmp_path)
        scene.screenshot()
        (tile,) = scene.slice_tiles
        actions.request("tool", "distance")
        drag(actions, tile, (0.4, 0.5), (0.6, 0.5))
        ends = [world(actions, tile, part, 0.5) for part in (0.4, 0.6)]
        (row,) = actions.state()["measurements"]
        assert float(row[2].split()[0]) == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-3)
        state = ask(actions, "measure_diameters")
        assert [one[2] for one in state["measurements"][1:]] == [state["measurements"][1][2]] * 4
        assert float(state["measurements"][1][2].split()[0]) == pytest.approx(20, abs=0.8)
        assert set(scene.measures.marks[tile].texts) == {one[2] for one in state["measurements"]}


def test_each_object_has_its_column(scene_of, tmp_path):
    z, y, x = np.indices((24, 30, 50))
    labels = np.zeros((24, 30, 50), np.uint8)
    labels[np.sqrt((z - 12) ** 2 + (y - 15) ** 2 + (x - 13) ** 2) < 8] = 3
    labels[np.sqrt((z - 12) ** 2 + (y - 15) ** 2 + (x - 36) ** 2) < 6] = 7
    image = Volume.from_array(((labels > 0) * 100).astype(np.float32))
    starts = tmp_path / "starts.nii.gz"
    write(Volume.from_array(labels), starts)
    config = RunConfig(objects=str(starts), threads=1, max_steps=3, name=("7=small",))
    with Session(image, config, name="two") as session:
        session.play().result(60)
        session.wait(60)
        actions = Actions(session, scene_of(image, size=(640, 360)), tmp_path / "out")
        state = ask(actions, "measure_table")
        assert state["figures"][0] == ["", "object 3", "small"] and state["figures_ids"] == [3, 7]
        first, second = (float(text.split()[0]) for text in state["figures"][1][1:])
        assert first == pytest.approx(4 / 3 * np.pi * 8**3 / 1000, rel=0.1) and second < 0.5 * first
        ask(actions, "measure_diameters", 7)
        (longest, *_) = actions.feature(MeasureFeature).measurements
        assert longest.value == pytest.approx(12, abs=1.8)
        middle = np.mean(longest.points, axis=0)
        assert np.linalg.norm(middle - image.geometry.index_to_world((12, 15, 36))) < 2
        ask(actions, "measure_diameters", 4)
        assert "expected 3, 7" in actions.message
