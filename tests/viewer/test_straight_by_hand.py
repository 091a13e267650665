"""An oblique scan in the window and in the page, by mouse and keys: straight by anatomy, or along the voxels."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from accelsurf import Volume, io
from tests.support import viewing
from tests.viewer.test_browser import Served, state, until
from tests.viewer.test_browser_controls import Hand, opened
from tests.viewer.test_desktop import Person, needs_screen, screen
from tests.viewer.test_desktop_controls import place_at, pressed

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
__all__ = ["screen"]

TURNED = Rotation.from_euler("xyz", [10, -15, 18], degrees=True).as_matrix() @ np.diag(
    [-1.0, -1.0, 1.0]
)


@pytest.fixture
def person(screen, tmp_path):
    viewing.needs_graphics()
    shape = (40, 48, 48)
    empty = Volume.from_array(np.zeros(shape, np.float32), direction=TURNED)
    center = empty.geometry.center_world()
    where = empty.geometry.index_to_world(np.moveaxis(np.indices(shape), 0, -1))
    image = 100.0 * (np.linalg.norm(where - center, axis=-1) < 14) + np.random.default_rng(
        0
    ).normal(0, 8, shape)
    io.write(empty.with_array(image.astype(np.float32)), tmp_path / "scan.nii.gz")
    made = Person(
        screen,
        tmp_path / "scan.nii.gz",
        tmp_path,
        start="ball:" + ",".join(f"{v:g}" for v in (*center, 6)),
    )
    yield made
    made.end()


@needs_screen
def test_the_window_shows_an_oblique_scan_straight_and_paints_in_it(person):
    assert person.now()["state"]["straight"] and person.now()["state"]["is_oblique"]
    assert person.now()["hidden_width"] == 0, "the panels fit beside the picture"
    x, y = person.now()["tiles"]["axial"]
    middle, right, up = (
        place_at(person, x, y),
        place_at(person, x + 30, y),
        place_at(person, x, y - 30),
    )
    assert right[0] > middle[0] + 1 and right[1:] == pytest.approx(middle[1:], abs=0.11)
    assert up[1] < middle[1] - 1 and up[[0, 2]] == pytest.approx(middle[[0, 2]], abs=0.11)
    # The key, and the box in the panel; along the voxels a way to the right is one along the grid's axis.
    person.key("2")
    person.until(lambda now: not now["state"]["straight"])
    along = place_at(person, x + 30, y) - place_at(person, x, y)
    assert along / np.linalg.norm(along) == pytest.approx(-TURNED[:, 0], abs=0.02)
    pressed(person, "straight")
    person.until(lambda now: now["state"]["straight"])
    assert place_at(person, x + 30, y) == pytest.approx(right, abs=0.11)
    # A stroke in the straight slice has the height of the slice all along.
    person.do("mousemove", str(x), str(y))
    person.key("i")
    person.drag((x - 8, y), (x + 8, y - 6), (x + 22, y - 12))
    now = person.until(lambda now: now["refinements"] and now["refinements"][-1]["inside"])
    (path,) = now["refinements"][-1]["inside"]
    places = np.array(
        [[float(v) for v in part.split(",")] for part in path.removeprefix("path:").split(";")]
    )
    assert (
        len(places) > 2
        and np.ptp(places[:, 2]) < 1e-3
        and places[0, 2] == pytest.approx(middle[2], abs=0.11)
    )
    person.leave()


@pytest.mark.program
def test_the_page_shows_an_oblique_scan_straight(tmp_path):
    viewing.needs_graphics()
    pytest.importorskip("trame", reason='trame is missing: pip install "accelsurf[viewer]"')
    served = Served(tmp_path, scan=viewing.ball_image(direction=TURNED))
    try:
        with opened(served, tmp_path) as browser:
            assert state(served)["straight"]
            hand = Hand(browser)
            axial = -hand.picture.size["width"] // 4, -hand.picture.size["height"] // 4
            middle, right = (np.array(hand.at((axial[0] + way, axial[1]))) for way in (0, 30))
            assert right[0] > middle[0] + 1 and right[1:] == pytest.approx(middle[1:], abs=0.11)
            switch = browser.find_element("id", "straight")
            assert switch.is_selected() and switch.is_enabled()
            switch.click()
            until(lambda: not state(served)["straight"])
            along = np.array(hand.at((axial[0] + 30, axial[1]))) - hand.at(axial)
            assert along / np.linalg.norm(along) == pytest.approx(-TURNED[:, 0], abs=0.02)
            hand.picture.send_keys("2")
            until(lambda: state(served)["straight"])
            # A slider goes to slices that lie beside the middle of the image too.
            slider = browser.find_element("id", "slice-sagittal")
            count = int(slider.get_attribute("max"))
            browser.execute_script(
                "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))",
                slider,
                count - 1,
            )
            until(lambda: state(served)["slices"]["sagittal"] == [count - 1, count])
    finally:
        assert served.close() == 0, served.log_text()
