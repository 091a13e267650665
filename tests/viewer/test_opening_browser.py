"""The start page and the opening of images in the page: what is sent to it, and a real browser that uses it."""

import json
import os
import subprocess
import sys
import time
from urllib.parse import urlsplit

import numpy as np
import pytest

from accelsurf import io
from accelsurf.cli import execute as command
from accelsurf.image.volume import Volume
from tests.support import viewing
from tests.viewer.test_browser import Served, ask, call_of, driven, packed, state, talk, until

pytestmark = pytest.mark.program

WIDTHS = (700, 1280, 1920)


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()


class StartPage(Served):
    """`accelsurf view --browser` without an image, in a process of its own."""

    def __init__(self, folder, *options):
        self.folder, self.results, self.state_home = (
            folder / "scans",
            folder / "results",
            folder / "state",
        )
        (self.folder / "inner").mkdir(parents=True)
        volume, _ = viewing.ball_image()
        noise = np.random.default_rng(1).normal(0, 20, volume.array.shape)
        io.write(
            volume.with_array((volume.array + noise).astype(np.float32)),
            self.folder / "ball.nii.gz",
        )
        io.write(
            volume.with_array((volume.array > 50).astype(np.uint8)),
            self.folder / "inner" / "labels.nrrd",
        )
        (self.folder / "broken.nii").write_bytes(b"no image" * 60)
        (folder / "secret.nii").write_bytes((folder / "scans" / "broken.nii").read_bytes())
        words = [
            sys.executable,
            "-m",
            "accelsurf",
            "view",
            "--browser",
            "--no-open",
            "--folder",
            str(self.folder),
        ]
        words += ["--threads", "1", "--output", str(self.results), *options]
        env = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
        env["XDG_STATE_HOME"] = str(self.state_home)
        self.log = open(folder / "log", "w+")
        self.process = subprocess.Popen(
            words, env=env, stdout=subprocess.PIPE, stderr=self.log, text=True
        )
        self.address = self.process.stdout.readline().strip()
        assert self.address.startswith("http://"), self.log_text()
        parts = urlsplit(self.address)
        self.port, self.token = parts.port, parts.query.removeprefix("secret=")
        self.origin = f"http://127.0.0.1:{self.port}"


@pytest.fixture
def served(tmp_path):
    server = StartPage(tmp_path, "--start", "center")
    yield server
    assert server.process.poll() is None, server.log_text()
    assert server.close() == 0, server.log_text()
    assert "Traceback" not in server.log_text()


def open_name(served):
    now = state(served)
    return now["title"] if now["is_open"] and not now["opening"] else ""


# ------------------------------------------------------------------------------------------------------- what is sent


def test_the_folder_and_nothing_else_can_be_opened(served):
    now = state(served)
    assert [name for name, _ in now["folders"]] == ["inner"]
    assert [name for name, _ in now["images"]] == ["ball.nii.gz", "broken.nii"] and now[
        "recent"
    ] == []
    outside = served.folder.parent / "secret.nii"
    for name in ("../secret.nii", str(outside), "/etc/passwd", "inner/../../secret.nii", "a\0b"):
        for request in ("open", "open_reference", "list_folder"):
            ask(served, request, name)
            now = state(served)
            assert (
                now["opening_failed"] and not now["is_open"] and "secret" not in str(now["images"])
            )
    ask(served, "drop", str(served.folder.parent / "secret.nii"))
    assert state(served)["opening_message"] == "request: drop is not known"
    ask(served, "step")
    assert state(served)["opening_message"] == "request: step is not known"
    ask(served, "open", "broken.nii")
    until(lambda: "broken.nii" in state(served)["opening_message"] and not state(served)["opening"])
    assert state(served)["opening_failed"] and not state(served)["is_open"]
    ask(served, "open", "ball.nii.gz")
    until(lambda: open_name(served) == "ball.nii.gz")
    ask(served, "open", "broken.nii")
    now = until(lambda: (one := state(served))["failed"] and one)
    assert now["title"] == "ball.nii.gz" and "broken.nii" in now["message"]
    ask(served, "open_reference", "inner/labels.nrrd")
    until(lambda: not state(served)["opening"])
    ask(served, "step")
    until(lambda: state(served)["step"] == 1)
    ask(served, "open", "ball.nii.gz")
    assert "not saved" in until(lambda: state(served)["question"])
    ask(served, "answer", "open")
    until(lambda: open_name(served) == "ball.nii.gz" and state(served)["step"] == 0)
    recent = json.loads((served.state_home / "accelsurf" / "recent.json").read_text())
    assert recent == [str(served.folder / "ball.nii.gz")]


def test_nobody_without_the_token_opens(served):
    answers = talk(served, packed(call_of("trame.trigger", "ask", ["open", "ball.nii.gz"], {})))
    assert all("error" in answer for answer in answers)
    assert not state(served)["is_open"] and not state(served)["opening"]


def test_options_that_have_no_place(tmp_path, capsys):
    assert command(["view", "--folder", str(tmp_path)]) == 2
    assert "--folder was given for a window" in capsys.readouterr().err
    assert command(["view", "--browser", "--folder", str(tmp_path / "absent")]) == 2
    assert "expected a folder" in capsys.readouterr().err
    assert command(["view", "--browser", "--reference", str(tmp_path / "a.nii")]) == 2
    assert "reference: it was given without an image" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------- driven by a real browser


def resize(browser, width, height=800):
    """Give the page itself this size."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )


def said(browser, selector):
    """The text of a part of the page, which may be replaced at any time."""
    return browser.execute_script(
        "return document.querySelector(arguments[0])?.textContent", selector
    )


def unnamed(browser):
    """Controls in sight that a screen reader has no name for."""
    controls = browser.find_elements(
        "css selector", "input, select, button, a, summary, img, [role=alertdialog]"
    )
    bare = [one for one in controls if one.is_displayed() and not one.accessible_name.strip()]
    return [one.get_attribute("outerHTML")[:120] for one in bare]


def too_wide(browser):
    """What does not fit into the width of the page."""
    return browser.execute_script(
        "return [...document.querySelectorAll('.page *')].filter(one => one.checkVisibility() && "
        "one.getBoundingClientRect().width > 0 && one.getBoundingClientRect().right > window.innerWidth + 1)"
        ".map(one => one.outerHTML.slice(0, 100))"
    )


def walk(browser, limit=200):
    """Go through the page by Tab: the order of the controls in the document, and those without a visible focus."""
    from selenium.webdriver import ActionChains, Keys

    browser.execute_script(
        "document.activeElement.blur(); window.getSelection().removeAllRanges();"
    )
    order, unseen, seen = [], [], set()
    for _ in range(limit):
        ActionChains(browser).send_keys(Keys.TAB).perform()
        one = browser.execute_script(
            "const at = document.activeElement, all = [...document.querySelectorAll('*')];"
            "const style = getComputedStyle(at);"
            "return [all.indexOf(at), at.tagName, style.outlineStyle, parseFloat(style.outlineWidth), at.id]"
        )
        if one[1] in ("BODY", "HTML") or one[0] in seen:
            break
        seen.add(one[0])
        order.append(one[0])
        if one[1] != "DIV" and (one[2] == "none" or one[3] < 1):
            unseen.append(one)
    return order, unseen


@pytest.mark.slow
def test_from_the_start_page_to_a_saved_result_by_keys_and_mouse(served, tmp_path):
    from selenium.webdriver import ActionChains, Keys

    with driven(tmp_path) as browser:
        browser.get(served.address)
        until(lambda: browser.find_elements("id", "phantoms"))
        assert unnamed(browser) == []
        for width in WIDTHS:
            resize(browser, width)
            assert too_wide(browser) == [], width
        order, unseen = walk(browser)
        assert order == sorted(order) and len(order) > 12 and not unseen
        # The first image by the keyboard alone.
        button = browser.find_element("xpath", "//ul[@id='folder']//button[text()='ball.nii.gz']")
        for _ in range(40):
            if browser.switch_to.active_element == button:
                break
            ActionChains(browser).send_keys(Keys.TAB).perform()
        ActionChains(browser).send_keys(Keys.ENTER).perform()
        until(lambda: browser.find_elements("id", "picture"))
        until(lambda: said(browser, "#state") == "paused")
        browser.execute_script(
            "document.querySelectorAll('details').forEach(one => { one.open = true })"
        )
        for width in WIDTHS:
            resize(browser, width)
            time.sleep(0.6)
            assert too_wide(browser) == [] and unnamed(browser) == [], width
            picture = browser.find_element("id", "picture").rect
            assert picture["width"] > 0.5 * width and picture["x"] + picture["width"] <= width + 1
        resize(browser, 700)
        _fold_and_touch(browser)
        order, unseen = walk(browser)
        assert order == sorted(order) and len(order) > 15 and not unseen
        browser.save_screenshot(str(tmp_path / "narrow.png"))
        browser.find_element("id", "phantom-disc").click()
        until(lambda: said(browser, "h1") == "disc")
        until(lambda: said(browser, "#state") == "paused")
        severe = [
            entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"
        ]
        assert not [message for message in severe if "/paraview/" not in message], severe


def _fold_and_touch(browser):
    """Fold the panels: the picture grows. Turn it with a finger."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.action_builder import ActionBuilder
    from selenium.webdriver.common.actions.pointer_input import PointerInput

    def source():
        return browser.find_element("id", "picture").get_attribute("src")

    before = browser.find_element("id", "picture").rect["width"]
    browser.find_element("id", "fold").click()
    until(lambda: browser.find_element("id", "picture").rect["width"] > before + 100)
    time.sleep(1.0)
    shown = source()
    box = browser.find_element("id", "picture").rect
    touch = ActionBuilder(browser, mouse=PointerInput("touch", "finger"))
    # The surface is below the slices at the right.
    assert browser.find_element("id", "layout").get_attribute("value") == "one"
    x, y = round(box["x"] + 0.8 * box["width"]), round(box["y"] + 0.86 * box["height"])
    touch.pointer_action.move_to_location(x, y).pointer_down().move_to_location(
        x + 60, y + 25
    ).pointer_up()
    touch.perform()
    until(lambda: source() != shown)
    ActionChains(browser).click(browser.find_element("id", "fold")).perform()
    until(lambda: browser.find_element("id", "step").is_displayed())


def test_an_image_of_another_size_takes_the_place_of_the_first(served):
    io.write(
        Volume.from_array(np.eye(20, dtype=np.float32)[None] * 50 + 1), served.folder / "flat.nii"
    )
    for name, is_flat in (("ball.nii.gz", False), ("flat.nii", True), ("ball.nii.gz", False)):
        ask(served, "open", name)
        until(lambda name=name: open_name(served) == name)
        assert state(served)["is_flat"] == is_flat
