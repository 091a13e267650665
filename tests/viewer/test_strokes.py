"""Strokes by actions: drawn at once, until the surface obeys; one stroke is one change and one click."""

import numpy as np
import pytest

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.image.volume import Volume
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import read_clicks
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.colors import INSIDE, OUTSIDE
from tests.support.steering import views
from tests.viewer.test_corrections import CONFIGS, SHAPE, SPACING, ended, scan, until


@pytest.fixture(scope="module")
def image():
    return scan()


@pytest.fixture
def actions(image, scene_of):
    scene = scene_of(image, size=(960, 544))
    with Session(image, CONFIGS["seeded"]) as session:
        ended(session)
        made = Actions(session, scene)
        shown(made)
        yield made


def shown(actions):
    """What the session has, drawn."""
    for view in views(actions.session):
        actions.update(view)
    actions.collect_results()
    actions.scene.render()
    return actions


def place_of(actions, tile, world):
    """Parts of the width and of the height from the top, of a point in a slice."""
    scene = actions.scene
    width, height = scene.plotter.render_window.GetSize()
    renderer = scene.tiles.renderer(tile)
    if tile == "space":
        renderer.SetWorldPoint(*world, 1.0)
        renderer.WorldToDisplay()
        x, y, _ = renderer.GetDisplayPoint()
    else:
        one = scene.slice_tiles[tile]
        right, up = one.to_tile(scene.geometry.world_to_index(np.asarray(world)))
        low, high = np.array(one.to_plane(0.0, 0.0)), np.array(one.to_plane(1.0, 1.0))
        share = (np.array([right, up]) - low) / (high - low)
        left, bottom, far, top = renderer.GetViewport()
        x, y = (
            width * (left + share[0] * (far - left)),
            height * (bottom + share[1] * (top - bottom)),
        )
    return x / width, 1.0 - y / height


def drag(actions, tile, *worlds):
    """Press at the first place, move over the others; the button stays down."""
    actions.request("press", *place_of(actions, tile, worlds[0]))
    for world in worlds[1:]:
        actions.request("move", *place_of(actions, tile, world))
    assert not actions.message


def pixels(actions, color, tile="axial"):
    """How many pixels of a tile are nearer to a translucent colour than to grey."""
    picture = actions.scene.screenshot().astype(float)
    height, width = picture.shape[:2]
    left, bottom, right, top = actions.scene.tiles.renderer(tile).GetViewport()
    part = picture[
        round(height * (1 - top)) : round(height * (1 - bottom)),
        round(width * left) : round(width * right),
    ]
    red, green, blue = (part[..., channel] for channel in range(3))
    if color == INSIDE:
        return int(((green > red + 40) & (green > blue + 15)).sum())
    return int(((red > green + 40) & (red > blue + 60)).sum())


@pytest.mark.parametrize(
    ("tool", "color"),
    [("inside", INSIDE), ("outside", OUTSIDE)],
)
def test_a_stroke_is_drawn_as_it_is_painted_and_until_the_surface_obeys(actions, tool, color):
    actions.request("cursor", 9.0, 8.0, 9.0)
    actions.request("radius", 1.6)
    actions.request("tool", tool)
    before = pixels(actions, color)
    x = (11.0, 15.0) if tool == "inside" else (5.0, 7.0)
    drag(actions, "axial", (x[0], 8.0, 9.0))
    first = pixels(actions, color)
    assert first > before + 50
    for part in np.linspace(x[0], x[1], 6)[1:]:
        actions.request("move", *place_of(actions, "axial", (part, 8.0, 9.0)))
    drawn = pixels(actions, color)
    assert drawn > first + 50 and actions.session.status.changes == ()
    actions.request("release")
    assert pixels(actions, color) == drawn and actions.scene.marks.count == 1
    assert actions.session.wait(60)
    shown(actions)
    assert actions.scene.marks.count == 0 and pixels(actions, color) < drawn
    assert actions.session.status.undoable == 1


def test_what_is_painted_is_what_is_clicked(actions):
    """The voxels drawn in each slice are those of the click that the session stores."""
    actions.request("cursor", 9.0, 8.0, 9.0)
    actions.request("radius", 2.0)
    actions.request("tool", "inside")
    drag(actions, "axial", (9.0, 8.0, 9.0), (12.0, 9.0, 9.0), (16.0, 11.0, 9.0))
    strokes = actions.scene.marks
    drawn = {}
    for z in range(SHAPE[0]):
        actions.scene.cursor = (9.0, 8.0, z * SPACING[0])
        layer = next(one for one in strokes.layers if one.tile.stack.axis == 0)
        drawn[z] = layer.sides[::-1] > 0  # the first row lies lowest, at the back
    actions.request("release")
    assert actions.session.wait(60)
    (refinement,) = actions.session.status.refinements
    assert len(refinement.inside) == 1 and refinement.inside[0].startswith("path:")
    (click,) = read_clicks(refinement.inside, "inside", actions.session.volume)
    want = np.zeros(SHAPE, bool)
    want[click.box] = click.mask
    for z, rows in drawn.items():
        np.testing.assert_array_equal(rows, want[z])
    assert want.sum() > 60


@pytest.mark.parametrize(
    ("radius", "places", "text"),
    [
        (0.5, [(21.0, 8.0, 9.0)], "point:"),
        (1.5, [(21.0, 8.0, 9.0)], "ball:"),
        (1.5, [(21.0, 8.0, 9.0), (25.0, 8.0, 9.0)], "path:"),
        (0.5, [(21.0, 8.0, 9.0), (25.0, 8.0, 9.0)], "path:"),
    ],
)
def test_a_click_is_a_point_a_ball_or_a_path(actions, radius, places, text):
    actions.request("cursor", *places[0])
    actions.request("radius", radius)
    actions.request("tool", "inside")
    drag(actions, "coronal", *places)
    actions.request("release")
    assert actions.session.wait(60)
    (refinement,) = actions.session.status.refinements
    (said,) = refinement.inside
    assert said.startswith(text)
    radii = {part.split(",")[-1] for part in said.split(":")[1].split(";")}
    assert text == "point:" or radii == {"0" if radius == 0.5 else "1.5"}


def test_a_stroke_on_the_surface_says_what_lies_there(actions):
    actions.request("view", "front")
    actions.request("radius", 1.0)
    actions.request("tool", "outside")
    x, y = place_of(actions, "space", (9.0, 8.0, 9.0))
    actions.request("press", x, y)
    for part in (0.004, 0.008, 0.012):
        actions.request("move", x + part, y)
    assert pixels(actions, OUTSIDE, "space") > 30
    actions.request("release")
    assert actions.session.wait(60) and not shown(actions).message
    (refinement,) = actions.session.status.refinements
    (click,) = read_clicks(refinement.outside, "outside", actions.session.volume)
    # Seen from the front, y is least.
    index = np.argwhere(click.mask) + [side.start for side in click.box]
    assert index[:, 1].max() < 8
    result = actions.scene.frame.surfaces[0]
    assert not any(result.contains(tuple(int(i) for i in one)) for one in index)


def test_a_stroke_that_is_refused_is_drawn_no_longer(actions):
    actions.request("cursor", 9.0, 8.0, 9.0)
    actions.request("radius", 12.0)
    actions.request("tool", "outside")
    drag(actions, "axial", (9.0, 8.0, 9.0), (14.0, 8.0, 9.0))
    actions.request("release")
    assert actions.session.wait(60)
    shown(actions)
    assert "nothing would be left" in actions.message and actions.scene.marks.count == 0
    assert actions.session.status.changes == ()


def test_the_slices_go_to_a_start_and_a_press(actions):
    actions.request("cursor", 9.0, 8.0, 9.0)
    actions.request("tool", "ball")
    drag(actions, "axial", (25.0, 7.0, 9.0))
    actions.request("release")
    np.testing.assert_allclose(actions.scene.cursor, (25.0, 7.0, 9.0), atol=0.4)
    assert actions.session.wait(60)
    actions.request("tool", "size")
    drag(actions, "axial", (9.0, 8.0, 9.0))
    np.testing.assert_allclose(actions.scene.cursor, (9.0, 8.0, 9.0), atol=0.4)
    actions.request("release")
    actions.session.wait(60)


def test_keys_of_the_strokes(actions):
    keys = actions.keys
    assert keys["I"].values == ("inside",) and keys["O"].values == ("outside",)
    for key, tool in (("I", "inside"), ("O", "outside")):
        actions.request("key", key)
        assert actions.state()["tool"] == tool
    radius = actions.radius
    actions.request("key", "]")
    assert actions.radius > radius
    actions.request("key", "[")
    assert actions.radius == pytest.approx(radius)


def test_escape_drops_a_stroke_that_is_being_painted(actions):
    actions.request("cursor", 9.0, 8.0, 9.0)
    actions.request("key", "I")
    drag(actions, "axial", (12.0, 8.0, 9.0), (16.0, 8.0, 9.0))
    assert actions.scene.marks.count == 1
    actions.request("key", "Escape")
    assert actions.scene.marks.count == 0 and actions.state()["tool"] == "look"
    actions.request("release")
    assert actions.session.wait(60) and actions.session.status.changes == ()


def test_in_one_slice_too(scene_of):
    y, x = np.indices((40, 50))
    noise = np.random.default_rng(0).normal(0, 5, (1, 40, 50))
    disks = (y - 20) ** 2 + np.minimum(abs(x - 14), abs(x - 36)) ** 2 < 8**2
    volume = Volume.from_array((100.0 * disks[None] + noise).astype(np.float32))
    scene = scene_of(volume, size=(640, 360))
    with Session(volume, RunConfig(inside="ball:14,20,0,3", threads=1)) as session:
        ended(session)
        actions = shown(Actions(session, scene))
        actions.request("radius", 2.0)
        actions.request("tool", "inside")
        drag(actions, "axial", (34.0, 20.0, 0.0), (38.0, 20.0, 0.0))
        assert pixels(actions, INSIDE) > 50
        actions.request("release")
        assert session.wait(60) and not shown(actions).message
        assert session.status.refinements[0].inside[0].startswith("path:")
        assert scene.frame.surfaces[0].contains((0, 20, 36))


def test_the_settings_of_a_painted_session_make_the_same_bytes(actions, image, tmp_path):
    actions.request("radius", 1.5)
    for tool, worlds in (
        ("inside", [(23.0, 8.0, 9.0), (27.0, 8.0, 9.0)]),
        ("outside", [(15.0, 4.0, 9.0), (18.0, 12.0, 9.0)]),
        ("inside", [(20.0, 8.0, 9.0)]),
    ):
        actions.request("cursor", *worlds[0])
        actions.request("tool", tool)
        drag(actions, "axial", *worlds)
        actions.request("release")
    assert actions.session.wait(120) and len(actions.session.status.refinements) == 3
    paths = actions.session.save(tmp_path, ("labels", "run")).result(60)
    labels = io.read_labels(next(path for path in paths if "_seg" in path.name)).array
    again = segment(image, config=RunConfig.from_toml(next(tmp_path.glob("*_run.toml"))))
    assert np.array_equal(again.labels, labels)


def test_the_history_leads_back_and_grey_lines_forward(actions):
    for text in ("ball:25,8,9,1.5", "point:9,8,16.5"):
        actions.session.add_click("inside" if text.startswith("ball") else "outside", text).result(
            60
        )
    state = actions.state()
    assert [(one["number"], one["done"]) for one in state["changes"]] == [(1, True), (2, True)]
    actions.request("change", 0)
    assert actions.session.wait(60)
    assert [one["done"] for one in actions.state()["changes"]] == [False, False]
    actions.request("change", 2)
    assert actions.session.wait(60) and len(actions.session.status.refinements) == 2
    for wrong in (-1, 3, "x", None, [1], float("nan")):
        actions.request("change", wrong)
        actions.session.wait(60)
        actions.collect_results()
        assert "expected a number" in actions.message
        assert len(actions.session.status.refinements) == 2
        actions.message = ""


def test_n_goes_to_the_doubtful_places_one_after_another(scene_of):
    z, y, x = np.indices(SHAPE) * np.array(SPACING)[:, None, None, None]
    bridge = (x > 12) & (x < 22) & (abs(y - 8) < 3)
    image = scan()
    image = image.with_array((image.array + 90.0 * bridge).clip(None, 100).astype(np.float32))
    scene = scene_of(image, size=(960, 544))
    with Session(image, CONFIGS["seeded"]) as session:
        actions = Actions(session, scene)
        session.ready.result(60)
        actions.request("key", "N")
        assert "when the run has ended" in actions.message
        ended(session)
        shown(actions)
        until(lambda: session.status.uncertain)
        plain = scene.screenshot()
        state = actions.state()
        assert actions.changed and len(scene.marks.places) == len(state["uncertain"]) > 0
        scene.render()
        for number in range(2 * len(state["uncertain"])):
            actions.request("key", "N")
            want = session.status.uncertain[number % len(state["uncertain"])]
            np.testing.assert_allclose(scene.cursor, want.world, atol=1e-6)
            assert actions.state()["uncertain_at"] == number % len(state["uncertain"]) + 1
        assert (scene.screenshot() != plain).any()
        session.add_click("inside", "ball:25,8,9,1.5").result(60)
        assert actions.state()["uncertain"] == [] and scene.marks.places == ()
