"""Settings in the page, driven by a real browser."""

import time

import numpy as np
import pytest

from accelsurf import cli
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.settings_rows import settings_rows
from tests.support import viewing
from tests.viewer.test_browser import Served, driven, until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
pytest.importorskip("selenium", reason="selenium is missing")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    viewing.needs_graphics()
    folder = tmp_path_factory.mktemp("settings")
    with driven(folder) as browser:
        made = Served(folder, "--energy", "threshold:40,160")
        browser.get(made.address)
        until(
            lambda: (
                browser.find_elements("id", "picture")
                and browser.find_elements("id", "energy-line")
            )
        )
        yield made, browser
    assert made.close() == 0, made.log_text()


@pytest.fixture
def element(server):
    return lambda name: server[1].find_element("id", name)


def value(element, name):
    """What is in the field of a setting."""
    return element(f"set-{name}").get_attribute("value")


def line(element):
    return element("energy-line").get_attribute("value")


def fill(browser, element, name, text, enter=True):
    from selenium.webdriver.common.keys import Keys

    browser.execute_script("document.querySelectorAll('details').forEach(one => one.open = true)")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element(name))
    element(name).click()
    element(name).send_keys(Keys.CONTROL, "a")
    element(name).send_keys(text, *([Keys.ENTER] if enter else []))


def test_the_page_has_the_rows_of_the_catalogue_and_no_others(server, element):
    _, browser = server
    config = RunConfig(energy="threshold:40,160", levels=1, threads=1)
    rows = settings_rows(config, (), 1.0)
    labels = browser.find_elements("css selector", ".setting > span:first-child")
    shown = [" ".join(label.get_attribute("textContent").split()) for label in labels]
    units = [f" ({row['unit']})" if row["unit"] else "" for row in rows]
    marks = [" \u21ba" if row["restarts"] else "" for row in rows]
    assert shown == [
        row["label"] + unit + mark for row, unit, mark in zip(rows, units, marks, strict=True)
    ]
    groups = browser.find_elements("css selector", "details.more > summary")
    names = [one.get_attribute("textContent") for one in groups]
    assert names == ["Expert"]
    for row in rows:
        if row["kind"] == "slider" and not row["words"]:
            assert float(value(element, row["key"])) == row["value"]
            assert float(element("set-" + row["key"]).get_attribute("max")) == row["limit"]
            assert int(value(element, row["key"] + "-range")) == row["tick"]
        elif row["kind"] in ("text", "list", "energy") and row["key"] not in ("start", "seed"):
            assert value(element, row["key"]) == row["value"], row["key"]
            options = element("set-" + row["key"]).find_elements("tag name", "option")
            assert [one.get_attribute("value") for one in options] == [
                one["name"] for one in row["names"]
            ]
            assert element("set-" + row["key"]).is_enabled() == row["enabled"]


def test_what_is_typed_stays_until_it_is_left_and_keys_stay_in_a_slider(server, element):
    from selenium.webdriver.common.keys import Keys

    _, browser = server
    fill(browser, element, "energy-line", "threshold:40,160 + geo", enter=False)
    until(
        lambda: (
            browser.find_elements("id", "energy-error")
            and "in place of 'geo'" in element("energy-error").text
        )
    )
    assert (
        line(element) == "threshold:40,160 + geo" and value(element, "energy") == "threshold:40,160"
    )
    browser.execute_script("arguments[0].blur()", element("energy-line"))
    until(lambda: not browser.find_elements("id", "energy-error"))
    until(lambda: line(element) == "threshold:40,160")
    fill(browser, element, "set-smoothness", "0.37")
    until(lambda: value(element, "smoothness-range") == "272")
    for count in (1, 2):
        element("set-smoothness-range").send_keys(Keys.ARROW_RIGHT)
        until(lambda count=count: int(value(element, "smoothness-range")) == 272 + count)
        time.sleep(0.2)
    until(lambda: value(element, "smoothness") == "0.375")


def test_a_region_is_typed_and_what_is_saved_repeats(server, element, tmp_path):
    served, browser = server
    low = float(value(element, "threshold-0-LO"))
    fill(browser, element, "set-presmooth", "0.5vox")
    until(lambda: "presmooth 0.5vox" in element("message").text)
    fill(browser, element, "set-roi", "4,4,2,40,36,17vox")
    until(lambda: value(element, "roi") == "4,4,2,40,36,17vox" and "roi" in element("message").text)
    for count in (1, 2, 3):
        browser.execute_script("arguments[0].click()", element("single"))
        until(
            lambda count=count: (
                element("step").text.split()[1] == str(count) and element("single").is_enabled()
            )
        )
    browser.execute_script("arguments[0].click()", element("save"))
    until(lambda: (served.results / "ball_view.png").exists())
    file = next(served.results.glob("*_run.toml"))
    config = RunConfig.from_toml(file)
    assert config.at(3).energy == f"threshold:{low:g},160" and config.presmooth == "0.5vox"
    assert config.roi == value(element, "roi")
    again = tmp_path / "again"
    words = ["segment", str(served.image), "--config", str(file), "-o", str(again), "--quiet"]
    assert cli.execute(words) == 0
    assert (again / "ball_seg.nii.gz").read_bytes() == (
        served.results / "ball_seg.nii.gz"
    ).read_bytes()


def test_a_bad_value_changes_nothing_in_the_page_either(server, element):
    _, browser = server
    now = value(element, "roi")
    fill(browser, element, "set-roi", "1,2,3")
    until(lambda: "roi: 1,2,3 was given" in element("message").text)
    browser.execute_script("arguments[0].blur()", element("set-roi"))
    until(lambda: value(element, "roi") == now)
    assert np.isfinite(float(value(element, "smoothness")))
