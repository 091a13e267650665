"""The configuration of another run in place of the present one: settings that are fixed while a run runs, presets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from accelsurf.settings.catalogue import as_typed
from accelsurf.settings.corrections import Correction
from accelsurf.settings.energy_expression import EnergyText
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.core.change_log import differing

#: Start of a run from clicks.
FROM_CLICKS = ("clicks",)


def restarted(
    settings: RunConfig,
    refinements: Sequence[Correction],
    changes: Mapping[str, Any],
    has_ids: bool,
) -> RunConfig:
    """Return the configuration of a run that begins again with other settings, and with the same corrections.

    Parameters
    ----------
    settings : RunConfig
        In force now, without edits.
    refinements : sequence of Correction
        In force; they are made again when the run has ended. Of a run that needs clicks to begin, and has none, they
        are the clicks.
    changes : mapping
        New values by name. A ``preset`` brings its values; see `of_preset`.
    has_ids : bool
        Whether it is a run of objects with ids.

    Raises
    ------
    UsageError
        When a value is not valid.
    """
    clicked = [each for each in refinements if each.kind == "clicks"]
    has_clicks = bool(settings.inside) or any(each.inside for each in clicked)
    if changes.get("preset") is not None:
        changes = {**changes, **of_preset(settings, str(changes["preset"]), has_clicks)}
    config = settings.replace(**changes)
    if has_ids or config.inside or config.labels is not None or not needs_clicks(config):
        return config.replace(refine=tuple(refinements))
    return config.replace(
        inside=tuple(text for each in clicked for text in each.inside),
        outside=(*config.outside, *(text for each in clicked for text in each.outside)),
        refine=tuple(each for each in refinements if each.kind != "clicks"),
    )


def of_preset(settings: RunConfig, name: str, has_clicks: bool) -> dict[str, Any]:
    """Return the values of a preset: they override those in force, but for values that need clicks if there are none.

    An unknown preset has none; the configuration refuses it.
    """
    values = dict(PRESETS[name].settings) if name in PRESETS else {}
    if settings.objects is not None or settings.labels is not None:
        values.pop("start", None)
    if not has_clicks:
        waits = {
            "start": FROM_CLICKS == values.get("start"),
            "energy": "energy" in values and EnergyText(values["energy"]).uses_model,
        }
        values |= {key: getattr(settings, key) for key, is_so in waits.items() if is_so}
    return values


def needs_clicks(config: RunConfig) -> bool:
    """Return True if a run begins from clicks, or its energy uses their model."""
    return FROM_CLICKS == config.start or config.energy.uses_model


def restart_message(before: RunConfig, after: RunConfig) -> str:
    """Return one line: the differences of another run, but for edits and clicks.

    Examples
    --------
    >>> restart_message(RunConfig(), RunConfig(cfl=0.3, presmooth="1vox"))
    'from the start: presmooth 1vox, cfl 0.3'
    """
    words = [
        f"{key.replace('_', ' ')} {as_typed(value) or 'none'}"
        for key, value in differing(before, after).items()
        if key not in ("edit", "refine", "inside", "outside", "preset")
    ]
    said = ", ".join(words) or "nothing else changes"
    if after.preset is None or after.preset == before.preset:
        return f"from the start: {said}"
    waits = (
        PRESETS[after.preset].settings.get("start") == FROM_CLICKS and after.start != FROM_CLICKS
    )
    then = "; now click in the object, or draw its size" if waits else ""
    return f"from the start: preset {after.preset}: {said}{then}"
