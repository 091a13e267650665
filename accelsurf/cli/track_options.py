"""Options of ``accelsurf track``: made from the settings of tracking, and of the run on each frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from accelsurf.cli.options import given_options, option, options_class, run_config, settings_class
from accelsurf.settings import toml
from accelsurf.settings.catalogue import as_typed
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import FRAME_SETTINGS, TrackConfig, split_table
from accelsurf.settings.track_fields import TrackFields

#: Settings of the run on each frame.
FrameSettings = settings_class(
    "FrameSettings",
    leave_out=tuple(key for key in RunConfig.model_fields if key not in FRAME_SETTINGS),
)


def _track_settings(name: str, keys: Iterable[str]) -> type:
    """A dataclass with an option for each of these settings of tracking; ``None`` where it was not given."""
    members = []
    for key in keys:
        field = TrackFields.model_fields[key]
        is_switch = field.annotation is bool
        default = "" if is_switch else as_typed(field.default)
        members.append(option(key, field, default, negative=() if is_switch else None))
    return options_class(name, members)


TrackSettings = _track_settings("TrackSettings", TrackFields.model_fields)
#: For commands that only read a sequence.
SequenceSettings = _track_settings("SequenceSettings", ("frame_time", "frames_from_slices"))


def track_config(
    track: Any, frame: Any, file: Path | Mapping[str, Any] | None, /, **forced: Any
) -> TrackConfig:
    """Return the configuration of a tracking: options override the file, which overrides the defaults.

    Parameters
    ----------
    track : TrackSettings, SequenceSettings or None
    frame : FrameSettings or None
    file : Path or mapping, optional
        TOML file of ``--config``, or its content: settings of the run, and a table ``track``.
    **forced
        Settings of either kind, over all others.

    Raises
    ------
    UsageError
        When the file or a value is not valid.
    """
    run, table = split_table(dict(toml.read_toml(file) if isinstance(file, Path) else file or {}))
    of_tracking = {key: value for key, value in forced.items() if key in TrackFields.model_fields}
    others = {key: value for key, value in forced.items() if key not in of_tracking}
    return TrackConfig(
        run=run_config(frame, run, **others), **{**table, **given_options(track), **of_tracking}
    )
