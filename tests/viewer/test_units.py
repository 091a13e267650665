"""Settings and the radius in the unit of the file, with digits that the slider can resolve; the session is in mm."""

import os
import subprocess
import sys

import numpy as np
import pytest

from accelsurf import Volume
from accelsurf.io.headers import UNIT_KEY
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.settings_rows import settings_rows
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.page.page import page_text
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing

#: Voxels of half a micrometre, mm.
FINE = 0.0005


def sliders(finest, of_file="mm", settings=None):
    rows = settings_rows(settings or RunConfig(), (), finest, of_file)
    return {row["key"]: row for row in rows if row["kind"] == "slider"}


@pytest.mark.sampled
@pytest.mark.parametrize("of_file", ["mm", "um", "nm"])
@pytest.mark.parametrize("finest", [1e-6, FINE, 0.03, 1.0, 40.0])
def test_each_slider_resolves_hundredths_of_what_it_shows(finest, of_file):
    """At a tenth, a quarter and the upper end of its range; none writes digits that nobody can read."""
    for row in sliders(finest, of_file).values():
        for share in (0.1, 0.25, 1.0):
            value = row["low"] + share * (row["high"] - row["low"])
            assert round(value, row["digits"]) == pytest.approx(value, rel=0.01), row["key"]
        assert row["digits"] == 0 or 10.0 ** -row["digits"] >= 5e-5 * row["high"]


def test_lengths_and_areas_are_in_the_unit_of_the_file_and_nothing_else_is():
    in_mm, in_um = sliders(FINE), sliders(FINE, "um", RunConfig(smoothness=0.0012))
    assert (
        in_um["smoothness"]["unit"] == "um"
        and in_um["diffusion"]["unit"] == "um2 per unit of flow time"
    )
    assert in_um["smoothness"]["high"] == pytest.approx(1000.0 * in_mm["smoothness"]["high"])
    assert in_um["diffusion"]["high"] == pytest.approx(1e6 * in_mm["diffusion"]["high"])
    assert in_um["smoothness"]["value"] == 1.2 and in_um["smoothness"]["tick"] > 600
    for key in ("cfl", "friction"):
        assert in_um[key] == in_mm[key]
    rows = {
        row["key"]: row
        for row in settings_rows(RunConfig(presmooth=0.001, max_volume=1e-6), (), FINE, "um")
    }
    assert (rows["presmooth"]["value"], rows["presmooth"]["unit"]) == ("1", "um")
    assert (rows["max_volume"]["value"], rows["max_volume"]["unit"]) == ("1000", "um3")
    assert rows["roi"]["unit"] == rows["box"]["unit"] == "mm"  # six numbers, as options take them
    assert rows["balloon"]["unit"] == "1/mm" and in_um["smoothness"]["help"].endswith("Here in um.")


@pytest.fixture
def actions():
    """A ball in a file in micrometres."""
    viewing.needs_graphics()
    volume = Volume.from_array(np.zeros((20, 24, 28), np.float32), (FINE, FINE, FINE))
    volume.metadata[UNIT_KEY] = "um"
    center = volume.geometry.center_world()
    where = volume.geometry.index_to_world(np.stack(np.indices(volume.array.shape), axis=-1))
    volume = volume.with_array(
        100 * (np.linalg.norm(where - center, axis=-1) < 7 * FINE).astype(np.float32)
    )
    start = "ball:" + ",".join(f"{part:.9g}" for part in (*center, 3 * FINE))
    scene = Scene(volume, size=(480, 272))
    with Session(
        volume, RunConfig(start=start, threads=1, max_steps=30, levels=1), name="cell"
    ) as session:
        session.ready.result(60)
        yield Actions(session, scene)
    scene.close()


def ask(actions, *request):
    actions.message = ""
    actions.request(*request)
    assert actions.session.wait(60)
    actions.collect_results()
    return actions.session.status.settings


def test_what_is_set_in_micrometres_is_in_mm_in_the_session(actions):
    assert ask(actions, "set", "smoothness", "0.6").smoothness == 0.0006
    assert ask(actions, "set", "smoothness", 1.25).smoothness == 0.00125
    assert ask(actions, "set", "diffusion", "2.5").diffusion == 2.5e-6
    assert ask(actions, "set", "diffusion", "free").diffusion == "free"
    assert ask(actions, "set", "presmooth", "0.5").presmooth == 0.0005
    assert ask(actions, "set", "presmooth", "2vox").presmooth == "2vox"
    assert ask(actions, "set", "cfl", "0.4").cfl == 0.4 and not actions.message
    rows = {row["key"]: row for row in actions.state()["settings"]}
    assert rows["smoothness"]["value"] == 1.25
    ask(actions, "set", "presmooth", "")
    assert "smoothness = 0.00125" in actions.session.status.settings.to_toml()
    for bad in ("nan", "-1", "1e400", "x", True, [1], 10**400):
        ask(actions, "set", "smoothness", bad)
        assert actions.message and actions.session.status.settings.smoothness == 0.00125


def test_the_radius_is_set_in_micrometres_and_copied_in_mm(actions):
    row = actions.state()["radius_row"]
    assert (row["unit"], row["low"], row["value"]) == ("um", 0.25, 1.0)
    assert row["high"] == pytest.approx(0.4 * 28 * 0.5) and row["digits"] == 3
    ask(actions, "set_radius", "1.375")
    assert actions.radius == 0.001375 and actions.state()["radius_row"]["value"] == 1.375
    assert actions.state()["radius"] == 0.001375
    for bad in ("nan", -1, 1e9, "x", None, [1]):
        ask(actions, "set_radius", bad)
        assert actions.message and actions.radius == 0.001375


def test_the_page_reads_unit_and_digits_from_the_rows():
    tools = page_text("tools.html")
    assert (
        "radius_row.unit" in tools and "toFixed(radius_row.digits)" in tools and ", mm" not in tools
    )
    assert "row.unit" in page_text("settings.html") and "toFixed(row.digits)" in page_text(
        "settings.html"
    )


WINDOW = """
from PySide6.QtWidgets import QApplication
app = QApplication([])
from accelsurf.viewer.window.section_panel import Amount
from accelsurf.viewer.actions.settings_rows import amount
made, emitted = Amount(amount(0.00025, 0.024, 0.001, 2.0, 1.0)), []
made.changed.connect(emitted.append)
made.show_value(0.001)
shown = float(made.box.text().replace(",", "."))
made.slider.setValue(500)
made._emit()
print(shown, *emitted)
"""


@pytest.mark.program
def test_the_slider_of_the_window_gives_small_numbers():
    """Voxels of 0.5 um in a file in mm: 0.001 is not shown as 0, and half of the slider is a quarter of its range."""
    pytest.importorskip("PySide6")
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", WINDOW], env=env, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    shown, emitted = map(float, done.stdout.split())
    assert shown == 0.001 and emitted == pytest.approx(0.00619, rel=0.01)
