"""Measuring in the window, driven for real; and fine screens."""

import numpy as np
import pytest

from tests.viewer.test_desktop import Person, needs_screen, scan, screen  # noqa: F401

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture
def open_window(screen, scan, tmp_path):  # noqa: F811
    made = []

    def make(**options):
        made.append(Person(screen, scan, tmp_path, start="ball:24,24,20,6", **options))
        return made[-1]

    yield make
    for person in made:
        if person.process.poll() is None:
            person.process.kill()
            person.process.wait()
        person.process.stdout.close()


@needs_screen
def test_a_length_an_angle_the_table_and_the_clipboard(open_window):
    person = open_window()
    person.key("space")
    person.until(lambda now: now["stop"] == "converged" and not now["playing"], 120)
    x, y = person.now()["tiles"]["axial"]
    person.key("d")
    person.drag((x - 50, y), (x, y + 5), (x + 40, y))
    person.until(lambda now: now["state"]["measurements"] and length(now) > 15)
    # How long 90 pixels are, the read-out says at both ends.
    spots = []
    for place in (x - 50, x + 40):
        before = person.now()["state"]["place"]
        person.do("mousemove", str(place), str(y))
        now = person.until(lambda now, before=before: now["state"]["place"] != before)
        spots.append(np.array([float(part) for part in now["state"]["place"].split(",")]))
    assert length(person.now()) == pytest.approx(np.linalg.norm(spots[1] - spots[0]), abs=0.3)
    closed = person.now()["buttons"]["measure_measure"]
    person.key("j")
    for dx, dy in ((30, -20), (-20, -20), (-20, 30)):
        person.drag((x + dx, y + dy))
    now = person.until(lambda now: [row[1] for row in now["state"]["measurements"]] == ["distance", "angle"])
    now = person.until(lambda now: now["state"]["measurements"][1][2] == "90.0°")
    press(person, "measure_title")
    person.until(lambda now: now["buttons"]["measure_measure"] != closed)
    press(person, "measure_measure")
    now = person.until(lambda now: now["state"]["figures"])
    lines = {line[0]: line[1] for line in now["state"]["figures"]}
    assert float(lines["Volume"].split()[0]) == pytest.approx(4 / 3 * np.pi * 15**3 / 1000, rel=0.05)
    assert float(lines["Diameter"].split()[0]) == pytest.approx(30, abs=3.5)  # noise of a third of the contrast
    press(person, "measure_copy")
    now = person.until(lambda now: "diameter_across_mm" in now["clipboard"])
    assert now["clipboard"].split("\t")[:2] == ["id", "name"] and "angle\t90" in now["clipboard"]
    press(person, "measure_diameters")
    now = person.until(lambda now: len(now["state"]["measurements"]) == 6)
    assert length(now) > 15
    press(person, "measure_clear")
    person.until(lambda now: not now["state"]["measurements"])
    person.leave()


def press(person, name):
    """Scroll the panels until a button is in sight, and click it."""
    for _ in range(30):
        now = person.now()["buttons"]
        x, y = now[name]
        if 60 < y < 655:
            return person.click(name)
        # Beside the panels' controls, which a wheel would turn.
        person.do("mousemove", str(now["save"][0] - 251), "300", "click", "5" if y > 350 else "4", "sleep", "0.2")
    return pytest.fail(f"{name} is never in sight: {person.now()['buttons']}")


def length(now):
    """Of the first measurement, mm."""
    return float(now["state"]["measurements"][0][2].split()[0])


@needs_screen
@pytest.mark.parametrize("scale", [1.5, 3])
def test_the_window_uses_the_pixels_of_a_fine_screen_once(open_window, scale):
    person = open_window(scale=scale)
    now = person.until(lambda now: now["pixels"][0] == scale)
    assert now["pixels"][1] == 72
    person.key("Right")
    person.until(lambda now: now["step"] == 1)
    person.leave()
