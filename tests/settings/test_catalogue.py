"""What is said about settings, terms and flows agrees with itself."""

import pytest

from accelsurf.io.format_functions import FORMAT_FUNCTIONS, functions_of
from accelsurf.measure.contours import CONTOUR_WRITERS
from accelsurf.measure.surface_mesh import SURFACE_WRITERS
from accelsurf.output.label_files import LABEL_WRITERS
from accelsurf.run.makers import FLOW_MAKERS, TERM_MAKERS
from accelsurf.settings.catalogue import acts_on, as_typed, default_shown, entry, help_of, is_switch
from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.entry import entry_of
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.mesh_formats import LABEL_OUTPUTS, mesh_formats
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_fields import TRACK_FORMATS
from accelsurf.track.output.outputs import TRACK_WRITERS

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
def test_every_term_and_flow_is_explained(spec):
    assert len(spec.help) > 10


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


@pytest.mark.parametrize(
    ("entries", "functions"),
    [
        (TERMS, TERM_MAKERS),
        (FLOWS, FLOW_MAKERS),
        (IMAGE_FORMATS, FORMAT_FUNCTIONS),
        (mesh_formats("surface"), SURFACE_WRITERS),
        (mesh_formats("contour"), CONTOUR_WRITERS),
        ([name for name, entry in LABEL_OUTPUTS.items() if not entry.needs_dicom], LABEL_WRITERS),
        (TRACK_FORMATS, TRACK_WRITERS),
    ],
    ids=["terms", "flows", "images", "surfaces", "contours", "label files", "tracks"],
)
def test_every_entry_has_its_function(entries, functions):
    assert list(functions) == list(entries)


@pytest.mark.parametrize("form", IMAGE_FORMATS.values(), ids=lambda form: form.name)
def test_a_format_of_images_is_written_if_its_entry_says_so(form):
    assert (functions_of(form).write is not None) == form.is_written
