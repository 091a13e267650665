"""Slices and objects in the page, by the mouse and the controls of a real browser."""

import re
from contextlib import contextmanager

import numpy as np
import pytest

from accelsurf import Volume
from tests.support import viewing
from tests.viewer.test_browser import Served, driven, state, until

pytest.importorskip("trame", reason='trame is missing: pip install "accelsurf[viewer]"')
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


@contextmanager
def opened(served, folder):
    """A browser with the page, once its picture is drawn and the run waits."""
    with driven(folder) as made:
        made.get(served.address)
        wide = "return (document.getElementById('picture') || {naturalWidth: 0}).naturalWidth > 400"
        until(lambda: made.execute_script(wide))
        until(lambda: made.find_element("id", "state").text == "paused")
        yield made


@pytest.fixture
def browser(served, tmp_path):
    with opened(served, tmp_path) as made:
        yield made


class Hand:
    """A mouse over the picture; places are pixels from its middle."""

    def __init__(self, browser):
        self.browser, self.picture = browser, browser.find_element("id", "picture")

    def drag(self, start, way, button):
        from selenium.webdriver.common.actions.action_builder import ActionBuilder

        made = ActionBuilder(self.browser)
        mouse = made.pointer_action
        mouse.move_to(self.picture, *start).pointer_down(button=button).pause(0.2)
        mouse.move_to(self.picture, start[0] + way[0] // 2, start[1] + way[1] // 2).pause(0.2)
        mouse.move_to(self.picture, start[0] + way[0], start[1] + way[1]).pause(0.2).pointer_up(
            button=button
        )
        made.perform()

    def at(self, place):
        """What is read out at a place: x, y, z in mm."""
        from selenium.webdriver import ActionChains

        chain = ActionChains(self.browser).move_to_element_with_offset(
            self.picture, place[0] + 5, place[1]
        )
        chain.pause(0.3).move_to_element_with_offset(self.picture, *place).pause(0.5).perform()
        words = self.browser.find_element("css selector", "#read-out span").text
        return [float(word) for word in words.removesuffix(" mm").split(",")]


def test_grey_values_zoom_pan_and_layouts_in_the_page(served, browser):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
    from selenium.webdriver.common.keys import Keys

    said, hand = state(served), Hand(browser)
    assert (said["layout"], said["chart"]) == ("one", False)
    browser.find_element("css selector", "#layout option[value=four]").click()
    until(lambda: state(served)["layout"] == "four")
    width, height = hand.picture.size["width"], hand.picture.size["height"]
    axial = -width // 4, -height // 4
    hand.drag(axial, (60, -30), 2)
    until(
        lambda: (
            (now := state(served))["width"] > 1.05 * said["width"] and now["level"] > said["level"]
        )
    )
    browser.find_element("css selector", "#window option[value=bone]").click()
    until(lambda: (state(served)["level"], state(served)["width"]) == (500, 2000))
    # Zoom with Ctrl and the wheel, around the mouse; the middle button moves what is under it.
    beside = axial[0] + 40, axial[1]
    middle, before = hand.at(axial), hand.at(beside)
    origin = ScrollOrigin.from_element(hand.picture, *axial)
    ActionChains(browser).key_down(Keys.CONTROL).scroll_from_origin(origin, 0, -240).key_up(
        Keys.CONTROL
    ).perform()
    until(lambda: abs(hand.at(beside)[0] - middle[0]) < 0.9 * abs(before[0] - middle[0]))
    assert hand.at(axial) == pytest.approx(middle, abs=0.2)
    hand.drag(axial, (40, 0), 1)
    until(lambda: hand.at(beside) == pytest.approx(middle, abs=0.3))
    browser.find_element("id", "whole").click()
    until(lambda: hand.at(beside) == pytest.approx(before, abs=0.2))
    browser.find_element("id", "tool-look").click()  # with Size a double click is two clicks
    ActionChains(browser).move_to_element_with_offset(hand.picture, *axial).double_click().perform()
    until(lambda: (state(served)["layout"], state(served)["large"]) == ("single", "axial"))
    ActionChains(browser).double_click().perform()
    until(lambda: state(served)["layout"] == "four")
    browser.find_element("css selector", "#layout option[value=slices]").click()
    until(lambda: state(served)["layout"] == "slices")
    browser.find_element("id", "chart").click()
    until(lambda: state(served)["chart"])


def test_the_list_of_objects_in_the_page(served, browser):
    from selenium.webdriver.common.keys import Keys

    def first():
        return state(served)["object_rows"][0]

    browser.find_element("css selector", "#object-1 button.name").click()
    name = until(lambda: browser.find_elements("css selector", "#panel-objects input.text"))[0]
    name.send_keys(Keys.CONTROL, "a")
    name.send_keys("cyst", Keys.TAB)
    until(lambda: first()["name"] == "cyst")
    browser.find_element("css selector", "#object-1 input[type=checkbox]").click()
    until(lambda: not first()["visible"])
    slider = browser.find_element("css selector", "#panel-objects input[type=range]")
    slider.send_keys(Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    until(lambda: first()["opacity"] == pytest.approx(0.9))
    browser.find_element("id", "object-add").click()
    until(lambda: len(state(served)["object_rows"]) == 2 and state(served)["tool"] == "size")
    browser.find_element("id", "object-remove").click()
    until(lambda: len(state(served)["object_rows"]) == 1)


def two_balls():
    """Two balls of one brightness, 16 and 48 mm from the left; the middle of the left one."""
    z, y, x = np.indices((24, 40, 64))
    balls = (z - 12) ** 2 + (y - 20) ** 2 + np.minimum(abs(x - 16), abs(x - 48)) ** 2 < 10**2
    return Volume.from_array(np.float32(100) * balls), np.array([16.0, 20.0, 12.0])


def test_objects_are_merged_split_removed_and_undone_and_a_place_is_copied_in_the_page(tmp_path):
    from selenium.webdriver.common.keys import Keys

    served = Served(tmp_path, scan=two_balls())

    def rows():
        """The objects, once nothing is under way; from the page itself."""
        said = state(served)
        return (
            []
            if said["playing"] or any(one["word"] != "converged" for one in said["object_rows"])
            else [{**one, "ml": viewing.ml(one)} for one in said["object_rows"]]
        )

    def listed():
        """What the page's list says of each object."""
        texts = "return [...document.querySelectorAll('.objects .ml')].map(one => one.textContent)"
        shown = [
            words
            for words in browser.execute_script(texts)
            if re.fullmatch(r"[\d.]+ (ml|mm3)", words)
        ]
        return [viewing.ml({"volume": words}) for words in shown]

    def count_is(count, total=None):
        """The objects, once there are so many, and the picture shows their volumes, ml together."""

        def is_seen(found):
            return len(found) == count and (
                total is None or sum(one["ml"] for one in found) == pytest.approx(total, rel=0.01)
            )

        found = until(lambda: is_seen(found := rows()) and found, 120)
        until(lambda: listed() == [one["ml"] for one in found])
        return found

    try:
        with opened(served, tmp_path) as browser:
            hand = Hand(browser)
            browser.find_element("css selector", "#layout option[value=four]").click()
            until(lambda: state(served)["layout"] == "four")
            axial = -hand.picture.size["width"] // 4, -hand.picture.size["height"] // 4
            left, right = (hand.at((axial[0] + way, axial[1]))[0] for way in (-40, 40))
            other = round(axial[0] - 40 + (48 - left) * 80 / (right - left)), axial[1]
            browser.find_element("id", "play").click()
            # The volume is that of the picture, which follows the run; the start has 524 mm3.
            until(lambda: state(served)["object_rows"][0]["volume"].endswith(" ml"), 120)
            (first,) = count_is(1)
            # Where the mouse is goes on the clipboard, as settings take it.
            allowed = {
                "permissions": ["clipboardReadWrite", "clipboardSanitizedWrite"],
                "origin": served.origin,
            }
            browser.execute_cdp_cmd("Browser.grantPermissions", allowed)
            place = hand.at(other)
            hand.picture.send_keys(Keys.CONTROL, "c")
            read = "const done = arguments[0]; navigator.clipboard.readText().then(done, error => done(String(error)))"
            words = until(
                lambda: (text := browser.execute_async_script(read)).startswith("point:") and text
            )
            assert [
                float(part) for part in words.removeprefix("point:").split(",")
            ] == pytest.approx(place, abs=0.06)
            browser.find_element("id", "object-add").click()
            until(lambda: state(served)["tool"] == "size")
            hand.drag(other, (round(10 * 80 / (right - left)), 0), 0)
            two = count_is(2)
            assert two[0]["ml"] == pytest.approx(first["ml"], rel=1e-3)
            browser.find_element("css selector", f"#object-{two[1]['id']} button.name").click()
            choice = until(
                lambda: browser.find_elements("css selector", "select[aria-label^='merge ']")
            )[0]
            choice.find_element("css selector", f"option[value='{two[0]['id']}']").click()
            (merged,) = count_is(1, sum(one["ml"] for one in two))
            hand.picture.send_keys("q")
            until(lambda: state(served)["tool"] == "split")
            hand.drag(other, (0, 0), 0)
            split = count_is(2, merged["ml"])
            assert [one["ml"] for one in split] == pytest.approx(
                [one["ml"] for one in two], rel=0.01
            )
            browser.find_element("css selector", f"#object-{split[1]['id']} button.name").click()
            until(lambda: browser.find_element("id", "object-remove").is_enabled())
            browser.find_element("id", "object-remove").click()
            (alone,) = count_is(1, split[0]["ml"])
            assert alone["ml"] == split[0]["ml"]
            # Each was one change: undone by the key and by the button, and made again.
            for wanted, steps in ((split, "key"), ([merged], "button"), (two, "key")):
                if steps == "key":
                    hand.picture.send_keys(Keys.CONTROL, "z")
                else:
                    browser.find_element("id", "undo").click()
                again = count_is(len(wanted), sum(one["ml"] for one in wanted))
                assert [one["ml"] for one in again] == [one["ml"] for one in wanted]
            browser.find_element("id", "redo").click()
            assert count_is(1, merged["ml"])[0]["ml"] == merged["ml"]
    finally:
        assert served.close() == 0, served.log_text()
