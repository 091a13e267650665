"""Settings as files of former versions have them: settings of flows stood beside the flow, as settings of the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from accelsurf.settings.edits import edits_of
from accelsurf.settings.expression import text_of
from accelsurf.settings.flow_specs import AUTO, FLOWS, MOMENTUM, spec_of

#: Settings of the run that became settings of flows: the name there, and the default that they had.
_MOVED: dict[str, tuple[str, Any]] = {
    "k": ("k", 2.0),
    "t0": ("t0", "auto"),
    "lam": ("lam", 1.0),
    "rho": ("rho", 1.0),
    "gravity": ("gravity", 0.0),
    "noise_length": ("noise_length", "auto"),
    "noise_time": ("noise_time", "auto"),
    "sobolev_length": ("length", "auto"),
    "blend": ("blend", 0.8),
}


def modern(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a file as they are written now; settings of the present version stay as they are.

    A setting that had no effect on the flow is left out, as is one with its default. A flow that was to be selected is
    the one with momentum if a setting of it was given.

    Parameters
    ----------
    values : mapping
        Settings of a run by name.

    Raises
    ------
    UsageError
        When an edit among them is none.

    Examples
    --------
    >>> modern({"flow": "sobolev", "k": 2.0, "sobolev_length": 5.0})
    {'flow': 'sobolev:length=5'}
    >>> modern({"k": 3.0, "edit": [{"step": 9, "lam": 2.0}]})["edit"]
    [{'step': 9, 'flow': 'constant-density:k=3,lam=2'}]
    """
    found = dict(values)
    if found.get("resample") is False:  # slices were put on no other grid, as now
        del found["resample"]
    edits = [edit.model_dump() for edit in edits_of(found.get("edit", ()))]
    if any(key in table for table in (found, *edits) for key in _MOVED):
        now = _Flow(AUTO, {})
        for table in (found, *edits):
            now = _replaced(table, now)
        found |= {"edit": edits} if edits else {}
    return found


class _Flow(NamedTuple):
    """A flow in force, and the settings that were given for any flow."""

    name: str
    given: Mapping[str, Any]

    def __str__(self) -> str:
        known = spec_of(self.name).settings
        values = [
            f"{key}={text_of(value) if isinstance(value := self.given[key], float) else value}"
            for key, default in _MOVED.values()
            if key in known and self.given.get(key, default) != default
        ]
        name = MOMENTUM if self.name == AUTO and values else self.name
        return f"{name}:{','.join(values)}" if values else name


def _replaced(table: dict[str, Any], before: _Flow) -> _Flow:
    """Put the flow in place of the settings that moved to it, and return it; one that there is not stays as it is."""
    name = table.get("flow", before.name)
    if not isinstance(name, str) or name not in (AUTO, *FLOWS):
        return before
    given = {new: table.pop(key) for key, (new, _) in _MOVED.items() if key in table}
    after = _Flow(name, {**before.given, **given})
    if "flow" in table or str(after) != str(before):
        table["flow"] = str(after)
    return after
