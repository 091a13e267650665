"""Settings that are fixed while a run runs, and presets: another run from the start, with what was clicked."""

from unittest.mock import patch

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.errors import InputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.settings.presets import PRESETS, Preset
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.session import Session
from tests.support.steering import at, labels_of
from tests.support.viewing import look

START = "ball:17,15,16,6"


def volume(shape=(24, 30, 34), spacing=(1.5, 1.0, 1.0)):
    z, y, x = np.indices(shape)
    ball = ((z - 11) * spacing[0]) ** 2 + (y - 15) ** 2 + (x - 17) ** 2 < 10**2
    return Volume.from_array(
        (ball * 100 + np.random.default_rng(0).normal(0, 30, shape)).astype(np.float32), spacing
    )


@pytest.fixture
def session():
    with Session(volume(), RunConfig(start=START)) as made:
        made.ready.result(60)
        yield made


def test_clicks_are_made_again_at_the_end_of_the_other_run(session, tmp_path):
    at(session, 3)
    session.change(smoothness=0.2).result(60)
    session.add_click("inside", "ball:17,15,16,2").result(60)
    at(session, 5)
    session.add_click("outside", ["point:17,28,16", "point:16,28,16"]).result(60)
    session.restart_with(presmooth="1vox", max_volume=9e4).result(60)
    status = session.status
    assert status.step == 0 and status.stop is None and not status.playing
    assert (status.settings.presmooth, status.settings.smoothness, status.settings.max_volume) == (
        "1vox",
        0.2,
        9e4,
    )
    assert status.edits == ()
    assert [(each.inside, each.outside) for each in status.refinements] == [
        (("ball:17,15,16,2",), ()),
        ((), ("point:17,28,16", "point:16,28,16")),
    ]
    assert status.message == "from the start: presmooth 1vox, max volume 90000"
    session.play().result(60)
    assert session.wait(120) and len(session.status.refinements) == 2
    saved, toml = labels_of(session, tmp_path)
    assert segment(volume(), config=RunConfig.from_toml(toml)).labels.tobytes() == saved


def test_it_is_one_change_that_can_be_undone(session):
    at(session, 4)
    session.add_click("inside", "ball:17,15,16,2").result(60)
    before = session.status
    session.restart_with(levels=2).result(60)
    assert session.status.settings.levels == 2 and session.status.undoable == before.undoable + 1
    session.undo().result(60)
    session.wait(60)
    assert session.status.settings == before.settings
    assert session.status.refinements == before.refinements
    session.redo().result(60)
    assert session.status.settings.levels == 2 and len(session.status.refinements) == 1


BAD = [
    ({"energy": "chan-vesee"}, UsageError, "chan-vese"),
    ({"presmooth": -1}, UsageError, "presmooth"),
    ({"roi": "1,2,3"}, UsageError, "roi"),
    ({"mask": "/nowhere.nii.gz"}, InputError, "nowhere"),
    ({"preset": "ct-boone"}, UsageError, "ct-skeleton"),
    ({"what": 1}, UsageError, "what"),
    ({"roi": "0,0,0,3,3,3vox"}, InputError, "start"),
    ({"energy": "seeded"}, UsageError, "inside"),
]


@pytest.mark.parametrize("settings, kind, named", BAD)
def test_what_is_wrong_changes_nothing(session, settings, kind, named):
    at(session, 3)
    session.add_click("inside" if "energy" not in settings else "outside", "point:3,3,16").result(
        60
    )
    before, frame = (
        session.status,
        look(session, lambda run: run.objects[0].surface.psi.copy()).result(60),
    )
    with pytest.raises(kind, match=named):
        session.restart_with(**settings).result(60)
    after = session.status
    assert after.failed and named in after.message
    assert after._replace(message="", failed=False) == before._replace(message="", failed=False)
    assert np.array_equal(
        look(session, lambda run: run.objects[0].surface.psi.copy()).result(60), frame
    )


def test_a_preset_overrides_what_was_chosen_and_gives_way_to_the_next(session):
    session.change(energy="likelihood", smoothness=0.7, percentile=90.0).result(60)
    session.restart_with(preset="mr-brain").result(60)
    now = session.status.settings
    assert {key: getattr(now, key) for key in PRESETS["mr-brain"].settings} == dict(
        PRESETS["mr-brain"].settings
    )
    assert now.percentile == 90.0 and now.preset == "mr-brain"
    assert (
        "preset mr-brain: " in session.status.message
        and "energy chan-vese" in session.status.message
    )
    session.restart_with(preset="fluorescence-nucleus").result(60)
    now = session.status.settings
    assert (now.energy, now.presmooth, now.balance, now.epsilon) == (
        "local-region",
        "1vox",
        1.0,
        1.5,
    )
    session.restart_with(preset=None).result(60)
    assert (
        session.status.settings.energy == "chan-vese" and session.status.settings.percentile == 90.0
    )


@pytest.fixture
def of_clicks():
    """Name of a preset that begins from clicks."""
    settings = {"energy": "seeded", "start": ("clicks",), "presmooth": "1vox"}
    preset = Preset(
        "toy-clicks",
        "Toys by a click.",
        settings,
        dict.fromkeys(settings, "toys"),
        {"a toy": "well"},
    )
    with patch.dict(PRESETS, {preset.name: preset}):
        yield preset.name


def test_a_preset_of_clicks_waits_for_them_and_then_begins_from_them(of_clicks, session, tmp_path):
    session.restart_with(preset=of_clicks).result(60)
    now = session.status.settings
    assert (now.presmooth, now.energy, now.start) == ("1vox", "chan-vese", (START,))
    assert session.status.message.endswith("now click in the object, or draw its size")
    session.add_click("inside", "point:17,15,16").result(60)
    session.add_click("outside", "point:1,1,1").result(60)
    session.restart_with(preset=of_clicks).result(60)
    now = session.status.settings
    assert (now.energy, now.start, now.inside, now.outside) == (
        "seeded",
        ("clicks",),
        ("point:17,15,16",),
        ("point:1,1,1",),
    )
    assert session.status.edits == ()
    saved, toml = labels_of(at(session, 9), tmp_path)
    assert segment(volume(), config=RunConfig.from_toml(toml)).labels.tobytes() == saved


def test_a_press_after_such_a_preset_keeps_what_it_says_of_the_image(of_clicks, session):
    session.restart_with(preset=of_clicks).result(60)
    drag = session.press("ball:17,15,16,3").result(60)
    assert drag.click
    session.release(10.0).result(60)
    assert (
        session.status.settings.presmooth == "1vox" and session.status.settings.energy == "seeded"
    )


def test_corrections_after_the_end_are_made_again_at_the_next(session):
    session.play().result(60)
    session.wait(120)
    assert session.status.stop is not None
    session.add_click("outside", "ball:17,6,16,2").result(60)
    assert session.status.refinements
    session.restart_with(presmooth=0.5).result(60)
    assert session.status.stop is None and len(session.status.refinements) == 1


def test_the_status_has_the_terms_with_every_setting_resolved(session):
    session.change(energy="threshold:auto").result(60)
    (term,) = session.status.terms
    assert term["term"] == "threshold" and 20 < term["LO"] < 80 and term["HI"] is None
