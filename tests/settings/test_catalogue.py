"""What is said about settings, terms and flows agrees with itself."""

import dataclasses

import pytest

from accelsurf.settings.catalogue import acts_on, as_typed, default_shown, entry, help_of, is_switch
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.entry import entry_of
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.mesh_formats import MESH_FORMATS
from accelsurf.settings.registry import Registry, load
from accelsurf.settings.run_config import RunConfig

SETTINGS = list(SettingFields.model_fields)


@pytest.mark.parametrize("key", SETTINGS)
def test_flows_and_terms_use_the_settings_that_are_theirs(key):
    users = {
        "flow": [name for name, flow in FLOWS.items() if key in flow.uses],
        "term": [name for name, term in TERMS.items() if key in (*term.uses, *term.uses_to_learn)],
    }
    scope = entry(key).scope
    assert {kind for kind, names in users.items() if names} == (
        {scope} if scope in users else set()
    )
    assert list(acts_on(key)) == users.get(scope, [])


def test_no_flow_or_term_uses_a_setting_that_there_is_not():
    used = {key for flow in FLOWS.values() for key in flow.uses}
    used |= {key for term in TERMS.values() for key in (*term.uses, *term.uses_to_learn)}
    assert used <= set(SETTINGS)


@pytest.mark.parametrize("spec", [*TERMS.values(), *FLOWS.values()], ids=lambda spec: spec.name)
def test_every_maker_is_there(spec):
    assert callable(load(spec.make)) and len(spec.help) > 10


@pytest.mark.parametrize("spec", list(TERMS.values()), ids=lambda spec: spec.name)
def test_examples_are_energies_and_settings_of_terms_are_explained(spec):
    assert spec.example is None or RunConfig(energy=spec.example).energy == spec.example
    assert all(len(kind.help) > 10 and kind.expected for kind in spec.settings.values())


@pytest.mark.parametrize("key", SETTINGS)
def test_help_names_the_unit_and_defaults_can_be_typed(key):
    said = entry(key)
    if said.unit:
        word = {"%": "percent", "1/mm": "per mm", "flow time": "time"}.get(said.unit, said.unit)
        assert word.split()[0] in help_of(key).lower()
    shown = default_shown(key)
    if shown and not is_switch(key) and shown != "none":
        assert getattr(RunConfig(**{key: shown}), key) == SettingFields.model_fields[key].default
    assert said.repeated == (SettingFields.model_fields[key].default in ((), ("center",)))


def test_what_is_shown_of_values():
    values = {"": None, "none": (), "yes": True, "0.001": 1e-3, "a,b": ("a", "b"), "7": 7}
    assert {text: as_typed(value) for text, value in values.items()} == {
        text: text for text in values
    }


def test_a_field_without_an_entry_is_refused():
    from pydantic.fields import FieldInfo

    with pytest.raises(TypeError, match="made by"):
        entry_of(FieldInfo(default=1))


def test_a_registration_can_be_removed_twice():
    registry = Registry("flow", *FLOWS.values())
    first = next(iter(FLOWS.values()))
    with pytest.raises(ValueError, match="a flow constant-density already"):
        registry.register(first)
    handle = Registry("flow").register(first)
    handle.remove()
    handle.remove()


@pytest.mark.parametrize("formats", [IMAGE_FORMATS, MESH_FORMATS], ids=["images", "meshes"])
def test_functions_that_a_format_names_are_there(formats):
    for form in formats.values():
        values = (getattr(form, field.name) for field in dataclasses.fields(form))
        assert all(
            load(value)
            for value in values
            if isinstance(value, str) and value.startswith("accelsurf.")
        )
