"""Several buttons, several fingers, parts of a notch: what a hand means is done, and nothing stays behind."""

import re

import numpy as np
import pytest

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.mouse import ZOOM, MouseFeature
from accelsurf.viewer.actions.run import HistoryFeature
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.page.page import document
from tests.viewer.test_corrections import CONFIGS, ended, scan
from tests.viewer.test_strokes import drag, place_of, shown

#: Two places in the axial slice, and the tools that paint.
FIRST, SECOND = (11.0, 8.0, 9.0), (25.0, 6.0, 9.0)
PAINTS = ("inside", "outside")


@pytest.fixture(scope="module")
def session():
    with Session(scan(), CONFIGS["seeded"]) as made:
        ended(made)
        yield made


@pytest.fixture
def actions(session, scene_of):
    made = Actions(session, scene_of(session.volume, size=(960, 544)))
    shown(made)
    made.request("cursor", 9.0, 8.0, 9.0)
    made.request("radius", 1.6)
    yield made
    assert session.wait(60)
    session.go_to_change(0).result(60)
    assert session.wait(60)
    if session.status.stop is None:  # a brush has let the run go on from before its end
        ended(session)


def state_when_idle(actions):
    assert actions.session.wait(60)
    shown(actions)
    return actions.session.status


def made(actions):
    """The changes that are in force."""
    return [one.line for one in state_when_idle(actions).changes if one.done]


def axial(actions, world):
    return place_of(actions, "axial", world)


def under(actions, x, y):
    """The place of the image under parts of the width and of the height."""
    width, height = actions.scene.plotter.render_window.GetSize()
    return actions.scene.pick(x * width, (1.0 - y) * height).world


def begin_pinch(actions, first=FIRST, second=SECOND):
    actions.request("touch_down", *axial(actions, first), 7, True)
    actions.request("touch_down", *axial(actions, second), 8, False)


# ------------------------------------------------------------------------------------------------------------ buttons


@pytest.mark.parametrize("tool", PAINTS)
def test_a_second_button_changes_nothing_until_the_first_is_up(actions, tool):
    actions.request("tool", tool)
    window = actions.scene.window
    drag(actions, "axial", FIRST, (13.0, 8.0, 9.0))
    actions.request("press", *axial(actions, FIRST), 2)
    actions.request("move", *axial(actions, (15.0, 8.0, 9.0)))
    actions.request("release", 2)
    assert actions.scene.marks.count == 1 and actions.scene.window == window
    actions.request("move", *axial(actions, (16.0, 8.0, 9.0)))
    actions.request("release", 0)
    assert len(made(actions)) == 1 and actions.scene.marks.count == 0
    assert not actions.message


def test_the_same_button_again_begins_anew_where_its_release_was_lost(actions):
    actions.request("tool", "inside")
    drag(actions, "axial", FIRST, (13.0, 8.0, 9.0))
    drag(actions, "axial", SECOND)
    assert actions.scene.marks.count == 1
    actions.request("release")
    (refinement,) = state_when_idle(actions).refinements
    assert len(refinement.inside) == 1 and refinement.inside[0].startswith("ball:25,")
    assert actions.scene.marks.count == 0


def test_a_key_for_another_tool_ends_a_drag(actions):
    actions.request("tool", "inside")
    drag(actions, "axial", FIRST)
    actions.request("key", "V")
    cursor = actions.scene.cursor
    actions.request("move", *axial(actions, SECOND))  # the button is still down
    assert np.array_equal(actions.scene.cursor, cursor)
    actions.request("release")
    assert made(actions) == [] and actions.scene.marks.count == 0


# ------------------------------------------------------------------------------------------------------------ fingers


@pytest.mark.parametrize("tool", PAINTS)
def test_two_touches_paint_nothing_and_leave_no_mark(actions, tool):
    actions.request("tool", tool)
    first, second = axial(actions, FIRST), axial(actions, SECOND)
    actions.request("touch_down", *first, 7, True)
    actions.request("touch_move", first[0] + 0.004, first[1], 7)
    assert actions.scene.marks.count == 1
    actions.request("touch_down", *second, 8, False)
    assert actions.scene.marks.count == 0
    for step in range(4):
        actions.request("touch_move", first[0] + 0.004 * step, first[1], 7)
        actions.request("touch_move", second[0] - 0.004 * step, second[1], 8)
    actions.request("touch_up", 7)
    actions.request("touch_move", first[0], first[1], 8)  # the last of two is no stroke
    actions.request("touch_up", 8)
    assert made(actions) == [] and actions.scene.marks.count == 0
    assert not actions.message and not actions.feature(MouseFeature).is_dragging


def test_one_touch_is_the_left_button(actions):
    actions.request("tool", "inside")
    for number in (3, 4):  # the second time a browser has another number for it
        actions.request("touch_down", *axial(actions, FIRST), number, True)
        actions.request("touch_move", *axial(actions, (13.0, 8.0, 9.0)), number)
        actions.request("touch_up", number)
        assert len(state_when_idle(actions).refinements) == number - 2 and not actions.message
    assert state_when_idle(actions).refinements[0].inside[0].startswith("path:")


def test_what_is_under_two_touches_stays_under_them(actions):
    """They move and spread at once: zoom and shift follow from where the two were and are."""
    actions.request("tool", "look")
    cursor = actions.scene.cursor
    begin_pinch(actions)
    assert np.allclose(
        actions.scene.cursor, cursor
    )  # the first finger has moved the slices: it was not meant
    (x, y), (far_x, far_y) = axial(actions, FIRST), axial(actions, SECOND)
    before = [under(actions, x, y), under(actions, far_x, far_y)]
    scale, beside = (
        actions.scene.slice_tiles[name].mm_per_pixel() for name in ("axial", "coronal")
    )
    # Spread by a fifth along the line between them, and moved: the two of a step one after another.
    right, down = 0.1 * (far_x - x), 0.1 * (far_y - y)
    for _ in range(2):
        x, y, far_x, far_y = (
            x - right + 0.004,
            y - down - 0.006,
            far_x + right + 0.004,
            far_y + down - 0.006,
        )
        actions.request("touch_move", x, y, 7)
        actions.request("touch_move", far_x, far_y, 8)
    after = [under(actions, x, y), under(actions, far_x, far_y)]
    np.testing.assert_allclose(after, before, atol=1e-3)  # tiles have whole pixels
    assert scale / actions.scene.slice_tiles["axial"].mm_per_pixel() == pytest.approx(1.4, rel=1e-6)
    assert actions.scene.slice_tiles["coronal"].mm_per_pixel() == beside
    actions.request("touch_up", 8)
    actions.request("touch_up", 7)
    assert (
        np.allclose(actions.scene.cursor, cursor) and not actions.feature(MouseFeature).is_dragging
    )


def test_two_touches_in_3d_zoom_about_their_middle(actions):
    actions.request("view", "front")
    x, y = place_of(actions, "space", (14.0, 8.0, 9.0))
    actions.request("touch_down", x - 0.05, y, 7, True)
    actions.request("touch_down", x + 0.05, y, 8)
    scale = actions.scene.tiles.tile("space").mm_per_pixel()
    for step in (0.06, 0.07, 0.08):
        actions.request("touch_move", x - step, y, 7)
        actions.request("touch_move", x + step, y, 8)
    assert scale / actions.scene.tiles.tile("space").mm_per_pixel() == pytest.approx(1.6, rel=1e-6)
    assert place_of(actions, "space", (14.0, 8.0, 9.0)) == pytest.approx((x, y), abs=2e-3)


def test_a_second_touch_takes_back_what_the_first_has_placed(actions):
    """Each tool: nothing is changed by the beginning of a pinch, what was there before stays."""
    for name in actions.tools:
        actions.request("tool", name)
        for first in (FIRST, SECOND, (17.0, 8.0, 9.0)):  # at its ends, and beside it
            begin_pinch(actions, first, (29.0, 8.0, 9.0))
            actions.request("touch_up", 8)
            actions.request("touch_up", 7)
        assert made(actions) == [] and not actions.message, name


def test_touches_that_were_lost_and_hands_beside_a_pen(actions):
    actions.request("tool", "inside")
    actions.request("touch_down", *axial(actions, SECOND), 1, True)  # its end is never heard of
    actions.request("touch_down", *axial(actions, FIRST), 2, True)
    actions.request("touch_cancel", 2)
    assert made(actions) == [] and actions.scene.marks.count == 0
    actions.request("touch_down", *axial(actions, SECOND), 3, True)
    drag(actions, "axial", FIRST)  # a pen, after the hand that holds it
    actions.request("touch_move", *axial(actions, (27.0, 8.0, 9.0)), 3)
    actions.request("touch_down", *axial(actions, SECOND), 4)
    actions.request("touch_up", 3)
    actions.request("touch_up", 4)
    actions.request("touch_down", *axial(actions, SECOND), 5, True)
    actions.request("touch_move", *axial(actions, (27.0, 8.0, 9.0)), 5)
    actions.request("touch_up", 5)
    assert actions.scene.marks.count == 1
    actions.request("release")
    (refinement,) = state_when_idle(actions).refinements
    assert refinement.inside[0].startswith("ball:11,") and actions.scene.marks.count == 0


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "bad", [None, True, "x", float("nan"), float("inf"), 1e308, [], {}, -0.1, 1.1, 2**40]
)
def test_what_is_no_touch_is_refused(actions, bad):
    actions.request("tool", "inside")
    for name, values in (
        ("touch_down", (bad, 0.5, 1, True)),
        ("touch_down", (0.5, bad, 1, True)),
        ("touch_move", (bad, 0.5, 1)),
        ("scroll_delta", (bad, 0.5, 100, 0)),
        ("press", (bad, 0.5)),
        ("release", (bad,)),
        ("touch_up", (bad,)),
    ):
        if name in ("release", "touch_up") and (
            bad is None or isinstance(bad, float) and abs(bad) < 2
        ):
            continue  # the button that is down, and numbers that a button or a finger may have
        actions.message = ""
        actions.request(name, *values)
        assert "was given, expected a number" in actions.message, name
        assert not actions.feature(MouseFeature).is_dragging
    for number in range(50):
        actions.request("touch_down", 0.5, 0.5, number)
    actions.request("touch_cancel")
    assert made(actions) == [] and not actions.feature(MouseFeature).is_dragging


# -------------------------------------------------------------------------------------------------------------- wheel


def at_middle(actions):
    return axial(actions, (17.0, 8.0, 9.0))


def test_parts_of_a_notch_add_up_to_a_slice(actions):
    tile, at = actions.scene.slice_tiles["axial"], at_middle(actions)
    before = tile.index
    for _ in range(9):
        actions.request("scroll", *at, 0.1)
        assert tile.index == before
    actions.request("scroll", *at, 0.1)
    assert abs(tile.index - before) == 1
    for _ in range(3):
        actions.request("scroll", *at, 0.3)
    actions.request("scroll", *at, -0.3)  # back: nothing is left of it
    for _ in range(2):
        actions.request("scroll", *at, -0.3)
    assert abs(tile.index - before) == 1
    actions.request("scroll", *at, -0.3)
    assert tile.index == before
    actions.request("scroll", *at, 2)
    assert abs(tile.index - before) == 2
    actions.request("scroll", *at, 0)
    assert abs(tile.index - before) == 2 and not actions.message


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("delta", "mode", "slices"),
    [
        (-100, 0, 1),
        (-120, 0, 1),
        (-53, 0, 1),
        (-240, 0, 2),
        (-3, 1, 1),
        (-1, 2, 1),
        (100, 0, -1),
        (0, 0, 0),
        (-20, 0, 0),
    ],
)
def test_a_notch_of_any_browser_is_a_slice(actions, delta, mode, slices):
    tile, at = actions.scene.slice_tiles["axial"], at_middle(actions)
    actions.request("scroll", *at, 1)
    middle = tile.index
    actions.request("scroll", *at, -1)
    one, before = middle - tile.index, tile.index
    actions.request("scroll_delta", *at, delta, mode, False)
    assert tile.index - before == slices * one and not actions.message


def test_a_pinch_on_a_trackpad_zooms_as_far_as_the_touches_part(actions):
    tile, at = actions.scene.slice_tiles["axial"], at_middle(actions)
    scale = tile.mm_per_pixel()
    for _ in range(20):  # a browser reports 100 times the logarithm of how far they have spread
        actions.request("scroll_delta", *at, -100 * np.log(2.0) / 20, 0, True)
    assert scale / tile.mm_per_pixel() == pytest.approx(2.0, rel=1e-6)
    actions.request("scroll_delta", *at, 0.0, 0, True)
    assert scale / tile.mm_per_pixel() == pytest.approx(2.0, rel=1e-6)
    actions.request("scroll_delta", *at, -100, 0, True)  # a notch of a mouse
    assert scale / tile.mm_per_pixel() == pytest.approx(2.0 * ZOOM, rel=1e-6)
    for bad in (None, "x", float("nan"), float("inf"), 1e9, True):
        actions.request("scroll_delta", *at, bad, 0, True)
        assert "was given" in actions.message
        actions.request("scroll_delta", *at, 1, bad, True)
        assert "was given" in actions.message
    assert scale / tile.mm_per_pixel() == pytest.approx(2.0 * ZOOM, rel=1e-6)


# ------------------------------------------------------------------------------------------------------ other defects


def test_a_key_shows_the_tile_under_the_mouse_alone_with_any_tool(actions):
    tiles = actions.scene.tiles
    layout = tiles.layout
    for tool in ("inside", "look"):
        actions.request("tool", tool)
        actions.request("hover", *place_of(actions, "coronal", (17.0, 8.0, 9.0)))
        actions.request("key", "1")
        assert (tiles.layout, tiles.large) == ("single", "coronal")
        actions.request("hover", 0.01, 0.01)
        actions.request("key", "1")
        assert tiles.layout == layout and not actions.message


def test_whatever_page_and_picture_ask_for_can_be_asked(actions):
    text = document(("head", "tools", "slices"))
    drawn = text.partition("<main>")[2].partition('aria-label="panels"')[0]
    sent = set(re.findall(r"\['([a-z_]+)', ", drawn)) | {"copy_failed", "cancel"}
    assert {"touch_down", "scroll_delta", "press"} <= sent <= set(actions.names)
    actions.request("copy_point")
    assert "copied point:" in actions.state()["message"]
    actions.request("copy_failed")
    assert "no clipboard" in actions.state()["message"] and actions.state()["failed"]


def test_steps_of_plateaus_reach_the_page_and_can_be_gone_to(actions):
    status = actions.session.status._replace(plateaus=(3, 7))
    assert actions.feature(HistoryFeature).state(status)["rests"] == [3, 7]
    for step in (7, 3):
        actions.request("go_to", step)
        assert state_when_idle(actions).step == step and not actions.message
