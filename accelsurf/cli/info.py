"""``accelsurf info``: what this installation is and knows."""

from __future__ import annotations

from typing import Annotated, get_args

from cyclopts import Parameter


def info(*, as_json: Annotated[bool, Parameter(name="--json", negative=(), show_default=False)] = False) -> int:
    """Show versions, names, exit codes and settings.

    Parameters
    ----------
    as_json
        Print JSON, with the schema of the configuration.
    """
    from accelsurf import io
    from accelsurf.cli import EXIT_CODES
    from accelsurf.evolution.records import StopReason
    from accelsurf.initialization import starts
    from accelsurf.phantoms import recipes
    from accelsurf.report.document import to_json
    from accelsurf.report.environment import versions
    from accelsurf.settings.catalogue import help_of
    from accelsurf.settings.energy_terms import TERMS, image_terms
    from accelsurf.settings.fields import MeshFormat
    from accelsurf.settings.flow_specs import FLOWS
    from accelsurf.settings.presets import PRESETS
    from accelsurf.settings.run_config import RunConfig
    from accelsurf.settings.trace_columns import TRACE_COLUMNS

    facts = {
        "versions": versions(),
        "energies": list(image_terms()),
        "flows": list(FLOWS),
        "starts": list(starts.KINDS),
        "stop_reasons": list(get_args(StopReason)),
        "volume_formats": list(io.SUFFIXES),
        "mesh_formats": list(get_args(MeshFormat)),
        "recipes": recipes.recipe_names(),
        "energy_terms": {
            name: spec.help + (f" (settings: {', '.join(spec.settings)})" if spec.settings else "")
            for name, spec in TERMS.items()
        },
        "trace_columns": {
            name: column.help + (f" ({column.unit})" if column.unit else "") for name, column in TRACE_COLUMNS.items()
        },
        "exit_codes": {str(code): meaning for code, meaning in EXIT_CODES.items()},
        "presets": {name: preset._asdict() for name, preset in PRESETS.items()},
        "config_schema": RunConfig.json_schema(),
    }
    if as_json:
        print(to_json(facts))
        return 0
    for title, value in facts.items():
        if title in ("config_schema", "presets"):
            continue
        if isinstance(value, dict):
            print(title.replace("_", " ") + ":")
            width = max(map(len, value))
            for key, entry in value.items():
                print(f"  {key:{width}}  {entry}")
        else:
            print(f"{title.replace('_', ' ')}: {', '.join(value)}")
    print("\nPresets (--preset NAME; options beside it win):")
    for name, preset in PRESETS.items():
        print(f"\n  {name}: {preset.summary}")
        for key, value in preset.settings.items():
            shown = ",".join(value) if isinstance(value, tuple) else value
            print(f"    {key} = {shown}: {preset.reasons[key]}")
        for volume, outcome in preset.tried.items():
            print(f"    tried on {volume}: {outcome}")
    print("\nSettings (accelsurf segment --help has their defaults):")
    for key in RunConfig.model_fields:
        print(f"  {key:12}  {help_of(key)}")
    return 0
