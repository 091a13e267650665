"""The box of a run, drawn and dragged in slices."""

import numpy as np
import pytest

from accelsurf.image.volume import Volume
from accelsurf.run.region_of_interest import region_of_interest
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.box import BoxFeature
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.box import BoxOverlay, VoxelBox
from accelsurf.viewer.scene.colors import MARK
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing
from tests.support.viewing import look, settle

SIZE = (1000, 600)


@pytest.fixture(scope="module", params=["straight", "oblique"])
def placed(request):
    viewing.needs_graphics()
    volume, center = viewing.ball_image(direction=viewing.TURN if request.param == "oblique" else None)
    scene = Scene(volume, size=SIZE)
    scene.tiles.lay_out("slices", "axial", False)
    yield scene, volume, center
    scene.close()


@pytest.fixture
def actions(placed):
    scene, volume, center = placed
    scene.frame, scene.cursor = None, center
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    with Session(volume, RunConfig(start=start, threads=1, max_steps=60), name="ball") as session:
        session.ready.result(60)
        made = Actions(session, scene)
        settle(made)
        scene.screenshot()
        yield made


def pixel(actions, tile_name, index):
    """Parts of width, and of the height from the top, at which an index (z, y, x) is seen in a tile."""
    tile = actions.scene.slice_tiles[tile_name]
    left, bottom, right, top = tile.renderer.GetViewport()
    x, y = tile.to_tile(np.asarray(index, float))
    (x0, y0), (x1, y1) = tile.to_plane(0.0, 0.0), tile.to_plane(1.0, 1.0)
    across, up = (x - x0) / (x1 - x0), (y - y0) / (y1 - y0)
    return left + across * (right - left), 1.0 - (bottom + up * (top - bottom))


def drag(actions, tile, start, end):
    actions.request("press", *pixel(actions, tile, start))
    for share in (0.3, 0.7, 1.0):
        between = np.asarray(start, float) + share * (np.asarray(end, float) - start)
        actions.request("move", *pixel(actions, tile, between))
    actions.request("release")


def box_of(actions):
    roi = actions.session.status.settings.roi
    return [(s.start, s.stop - 1) for s in region_of_interest(roi, actions.scene.geometry)]


# -------------------------------------------------------------------------------------------------------------- the box


def test_a_box_is_drawn_in_a_slice_and_its_sides_are_dragged(actions):
    tile = actions.scene.slice_tiles["axial"]
    assert tile.stack.axis == 0
    z = tile.index
    actions.request("tool", "box")
    drag(actions, "axial", (z, 4, 6), (z, 33, 39))
    settle(actions)
    assert not actions.message and actions.session.status.step == 0
    assert box_of(actions) == [(0, 19), (4, 33), (6, 39)] and actions.state()["has_box"]
    # the upper side along y, in the same slice; then both sides of a corner in another one
    drag(actions, "axial", (z, 33.5, 20), (z, 36, 20))
    settle(actions)
    assert box_of(actions) == [(0, 19), (4, 36), (6, 39)]
    other = actions.scene.slice_tiles["coronal"]
    across = other.index
    corner, target = [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]
    corner[other.stack.axis] = target[other.stack.axis] = across
    free = 3 - other.stack.axis  # the axis in the plane of both that is not z
    corner[0], corner[free] = -0.5, box_of(actions)[free][0] - 0.5
    target[free] = box_of(actions)[free][0] + 3
    before = box_of(actions)
    drag(actions, "coronal", corner, target)
    settle(actions)
    wanted = list(before)
    wanted[0], wanted[free] = (2, 19), (before[free][0] + 3, before[free][1])
    assert box_of(actions) == wanted
    actions.request("undo")
    settle(actions)
    assert box_of(actions) == before
    assert actions.feature(BoxFeature).overlay.box == VoxelBox(*zip(*before, strict=True))


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0, 3.0])
def test_a_side_is_taken_from_as_far_on_a_fine_screen(placed, ratio):
    """A hand is as steady there: six pixels of a usual screen beside the side, twelve are too far."""
    scene, _, _ = placed
    overlay, tile = BoxOverlay(scene), scene.slice_tiles["axial"]
    scene.tiles.pixel_ratio = ratio
    try:
        overlay.show(VoxelBox((2, 3, 4), (15, 30, 33)))
        for pixels, sides in ((6.0, {1: 1}), (12.0, {})):
            index = np.array([tile.index, 30.5, 18.0])
            index[1] += pixels * ratio * tile.mm_per_pixel() / scene.geometry.spacing[1]
            assert overlay.sides_at(tile, index) == sides
    finally:
        scene.tiles.pixel_ratio = 1.0
        overlay.show(None)


def test_a_box_that_the_run_refuses_leaves_the_one_before(actions):
    actions.request("tool", "box")
    z = actions.scene.slice_tiles["axial"].index
    drag(actions, "axial", (z, 1, 1), (z, 4, 4))
    settle(actions)
    assert "start" in actions.message and actions.session.status.settings.roi is None
    assert actions.feature(BoxFeature).overlay.box is None
    actions.message = ""
    drag(actions, "axial", (z, 10, 10), (z, 10.2, 10.2))
    settle(actions)
    assert actions.session.status.settings.roi is None and not actions.message, "a click draws none"


def test_a_box_is_laid_around_the_object_and_taken_away(actions):
    actions.request("box_around")
    settle(actions)
    box = box_of(actions)
    psi = look(actions.session, lambda run: run.objects[0].surface.psi.shape).result(60)
    assert psi == tuple(high - low + 1 for low, high in box) and np.prod(psi) < 0.8 * 20 * 40 * 44
    actions.request("box_none")
    settle(actions)
    assert actions.session.status.settings.roi is None and not actions.state()["has_box"]


def test_the_box_is_seen_in_slices_and_in_3d(actions):
    actions.scene.tiles.lay_out("four", "space", False)
    settle(actions)
    without = actions.scene.screenshot().astype(int)
    actions.request("set", "roi", "6,6,4,38,34,16vox")
    settle(actions)
    picture = actions.scene.screenshot().astype(int)
    color = np.array([int(MARK[i : i + 2], 16) for i in (1, 3, 5)])
    for name in ("space", "axial", "coronal", "sagittal"):
        left, bottom, right, top = actions.scene.tiles.renderer(name).GetViewport()
        rows = slice(round(SIZE[1] * (1 - top)), round(SIZE[1] * (1 - bottom)))
        columns = slice(round(SIZE[0] * left), round(SIZE[0] * right))
        near = [(np.abs(one[rows, columns] - color).sum(axis=-1) < 40).sum() for one in (without, picture)]
        assert near[1] > near[0] + 60, name
    actions.scene.tiles.lay_out("slices", "axial", False)


def test_an_image_of_one_slice_has_a_box_too():
    viewing.needs_graphics()
    rows, columns = np.indices((40, 50))
    disc = ((rows - 20) ** 2 + (columns - 25) ** 2 < 100)[None] * np.float32(100)
    scene = Scene(Volume.from_array(disc), size=(600, 400))
    with Session(scene.volume, RunConfig(start="ball:25,20,0,6vox", threads=1), name="disc") as session:
        session.ready.result(60)
        actions = Actions(session, scene)
        settle(actions)
        scene.screenshot()
        actions.request("tool", "box")
        drag(actions, next(iter(scene.slice_tiles)), (0, 3, 5), (0, 36, 44))
        settle(actions)
        assert not actions.message
        assert box_of(actions) == [(0, 0), (3, 36), (5, 44)] and not actions.message
    scene.close()
