"""The settings of the run: rows of the catalogue, energies as they are typed, presets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings import energy_expression
from accelsurf.settings.catalogue import as_typed, default_of, entry, is_switch, viewer_settings
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.wording import did_you_mean
from accelsurf.viewer.actions.settings_rows import Row, from_read, settings_rows, unit_read
from accelsurf.viewer.actions.tool import AllActions, Feature, finest, short, text, whole
from accelsurf.viewer.core.status import Status

#: Settings that can be changed.
SETTINGS = (*viewer_settings("first"), *viewer_settings("more"))
#: Letters of a value at most.
MAX_VALUE = 400
#: Words with which a start names a file: what a page sends must read none but those that it was offered.
FILE_WORDS = ("label:", "mesh:", "stroke:")


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
            self._rows = settings_rows(status.settings, status.terms, self._finest, self._unit, status.flow_why)
        return {"settings": self._rows, "energy_error": self._energy_error}

    # -- changes ------------------------------------------------------------------------------------------

    def _set(self, key: Any, value: Any) -> None:
        if not isinstance(key, str) or key not in SETTINGS:
            raise UsageError(f"set: {short(key)}: there is no such setting", did_you_mean(short(key), SETTINGS))
        self._change(key, self._checked(key, from_read(value, unit_read(key, self._unit)[1])))

    def _checked(self, key: str, value: Any) -> Any:
        """A value as the configuration takes it."""
        if is_switch(key):
            if not isinstance(value, bool):
                raise UsageError(f"{key}: {short(value)} was given, expected true or false")
            return value
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            value = str(value)
        typed = text(value, MAX_VALUE)
        if any(start in typed for start in FILE_WORDS):
            raise UsageError(f"{key}: {short(value)} was given, expected no file", "the command line takes files")
        if not typed:
            return default_of(key)
        return tuple(typed.split()) if entry(key).repeated else typed

    def _change(self, key: str, value: Any) -> None:
        """Change a setting from here on, or begin another run where it is fixed; the same value changes nothing."""
        session = self.actions.session
        if entry(key).fixed:
            if key == "preset" or as_typed(value) != as_typed(getattr(session.status.settings, key)):
                self.actions.ask(session.restart_with(**{key: value}))
            return
        if key == "energy":
            self._energy_error = ""
        self.actions.ask(session.change(**{key: value}))

    def _set_term(self, place: Any, key: Any, value: Any) -> None:
        place, key = whole(place, 0, energy_expression.MAX_TERMS), text(key, 40)
        value = str(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else text(value, 40)
        energy = self.actions.session.status.settings.energy
        self._change("energy", energy_expression.with_setting(energy, place, key, value))

    def _type_energy(self, typed: Any) -> None:
        """Check an energy that is being typed; the run goes on with its own."""
        try:
            energy_expression.parse(text(typed, MAX_VALUE))
        except UsageError as error:
            self._energy_error = error.message + (f" ({error.hint})" if error.hint else "")
        else:
            self._energy_error = ""
