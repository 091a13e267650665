"""The settings as window and page show them, and numbers on sliders: in the unit of the file, with as many digits as
they can resolve. The session, its files and texts copied from it are in mm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings import catalogue
from accelsurf.settings.catalogue import (
    as_typed,
    entry,
    help_of,
    kind_of,
    label_of,
    names_of,
    viewer_settings,
)
from accelsurf.settings.energy_expression import MAX_TERMS, EnergyText
from accelsurf.settings.energy_terms import TERMS, examples
from accelsurf.settings.expression import Number, Word
from accelsurf.settings.flow_specs import spec_of
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import did_you_mean, in_unit
from accelsurf.viewer.actions.tool import AllActions, Feature, finest, short, text, whole
from accelsurf.viewer.core.status import Status

#: Settings that can be changed.
SETTINGS = (*viewer_settings("first"), *viewer_settings("more"))
#: Letters of a value at most.
MAX_VALUE = 400
#: Words with which a start names a file: values from a page may read only files that it was offered.
FILE_WORDS = ("label:", "mesh:", "stroke:")
#: Positions of a slider.
TICKS = 1000
#: Place of the flow in a row's ``term``; terms of the energy count from 0.
OF_FLOW = -1
#: Group that is folded away: the words of the energy and of the solver.
EXPERT = "Expert"
_FIRST = ("preset", "smoothness", "presmooth", "size", "max_volume", "roi")
#: A unit of a setting that is a length, an area or a volume, whatever it is per.
_LENGTH = re.compile(r"mm([23])?(?= |$)")


def amount(
    low: float,
    high: float,
    value: float | str,
    power: float,
    limit: float,
    words: Sequence[str] = (),
    per: float = 1.0,
) -> dict[str, Any]:
    """Return how a number is shown.

    Parameters
    ----------
    low, high : float
        Ends of the slider.
    value : float or str
        In force; a word may stand for it.
    power : float
        Above 1 the slider is finer at its lower end.
    limit : float
        Largest number that can be typed.
    words : sequence of str
        Words that may stand for a number.
    per : float
        How many of the unit that is shown are one of that of the numbers given here.

    Returns
    -------
    dict
        ``low``, ``high``, ``value``, ``limit`` in the unit that is shown, ``power``, ``words``; ``digits`` after the
        point; ``tick``, the position from 0 to `TICKS`.

    Examples
    --------
    >>> row = amount(0.0, 0.0025, 0.0001, power=2.0, limit=1.0, per=1000.0)
    >>> row["high"], row["value"], row["digits"], row["tick"]
    (2.5, 0.1, 3, 200)
    """
    share = 0.0 if isinstance(value, str) else min(max((value - low) / (high - low), 0.0), 1.0)
    return {
        "low": low * per,
        "high": high * per,
        "power": power,
        "digits": digits_of(low * per, high * per),
        "value": value if isinstance(value, str) else rounded(value * per),
        "limit": limit * per,
        "words": list(words),
        "tick": round(TICKS * share ** (1.0 / power)),
    }


def digits_of(low: float, high: float) -> int:
    """Return a slider's digits after the point: thousandths of its upper end, and two digits of its lower end.

    Examples
    --------
    >>> digits_of(0.0, 5.0), digits_of(0.0, 0.0025), digits_of(0.25, 24.0), digits_of(250.0, 24000.0)
    (3, 6, 2, 0)
    """
    needed = [3 - math.floor(math.log10(high))] + (
        [1 - math.floor(math.log10(low))] if low > 0 else []
    )
    return max(0, *needed)


def rounded(value: float) -> float:
    """A number without the rounding error of a change of unit in its last digits.

    Examples
    --------
    >>> rounded(0.0003 * 1000.0), rounded(float("inf"))
    (0.3, inf)
    """
    return float(f"{value:.12g}")


def read_in(unit: str, of_file: str) -> tuple[str, float]:
    """Return the unit in which a number is read, and how many of it are one of its own: the file's unit for lengths.

    Examples
    --------
    >>> read_in("mm2 per unit of flow time", "um"), read_in("voxels", "um"), read_in("1/mm", "nm")
    (('um2 per unit of flow time', 1000000.0), ('voxels', 1.0), ('1/mm', 1.0))
    """
    found = _LENGTH.match(unit)
    if found is None:
        return unit, 1.0
    return f"{of_file}{unit[2:]}", in_unit(1.0, of_file, int(found.group(1) or 1))


def from_read(value: Any, per: float) -> Any:
    """Return a value, typed or set in the unit that is read, in its own unit; anything but a number stays as it is.

    Examples
    --------
    >>> from_read("0.6", 1000.0), from_read("2vox", 1000.0), from_read(0.1, 1.0)
    (0.0006, '2vox', 0.1)
    """
    if per == 1.0 or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return value
    try:
        return rounded(float(value) / per)
    except (ValueError, OverflowError):
        return value


Row = dict[str, Any]
#: Values of a row that does not say otherwise.
DEFAULTS: Row = {
    "unit": "",
    "group": "",
    "enabled": True,
    "restarts": False,
    "names": [],
    "term": [],
    "now": "",
    "low": 0.0,
    "high": 0.0,
    "power": 1.0,
    "digits": 0,
    "limit": 0.0,
    "words": [],
    "tick": 0,
}


def settings_rows(
    settings: RunConfig,
    terms: Sequence[Mapping[str, Any]],
    finest: float,
    of_file: str = "mm",
    flow_why: str = "",
) -> list[Row]:
    """Return a row for each setting that the viewer shows: common ones, then the energy's and the solver's.

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
    flow_why : str, optional
        As `Status.flow_why`, which the help of the flow ends with.

    Returns
    -------
    list of dict
        ``key``, ``label``, ``unit``, ``help``; ``kind``: slider, list, text, switch or energy; ``group``: empty for
        the common ones, else `EXPERT`; ``value`` in force; ``enabled``: whether it acts on this flow and energy;
        ``restarts``: whether a change begins another run; ``names`` of a list, each with its help; of a slider its
        ``low`` and ``high`` end, ``power``, ``digits``, ``limit``, ``words`` and ``tick``, see `amount`; ``term``: of a
        setting of a term or the flow its place and name, else empty (the channel of a term only where there are
        several); ``now``: the value that is meant by an empty field.
    """
    others = [
        key for key in (*viewer_settings("first"), *viewer_settings("more")) if key not in _FIRST
    ]
    rows = []
    for key in (*_FIRST, *others):
        rows.append(_setting_row(key, settings, finest, key in _FIRST, of_file))
        if key == "flow" and flow_why:
            rows[-1]["help"] += f" Now {flow_why}."
        if key == "energy":
            rows += _term_rows(settings, terms)
        if key == "flow":
            rows += _flow_rows(settings)
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
    said, value = entry(key), getattr(settings, key)
    unit, per = unit_read(key, of_file)
    kind = "energy" if key == "energy" else kind_of(key)
    row: Row = DEFAULTS | {
        "key": key,
        "label": label_of(key),
        "unit": unit,
        "kind": kind,
        "help": help_of(key) + ("" if per == 1.0 else f" Here in {unit}."),
        "group": "" if is_first else EXPERT,
        "value": shown_value(key, value, per),
        "enabled": settings.matters(key),
        "restarts": said.fixed,
        "names": _names(key, settings),
    }
    if said.slider is not None:
        scale, slider = finest**said.slider.voxel_power, said.slider
        row |= amount(
            slider.low * scale,
            slider.high * scale,
            value,
            slider.power,
            slider.limit,
            slider.words,
            per,
        )
    return row


def shown_value(key: str, value: Any, per: float) -> Any:
    """A value as a row has it: numbers of sliders and switches as they are, all else as it would be typed."""
    if per != 1.0 and isinstance(value, float):
        value = rounded(value * per)
    if kind_of(key) == "switch" or (kind_of(key) == "slider" and not isinstance(value, str)):
        return value
    return " ".join(value) if entry(key).repeated else as_typed(value)


def _names(key: str, settings: RunConfig) -> list[dict[str, str]]:
    """Return the choices, each with its meaning."""
    if key == "preset":
        presets = {
            name: f"{preset.summary} Sets {_said(preset.settings)}."
            for name, preset in PRESETS.items()
        }
        return _listed({"": "No preset: its values are the defaults again.", **presets})
    if key == "energy":
        # The run's energy may be an expression that is not in the list.
        return _listed(
            {name: TERMS[name.partition(":")[0]].help for name in examples()}
            | {settings.energy: ""}
        )
    if key == "flow":
        return _listed({**names_of(key), settings.flow: names_of(key)[settings.flow.name]})
    return _listed(names_of(key)) if kind_of(key) == "list" else []


def _listed(names: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "help": help} for name, help in names.items()]


def _said(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{label_of(key)} {as_typed(value)}" for key, value in values.items())


def _term_rows(settings: RunConfig, terms: Sequence[Mapping[str, Any]]) -> list[Row]:
    """A row for each setting that a term of the energy has of its own, below the energy."""
    rows: list[Row] = []
    for place, term in enumerate(settings.terms):
        known = terms[place] if place < len(terms) and terms[place].get("term") == term.name else {}
        for key, kind in TERMS[term.name].settings.items():
            if key == "channel" and "channels" not in known:
                continue  # there is but one
            rows.append(_row_of(f"{term.name}-{place}-{key}", f"{term.name} {key}", kind))
            rows[-1] |= {"value": as_typed(term.settings.get(key)), "term": [place, key]}
            now = known.get(key)
            rows[-1]["now"] = f"{now:.4g}" if isinstance(now, float) else as_typed(now)
    return rows


def _flow_rows(settings: RunConfig) -> list[Row]:
    """A row for each setting that the flow has of its own, below the flow; before it is selected, those of momentum."""
    rows: list[Row] = []
    for key, kind in spec_of(settings.flow.name).settings.items():
        rows.append(_row_of(f"flow-{key}", label_of(key), kind))
        value = as_typed(settings.flow.settings.get(key))
        rows[-1] |= {"value": value, "term": [OF_FLOW, key]}
    return rows


def _row_of(key: str, label: str, kind: Number | Word) -> Row:
    """A row for a setting of a term or a flow."""
    names = _listed({"": "", **dict.fromkeys(kind.words, "")}) if isinstance(kind, Word) else []
    return DEFAULTS | {
        "key": key,
        "label": label,
        "names": names,
        "help": f"{kind.help[:1].upper()}{kind.help[1:]}: {kind.expected}.",
        "group": EXPERT,
        "kind": "list" if names else "text",
    }


class SettingsFeature(Feature):
    """Changes settings of the run; those that are fixed while it runs begin another."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._finest, self._unit = finest(actions.scene.geometry), actions.scene.unit
        self._shown: tuple[RunConfig, Sequence[Mapping[str, Any]]] | None = None
        self._rows: list[Row] = []
        self._energy_error = ""

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"set": self._set, "set_term": self._set_term, "type_energy": self._type_energy}

    def state(self, status: Status) -> dict[str, Any]:
        now = (status.settings, status.terms)
        if self._shown is None or any(a is not b for a, b in zip(now, self._shown, strict=True)):
            self._shown = now
            self._rows = settings_rows(
                status.settings, status.terms, self._finest, self._unit, status.flow_why
            )
        return {"settings": self._rows, "energy_error": self._energy_error}

    # -- changes ------------------------------------------------------------------------------------------

    def _set(self, key: Any, value: Any) -> None:
        if not isinstance(key, str) or key not in SETTINGS:
            raise UsageError(
                f"set: {short(key)}: there is no such setting", did_you_mean(short(key), SETTINGS)
            )
        self._change(key, self._checked(key, from_read(value, unit_read(key, self._unit)[1])))

    def _checked(self, key: str, value: Any) -> Any:
        """A value as the configuration takes it."""
        if catalogue.is_switch(key):
            if not isinstance(value, bool):
                raise UsageError(f"{key}: {short(value)} was given, expected true or false")
            return value
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            value = str(value)
        typed = text(value, MAX_VALUE)
        if any(start in typed for start in FILE_WORDS):
            raise UsageError(
                f"{key}: {short(value)} was given, expected no file", "the command line takes files"
            )
        if not typed:
            return catalogue.default_of(key)
        return tuple(typed.split()) if entry(key).repeated else typed

    def _change(self, key: str, value: Any) -> None:
        """Change a setting from here on, or begin another run where it is fixed; the same value changes nothing."""
        session = self.actions.session
        if entry(key).fixed:
            if key == "preset" or as_typed(value) != as_typed(
                getattr(session.status.settings, key)
            ):
                self.actions.ask(session.restart_with(**{key: value}))
            return
        if key == "energy":
            self._energy_error = ""
        self.actions.ask(session.change(**{key: value}))

    def _set_term(self, place: Any, key: Any, value: Any) -> None:
        place, key = whole(place, OF_FLOW, MAX_TERMS), text(key, 40)
        value = (
            str(value)
            if isinstance(value, (int, float)) and not isinstance(value, bool)
            else text(value, 40)
        )
        settings = self.actions.session.status.settings
        if place == OF_FLOW:
            self._change("flow", settings.flow.with_setting(key, value))
        else:
            self._change("energy", settings.energy.with_setting(place, key, value))

    def _type_energy(self, typed: Any) -> None:
        """Check an energy that is being typed; the run goes on with its own."""
        try:
            EnergyText(text(typed, MAX_VALUE))
        except UsageError as error:
            self._energy_error = error.message + (f" ({error.hint})" if error.hint else "")
        else:
            self._energy_error = ""
