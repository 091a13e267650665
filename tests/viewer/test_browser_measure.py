"""Measuring in the page, driven by a real browser; fine screens; letters of an exported page."""

import re

import pytest

import accelsurf
from accelsurf.io.headers import DICOM_KEY
from tests.support import viewing
from tests.viewer.test_browser import driven, until

pytest.importorskip("trame", reason='trame is missing: pip install "accelsurf[viewer]"')


@pytest.fixture(scope="module", autouse=True)
def graphics():
    viewing.needs_graphics()
    viewing.needs_chromium_driver()


def test_the_table_is_measured_copied_saved_and_a_length_is_drawn(served, tmp_path):
    with driven(tmp_path) as browser:
        def element(name):
            return browser.find_element("id", name)

        browser.get(served.address)
        until(lambda: browser.find_elements("id", "picture") and element("picture").get_attribute("src"))
        until(lambda: browser.execute_script("return document.getElementById('picture').naturalWidth") > 400)
        browser.execute_script("document.getElementById('measure').closest('details').open = true")
        assert not element("measure-copy").is_enabled()
        until(element("measure").is_enabled)
        element("measure").click()
        cells = until(lambda: [one.text for one in browser.find_elements("css selector", "#figures tr:nth-child(2) *")])
        assert cells[0] == "Volume" and cells[1].endswith(" ml")
        assert float(cells[1].split()[0]) == pytest.approx(4 / 3 * 3.1416 * 5**3 / 1000, rel=0.1)
        # Without a clipboard (a page that is no secure place) the text is selected and copied all the same.
        browser.execute_script(
            "window.copied = '';"
            "document.addEventListener('copy', () => window.copied = String(document.activeElement.value));"
            "Object.defineProperty(navigator, 'clipboard', {value: undefined})"
        )
        element("measure-copy").click()
        table = until(lambda: browser.execute_script("return window.copied"))
        assert table.split("\t")[:2] == ["id", "name"] and "diameter_axial_across_mm" in table
        element("diameters").click()
        until(lambda: len(browser.find_elements("css selector", "#measurements tr")) == 4)
        element("measure-delete-2").click()
        until(lambda: len(browser.find_elements("css selector", "#measurements tr")) == 3)
        element("tool-distance").click()
        from selenium.webdriver import ActionChains

        picture = element("picture")
        right, down = 0.12 * picture.size["width"], -0.25 * picture.size["height"]
        chain = ActionChains(browser).move_to_element_with_offset(picture, right, down).click_and_hold()
        chain.pause(0.2).move_by_offset(30, 12).pause(0.2).release().perform()
        last = until(lambda: [one.text for one in browser.find_elements("css selector", "#measurements tr")][3:])
        assert re.fullmatch(r"5 distance [\d.]+ mm.*", last[0].replace("\n", " "))
        element("measure-save").click()
        until((served.results / "ball_measurements.csv").exists)
        assert len((served.results / "ball_measurements.csv").read_text().splitlines()) == 5
        assert until(lambda: browser.find_elements("link text", "ball_figures.csv"))


def test_a_fine_screen_gets_its_pixels_when_nothing_moves(served, tmp_path):
    with driven(tmp_path, "--force-device-scale-factor=2") as browser:
        browser.get(served.address)
        natural = "const one = document.getElementById('picture'); return one && [one.naturalWidth, one.clientWidth]"
        size = until(lambda: (found := browser.execute_script(natural)) and found[0] > 1.9 * found[1] > 0 and found)
        assert size[0] == pytest.approx(2 * size[1], rel=0.02)


def test_the_picture_fits_the_page_after_the_window_has_changed(served, tmp_path):
    with driven(tmp_path) as browser:
        from selenium.webdriver import ActionChains

        browser.get(served.address)
        sizes = "const one = document.getElementById('picture'); return one && [one.naturalWidth, one.naturalHeight]"
        until(lambda: (found := browser.execute_script(sizes)) and found[0] > 900)
        browser.set_window_size(900, 863)
        main = browser.find_element("css selector", "main")
        ActionChains(browser).move_to_element_with_offset(main, -main.size["width"] // 2 - 20, 0).perform()
        ActionChains(browser).move_to_element(main).perform()
        size = until(lambda: (found := browser.execute_script(sizes)) and found[0] < 700 and found)
        assert size[0] == pytest.approx(main.size["width"], abs=9) and size[1] > 1.2 * size[0] * 0.5


@pytest.mark.slow
def test_letters_of_an_exported_page_never_overlap(tmp_path):
    volume, center = viewing.ball_image((4, 40, 44), radius=9.0)
    volume.metadata[DICOM_KEY] = "1.2.3"  # its axes are a patient's
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    result = accelsurf.segment(volume, start=start, max_steps=2, levels=1)
    accelsurf.show(result, to=tmp_path / "a.html", title="A title & more")
    assert "<title>A title &amp; more</title>" in (tmp_path / "a.html").read_text()
    with driven(tmp_path) as browser:
        browser.get((tmp_path / "a.html").as_uri())
        for turn, tilt in ((-28.8, 23.7), (0, 90), (0, 0), (90, 0), (0, 60), (-28.8, 5)):
            letters = browser.execute_script(
                "const said = [], old = pen.fillText; pen.fillText = (text, x, y) => said.push([text, x, y]);"
                f"turn = {turn}; tilt = {tilt}; draw(); pen.fillText = old; return said"
            )
            places = {text: (x, y) for text, x, y in letters if len(text) == 1}
            assert {"S", "I"} & set(places)
            for one, (x, y) in places.items():
                for other, (a, b) in places.items():
                    assert one >= other or max(abs(x - a), abs(y - b)) > 11, (turn, tilt, one, other)
