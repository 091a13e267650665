"""The settings as window and page show them: rows made from the catalogue, and from the terms of the energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from accelsurf.settings import energy_expression
from accelsurf.settings.catalogue import as_typed, entry, help_of, kind_of, label_of, names_of, viewer_settings
from accelsurf.settings.energy_terms import TERMS, Word, examples
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.workplace.amounts import amount, read_in, rounded

Row = dict[str, Any]


def settings_rows(
    settings: RunConfig, terms: Sequence[Mapping[str, Any]], finest: float, of_file: str = "mm"
) -> list[Row]:
    """Return a row for each setting that the viewer shows, in the order of the help; the common ones first.

    Parameters
    ----------
    settings : RunConfig
        In force.
    terms : sequence of mapping
        Of the energy, with every setting resolved, see `Status.terms`.
    finest : float
        Smallest spacing of the image, mm: lengths of sliders are in voxels.
    of_file : str, optional
        Unit of lengths in the file, in which they are shown: mm, um or nm.

    Returns
    -------
    list of dict
        ``key``, ``label``, ``unit``, ``help``; ``kind``: slider, list, text, switch, energy or file; ``group``: empty
        for the common ones; ``value`` in force; ``enabled``: whether it acts on this flow and energy; ``restarts``:
        whether a change begins another run; ``names`` of a list, each with its help; of a slider its ``low`` and
        ``high`` end, ``power``, ``digits``, ``limit``, ``words`` and ``tick``, see `amounts.amount`;
        ``term``: of a setting of a term its place and name, else empty (the channel of a term only where there are
        several); ``now``: the value that is meant by an empty field.
    """
    rows = []
    for where in ("first", "more"):
        for key in viewer_settings("first" if where == "first" else "more"):
            rows.append(_setting_row(key, settings, finest, where == "first", of_file))
            if key == "energy":
                rows += _term_rows(settings.energy, terms)
    return rows


def unit_read(key: str, of_file: str) -> tuple[str, float]:
    """Return the unit in which a setting is shown, and how many of it are one of its own; boxes stay in mm.

    Examples
    --------
    >>> unit_read("smoothness", "um"), unit_read("roi", "um"), unit_read("smoothness", "mm")
    (('um', 1000.0), ('mm', 1.0), ('mm', 1.0))
    """
    said = entry(key)
    return (said.unit, 1.0) if said.metavar == "BOX" else read_in(said.unit, of_file)


def _setting_row(key: str, settings: RunConfig, finest: float, is_first: bool, of_file: str) -> Row:
    said, value, (unit, per) = entry(key), getattr(settings, key), unit_read(key, of_file)
    kind: str = {"energy": "energy", "mask": "file"}.get(key, kind_of(key))
    restarts = said.fixed and said.group is not SettingGroup.FILES
    row: Row = {
        "key": key, "label": label_of(key), "unit": unit, "kind": kind,
        "help": help_of(key) + ("" if per == 1.0 else f" Here in {unit}."),
        "group": "" if is_first else str(said.group), "value": shown_value(key, value, per),
        "enabled": settings.matters(key), "restarts": restarts, "names": _names(key, settings), "term": [],
        "now": "", "low": 0.0, "high": 0.0, "power": 1.0, "digits": 0, "limit": 0.0, "words": [],
        "tick": 0,
    }
    if said.slider is not None:
        scale, one = finest**said.slider.voxel_power, said.slider
        row |= amount(one.low * scale, one.high * scale, value, one.power, one.limit, one.words, per)
    return row


def shown_value(key: str, value: Any, per: float) -> Any:
    """A value as a row has it: numbers of sliders and switches as they are, all else as it would be typed."""
    if per != 1.0 and isinstance(value, float):
        value = rounded(value * per)
    if kind_of(key) == "switch" or (kind_of(key) == "slider" and not isinstance(value, str)):
        return value
    return " ".join(value) if entry(key).repeated else as_typed(value)


def _names(key: str, settings: RunConfig) -> list[dict[str, str]]:
    """What can be chosen, each with what it means."""
    if key == "preset":
        presets = {name: f"{one.summary} Sets {_said(one.settings)}." for name, one in PRESETS.items()}
        return _listed({"": "No preset: its values are the defaults again.", **presets})
    if key == "energy":
        # The run's energy may be an expression that is not in the list.
        return _listed({name: TERMS[name.partition(":")[0]].help for name in examples()} | {settings.energy: ""})
    return _listed(names_of(key)) if kind_of(key) == "list" else []


def _listed(names: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "help": help} for name, help in names.items()]


def _said(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{label_of(key)} {as_typed(value)}" for key, value in values.items())


def _term_rows(energy: str, terms: Sequence[Mapping[str, Any]]) -> list[Row]:
    """A row for each setting that a term of the energy has of its own, below the energy."""
    rows: list[Row] = []
    for place, term in enumerate(energy_expression.parse(energy)):
        known = terms[place] if place < len(terms) and terms[place].get("term") == term.name else {}
        for key, kind in TERMS[term.name].settings.items():
            if key == "channel" and "channels" not in known:
                continue  # there is but one
            names = _listed({"": "", **dict.fromkeys(kind.words, "")}) if isinstance(kind, Word) else []
            rows.append({
                "key": f"{term.name}-{place}-{key}", "label": f"{term.name} {key}", "unit": "", "help": _help_of(kind),
                "kind": "list" if names else "text", "group": "", "value": as_typed(term.settings.get(key)),
                "enabled": True, "restarts": False, "names": names, "term": [place, key],
                "now": _resolved(known.get(key)), "low": 0.0, "high": 0.0, "power": 1.0, "digits": 0, "limit": 0.0,
                "words": [], "tick": 0,
            })  # fmt: skip
    return rows


def _help_of(kind: Any) -> str:
    return f"{kind.help[:1].upper()}{kind.help[1:]}: {kind.expected}."


def _resolved(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else as_typed(value)
