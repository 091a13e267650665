"""Distances and angles: exact in world mm on oblique, anisotropic grids; drawn where they are."""

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.errors import UsageError
from accelsurf.io.headers import UNIT_KEY
from accelsurf.viewer.core.measurements import COLUMNS, MAX_COUNT, Measurement, Measurements
from accelsurf.viewer.scene.overlay import Pixels
from tests.support import viewing


def oblique(unit=None):
    """An image with voxels of 2.5 x 0.7 x 1.3 mm on a grid turned about all axes."""
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    volume = Volume.from_array(np.zeros((20, 48, 36), np.float32), (2.5, 0.7, 1.3), (11.0, -7.0, 3.0), q)
    if unit:
        volume.metadata[UNIT_KEY] = unit
    return volume


def test_a_distance_between_voxels_is_that_of_their_steps():
    geometry = oblique().geometry
    for step in ((3, 0, 0), (0, 10, 0), (0, 0, 7), (4, -9, 6)):
        ends = geometry.index_to_world([(8, 20, 10), np.add((8, 20, 10), step)])
        expected = np.linalg.norm(np.multiply(step, (2.5, 0.7, 1.3)))
        assert Measurement(1, "distance", tuple(map(tuple, ends))).value == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 30.0, 90.0, 179.9999, 180.0])
def test_an_angle_is_exact_where_it_is_small_and_where_it_is_flat(degrees):
    geometry, turn = oblique().geometry, np.radians(degrees)
    middle = geometry.index_to_world((9, 20, 15))
    first = geometry.direction @ (11.0, 0.0, 0.0)
    second = geometry.direction @ (5.0 * np.cos(turn), 0.0, 5.0 * np.sin(turn))
    one = Measurement(1, "angle", (tuple(middle + first), tuple(middle), tuple(middle + second)))
    assert one.value == pytest.approx(degrees, abs=1e-7)
    assert one.text() == f"{degrees:.1f}°"


def test_text_is_in_the_unit_of_the_file():
    one = Measurement(1, "distance", ((0.0, 0.0, 0.0), (0.0123456, 0.0, 0.0)))
    assert (one.text("um"), one.text("nm"), one.text()) == ("12.35 um", "1.235e+04 nm", "0.01235 mm")
    assert Measurement(1, "distance", ((0.0, 0.0, 0.0),)).text() == ""
    assert Measurement(1, "angle", ((1.0, 0.0, 0.0),) * 3).value is None


def test_they_are_listed_moved_and_deleted():
    measurements = Measurements()
    first = measurements.add("distance", [(0, 0, 0)])
    assert not first.is_complete and measurements.rows() == []
    measurements.add_point(first.number, (3, 4, 0))
    measurements.add_point(first.number, (9, 9, 9))  # it has all its points: nothing happens
    second = measurements.add("angle", [(1, 0, 0), (0, 0, 0), (0, 1, 0)])
    assert [one.number for one in measurements] == [1, 2] and second.value == 90.0
    assert measurements.nearest((3.2, 4, 0), 0.5) == (1, 1) and measurements.nearest((3.2, 4, 0), 0.1) is None
    measurements.move(1, 1, (0, 0, 12))
    assert measurements[1].value == 12.0
    rows = measurements.rows()
    assert tuple(rows[0]) == COLUMNS and rows[0]["unit"] == "mm"
    assert rows[0]["z2_mm"] == 12.0 and rows[0]["x3_mm"] is None
    assert rows[1]["value"] == 90.0 and rows[1]["unit"] == "degrees"
    measurements.delete(1)
    assert [one.number for one in measurements] == [2]
    assert measurements.add("distance", [(0, 0, 0)]).number == 3  # a number is never used again
    measurements.clear()
    assert len(measurements) == 0


def test_what_is_wrong_changes_nothing():
    measurements = Measurements()
    for wrong in (
        lambda: measurements.add("area", [(0, 0, 0)]),
        lambda: measurements.add("distance", [(0, 0, np.nan)]),
        lambda: measurements.add("distance", [(0, 0, 0)] * 3),
        lambda: measurements.delete(1),
        lambda: measurements.move(7, 0, (0, 0, 0)),
    ):
        with pytest.raises(UsageError):
            wrong()
    assert len(measurements) == 0
    for _ in range(MAX_COUNT):
        measurements.add("distance", [(0, 0, 0)])
    with pytest.raises(UsageError, match="no more"):
        measurements.add("distance", [(0, 0, 0)])


# -- drawn ---------------------------------------------------------------------------------------------------


@pytest.fixture
def scene(scene_of):
    viewing.needs_graphics()
    return scene_of(oblique(), size=(1280, 720))


def in_slice(scene, name, *places):
    """World places at parts of a slice's width and height."""
    tile = scene.slice_tiles[name]
    left, right, bottom, top = tile.stack.extent
    return [
        scene.geometry.index_to_world(tile.from_tile(left + a * (right - left), bottom + b * (top - bottom)))
        for a, b in places
    ]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["axial", "coronal", "sagittal"])
def test_a_line_drawn_in_a_slice_has_the_length_it_has_on_the_screen(scene, name):
    scene.cursor = scene.geometry.index_to_world((9, 21, 17))
    ends = in_slice(scene, name, (0.2, 0.3), (0.7, 0.75))
    tile = scene.slice_tiles[name]
    left, right, bottom, top = tile.stack.extent
    on_screen = np.hypot(0.5 * (right - left), 0.45 * (top - bottom))
    one = Measurement(1, "distance", tuple(map(tuple, ends)))
    assert one.value == pytest.approx(on_screen, rel=1e-9)
    before = scene.screenshot()
    scene.measures.show([one])
    after = scene.screenshot()
    x, y, far, high = tile.renderer.GetViewport()
    height, width = after.shape[:2]
    changed = np.argwhere((before != after).any(axis=2))
    rows, columns = (height - 1 - changed[:, 0]) / height, changed[:, 1] / width
    assert ((columns >= x) & (columns <= far) & (rows >= y) & (rows <= high)).any()
    assert scene.measures.marks[name].texts == (one.text(),)
    others = [texts.texts for other, texts in scene.measures.marks.items() if other not in (name, "space")]
    assert others == [(), ()]  # it is in no other slice
    assert scene.measures.marks["space"].texts == (one.text(),)
    scene.step_slice(name, 1)
    assert scene.measures.marks[name].texts == ()
    scene.measures.show([])
    scene.step_slice(name, -1)
    assert (scene.screenshot() == before).all()


def test_an_angle_has_an_arc_and_an_end_in_another_slice_is_a_dot(scene):
    scene.cursor = scene.geometry.index_to_world((9, 21, 17))
    first, middle, last = in_slice(scene, "axial", (0.8, 0.2), (0.2, 0.2), (0.2, 0.8))
    plain = scene.screenshot()
    scene.measures.show([Measurement(1, "angle", (tuple(first), tuple(middle), tuple(last)))])
    assert scene.measures.marks["axial"].texts == ("90.0°",)
    angle = scene.screenshot()
    across = np.eye(3)[scene.slice_tiles["axial"].stack.axis]
    away = scene.geometry.index_to_world(scene.geometry.world_to_index(middle) + 5 * across)
    scene.measures.show([Measurement(1, "distance", (tuple(middle), tuple(away)))])
    assert scene.measures.marks["axial"].texts == ()
    dots = scene.screenshot()
    tile = scene.slice_tiles["axial"].renderer.GetViewport()
    height, width = plain.shape[:2]
    part = slice(round((1 - tile[3]) * height), round((1 - tile[1]) * height)), slice(
        round(tile[0] * width), round(tile[2] * width)
    )
    few = (plain[part] != dots[part]).any(axis=2).sum()
    many = (plain[part] != angle[part]).any(axis=2).sum()
    assert 20 < few < 120 and many > 10 * few


def test_ends_and_lines_are_wider_on_a_fine_screen(scene):
    scene.cursor = scene.geometry.index_to_world((9, 21, 17))
    ends = in_slice(scene, "axial", (0.1, 0.5), (0.9, 0.5))
    one = Measurement(1, "distance", tuple(map(tuple, ends)))
    changed = []
    for scene.tiles.pixel_ratio in (1.0, 2.0):
        scene.measures.show([])
        plain = scene.screenshot()
        scene.measures.show([one])
        changed.append((scene.screenshot() != plain).any(axis=2).sum())
    assert 1.5 < changed[1] / changed[0] < 4.0
    assert Pixels(720, 2.0).text == 24
