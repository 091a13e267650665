"""Slices of an oblique scan, straight by anatomy: what is seen, clicked, painted, measured is where the world says."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from accelsurf.image.grey_window import GreyWindow
from accelsurf.image.volume import Volume
from accelsurf.io.headers import DICOM_KEY
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import read_clicks
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.slices import DragLines, function_lines, surface_lines
from tests.support import viewing
from tests.support.viewing import wait_until_idle

TURNED = Rotation.from_euler("xyz", [9, -14, 20], degrees=True).as_matrix() @ np.diag(
    [-1.0, -1.0, 1.0]
)
SHAPE, SPACING = (26, 44, 40), (1.8, 1.0, 1.1)
RADIUS = 11.0
SIZE = (900, 600)
#: World axes to the right and up, with their signs, and across.
HANGS = {
    "axial": ((0, 1), (1, -1), 2),
    "coronal": ((0, 1), (2, 1), 1),
    "sagittal": ((1, 1), (2, 1), 0),
}


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


def scan(direction=TURNED, anatomical=True):
    """A ball of 100 in a patient's oblique grid; its centre (x, y, z)."""
    volume, center = viewing.ball_image(SHAPE, SPACING, direction, RADIUS)
    if anatomical:
        volume.metadata[DICOM_KEY] = "1.2.3"
    return volume, center


@pytest.fixture
def placed(scene_of):
    volume, center = scan()
    scene = scene_of(volume, size=SIZE)
    scene.tiles.lay_out("slices", chart=False)
    scene.screenshot()
    return scene, center


def pixel_of(scene, name, world):
    """Pixel from the lower left corner at which a world point is seen, by the table of how slices hang."""
    tile = scene.slice_tiles[name]
    (right, sign), (up, turn), _ = HANGS[name]
    place = np.array([sign * world[right], turn * world[up]])
    low, high = np.array(tile.to_plane(0.0, 0.0)), np.array(tile.to_plane(1.0, 1.0))
    part = (place - low) / (high - low)
    left, bottom, far, top = tile.renderer.GetViewport()
    return SIZE[0] * (left + part[0] * (far - left)), SIZE[1] * (bottom + part[1] * (top - bottom))


# ------------------------------------------------------------------------------------------------------- which slices


def test_only_oblique_scans_of_patients_begin_straight(scene_of):
    for direction, anatomical, straight, oblique in (
        (TURNED, True, True, True),
        (TURNED, False, False, True),
        (np.diag([-1.0, -1.0, 1.0]), True, False, False),
    ):
        scene = scene_of(scan(direction, anatomical)[0])
        assert (scene.is_straight, scene.is_oblique) == (straight, oblique)
        assert all(tile.stack.is_straight == straight for tile in scene.slice_tiles.values())
    flat = Volume.from_array(np.ones((1, 20, 30), np.float32), direction=TURNED)
    flat.metadata[DICOM_KEY] = "1.2.3"
    scene = scene_of(flat)
    assert not scene.is_straight and not scene.is_oblique


def test_titles_say_the_world_coordinate(placed):
    scene, center = placed
    scene.cursor = center
    for name, tile in scene.slice_tiles.items():
        across = HANGS[name][2]
        letter = "xyz"[across]
        assert tile.title.text == f"{name.capitalize()}  {letter} = {tile.across:.4g} mm"
        assert abs(tile.across - center[across]) <= 0.5 * abs(tile.stack.step)
    scene.straighten(False)
    assert all("'" in tile.title.text for tile in scene.slice_tiles.values())


@pytest.mark.parametrize("name", list(HANGS))
def test_a_pixel_is_picked_where_the_world_has_it(placed, name):
    scene, center = placed
    scene.cursor = center
    across = HANGS[name][2]
    for offset in ((0.0, 0.0, 0.0), (5.0, -3.0, 2.0), (-7.0, 6.0, -4.0)):
        world = center + offset
        world[across] = scene.slice_tiles[name].across
        picked = scene.pick(*pixel_of(scene, name, world))
        assert picked.tile == name
        np.testing.assert_allclose(picked.world, world, atol=1e-6)
    left, bottom, right, top = scene.slice_tiles[name].renderer.GetViewport()
    at_corner = scene.pick(SIZE[0] * left + 3, SIZE[1] * bottom + 3)
    assert at_corner.tile == name and at_corner.world is None


def test_the_picture_ends_where_the_image_ends(placed):
    """Beside the image is the background; the same pixels pick nothing."""
    scene, center = placed
    scene.cursor = center
    scene.window = GreyWindow.of(-50.0, 10.0)  # all of the image is white
    picture = scene.screenshot()
    white = (picture > 200).all(axis=2)
    agree = []
    for tile in scene.slice_tiles.values():
        left, bottom, right, top = tile.renderer.GetViewport()
        for part in np.random.default_rng(2).uniform(0.12, 0.85, (150, 2)):
            x, y = (
                SIZE[0] * (left + part[0] * (right - left)),
                SIZE[1] * (bottom + part[1] * (top - bottom)),
            )
            agree.append(
                (scene.pick(x, y).world is not None) == white[SIZE[1] - 1 - int(y), int(x)]
            )
    assert (
        np.mean(agree) > 0.97 and len(agree) == 450
    )  # the rest: letters, the cursor's lines, the rim


# ------------------------------------------------------------------------------------------------------- what is drawn


def exact_surface(volume, center):
    """The ball's own signed distance as the frame of a run."""
    frames, _ = viewing.run_frames(volume, center, levels=1, max_steps=2)
    index = np.moveaxis(np.indices(SHAPE), 0, -1)
    psi = np.linalg.norm(volume.geometry.index_to_world(index) - center, axis=-1) - RADIUS
    (surface,) = frames[-1].surfaces
    exact = dataclasses.replace(
        surface,
        psi=psi.astype(np.float32),
        offset=(0, 0, 0),
        stride=1,
        corner=(0, 0, 0),
        shape=SHAPE,
    )
    return dataclasses.replace(frames[-1], surfaces=(exact,))


@pytest.mark.parametrize("name", list(HANGS))
def test_the_contour_of_a_ball_is_its_circle(placed, name):
    scene, center = placed
    frame = exact_surface(scene.volume, center)
    scene.cursor = center
    (right, sign), (up, turn), across = HANGS[name]
    stack, tile = scene.slice_tiles[name].stack, scene.slice_tiles[name]
    for count in (0, 2, -4):
        number = tile.index + count
        lines = surface_lines(frame.surfaces[0], stack, number)
        circle = np.sqrt(RADIUS**2 - (stack.across(number) - center[across]) ** 2)
        away = np.linalg.norm(lines - [sign * center[right], turn * center[up]], axis=-1)
        assert (
            np.abs(away - circle).max() < 0.12 and len(lines) > 40
        )  # linear between voxels of 1 to 1.8 mm
        # closed: at each end there are two segments, or four where it is at a pixel
        _, counts = np.unique(np.round(lines.reshape(-1, 2), 3), axis=0, return_counts=True)
        assert (counts % 2 == 0).all()
    far = stack.nearest_number(
        scene.geometry.world_to_index(center + 1.5 * RADIUS * np.eye(3)[across])
    )
    assert len(surface_lines(frame.surfaces[0], stack, far)) == 0


def test_a_contour_ends_at_the_border_of_the_image(placed):
    """A half space in the world: its contour is a straight line, and lies in the image alone."""
    scene, center = placed
    scene.cursor = center
    world = scene.geometry.index_to_world(np.moveaxis(np.indices(SHAPE), 0, -1))
    function = (world[..., 0] - center[0]).astype(np.float32)
    tile = scene.slice_tiles["coronal"]
    lines = function_lines(function, tile.stack, tile.index)
    ends = lines.reshape(-1, 2)
    index = tile.stack.to_index(np.column_stack([ends, np.full(len(ends), tile.across)]))
    known = ((index >= 0) & (index <= np.array(SHAPE) - 1)).all(axis=1)
    assert known.mean() > 0.9
    np.testing.assert_allclose(ends[known, 0], center[0], atol=1e-3)
    middles = tile.stack.to_index(
        np.column_stack([lines.mean(axis=1), np.full(len(lines), tile.across)])
    )
    assert ((middles >= -0.5) & (middles <= np.array(SHAPE) - 0.5)).all()
    outline = tile.stack.outline(tile.across, (0, 0, 0), np.array(SHAPE) - 1)
    assert np.ptp(lines[..., 1]) > 0.7 * np.ptp(outline[:, 1])


def test_the_outline_of_a_size_is_that_of_its_values(placed):
    """Values that grow with the distance from a point: the outline of a volume is a circle."""
    scene, center = placed
    scene.cursor = center
    index = np.moveaxis(np.indices(SHAPE), 0, -1)
    times = np.linalg.norm(scene.geometry.index_to_world(index) - center, axis=-1).astype(
        np.float32
    )
    drag = SizeDrag(
        "ball:0,0,0,1", np.minimum(times / 14.0, 1.0), (0, 0, 0), scene.geometry.voxel_volume, 1e4
    )
    for name, ((right, sign), (up, turn), across) in HANGS.items():
        tile = scene.slice_tiles[name]
        outline = DragLines()
        for radius, number in ((8.0, tile.index), (6.0, tile.index), (6.0, tile.index + 1)):
            lines = outline.lines(drag, 4.0 / 3.0 * np.pi * radius**3, tile.stack, number)
            circle = np.sqrt(radius**2 - (tile.stack.across(number) - center[across]) ** 2)
            away = np.linalg.norm(lines - [sign * center[right], turn * center[up]], axis=-1)
            assert np.abs(away - circle).max() < 0.35 and len(lines) > 20


def test_slices_in_3d_are_those_of_the_tiles(placed):
    scene, center = placed
    scene.tiles.lay_out("four", chart=False)
    scene.cursor = center
    scene.show_planes(True)
    for name, tile in scene.slice_tiles.items():
        mesh, grey = tile.in_space()
        np.testing.assert_allclose(
            np.asarray(mesh.points)[:, HANGS[name][2]], tile.across, atol=1e-4
        )
        assert grey.shape == tile.stack.size() and grey.max() > 200
    straight = scene.screenshot()
    scene.straighten(False)
    assert (scene.screenshot() != straight).any()
    scene.straighten(True)
    assert (scene.screenshot() == straight).all()


# ------------------------------------------------------------------------------------------------------ what is done


@pytest.fixture
def actions():
    volume, center = scan()
    rough = volume.with_array(
        volume.array + np.random.default_rng(3).normal(0, 4, SHAPE).astype(np.float32)
    )
    scene = Scene(rough, size=SIZE)
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    with Session(rough, RunConfig(start=start, threads=1, max_steps=60), name="ball") as session:
        session.ready.result(60)
        made = Actions(session, scene)
        made.request("layout", "slices")
        made.request("chart", False)
        made.request("cursor", *center)
        wait_until_idle(made)
        scene.screenshot()
        yield made, center
    scene.close()


def drag(actions, name, *worlds):
    parts = [
        (x / SIZE[0], 1.0 - y / SIZE[1])
        for x, y in (pixel_of(actions.scene, name, world) for world in worlds)
    ]
    actions.request("press", *parts[0])
    for part in parts[1:]:
        actions.request("move", *part)


@pytest.mark.parametrize("name", list(HANGS))
def test_a_stroke_marks_the_voxels_under_the_brush(actions, name):
    """Coloured are the pixels in voxels of the click, all of them; and that is a band as wide as the brush."""
    actions, center = actions
    scene = actions.scene
    tile = scene.slice_tiles[name]
    (right, sign), (up, turn), across = HANGS[name]
    start, end = center.copy(), center.copy()
    end[right] += 7.0
    end[up] += 4.0
    start[across] = end[across] = tile.across
    actions.request("radius", 2.5)
    actions.request("tool", "inside")
    drag(actions, name, start, 0.5 * (start + end), end)
    strokes = scene.marks
    drawn = {
        key: layer.sides > 0 for key, layer in zip(scene.slice_tiles, strokes.layers, strict=True)
    }
    actions.request("release")
    wait_until_idle(actions)
    given = [
        text for correction in actions.session.status.refinements for text in correction.inside
    ]
    assert len(given) == 1 and given[0].startswith("path:"), actions.message
    (click,) = read_clicks(tuple(given), "inside", scene.volume)
    named = np.zeros(SHAPE, bool)
    named[click.box] = click.mask
    for key, rows in drawn.items():
        stack = scene.slice_tiles[key].stack
        patch = stack.patch(scene.slice_tiles[key].index, fine=stack.fine)
        index = np.stack(np.broadcast_arrays(*patch.places), axis=-1)
        at = np.rint(index).astype(int)
        inside = ((at >= 0) & (at < SHAPE)).all(axis=-1)
        want = np.zeros(rows.shape, bool)
        want[inside] = named[tuple(at[inside].T)]
        np.testing.assert_array_equal(rows, want)
    # By the world alone: the pixel's distance from the line, give or take half the diagonal of a voxel.
    stack = tile.stack
    left, _, bottom, _ = stack.extent
    rows, columns = np.nonzero(drawn[name])
    places = (
        np.array([left, bottom])
        + (np.stack([columns, rows], axis=-1) + 0.5) * np.array(stack.pitch) / stack.fine
    )
    line = [np.array([sign * one[right], turn * one[up]]) for one in (start, end)]
    way = line[1] - line[0]
    share = np.clip((places - line[0]) @ way / (way @ way), 0.0, 1.0)
    away = np.linalg.norm(places - line[0] - share[:, None] * way, axis=-1)
    half = 0.5 * np.linalg.norm(SPACING)
    assert away.max() < 2.5 + half and len(away) > 100
    area = len(away) * np.prod(stack.pitch) / stack.fine**2
    assert area == pytest.approx(np.pi * 2.5**2 + 5.0 * np.linalg.norm(way), rel=0.15)


def test_the_read_out_is_of_the_voxel_under_the_mouse_and_can_be_copied(actions):
    actions, center = actions
    world = center + [6.0, -2.0, 0.0]
    world[2] = actions.scene.slice_tiles["axial"].across
    x, y = pixel_of(actions.scene, "axial", world)
    actions.request("hover", x / SIZE[0], 1.0 - y / SIZE[1])
    said = actions.state()
    voxel = np.rint(actions.scene.geometry.world_to_index(world)).astype(int)
    assert said["voxel"] == ", ".join(str(v) for v in voxel[::-1])
    assert float(said["value"]) == pytest.approx(actions.scene.volume.array[tuple(voxel)], rel=1e-5)
    assert [float(v) for v in said["as_point"].removeprefix("point:").split(",")] == pytest.approx(
        world, abs=0.06
    )


def test_sliders_scroll_and_switch(actions):
    actions, center = actions
    scene, said = actions.scene, actions.state()
    assert said["straight"] and said["is_oblique"]
    assert said["slices"] == {
        name: [tile.index + 1, tile.stack.count] for name, tile in scene.slice_tiles.items()
    }
    for name, tile in scene.slice_tiles.items():
        for number in (1, tile.stack.count, tile.stack.count // 2):
            actions.request("slice", name, number)
            assert actions.state()["slices"][name][0] == number and not actions.message
        x, y = pixel_of(scene, name, scene.cursor)
        before = scene.cursor
        actions.request("scroll", x / SIZE[0], 1.0 - y / SIZE[1], 1)
        moved = scene.cursor - before
        across = HANGS[name][2]
        assert moved[across] > 0 and np.abs(np.delete(moved, across)).max() < 1e-6
    actions.request("key", "2")
    assert not actions.state()["straight"] and not actions.message
    assert all(tile.stack.count == SHAPE[tile.stack.axis] for tile in scene.slice_tiles.values())
    actions.request("straight", True)
    assert actions.state()["straight"]


def test_the_switch_is_refused_where_it_does_nothing(scene_of):
    volume, center = scan(np.eye(3))
    scene = scene_of(volume)
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    with Session(volume, RunConfig(start=start, threads=1), name="ball") as session:
        session.ready.result(60)
        made = Actions(session, scene)
        made.request("straight", True)
        assert made.message.startswith("straight: ") and not made.state()["straight"]
        assert not made.state()["is_oblique"]
