"""Entries of settings by name: for help, messages, the viewer and the reference pages."""

from __future__ import annotations

from typing import Any, Literal

from accelsurf.settings.energy_terms import TERMS
from accelsurf.settings.entry import SettingEntry, SettingGroup, entry_of, full_help
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.flow_specs import FLOWS

#: Groups whose settings the viewer shows: the image has been read by then, and files are not written yet.
VIEWER_GROUPS = (SettingGroup.RUN, SettingGroup.FLOW)


def entry(key: str) -> SettingEntry:
    """The entry of a setting: all but its type, bounds, default and help."""
    return entry_of(SettingFields.model_fields[key])


def help_of(key: str) -> str:
    """The help of a setting, with the registered terms or flows.

    Examples
    --------
    >>> help_of("cfl")
    'How far the surface may move in one step, in voxels: larger takes fewer steps and is less exact.'
    """
    return full_help(SettingFields.model_fields[key])


def default_of(key: str) -> Any:
    """The value that a setting has unless it is given."""
    return SettingFields.model_fields[key].default


def as_typed(value: Any) -> str:
    """A value as it would be typed; empty for None.

    Examples
    --------
    >>> as_typed(0.5), as_typed(("ply", "stl")), as_typed(False), as_typed(())
    ('0.5', 'ply,stl', 'no', 'none')
    """
    if value is None:
        return ""
    if value == ():
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return (
        ",".join(value)
        if isinstance(value, tuple)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value)
    )


def default_shown(key: str) -> str:
    """The default of a setting as it would be typed; empty where it has none."""
    return as_typed(default_of(key))


def is_switch(key: str) -> bool:
    """Return True if a setting is true or false."""
    return SettingFields.model_fields[key].annotation is bool


def viewer_settings(where: Literal["first", "more"]) -> tuple[str, ...]:
    """The settings that the viewer shows first, or folded under "more", in the order of the help.

    Examples
    --------
    >>> viewer_settings("first")
    ('preset', 'energy', 'smoothness', 'presmooth', 'size', 'answer', 'max_volume', 'levels', 'roi')
    """
    shown = [key for key in SettingFields.model_fields if entry(key).viewer == where]
    return tuple(key for group in VIEWER_GROUPS for key in shown if entry(key).group is group)


def kind_of(key: str) -> Literal["switch", "slider", "list", "text"]:
    """Return the kind of control that the viewer has for a setting.

    Examples
    --------
    >>> [kind_of(key) for key in ("flow", "cfl", "seed", "reproducible")]
    ['list', 'slider', 'text', 'switch']
    """
    if is_switch(key):
        return "switch"
    return "slider" if entry(key).slider is not None else "list" if entry(key).choice else "text"


def label_of(key: str) -> str:
    """The name of a setting, as its option but for the dashes.

    Examples
    --------
    >>> label_of("max_volume")
    'max volume'
    """
    return key.replace("_", " ")


def names_of(key: str) -> dict[str, str]:
    """The words that a setting takes, with their meaning where the help tells it; empty for numbers and free text.

    Examples
    --------
    >>> list(names_of("mesh_space")), names_of("cfl")
    (['lps', 'ras'], {})
    """
    known = entry(key).names
    schema = SettingFields.model_json_schema()["properties"][key]
    words = dict.fromkeys(word for word in enumerated(schema) if isinstance(word, str))
    return {**dict.fromkeys(words, ""), **(known() if known is not None else {})}


def enumerated(schema: Any) -> list[Any]:
    """The values that a JSON schema lists, at any depth."""
    if isinstance(schema, list):
        return [value for part in schema for value in enumerated(part)]
    if not isinstance(schema, dict):
        return []
    values = [*schema.get("enum", ()), *([schema["const"]] if "const" in schema else ())]
    parts = (part for key, part in schema.items() if key not in ("enum", "const", "default"))
    return values + [value for part in parts for value in enumerated(part)]


def energy_settings() -> tuple[str, ...]:
    """Settings of the named energies; an energy of the user's own does not use them."""
    return tuple(
        key for key in SettingFields.model_fields if entry(key).scope in ("energy", "term")
    )


def acts_on(key: str) -> tuple[str, ...]:
    """Names of the flows and terms that a setting acts on; none where it acts on every run or energy.

    Examples
    --------
    >>> acts_on("noise"), acts_on("epsilon"), acts_on("cfl")
    (('constant-density', 'flowable-mass'), ('chan-vese', 'local-region'), ())
    """
    match entry(key).scope:
        case "flow":
            return tuple(name for name, flow in FLOWS.items() if key in flow.uses)
        case "term":
            return tuple(
                name for name, term in TERMS.items() if key in (*term.uses, *term.uses_to_learn)
            )
        case _:
            return ()
