"""What of the slices and of the list of objects only a hand can show, in the window: mouse and keys of a screen."""

import time

import matplotlib.image
import numpy as np
import pytest

from tests.support import viewing
from tests.viewer.test_desktop import Person, at_left_ball, needs_screen, scan, screen

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
__all__ = ["scan", "screen"]


@pytest.fixture
def person(screen, scan, tmp_path):
    made = Person(screen, scan, tmp_path, start="ball:24,24,20,6")
    yield made
    made.end()


def pressed(person, name):
    """Click on a control of the panels, which are scrolled until it is in sight."""
    x, y, *_ = person.reach(lambda now: now["buttons"][name])
    person.do("mousemove", str(x), str(y), "click", "1")


def place_at(person, x, y):
    """What is read out at a pixel: x, y, z in mm."""
    person.do(
        "mousemove", str(x + 9), str(y), "sleep", "0.2", "mousemove", str(x), str(y), "sleep", "0.2"
    )
    return np.array(
        [float(part) for part in person.at_rest(lambda now: now["state"]["place"]).split(",")]
    )


def crop(person, folder, name):
    """The picture of the slices and the surface, once nothing changes any more; the mouse is elsewhere."""
    person.do("mousemove", "700", "690")
    time.sleep(1.2)
    person.picture(folder / f"{name}.png")
    return matplotlib.image.imread(folder / f"{name}.png")[40:640, :950, :3]


@needs_screen
def test_grey_values_by_drag_scroll_and_list(person):
    x, y = person.now()["tiles"]["axial"]
    before = person.now()["state"]
    person.do(
        "mousemove",
        str(x),
        str(y),
        "mousedown",
        "3",
        "sleep",
        "0.1",
        "mousemove",
        str(x + 60),
        str(y - 40),
    )
    person.do("sleep", "0.2", "mouseup", "3")
    now = person.until(lambda now: now["state"]["window_word"] == "")["state"]
    assert now["width"] > 1.05 * before["width"] and now["level"] > before["level"]
    # The list of windows, by click and the first letter.
    pressed(person, "grey values")
    person.key("b", "Return")
    now = person.until(lambda now: now["state"]["window_word"] == "bone")["state"]
    assert (now["level"], now["width"]) == (500.0, 2000.0)
    # The wheel over the number scrolls the panels: it is no dial.
    at = person.reach(lambda now: now["buttons"]["level"])
    person.do("mousemove", *map(str, at), "click", "4")
    person.until(lambda now: now["buttons"]["level"] != list(at))
    assert person.now()["state"]["level"] == 500.0
    person.do("mousemove", str(x), str(y))
    person.key("a")
    person.until(lambda now: now["state"]["window_word"] == "auto" and now["state"]["width"] < 400)
    person.leave()


@needs_screen
def test_zoom_pan_layouts_and_copied_places(person):
    x, y = person.now()["tiles"]["axial"]
    middle, beside = place_at(person, x, y), place_at(person, x + 40, y)
    person.do(
        "mousemove", str(x), str(y), "keydown", "ctrl", "click", "4", "click", "4", "keyup", "ctrl"
    )
    zoomed = place_at(person, x + 40, y)
    factor = np.linalg.norm(beside - middle) / np.linalg.norm(zoomed - place_at(person, x, y))
    assert factor > 1.1 and place_at(person, x, y) == pytest.approx(middle, abs=0.1)
    # Moved by shift and drag, and by the middle button, the image follows the hand.
    person.do(
        "mousemove",
        str(x),
        str(y),
        "keydown",
        "shift",
        "mousedown",
        "1",
        "mousemove",
        str(x + 20),
        str(y),
    )
    person.do(
        "sleep",
        "0.2",
        "mousemove",
        str(x + 40),
        str(y),
        "sleep",
        "0.2",
        "mouseup",
        "1",
        "keyup",
        "shift",
    )
    assert place_at(person, x + 40, y) == pytest.approx(middle, abs=0.1)
    person.do(
        "mousemove",
        str(x + 40),
        str(y),
        "mousedown",
        "2",
        "mousemove",
        str(x + 20),
        str(y),
        "sleep",
        "0.2",
    )
    person.do("mousemove", str(x), str(y), "sleep", "0.2", "mouseup", "2")
    assert place_at(person, x, y) == pytest.approx(middle, abs=0.1)
    person.key("ctrl+c")
    point = person.until(lambda now: now["clipboard"].startswith("point:"))["clipboard"]
    person.key("ctrl+shift+c")
    ball = person.until(lambda now: now["clipboard"].startswith("ball:"))["clipboard"]
    place = [float(part) for part in point.removeprefix("point:").split(",")]
    assert place == pytest.approx(middle, abs=0.1) and ball.startswith(
        point.replace("point", "ball") + ","
    )
    person.key("r")
    assert place_at(person, x + 40, y) == pytest.approx(beside, abs=0.1)
    # Layouts: by the list, by W, one tile alone by a double click and by 1, the chart by E, voxels by M.
    assert (person.now()["state"]["layout"], person.now()["state"]["chart"]) == ("one", False)
    person.key("e")
    person.until(lambda now: now["state"]["chart"])
    pressed(person, "layout")
    person.key("s", "Return")
    person.until(lambda now: now["state"]["layout"] == "slices" and "space" not in now["tiles"])
    x, y = person.now()["tiles"]["coronal"]
    person.do("mousemove", str(x), str(y), "click", "--repeat", "2", "--delay", "60", "1")
    person.until(
        lambda now: now["state"]["layout"] == "single" and list(now["tiles"]) == ["coronal"]
    )
    person.key("1")
    person.until(lambda now: now["state"]["layout"] == "slices")
    person.key("w", "w", "m")
    person.until(lambda now: now["state"]["layout"] == "one" and not now["state"]["interpolate"])
    person.leave()


@needs_screen
def test_objects_are_merged_split_removed_and_undone_without_a_trace(screen, tmp_path):
    z, y, x = np.indices((24, 40, 64))
    balls = (z - 12) ** 2 + (y - 20) ** 2 + np.minimum(abs(x - 16), abs(x - 48)) ** 2 < 10**2
    person, _ = at_left_ball(
        screen, tmp_path, 100.0 * balls + np.random.default_rng(0).normal(0, 6, balls.shape)
    )
    try:
        person.key("space")
        person.until(lambda now: now["stop"] and not now["playing"], 120)
        at_x, at_y = person.now()["tiles"]["axial"]
        left, right = place_at(person, at_x - 40, at_y)[0], place_at(person, at_x + 40, at_y)[0]
        mm = (right - left) / 80
        other = at_x - 40 + round((48 - left) / mm)
        first = crop(person, tmp_path, "one")
        pressed(person, "object_add")
        person.until(lambda now: now["state"]["tool"] == "size")
        person.drag((other, at_y), (other + 5 / mm, at_y), (other + 10 / mm, at_y))
        rows = person.until(lambda now: len(state_when_idle(now)) == 2, 120)["state"]["object_rows"]
        person.key("v")
        two = crop(person, tmp_path, "two")
        assert (two != first).any()
        x, y, width = person.reach(lambda now: now["buttons"]["opacity"])
        person.drag((x + width - 7, y), (x + width * 0.7, y), (x + width * 0.5, y))
        person.until(lambda now: 0.4 < opacity(now) < 0.6)
        person.drag((x + width * 0.5, y), (x + width * 0.8, y), (x + width + 20, y))
        person.until(lambda now: opacity(now) == 1.0)
        # Both rows are selected and become one; the part under a click is an object of its own again.
        person.click("object 0")
        x, y = person.now()["buttons"]["object 1"]
        person.do("keydown", "ctrl", "mousemove", str(x), str(y), "click", "1", "keyup", "ctrl")
        pressed(person, "object_merge")
        merged = person.until(lambda now: len(state_when_idle(now)) == 1)["state"]["object_rows"]
        assert viewing.ml(merged[0]) == pytest.approx(
            sum(viewing.ml(row) for row in rows), rel=0.02
        )
        person.key("q")
        person.until(lambda now: now["state"]["tool"] == "split")
        person.drag((other, at_y))
        split = person.until(lambda now: len(state_when_idle(now)) == 2)["state"]["object_rows"]
        assert [viewing.ml(row) for row in split] == pytest.approx(
            [viewing.ml(row) for row in rows], rel=0.02
        )
        person.click("object 1")
        person.until(lambda now: now["state"]["object_active"] == split[1]["id"])
        pressed(person, "object_remove")
        person.until(lambda now: len(state_when_idle(now)) == 1)
        # Each was one change; when all are undone, what is drawn is what was drawn then.
        for count in (2, 1, 2):
            person.key("ctrl+z")
            person.until(lambda now, count=count: len(state_when_idle(now)) == count)
        person.key("v")
        assert np.abs(crop(person, tmp_path, "again") - two).max() < 0.05
        person.leave()
    finally:
        person.end()


@needs_screen
def test_the_colour_dialog_is_opened_and_used(person, tmp_path):
    def asked():
        """Double click on the colour of the first object; what the dialog has."""
        x, y = person.reach(lambda now: now["buttons"]["color 0"])
        person.do("mousemove", str(x), str(y), "click", "--repeat", "2", "--delay", "60", "1")
        shown = person.until(lambda now: now["dialog"].get("code"))["dialog"]
        assert shown["title"] == "Colour of the object"
        person.do(
            "search", "--sync", "--onlyvisible", "--name", shown["title"], "windowfocus", "--sync"
        )
        return person.until(lambda now: now["dialog"] == shown)["dialog"]

    def pixels(name, code):
        """How many pixels of slices and surface have a colour."""
        rgb = np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        return int((np.abs(crop(person, tmp_path, name) - rgb).max(axis=2) < 0.06).sum())

    def typed(code):
        ((x, y),) = asked()["code"]
        person.do(
            "mousemove",
            str(x),
            str(y),
            "click",
            "--repeat",
            "3",
            "--delay",
            "60",
            "1",
            "type",
            code,
        )

    before = person.now()["state"]["object_rows"][0]["color"]
    assert pixels("before", "#cc33aa") == 0 and pixels("own", before) > 40
    typed("#cc33aa")
    x, y = person.now()["dialog"]["OK"]
    person.do("mousemove", str(x), str(y), "click", "1")
    person.until(
        lambda now: not now["dialog"] and now["state"]["object_rows"][0]["color"] == "#cc33aa"
    )
    assert pixels("after", "#cc33aa") > 40 and pixels("own", before) == 0
    # What the dialog is closed over is not taken.
    typed("#00ff00")
    person.key("Escape")
    person.until(lambda now: not now["dialog"])
    assert person.now()["state"]["object_rows"][0]["color"] == "#cc33aa"
    person.do(
        "search", "--sync", "--onlyvisible", "--name", "accelsurf - scan", "windowfocus", "--sync"
    )
    person.leave()


def opacity(now):
    """The smallest of all objects."""
    return min(row["opacity"] for row in now["state"]["object_rows"])


def state_when_idle(now):
    """The rows of the objects, once nothing is under way."""
    rows = now["state"]["object_rows"]
    return [] if now["playing"] or any(row["word"] != "converged" for row in rows) else rows
