"""Everything a tracking needs, validated once: how objects are followed, and the run on each frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, ValidationError

from accelsurf.errors import UsageError
from accelsurf.settings import catalogue, messages, toml
from accelsurf.settings.entry import SettingEntry, SettingGroup, entry_of
from accelsurf.settings.expression import MAGNITUDES
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.older import modern
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_fields import TrackFields

#: Table of a configuration file with the settings of tracking; settings of the run are at its top level.
TABLE = "track"
#: Friction that ``auto`` is, per frame (docs/decisions/0033-momentum-between-frames.md has the measurements).
AUTO_FRICTION = 0.5

#: Settings of a run that mean another thing in a tracking, or nothing: where both have one, it is that of tracking.
_NOT_OF_FRAMES = (
    *TrackFields.model_fields,
    "time_index",
    "channels_from_time",
    "edit",
    "refine",
    "level",
)
_GROUPS_OF_FRAMES = (SettingGroup.RUN, SettingGroup.FLOW, SettingGroup.IMAGE)
#: Settings of the run on each frame.
FRAME_SETTINGS = tuple(
    key
    for key in SettingFields.model_fields
    if key not in _NOT_OF_FRAMES and catalogue.entry(key).group in _GROUPS_OF_FRAMES
)


class TrackConfig(TrackFields):
    """Settings of a tracking, and in ``run`` the settings of the run on each frame.

    Parameters
    ----------
    **values
        Settings by name: of tracking, or of `RunConfig`. Where both have one (``friction``) it is that of tracking.
    run : RunConfig, optional
        Under the other settings of the run.

    Raises
    ------
    UsageError
        When a key is unknown or a value is out of bounds.

    Examples
    --------
    >>> config = TrackConfig(start="ball:0,0,0,20", model="none")
    >>> config.model, config.run.start, config.gains
    ('none', ('ball:0,0,0,20',), (1.0, 1.0))
    >>> print(config.to_toml())
    energy = "chan-vese"
    ...
    [track]
    frame = 0
    ...
    """

    model_config = ConfigDict(defer_build=False)

    run: RunConfig = RunConfig()

    def __init__(self, **values: Any) -> None:
        of_tracking = {
            key: value for key, value in values.items() if key in TrackFields.model_fields
        }
        others = {
            key: value for key, value in values.items() if key not in of_tracking and key != "run"
        }
        run = values.get("run") or RunConfig()
        try:
            values = {**of_tracking, "run": run.replace(**others) if others else run}
            super().__init__(**values)
        except ValidationError as error:
            raise messages.usage_error(error, of_tracking, TrackFields) from None
        self._check_together()

    def _check_together(self) -> None:
        """Refuse values that are valid one by one but not together."""
        low, high = MAGNITUDES
        for key in ("friction", "frame_time"):
            value = getattr(self, key)
            if isinstance(value, float) and value and not low <= value <= high:
                raise UsageError(
                    f"{key}: {value:g} was given, expected a size of {low:g} to {high:g}"
                )
        before, after = self.direction == "backward", self.direction == "forward"
        for correction in self.correct:
            if (before and correction.frame > self.frame) or (
                after and correction.frame < self.frame
            ):
                raise UsageError(
                    f"correct: frame {correction.frame} was given, the tracking goes {self.direction} from frame "
                    f"{self.frame}",
                    "give --direction both, or another --frame",
                )
        given = [
            key
            for key in ("time_index", "label_group", "checkpoint")
            if getattr(self.run, key) is not None
        ]
        given += [key for key in ("channels_from_time", "save_sdf") if getattr(self.run, key)]
        if given:
            raise UsageError(
                f"{given[0]}: it was given for a sequence, it is of a single image", "leave it out"
            )

    @property
    def gains(self) -> tuple[float, float]:
        """Gains of the observer: of the surface and of the velocity."""
        psi, velocity = (float(text) for text in self.observer.split(","))
        return psi, velocity

    def friction_for(self, times: Sequence[float]) -> float:
        """Friction per unit of time for a sequence with these times of its frames."""
        if self.friction != "auto":
            return self.friction
        if len(times) < 2:
            return 0.0
        return AUTO_FRICTION * (len(times) - 1) / (times[-1] - times[0])

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some settings changed, of tracking or of the run, validated again."""
        of_tracking = {key: getattr(self, key) for key in TrackFields.model_fields}
        return type(self)(**{**of_tracking, "run": self.run, **changes})

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a configuration file: settings of the run, and settings of tracking in its table ``track``.

        Raises
        ------
        UsageError
            When the file cannot be read, has an unknown key, or a value is out of bounds.
        """
        run, track = split_table(toml.read_toml(path))
        return cls(run=RunConfig(**modern(run)), **track)

    def to_toml(self) -> str:
        """Return the configuration as TOML; `from_toml` gives an equal object back."""
        of_tracking = self.model_dump(exclude={"run", "correct"})
        table = toml.toml_text(of_tracking, tables=())
        written = (
            toml.toml_text(correction.model_dump(), tables=()) for correction in self.correct
        )
        corrections = "".join(f"\n[[{TABLE}.correct]]\n{text}" for text in written)
        return f"{self.run.to_toml()}\n[{TABLE}]\n{table}{corrections}"


def split_table(values: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the settings of a configuration file into settings of the run and of tracking.

    Raises
    ------
    UsageError
        When the table is none, or has an unknown key.
    """
    table = values.get(TABLE, {})
    if not isinstance(table, dict):
        raise UsageError(
            f"{TABLE}: a table was expected",
            f"write [{TABLE}], and the settings of tracking below it",
        )
    for key in table:
        if key not in TrackFields.model_fields:
            raise UsageError(*messages.no_such_setting(key, TrackFields))
    return {key: value for key, value in values.items() if key != TABLE}, table


def setting_entry(key: str) -> SettingEntry:
    """The entry of a setting of a tracking, or of the run on each frame.

    Examples
    --------
    >>> setting_entry("max_gap").metavar, setting_entry("smoothness").group is SettingGroup.RUN
    ('FRAMES', True)
    """
    return (
        entry_of(TrackFields.model_fields[key])
        if key in TrackFields.model_fields
        else catalogue.entry(key)
    )
