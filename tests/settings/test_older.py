"""Settings as files of the former version have them: nine settings of flows stood beside the flow."""

import itertools

import numpy as np
import pytest

from accelsurf.errors import UsageError
from accelsurf.output.given_image import settings_of
from accelsurf.output.reports import had_settings
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.older import modern
from accelsurf.settings.run_config import RunConfig

#: As every run.toml of the former version had them.
DEFAULTS = {
    "k": 2.0,
    "t0": "auto",
    "lam": 1.0,
    "rho": 1.0,
    "gravity": 0.0,
    "noise_length": "auto",
    "noise_time": "auto",
    "sobolev_length": "auto",
    "blend": 0.8,
}
OTHER = {
    "k": 3.5,
    "t0": 0.5,
    "lam": 2.0,
    "rho": 0.25,
    "gravity": 0.1,
    "noise_length": 6.0,
    "noise_time": 20.0,
    "sobolev_length": 4.0,
    "blend": 0.5,
}
#: Names of them now, where they are others.
NAMES = {"sobolev_length": "length"}


def written(values):
    """TOML of flat settings, with edits."""
    edits = values.pop("edit", [])
    lines = [f"{key} = {value!r}".replace("'", '"') for key, value in values.items()]
    for edit in edits:
        lines += [
            "[[edit]]",
            *(f"{key} = {value!r}".replace("'", '"') for key, value in edit.items()),
        ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("flow", ["auto", *FLOWS])
def test_a_file_with_every_default_says_the_flow_alone(flow, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(written({"flow": flow, **DEFAULTS, "cfl": 0.4}))
    assert RunConfig.from_toml(path) == RunConfig(flow=flow, cfl=0.4)


@pytest.mark.parametrize("flow", FLOWS)
@pytest.mark.parametrize("seed", range(4))
def test_settings_of_a_flow_go_to_it_and_those_without_effect_are_left_out(flow, seed, tmp_path):
    some = np.random.default_rng(seed).permutation(list(OTHER))[: 3 + seed]
    path = tmp_path / "run.toml"
    path.write_text(written({"flow": flow, **DEFAULTS, **{str(key): OTHER[key] for key in some}}))
    config = RunConfig.from_toml(path)
    assert config.flow.name == flow
    expected = {NAMES.get(key, key): OTHER[key] for key in some}
    known = FLOWS[flow].settings
    assert config.flow.settings == {key: v for key, v in expected.items() if key in known}


@pytest.mark.parametrize("key", OTHER)
def test_of_an_open_flow_a_setting_of_momentum_brings_momentum(key):
    has_it = key in FLOWS["constant-density"].settings
    wanted = f"constant-density:{key}={OTHER[key]:g}" if has_it else "auto"
    assert modern({"flow": "auto", **DEFAULTS, key: OTHER[key]}) == {"flow": wanted}


def test_edits_change_the_flow_in_force(tmp_path):
    path = tmp_path / "run.toml"
    edits = [
        {"step": 3, "lam": 2.0},
        {"step": 5, "flow": "gradient"},
        {"step": 6, "cfl": 0.3},
        {"step": 7, "flow": "flowable-mass", "gravity": 0.1},
        {"step": 9, "k": 2.0},
    ]
    path.write_text(written({**DEFAULTS, "k": 3.0, "edit": edits}))
    config = RunConfig.from_toml(path)
    flows = [config.at(step).flow for step in (0, 3, 5, 6, 7, 9)]
    assert flows == [
        "constant-density:k=3",
        "constant-density:k=3,lam=2",
        "gradient",
        "gradient",
        "flowable-mass:k=3,lam=2,gravity=0.1",
        "flowable-mass:lam=2,gravity=0.1",
    ]
    assert config.edit[2].settings == {"cfl": 0.3}
    assert RunConfig(**modern({"edit": ["step=3 lam=2"]})).at(3).flow == "constant-density:lam=2"


def test_a_report_of_the_former_version_is_read_and_compared(tmp_path):
    config = RunConfig(flow="constant-density:k=3")
    flat = {**RunConfig(flow="constant-density").model_dump(mode="json"), **DEFAULTS, "k": 3.0}
    assert settings_of({"config": flat}, tmp_path) == config
    assert had_settings({"config": flat}, config)
    assert not had_settings({"config": flat}, RunConfig(flow="constant-density"))
    assert not had_settings({"config": {**flat, "edit": 3}}, config)


def test_present_settings_stay_as_they_are():
    values = RunConfig(flow="sobolev:length=3", edit=["step=3 flow=gradient"]).model_dump()
    assert modern(values) == values


def test_resampling_of_slices_is_gone():
    assert modern({"resample": False, "cfl": 0.3}) == {"cfl": 0.3}
    with pytest.raises(UsageError, match="resample: there is no such setting"):
        RunConfig(**modern({"resample": True}))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"flow": "nope", "k": 3}, "flow: nope was given"),
        ({"flow": 3, "k": 3}, "flow: 3 was given"),
        ({"flow": ["gradient"], "k": 3}, "flow: "),
        ({"flow": "constant-density", "k": "3,rho=x"}, "rho of constant-density"),
        ({"k": True}, "k of constant-density"),
        ({"k": [1]}, "k of constant-density"),
        ({"edit": 3, "k": 3}, "edit: "),
        ({"edit": [{"step": 1, "flow": {}, "k": 3}]}, "k: there is no such setting"),
    ],
)
def test_what_is_wrong_in_a_file_is_one_clear_line(values, words):
    with pytest.raises(UsageError) as caught:
        RunConfig(**modern(values))
    assert words in caught.value.message and "\n" not in caught.value.message


def test_as_settings_they_are_refused_with_the_way_they_are_written_now():
    for key, _ in itertools.islice(DEFAULTS.items(), 7):
        with pytest.raises(UsageError, match=f"^{key}: there is no such setting") as caught:
            RunConfig(**{key: 1})
        assert f":{key}=" in caught.value.hint
