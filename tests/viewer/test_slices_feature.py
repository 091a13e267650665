"""Slices that one can read: grey values, zoom, layouts, and what is under the mouse."""

import numpy as np
import pytest

from accelsurf.errors import UsageError
from accelsurf.image.grey_window import CT_WINDOWS, GreyWindow, parse_window
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.tiles import LAYOUTS, viewports
from tests.support import viewing

TILES = ("axial", "coronal", "sagittal", "space")


# ---------------------------------------------------------------------------------------------------------- grey values


def test_grey_values_are_linear_between_the_ends_of_the_window():
    window = GreyWindow.of(40.0, 400.0)
    values = np.array([-2000, -160, -60, 40, 140, 240, 3000, np.inf, -np.inf, np.nan], np.float32)
    assert window.grey(values).tolist() == [0, 0, 63, 127, 191, 255, 255, 255, 0, 0]
    for kind in (np.int16, np.uint16, np.uint8, np.float64, bool):
        assert window.grey(np.array([0, 1], kind)).tolist() == [102, 102]
    assert values[0] == -2000  # not changed


@pytest.mark.parametrize(
    "text", ["", "40", "40,0", "40,-3", "nan,3", "3,inf", "1,2,3", "Bone", "a,b"]
)
def test_what_is_no_window_is_refused_in_one_line(text):
    with pytest.raises(UsageError, match="expected auto, soft-tissue"):
        parse_window(text)


# ------------------------------------------------------------------------------------------------------------ layouts


@pytest.mark.sampled
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("chart", [False, True])
@pytest.mark.parametrize("tiles", [TILES, ("axial",)])
def test_tiles_cover_the_picture_once(layout, chart, tiles):
    for large in tiles:
        places = viewports(layout, tiles, large, chart)
        assert ("energies" in places) == chart and set(places) <= {*tiles, "energies"}
        count = np.zeros((60, 60), int)
        for left, bottom, right, top in places.values():
            assert left < right and bottom < top
            count[round(60 * bottom) : round(60 * top), round(60 * left) : round(60 * right)] += 1
        assert (count == 1).all()


@pytest.fixture(scope="module")
def actions():
    viewing.needs_graphics()
    volume, center = viewing.ball_image(direction=viewing.TURN)
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    scene = Scene(volume, size=(640, 360))
    with Session(volume, RunConfig(start=start, threads=1, max_steps=60), name="ball") as session:
        session.ready.result(60)
        made = Actions(session, scene)
        view = None
        while view is None:
            view = session.next_view()
        made.update(view)
        yield made
    scene.close()


@pytest.fixture
def fresh(actions):
    actions.scene.tiles.lay_out("one", "space", True)
    actions.scene.tiles.show_whole()
    actions.request("window_named", "image")
    actions.request("tool", "look")
    actions.message = ""
    actions.scene.screenshot()
    return actions


def middle(actions, tile):
    """Parts of width, and of the height from the top, of the middle of a tile."""
    left, bottom, right, top = actions.scene.tiles.renderer(tile).GetViewport()
    return 0.5 * (left + right), 1.0 - 0.5 * (bottom + top)


def part_of(picture, actions, tile):
    """The pixels of a tile."""
    height, width, _ = picture.shape
    left, bottom, right, top = actions.scene.tiles.renderer(tile).GetViewport()
    return picture[
        round(height * (1 - top)) : round(height * (1 - bottom)),
        round(width * left) : round(width * right),
    ]


def test_a_drag_with_the_right_button_changes_grey_values_in_slices_alone(fresh):
    before, window = fresh.scene.screenshot(), fresh.scene.window
    x, y = middle(fresh, "axial")
    fresh.request("press", x, y, 2)
    fresh.request("move", x + 0.05, y)
    wider = fresh.scene.window
    assert wider.width == pytest.approx(
        window.width * np.exp(0.1)
    ) and wider.level == pytest.approx(window.level)
    fresh.request("move", x + 0.05, y - 0.1)
    fresh.request("release")
    assert fresh.scene.window.level == pytest.approx(window.level + 0.2 * wider.width)
    after = fresh.scene.screenshot()
    assert fresh.state()["window_word"] == "" and not fresh.message
    assert not np.array_equal(part_of(after, fresh, "axial"), part_of(before, fresh, "axial"))
    assert np.array_equal(part_of(after, fresh, "space"), part_of(before, fresh, "space"))


def test_windows_have_names_and_numbers(fresh):
    for name, window in CT_WINDOWS.items():
        fresh.request("window_named", name)
        assert fresh.scene.window == GreyWindow.of(*window) and fresh.state()["window_word"] == name
    fresh.request("window", "-600", 1500)
    assert (
        fresh.scene.window == GreyWindow.of(-600.0, 1500.0) and fresh.state()["window_word"] == ""
    )
    for bad in ((1, 0), (1, -1), ("x", 1), (1e99, 1), (float("nan"), 1)):
        fresh.request("window", *bad)
        assert "was given" in fresh.message and fresh.scene.window == GreyWindow.of(-600.0, 1500.0)
    fresh.request("window_named", "auto")
    # Ball of 100 in 0: both are seen.
    # The start is in the ball; with a voxel of the outside around it both are seen.
    assert (
        fresh.scene.window.low <= 0 + 1 and fresh.scene.window.high >= 100 - 1 and not fresh.message
    )


def test_the_scroll_goes_through_slices_and_zooms_with_ctrl_around_the_mouse(fresh):
    x, y = middle(fresh, "coronal")
    place = fresh.scene.pick((x + 0.03) * 640, (1 - y) * 360).world
    fresh.request("scroll", x + 0.03, y, 3, True)
    assert np.allclose(fresh.scene.pick((x + 0.03) * 640, (1 - y) * 360).world, place, atol=1e-6)
    tile = fresh.scene.slice_tiles["coronal"]
    assert tile.mm_per_pixel() < 0.8 * fresh.scene.slice_tiles["sagittal"].mm_per_pixel()
    before = tile.index
    fresh.request("scroll", x, y, 1)
    assert abs(tile.index - before) == 1
    # Middle, or shift with left, moves the picture; the image point under the mouse stays under it.
    at = fresh.scene.pick(x * 640, (1 - y) * 360).world
    fresh.request("press", x, y, 0, True)
    fresh.request("move", x + 0.02, y + 0.02)
    fresh.request("release")
    assert np.allclose(
        fresh.scene.pick((x + 0.02) * 640, (1 - y - 0.02) * 360).world, at, atol=1e-6
    )
    for _ in range(40):
        fresh.request("scroll", x, y, -100, True)
        fresh.request("press", x, y, 1)
        fresh.request("move", 1.0, 1.0)
        fresh.request("release")
    fresh.request("whole")
    assert tile.mm_per_pixel() == pytest.approx(
        fresh.scene.slice_tiles["axial"].mm_per_pixel(), rel=0.5
    )


def share_of_slices(scene):
    """The part of the picture that is image in slices."""
    area = 0.0
    for tile in scene.slice_tiles.values():
        left, right, bottom, top = tile.stack.extent
        sides = np.minimum(
            np.array([right - left, top - bottom]) / tile.mm_per_pixel(), tile.renderer.GetSize()
        )
        area += float(np.prod(sides))
    return area / np.prod(scene.plotter.render_window.GetSize())


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "size", [(704, 656), (960, 600), (1600, 960), (2240, 1320), (3520, 2040), (456, 720)]
)
def test_slices_take_most_of_any_window_and_3d_waits_for_a_surface(fresh, size):
    new, scene = Actions(fresh.session, fresh.scene), fresh.scene
    frame = scene.frame
    scene.frame = None
    new.request("size", *size)
    scene.render()
    alone = share_of_slices(scene)
    assert not scene.tiles.shows_space and not scene.tiles.shows_chart
    assert (
        alone == max(alone, *(share_in(new, layout) for layout in ("one", "four", "slices")))
        and alone > 0.5
    )
    new = Actions(fresh.session, scene)
    scene.frame = frame
    new.request("size", size[0] - 8, size[1])
    new.request("size", *size)
    scene.render()
    assert (
        scene.tiles.shows_space
        and not scene.tiles.shows_chart
        and 0.3 < share_of_slices(scene) < alone
    )
    new.request("size", 640, 360)


def share_in(actions, layout):
    """The share of slices in a layout, without 3D."""
    actions.scene.tiles.lay_out(layout, "axial", chart=False, space=False)
    actions.scene.render()
    return share_of_slices(actions.scene)


def test_the_layout_follows_the_window_until_one_is_chosen(fresh):
    new, tiles, space = Actions(fresh.session, fresh.scene), fresh.scene.tiles, fresh.scene.space
    for width, height in ((960, 640), (1600, 1200), (480, 800)):
        new.request("size", width, height)
        # The picture in 3D is seen whole in each, and no smaller than it must be.
        assert space.renderer.camera.parallel_scale == pytest.approx(space.fitted_scale())
    assert (
        tiles.large == "axial" and tiles.renderer("axial").GetViewport()[2] == 1.0
    )  # above the others
    # What counts are pixels of a usual screen: this picture has as many of the device as the one before.
    new.request("size", 800, 600, 2.0)
    assert tiles.layout == "one" and tiles.renderer("axial").GetViewport()[2] == pytest.approx(0.6)
    new.request("layout", "four")
    new.request("chart", True)
    new.request("size", 1600, 1200)
    assert (tiles.layout, tiles.shows_chart) == ("four", True)
    new.request("size", 640, 360)


@pytest.mark.parametrize("name", ["axial", "coronal", "sagittal"])
def test_the_slider_of_a_slice_goes_through_all_of_them(fresh, name):
    scene = fresh.scene
    scene.render()
    tile = scene.slice_tiles[name]
    left, bottom, right, top = tile.renderer.GetViewport()
    y, steps = 1 - bottom - 4 / 360, fresh.session.status.undoable
    for share, number in ((0.0, 0), (1.0, tile.stack.count - 1), (0.5, (tile.stack.count - 1) / 2)):
        fresh.request("press", left + 0.5 * (right - left), y)
        fresh.request("move", min(max(left + share * (right - left), 0.0), 1.0), 0.2)
        fresh.request("release")
        across = number if tile.stack.step > 0 else tile.stack.count - 1 - number
        assert abs(tile.index - across) <= 1 and not fresh.message
    assert fresh.session.status.undoable == steps  # a press there is none in the image


def test_level_width_and_value_are_in_the_slice_while_grey_values_are_dragged(fresh):
    x, y = middle(fresh, "axial")
    tile = fresh.scene.slice_tiles["axial"]
    fresh.request("press", x, y, 2)
    fresh.request("move", x + 0.05, y)
    said = tile.title.text.splitlines()[1]
    window = fresh.scene.window
    assert said.startswith(f"level {window.level:.4g}, width {window.width:.4g}, value ")
    assert said.endswith(fresh.state()["value"])
    fresh.request("release")
    assert len(tile.title.text.splitlines()) == 1


def test_a_double_click_shows_a_tile_alone_and_again_all(fresh):
    fresh.request("layout", "four")
    x, y = middle(fresh, "sagittal")
    fresh.request("double", x, y)
    assert (fresh.scene.tiles.layout, fresh.scene.tiles.large) == ("single", "sagittal")
    fresh.request("chart", False)
    assert fresh.scene.pick(5, 5).tile == "sagittal"
    fresh.request("double", 0.5, 0.5)
    assert fresh.scene.tiles.layout == "four" and not fresh.message
    # A double click with a tool is two clicks.
    fresh.request("tool", "inside")
    fresh.request("double", *middle(fresh, "axial"))
    assert fresh.scene.tiles.layout == "four"


def test_the_read_out_says_place_voxel_value_and_label(fresh):
    scene, geometry = fresh.scene, fresh.scene.geometry
    frame = scene.frame
    x, y = middle(fresh, "axial")
    for dx in (-0.06, 0.0, 0.013, 0.06):
        fresh.request("hover", x + dx, y)
        world = scene.pick((x + dx) * 640, (1 - y) * 360).world
        said = fresh.state()
        k, j, i = (round(float(v)) for v in geometry.world_to_index(world))
        assert said["voxel"] == f"{i}, {j}, {k}"
        assert float(said["value"]) == pytest.approx(scene.volume.array[k, j, i], rel=1e-5)
        assert np.allclose([float(v) for v in said["place"].split(",")], world, atol=0.06)
        inside = (
            np.linalg.norm(geometry.index_to_world([k, j, i]) - frame_center(frame, geometry)) < 6
        )
        assert said["label"] == (str(frame.surfaces[0].id) if inside else "0")
        assert said["as_point"] == f"point:{said['place'].replace(' ', '')}"
    fresh.request("copy_point")
    assert fresh.state()["copied"][1] == said["as_point"]
    fresh.request("key", "Ctrl+Shift+C")
    assert (
        fresh.state()["copied"] == (2, said["as_ball"])
        or fresh.state()["copied"][1] == said["as_ball"]
    )
    RunConfig(
        start=said["as_ball"], inside=[said["as_point"]]
    )  # what is copied is what settings take


def frame_center(frame, geometry):
    return geometry.index_to_world(frame.middle())


def test_voxels_can_be_seen_as_rectangles(fresh):
    fresh.request("large", "axial")
    fresh.request("interpolate", False)
    voxels = len(np.unique(fresh.scene.screenshot().reshape(-1, 3), axis=0))
    fresh.request("interpolate", True)
    assert len(np.unique(fresh.scene.screenshot().reshape(-1, 3), axis=0)) > 1.1 * voxels


def test_only_what_has_changed_is_drawn(fresh):
    drawn = []
    renderers = {name: fresh.scene.tiles.renderer(name) for name in fresh.scene.tiles.names}
    tags = [
        (renderer, renderer.AddObserver("StartEvent", lambda *_, name=name: drawn.append(name)))
        for name, renderer in renderers.items()
    ]
    fresh.scene.render()
    assert drawn == []  # nothing
    fresh.request("scroll", *middle(fresh, "axial"), 1, True)
    fresh.scene.render()
    assert drawn == ["axial"]
    drawn.clear()
    fresh.request("scroll", *middle(fresh, "axial"), 1)
    fresh.scene.render()
    assert sorted(drawn) == ["axial", "coronal", "sagittal"]  # the lines of the cursor
    drawn.clear()
    fresh.scene.plotter.render_window.Render()  # as a window system does
    assert sorted(drawn) == sorted(renderers)
    for renderer, tag in tags:
        renderer.RemoveObserver(tag)


def test_an_image_of_one_slice_has_the_same():
    viewing.needs_graphics()
    volume = Volume.from_array(np.arange(600.0, dtype=np.float32).reshape(1, 20, 30))
    scene = Scene(volume, size=(640, 360))
    with Session(volume, RunConfig(start="ball:15,10,0,4", threads=1), name="flat") as session:
        session.ready.result(60)
        made = Actions(session, scene)
        for layout in LAYOUTS:
            made.request("layout", layout)
        made.request("scroll", 0.3, 0.5, 1, True)
        made.request("double", 0.3, 0.5)
        made.request("hover", 0.3, 0.5)
        assert not made.message and made.state()["slices"] == {"axial": [1, 1]}
        assert scene.screenshot().std() > 10
    scene.close()
