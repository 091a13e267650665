"""Options of ``accelsurf track``: made from the settings of tracking, and those of the run on each frame."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from accelsurf.cli.options import option, options_class, run_config, settings_class
from accelsurf.settings import toml
from accelsurf.settings.catalogue import as_typed
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.track_config import TrackConfig, split_table
from accelsurf.settings.track_fields import TrackFields


def _track_settings() -> type:
    """A dataclass with an option for each setting of tracking; ``None`` where it was not given."""
    members = []
    for key, field in TrackFields.model_fields.items():
        is_switch = field.annotation is bool
        default = "" if is_switch else as_typed(field.default)
        members.append(option(key, field, default, negative=() if is_switch else None))
    return options_class("TrackSettings", members)


TrackSettings = _track_settings()
#: Settings of the run that mean another thing here, or nothing: where both have one, it is that of tracking.
_NOT_OF_FRAMES = (
    *TrackFields.model_fields, "time_index", "channels_from_time", "edit", "refine", "level",
)
#: Settings of the run on each frame.
FrameSettings = settings_class(
    "FrameSettings", leave_out=_NOT_OF_FRAMES, groups=(SettingGroup.RUN, SettingGroup.FLOW, SettingGroup.IMAGE)
)


def track_config(track: Any, frame: Any, file: Path | None) -> TrackConfig:
    """Return the configuration of a tracking: options override the file, which overrides the defaults.

    Parameters
    ----------
    track : TrackSettings or None
    frame : FrameSettings or None
    file : Path, optional
        TOML file of ``--config``: settings of the run, and a table ``track``.

    Raises
    ------
    UsageError
        When the file or a value is not valid.
    """
    run, table = split_table(toml.read(file)) if file is not None else ({}, {})
    given = {one.name: getattr(track, one.name) for one in fields(track)} if track is not None else {}
    typed = {key: _value(key, value) for key, value in given.items() if value is not None}
    return TrackConfig(run=run_config(frame, run), **{**table, **typed})


def _value(key: str, value: Any) -> Any:
    """A number as it was typed; a text that is none stays for the message."""
    if key in ("frame", "max_gap", "frame_time") or (key == "friction" and value != "auto"):
        try:
            return float(value) if key in ("frame_time", "friction") else int(value)
        except ValueError:
            return value
    return value
