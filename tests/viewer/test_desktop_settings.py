"""Settings in the window, by mouse and keys."""

import pytest

from accelsurf import io
from accelsurf.api.segment import segment
from accelsurf.settings.run_config import RunConfig
from tests.viewer.test_desktop import needs_screen, person, scan, screen

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
__all__ = ["person", "scan", "screen"]


def fill(person, key, text):
    """Click on the line of a setting, replace what is in it, press Return."""
    x, y = person.reach(lambda now: now["rows"][key][1])
    person.do("mousemove", str(x), str(y), "click", "1")
    person.do("key", "ctrl+a")
    person.do("type", "--delay", "5", text)
    return lambda: person.do("key", "Return")


@needs_screen
def test_a_run_set_up_by_hand_is_the_same_from_the_command_line(person, scan, tmp_path):
    now = person.now()
    rows = now["state"]["settings"]
    assert [row["key"] for row in rows] == list(now["rows"])
    for row in rows:
        label = now["rows"][row["key"]][0]
        assert (
            label.startswith(row["label"])
            and row["unit"] in label
            and ("\u21ba" in label) == row["restarts"]
        )
    # The wheel over the panel scrolls it, and changes no list and no number.
    x, y = now["rows"]["energy"][1]
    person.do("mousemove", str(x), str(y - 28), "click", "5")
    person.until(lambda now: now["rows"]["energy"][1][1] != y)
    assert person.now()["settings"] == now["settings"]
    # An energy, with a mistake on the way.
    fill(person, "energy", "threshold:60,1e")
    person.until(lambda now: "not '1e'" in now["energy_error"])
    assert person.now()["settings"]["energy"] == "chan-vese"
    enter = fill(person, "energy", "threshold:40,400")
    person.until(lambda now: now["energy_error"] == "")
    enter()
    person.until(lambda now: now["settings"]["energy"] == "threshold:40,400")
    person.until(lambda now: "threshold-0-LO" in now["rows"])
    # What is fixed while a run runs; the region of interest.
    fill(person, "presmooth", "0.5vox")()
    now = person.until(lambda now: now["settings"]["presmooth"] == "0.5vox")
    assert now["settings"]["energy"] == "threshold:40,400" and now["step"] == 0
    fill(person, "roi", "4,4,4,43,43,36vox")()
    person.until(lambda now: now["settings"]["roi"] == "4,4,4,43,43,36vox")
    person.key("Right", "Right", "Right")
    person.until(lambda now: now["drawn"][0] == 3 and now["step"] == 3)
    person.do("key", "ctrl+s")
    person.until(lambda now: "saved in" in now["message"], 120)
    person.leave()
    config = RunConfig.from_toml(next((tmp_path / "out").glob("*_run.toml")))
    assert config.roi == now["settings"]["roi"] and config.presmooth == "0.5vox"
    again = segment(io.read(scan), config=config)
    assert (
        again.labels.tobytes() == io.read_labels(tmp_path / "out/scan_seg.nii.gz").array.tobytes()
    )
