"""Settings of the cases of a batch: those of images, or with ``--track`` those of tracking; never a mixture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from accelsurf.batch.case import Case
from accelsurf.cli.options import options_class, run_config, settings_class
from accelsurf.cli.track_options import FrameSettings, TrackSettings, track_config
from accelsurf.errors import UsageError
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import FRAME_SETTINGS, TABLE, TrackConfig
from accelsurf.settings.track_fields import TrackFields

#: A folder is read in a layout of its own.
SettingsWithoutLayout = settings_class("SettingsWithoutLayout", leave_out=("layout",))


def _batch_settings() -> type:
    """A dataclass with the options of both; where both have one it is a text for either."""
    own = {one.name: (one.name, one.type, None) for one in fields(SettingsWithoutLayout)}
    tracking = {one.name: (one.name, one.type, None) for one in fields(TrackSettings)}
    return options_class("BatchSettings", list({**tracking, **own}.values()))


BatchSettings = _batch_settings()


def run_configs(
    cases: Sequence[Case], settings: Any, file: Mapping[str, Any], layout: str | None = None
) -> list[RunConfig | TrackConfig]:
    """Return the settings of each image.

    Parameters
    ----------
    cases : sequence of Case
    settings : BatchSettings or None
    file : mapping
        What the configuration file says.
    layout : str, optional
        Of the outputs.

    Raises
    ------
    UsageError
        With the case where it is its own setting that is not valid; when settings of tracking are among them.
    """
    given = _given(settings)
    for key in given:
        if key in TrackFields.model_fields and key not in RunConfig.model_fields:
            raise UsageError(f"{_option(key)} is a setting of tracking", "add --track, or leave it out")
    if TABLE in file:
        raise UsageError(f"{TABLE}: the configuration file has a table of tracking", "add --track, or take it out")
    forced = {} if layout is None else {"layout": layout}
    options = SettingsWithoutLayout(**given)
    return _each(cases, lambda own: run_config(options, file, **{**forced, **own}))


def track_configs(cases: Sequence[Case], settings: Any, file: Mapping[str, Any]) -> list[RunConfig | TrackConfig]:
    """Return the settings of each sequence; parameters and errors as of `run_configs`."""
    given = _given(settings)
    for key in given:
        if key not in (*FRAME_SETTINGS, *TrackFields.model_fields):
            raise UsageError(f"{_option(key)} is of single images, --track was given", "leave one of them out")
    track = TrackSettings(**{key: value for key, value in given.items() if key in TrackFields.model_fields})
    frame = FrameSettings(**{key: value for key, value in given.items() if key in FRAME_SETTINGS})
    return _each(cases, lambda own: track_config(track, frame, file, **own))


def _given(settings: Any) -> dict[str, Any]:
    """The options that were given."""
    every = {one.name: getattr(settings, one.name) for one in fields(settings)} if settings is not None else {}
    return {key: value for key, value in every.items() if value is not None}


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _each(
    cases: Sequence[Case], config: Callable[[Mapping[str, Any]], RunConfig | TrackConfig]
) -> list[RunConfig | TrackConfig]:
    """The settings of each case; those without any of their own share one."""
    common, configs = config({}), []
    for case in cases:
        try:
            configs.append(config(case.settings) if case.settings else common)
        except UsageError as error:
            raise UsageError(f"{case.place}: {error.message}", error.hint) from None
    return configs
