"""Settings that change while the run goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import choices, sliders
from accelsurf.settings.energy_terms import examples
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.workplace.checks import MAX_LETTERS, number, short, word
from accelsurf.viewer.workplace.feature import Feature

#: Settings that can be changed, those of sliders and lists.
SETTINGS = (*sliders(), *choices())
#: Largest magnitude of a setting.
_MAX_SETTING = 1e6


class SettingsFeature(Feature):
    """Changes settings of the run."""

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"set": self._set}

    def state(self, status: Status) -> dict[str, Any]:
        return {
            **{key: getattr(status.settings, key) for key in SETTINGS},
            "flows": list(FLOWS),
            # The run's energy may be an expression that is not in the list.
            "energies": list(dict.fromkeys((*examples(), status.settings.energy))),
        }

    def _set(self, key: Any, value: Any) -> None:
        key = word(key, SETTINGS)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            value = str(number(value, -_MAX_SETTING, _MAX_SETTING))
        if not isinstance(value, str) or len(value) > MAX_LETTERS or not value.isprintable():
            raise UsageError(f"{key}: {short(value)} was given, expected a number or a word")
        self.workplace.ask(self.workplace.session.change(**{key: value.strip()}))
