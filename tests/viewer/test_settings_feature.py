"""Settings by actions: rows from the catalogue, presets, energies as they are typed."""

import json
import re

import pytest

from accelsurf import io
from accelsurf.cli import execute
from accelsurf.settings.catalogue import default_shown, entry, help_of, names_of, viewer_settings
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.expression import Word
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.settings_rows import EXPERT, OF_FLOW, settings_rows
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.scene.scene import Scene
from tests.support import viewing

COMMON = ["preset", "smoothness", "presmooth", "size", "max_volume", "roi"]


def rows_of(actions):
    return {row["key"]: row for row in actions.state()["settings"]}


@pytest.fixture(scope="module")
def scene():
    viewing.needs_graphics()
    volume, _ = viewing.ball_image()
    made = Scene(volume, size=(480, 272))
    yield made
    made.close()


@pytest.fixture
def actions(scene, tmp_path):
    volume, center = viewing.ball_image()
    start = "ball:" + ",".join(f"{v:g}" for v in (*center, 6.0))
    image = tmp_path / "scan" / "ball.nii.gz"
    image.parent.mkdir()
    io.write(volume, image)
    config = RunConfig(start=start, threads=1, max_steps=60)
    with Session(volume, config, name="ball", source=image) as session:
        session.ready.result(60)
        yield Actions(session, scene, tmp_path / "out")


def ask(actions, *request):
    actions.message = ""
    actions.request(*request)
    assert actions.session.wait(60)
    actions.collect_results()
    return actions.session.status


# ------------------------------------------------------------------------------------------------------------ the rows


def test_rows_are_the_options_of_the_command_line_in_their_order(capsys):
    """The same names, help and numbers: the common ones first, each part in the order of ``--help-all``."""
    assert execute(["segment", "--help-all"]) == 0
    shown = capsys.readouterr().out
    options = re.findall(r"^│ (?:\* +)?--([a-z0-9-]+)", shown, re.MULTILINE)
    places = {key: options.index(key) for key in dict.fromkeys(options)}
    rows = [row for row in settings_rows(RunConfig(), (), 1.0) if not row["term"]]
    assert [row["key"] for row in rows if not row["group"]] == COMMON
    assert {row["group"] for row in rows} == {"", EXPERT}
    assert {"energy", "levels", "epsilon"} <= {row["key"] for row in rows if row["group"]}
    first = [key for key in viewer_settings("first") if key not in COMMON]
    for wanted in (
        COMMON,
        first,
        [row["key"] for row in rows if row["group"] and row["key"] not in first],
    ):
        order = [places[key.replace("_", "-")] for key in wanted]
        assert order == sorted(order)
    for row in rows:
        assert row["label"].replace(" ", "-") in places
        assert row["help"] == help_of(row["key"]) and row["unit"] == entry(row["key"]).unit
    values = {
        row["key"]: str(row["value"]) for row in rows if row["kind"] not in ("switch", "slider")
    }
    assert values == {key: default_shown(key).replace("none", "") for key in values}


def test_each_kind_of_row_has_what_it_needs():
    rows = {row["key"]: row for row in settings_rows(RunConfig(flow="gradient"), (), 0.5)}
    assert json.loads(json.dumps(rows)) == rows
    assert {row["kind"] for row in rows.values()} == {"slider", "list", "text", "switch", "energy"}
    smooth, diffusion, flow = rows["smoothness"], rows["diffusion"], rows["flow"]
    assert (smooth["low"], smooth["high"], smooth["value"], smooth["words"]) == (0.0, 2.5, 0.0, [])
    assert (diffusion["high"], diffusion["value"], diffusion["words"]) == (
        5.0,
        "auto",
        ["auto", "free"],
    )
    assert not rows["friction"]["enabled"] and smooth["enabled"]
    assert not diffusion["restarts"] and rows["levels"]["restarts"]
    assert {one["name"]: one["help"] for one in flow["names"]} == names_of("flow")
    assert [one["name"] for one in rows["preset"]["names"]] == ["", *PRESETS]
    skeleton = next(one["help"] for one in rows["preset"]["names"] if one["name"] == "ct-skeleton")
    assert PRESETS["ct-skeleton"].summary in skeleton and "smoothness 0.2" in skeleton


@pytest.mark.parametrize("name", [name for name, term in TERMS.items() if term.sees_image])
def test_the_settings_of_a_term_appear_when_the_energy_has_it(name):
    text = TERMS[name].example or name
    config = RunConfig(energy=f"{text} + area", flow="gradient")
    rows = [row for row in settings_rows(config, (), 1.0) if row["term"]]
    assert [row["term"] for row in rows] == [
        [0, key] for key in TERMS[name].settings if key != "channel"
    ]
    several = [{"term": name, "weight": 1.0, "channels": [{"channel": 1}, {"channel": 2}]}]
    rows = [row for row in settings_rows(config, several, 1.0) if row["term"]]
    assert [row["term"] for row in rows] == [[0, key] for key in TERMS[name].settings]
    for row in rows:
        kind = TERMS[name].settings[row["term"][1]]
        assert row["label"] == f"{name} {row['term'][1]}" and kind.expected in row["help"]
        assert [one["name"] for one in row["names"]] == (
            ["", *kind.words] if isinstance(kind, Word) else []
        )


@pytest.mark.parametrize("name", FLOWS)
def test_the_settings_of_a_flow_appear_when_the_run_has_it(name):
    known = FLOWS[name].settings
    text = f"{name}:{next(iter(known))}=0.5" if known else name
    rows = settings_rows(RunConfig(flow=text), (), 1.0)
    own = [row for row in rows if row["term"] and row["term"][0] == OF_FLOW]
    assert [row["term"][1] for row in own] == list(known)
    assert [row["value"] for row in own] == (["0.5"] + [""] * (len(known) - 1) if known else [])
    for row in own:
        assert known[row["term"][1]].expected in row["help"]
    flow = next(row for row in rows if row["key"] == "flow")
    assert flow["value"] == text and text in [choice["name"] for choice in flow["names"]]


# ------------------------------------------------------------------------------------------------------------- changes


def test_a_setting_of_the_flow_is_an_edit_of_the_flow(actions):
    ask(actions, "step")
    assert ask(actions, "set_term", OF_FLOW, "rho", "2").settings.flow == "constant-density:rho=2"
    status = ask(actions, "set_term", OF_FLOW, "k", 3)
    assert status.settings.flow == "constant-density:rho=2,k=3"
    assert rows_of(actions)["flow-rho"]["value"] == "2"
    assert ask(actions, "set_term", OF_FLOW, "rho", "").settings.flow == "constant-density:k=3"
    ask(actions, "set_term", OF_FLOW, "k", "0")
    assert "at least 0.1" in actions.message


def test_a_setting_that_may_change_is_an_edit_and_a_fixed_one_begins_another_run(actions):
    status = ask(actions, "step")
    status = ask(actions, "set", "smoothness", 0.4)
    assert status.step == 1 and status.edits[0].settings == {"smoothness": 0.4}
    assert rows_of(actions)["smoothness"]["value"] == 0.4
    status = ask(actions, "set", "presmooth", " 1vox ")
    assert (
        status.step == 0
        and status.settings.presmooth == "1vox"
        and status.settings.smoothness == 0.4
    )
    ask(actions, "step")
    assert ask(actions, "set", "presmooth", "1vox").step == 1, "nothing is different"
    assert ask(actions, "set", "presmooth", "").settings.presmooth == 0.0
    assert ask(actions, "set", "stop_at_rest", True).settings.stop_at_rest is True
    assert ask(
        actions, "set", "foreground", "ball:1,2,3,4vox ball:9,9,9,2vox"
    ).settings.foreground == (
        "ball:1,2,3,4vox",
        "ball:9,9,9,2vox",
    )
    assert rows_of(actions)["foreground"]["value"] == "ball:1,2,3,4vox ball:9,9,9,2vox"
    assert not actions.message


def test_a_preset_is_chosen_and_says_what_it_changes(actions):
    status = ask(actions, "set", "preset", "fluorescence-nucleus")
    assert (
        status.settings.energy == "local-region"
        and status.settings.preset == "fluorescence-nucleus"
    )
    assert actions.state()["message"] == (
        "from the start: preset fluorescence-nucleus: energy local-region, start otsu, presmooth 1vox"
    )
    status = ask(actions, "undo")
    assert status.settings.preset is None and status.settings.energy == "chan-vese"


BAD = [
    ("set", "energy", "chan-vesee"),
    ("set", "energy", "balloon"),
    ("set", "presmooth", "-1"),
    ("set", "cfl", "7"),
    ("set", "preset", "ct-boone"),
    ("set", "levels", 0),
    ("set", "roi", "1,2"),
    ("set", "stop_at_rest", "yes"),
    ("set", "start", "label:/etc/passwd"),
    ("set", "start", "ball:1,2,3,4 mesh:/x.stl"),
    ("set", "mask", "/etc/passwd"),
    ("set", "foreground", "label:secret.nii"),
    ("set", "edit", "step=3"),
    ("set", "channel", "/etc/passwd"),
    ("set", "smoothness", "x" * 500),
    ("set", "smoothness", True),
    ("mask", "/etc/passwd"),
    ("set_term", 0, "R", 3),
    ("set_term", 5, "balance", 3),
    ("set_term", 0, "balance", "-3"),
    ("set_term", 0, "balance", "2,epsilon=1"),
    ("set_term", 0, "balance", "2 + geodesic"),
]


@pytest.mark.parametrize("request_", BAD, ids=str)
def test_what_is_wrong_changes_nothing_and_says_so_in_one_line(actions, request_):
    before = ask(actions, "step")
    after = ask(actions, *request_)
    assert actions.message and "\n" not in actions.message and len(actions.message) < 700
    assert (after.step, after.settings, after.edits, after.undoable) == (1, before.settings, (), 0)
    assert actions.state()["failed"]


def test_an_energy_is_checked_as_it_is_typed(actions):
    before = actions.session.status
    for typed, wrong in (
        ("chan", "chan"),
        ("chan-vese + ", "blank"),
        ("local-region:R=-1", "R of local-region"),
    ):
        actions.request("type_energy", typed)
        assert wrong in actions.state()["energy_error"], typed
        assert not actions.message and actions.session.status is before
    actions.request("type_energy", "local-region:R=9 + 0.1*geodesic")
    assert actions.state()["energy_error"] == ""
    ask(actions, "type_energy", "chan")
    status = ask(actions, "set", "energy", "local-region:R=9 + 0.1*geodesic")
    assert (
        status.settings.energy == "local-region:R=9 + 0.1*geodesic"
        and actions.state()["energy_error"] == ""
    )
    rows = rows_of(actions)
    assert rows["local-region-0-R"]["value"] == "9" and rows["geodesic-1-scale"]["now"] == "2"
    assert (
        ask(actions, "set_term", 0, "R", "7.5").settings.energy
        == "local-region:R=7.5 + 0.1*geodesic"
    )
    assert ask(actions, "set_term", 0, "R", "").settings.energy == "local-region + 0.1*geodesic"


def test_no_key_is_taken_twice(actions):
    taken = [tool.key for tool in actions.tools.values()]
    taken += [key for feature in actions.features for key in feature.keys()]
    assert len(taken) == len(set(taken)) == len(actions.keys), sorted(taken)


def test_the_flow_says_why_the_program_chose_it():
    said = "momentum, as under chan-vese descent rests too soon or finds less"
    rows = {row["key"]: row["help"] for row in settings_rows(RunConfig(), (), 1.0, flow_why=said)}
    assert rows["flow"].endswith(f" Now {said}.") and "Now" not in rows["energy"]
