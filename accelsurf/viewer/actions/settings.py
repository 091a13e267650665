"""The settings of the run: rows of the catalogue, energies as they are typed, presets, the mask."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings import energy_expression
from accelsurf.settings.catalogue import as_typed, default_of, entry, is_switch, viewer_settings
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.file_formats import IMAGE_FORMATS
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
#: Seconds between two looks at the folders of masks, and how many files are offered at most.
LOOK_SECONDS, MAX_FILES = 5.0, 200


class SettingsFeature(Feature):
    """Changes settings of the run; those that are fixed while it runs begin another, those of files touch no run."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._finest, self._unit = finest(actions.scene.geometry), actions.scene.unit
        self._shown: tuple[RunConfig, Sequence[Mapping[str, Any]], tuple[str, ...]] | None = None
        self._rows: list[Row] = []
        self._energy_error = ""
        self._masks: dict[str, Path] = {}
        self._looked_at = -LOOK_SECONDS

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"set": self._set, "set_term": self._set_term, "type_energy": self._type_energy, "mask": self._mask}

    def state(self, status: Status) -> dict[str, Any]:
        masks = self._offered_masks(status)
        now = (status.settings, status.terms, masks)
        if self._shown is None or any(a is not b for a, b in zip(now[:2], self._shown[:2], strict=True)) or (
            masks != self._shown[2]
        ):
            self._shown = now
            self._rows = settings_rows(status.settings, status.terms, self._finest, self._unit)
            for row in self._rows:
                if row["kind"] == "file":
                    row["names"] = [{"name": name, "help": str(self._masks.get(name, ""))} for name in masks]
                    row["value"] = Path(row["value"]).name
        return {"settings": self._rows, "energy_error": self._energy_error}

    # -- changes ------------------------------------------------------------------------------------------

    def _set(self, key: Any, value: Any) -> None:
        if not isinstance(key, str) or key not in SETTINGS:
            raise UsageError(f"set: {short(key)}: there is no such setting", did_you_mean(short(key), SETTINGS))
        if key == "mask" and value != "":
            raise UsageError("mask: a file is chosen by the request mask")
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
        """Change a setting from here on, or begin another run where it is fixed; the same value changes nothing.

        Which files are written may change at any time.
        """
        session = self.actions.session
        if entry(key).group is SettingGroup.FILES:
            self.actions.ask(session.change_files(**{key: value}))
            return
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

    # -- the mask -----------------------------------------------------------------------------------------

    def _mask(self, name: Any) -> None:
        """Use a mask that was offered by its name; "" uses none."""
        known = text(name, MAX_VALUE)
        if known and known not in self._masks:
            raise UsageError(f"mask: {short(name)} was given, expected one of the files that are offered")
        self.use_mask(self._masks[known] if known else None)

    def use_mask(self, path: Path | None) -> None:
        """Use a label map as the mask, or none; for a window, in which the person has chosen the file."""
        self._change("mask", None if path is None else str(path))

    def _offered_masks(self, status: Status) -> tuple[str, ...]:
        """Names of the files beside the image and among those that were saved that may be masks."""
        if time.monotonic() - self._looked_at >= LOOK_SECONDS:
            self._looked_at = time.monotonic()
            image = self.actions.session.source
            folders = [folder for folder in (image and image.parent, self.actions.folder) if folder is not None]
            self._masks = {path.name: path for folder in folders for path in _images(folder) if path != image}
        given = () if status.settings.mask is None else (Path(status.settings.mask).name,)
        return tuple(dict.fromkeys(("", *self._masks, *given)))


def _images(folder: Path) -> list[Path]:
    """The image files of a folder, in order of their names; none where it cannot be read."""
    endings = tuple(ending for kind in IMAGE_FORMATS.values() for ending in kind.suffixes)
    try:
        found = sorted(path for path in folder.iterdir() if path.name.lower().endswith(endings) and path.is_file())
    except OSError:
        return []
    return found[:MAX_FILES]
