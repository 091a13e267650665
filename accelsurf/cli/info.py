"""``accelsurf info``: versions, names and settings of this installation, or the description of an image."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from cyclopts import Parameter

from accelsurf.cases import MAX_HINT, printable
from accelsurf.cli.options import FILES, run_config, settings_class
from accelsurf.errors import InputError
from accelsurf.evolution import StopReason
from accelsurf.io import (
    FRAME_KEY,
    UNIT_KEY,
    format_of,
    header_counts,
    naming,
    parse_header,
    read_json,
)
from accelsurf.output import report_json, versions
from accelsurf.phantoms import recipe_files
from accelsurf.settings.catalogue import as_typed, help_of
from accelsurf.settings.energy_terms import TERMS, image_terms
from accelsurf.settings.entry import SettingGroup
from accelsurf.settings.fields import SettingFields
from accelsurf.settings.file_formats import image_suffixes
from accelsurf.settings.flow_specs import FLOWS
from accelsurf.settings.mesh_formats import MESH_FORMATS
from accelsurf.settings.presets import PRESETS
from accelsurf.settings.reading import ReadOptions
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.trace_columns import TRACE_COLUMNS
from accelsurf.settings.wording import in_unit, size_text

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry

#: Topics of `accelsurf info TOPIC`, and the content of each.
_TOPICS = {
    "versions": "accelsurf, Python and the libraries, as a report has them",
    "presets": "settings for a kind of scan, with the reason of each value",
    "settings": "every setting of a run",
    "energies": "names of the image terms of --energy",
    "energy-terms": "each term, its meaning and its settings",
    "flows": "each flow, how it moves the surface and its settings",
    "starts": "ways to write a first surface: kinds of --start",
    "volume-formats": "endings of image files",
    "mesh-formats": "endings of mesh files",
    "recipes": "phantoms that accelsurf synth makes",
    "recipes-in-time": "the same, for sequences",
    "trace-columns": "columns of the trace of a run",
    "stop-reasons": "why a run can end",
    "exit-codes": "what a command returns to the shell",
}

ReadSettings = settings_class("ReadSettings", groups=(SettingGroup.IMAGE,))


def info(
    image: Annotated[Path | None, Parameter(name="IMAGE|TOPIC", group=FILES)] = None,
    *,
    as_json: Annotated[bool, Parameter(name="--json", negative=(), show_default=False)] = False,
    reading: ReadSettings | None = None,  # type: ignore[valid-type]
) -> int:
    """Describe an image, or the results in a folder; without one list the topics that accelsurf tells about.

    Parameters
    ----------
    image
        An image, whose voxels are not read where its format allows that; a folder of results; or a topic: versions,
        presets, settings, recipes and others, which `accelsurf info` lists.
    as_json
        Print JSON; without an image of all topics, with the schema of the configuration.
    """
    topic = "" if image is None or image.exists() else str(image)
    if image is not None and topic not in _TOPICS:
        reports = sorted(image.glob("*_report.json")) if image.is_dir() else []
        if reports:
            _show_results(reports, as_json)
            return 0
        _show_image(image, as_json, run_config(reading).reading)
        return 0

    known = _known()
    if as_json:
        presets = {name: preset._asdict() for name, preset in PRESETS.items()}
        for said in presets.values():
            del said["name"]
        print(report_json({**known, "presets": presets, "config_schema": RunConfig.json_schema()}))
        return 0
    if topic:
        _show_topic(topic, known)
    else:
        _show_topics(known)
    return 0


def _show_topics(known: Mapping[str, Any]) -> None:
    """Print the version, and the topics with their content."""
    print(f"accelsurf {known['versions']['accelsurf']}")
    print("\naccelsurf info IMAGE describes an image, accelsurf info FOLDER the results in it.")
    print("accelsurf info TOPIC tells about:\n")
    _print_table(_TOPICS)


def _show_topic(topic: str, known: Mapping[str, Any]) -> None:
    """Print all that is known of a topic."""
    if topic == "presets":
        _print_presets()
    elif topic == "settings":
        _print_settings()
    else:
        value = known[topic.replace("-", "_")]
        if isinstance(value, dict):
            _print_table(value)
        else:
            print(*value, sep="\n")


def _show_image(path: Path, as_json: bool, requested: ReadOptions) -> None:
    """Print the description of an image."""
    volumes = _listing(path)
    if volumes is not None and requested.series is None:
        _show_volumes(volumes, as_json)
        return
    description = _described(path, requested)
    if as_json:
        print(report_json(description))
        return
    levels, unit = description.pop("levels"), description["unit_of_the_file"] or "mm"
    for key in ("spacing", "origin"):
        description[key] = _lengths(description[key], unit)
    description["direction"] = [
        [float(f"{v:.6g}") for v in row] for row in description["direction"]
    ]
    _print_table(
        {
            key.replace("_", " "): str(value)
            for key, value in description.items()
            if value is not None
        }
    )
    for number, level in enumerate(levels):
        print(f"  level {number}: size {level['size']}, spacing {_lengths(level['spacing'], unit)}")


def _lengths(mm: Sequence[float], unit: str) -> str:
    """Return lengths in the unit of the file, with the digits that headers have."""
    return f"[{', '.join(f'{in_unit(value, unit):.6g}' for value in mm)}] {unit}"


def _show_results(reports: Sequence[Path], as_json: bool) -> None:
    """Print the results of a folder, by their reports."""
    documents = [read_json(path) for path in reports]
    if as_json:
        print(report_json({"results": documents}))
        return
    for path, document in zip(reports, documents, strict=True):
        print(path.name.removesuffix("_report.json"))
        lines = {name: printable(text, MAX_HINT) for name, text in _summary(document).items()}
        _print_table(lines or {"report": "is not of a run"})


def _summary(report: object) -> dict[str, str]:
    """Return image, end, volume and quality as a report has them."""
    document = report if isinstance(report, dict) else {}
    source, stop, error, quality, best = (
        _fields_of(document, name) for name in ("input", "stop", "error", "quality", "estimates")
    )
    out = {"image": source.get("path"), "ended": stop.get("message") or error.get("message")}
    unit = source.get("unit")
    volume = best.get("volume_mm3", document.get("volume_mm3"))
    probability = quality.get("probability")
    if isinstance(volume, int | float):
        out["volume"] = size_text(volume, unit if unit in ("um", "nm") else "mm", 3)
    if isinstance(probability, int | float):
        out["likely to be good"] = f"{probability:.0%}"
    warnings = quality.get("warnings")
    out["warning"] = "; ".join(map(str, warnings)) if isinstance(warnings, list) else None
    return {name: str(value) for name, value in out.items() if value}


def _fields_of(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = document.get(name)
    return part if isinstance(part, dict) else {}


def _listing(path: Path) -> list[dict[str, Any]] | None:
    """The volumes of a folder, archive or file of a format that may have several; None of other formats."""
    from accelsurf.io import functions_of

    with naming(path):
        listing = functions_of(format_of(path)).listing
        return None if listing is None else listing(path)


def _show_volumes(volumes: list[dict[str, Any]], as_json: bool) -> None:
    """Print the volumes of a folder, a block of lines each."""
    if as_json:
        print(report_json({"volumes": volumes}))
        return
    for entry in volumes:
        phase = ", ".join(f"{name} {value}" for name, value in entry["phase"].items())
        title = (
            " ".join(word for word in (entry["modality"], entry["description"]) if word)
            or "without a name"
        )
        print(f"{entry['number']}  {title}" + (f" ({phase})" if phase else ""))
        if entry["size"] is not None:
            size, voxel = (
                " x ".join(map(str, entry["size"])),
                " x ".join(f"{h:.4g}" for h in entry["spacing"]),
            )
            print(
                f"   {size} voxels of {voxel} mm, {entry['orientation']}, {entry['unit'] or 'no unit'}"
            )
        print(
            f"   {entry['files']} file{'s' if entry['files'] > 1 else ''}, first {entry['first_file']}"
        )
        print(f"   series {entry['uid'] or 'without a UID'}")
        if entry["segments"]:
            print(
                "   segments "
                + ", ".join(f"{segment['id']} {segment['name']}" for segment in entry["segments"])
            )
        for warning in entry["warnings"]:
            print(f"   warning: {warning}")
    for note in volumes[0]["left_out"]:
        print(note)
    if any(entry["segments"] for entry in volumes):
        print("a label map: FILE@2 takes segment 2 alone")
    else:
        print(
            "--series NUMBER chooses one"
            if len(volumes) > 1
            else "it is the only one: no --series is needed"
        )


def _described(path: Path, requested: ReadOptions) -> dict[str, Any]:
    """Describe an image; lengths in mm, all in the order (x, y, z)."""
    from accelsurf import io

    first = replace(
        requested,
        time_index=requested.time_index or 0,
        channel_index=requested.channel_index or 0,
        channels_from_time=False,
    )
    try:
        lazy, by_boxes = (
            io.open_volume(
                path,
                level=requested.level,
                channel_index=first.channel_index,
                time_index=first.time_index,
                spacing=requested.spacing,
            ),
            True,
        )
        channels, time_points = lazy.layout.channels, lazy.layout.time_points
    except InputError:  # packed as a whole, or damaged: reading says which
        lazy, by_boxes = io.LazyVolume.of_array(io.read(path, options=first)), False
        channels, time_points = header_counts(path, first)
    geometry, layout = lazy.geometry, lazy.layout
    seconds = lazy.metadata.get(FRAME_KEY)
    form, header = parse_header(path, first)
    warning = lazy.metadata.get(io.WARNING_KEY)
    if getattr(header, "are_channels_guessed", False):
        unsaid = f"nothing is said of time: {channels} volumes, which segment reads as channels and track as frames"
        warning = f"{warning}; {unsaid}" if warning else unsaid
    return {
        "format": form.name,
        **_grid(geometry),
        "origin": list(geometry.origin),
        "direction": geometry.direction.tolist(),
        "type": str(lazy.dtype),
        "megabytes": round(math.prod(geometry.shape) * lazy.dtype.itemsize / 1e6, 3),
        "channels": channels,
        "time_points": time_points,
        "seconds_per_time_point": None if seconds is None else float(seconds),
        "unit_of_the_file": lazy.metadata.get(UNIT_KEY),
        "chunks": None if layout.chunk_shape is None else list(layout.chunk_shape[::-1]),
        "read_by_boxes": by_boxes,
        "warning": warning,
        "levels": [_grid(grid) for grid in layout.levels],
    }


def _grid(geometry: Geometry) -> dict[str, Any]:
    """Size and spacing, (x, y, z), mm."""
    return {"size": list(geometry.size), "spacing": list(geometry.spacing_xyz)}


def _known() -> dict[str, Any]:
    """Names by kind: lists of them, or dictionaries with the meaning of each."""
    from accelsurf.cli import EXIT_CODES
    from accelsurf.text.starts import KINDS

    return {
        "versions": versions(),
        "energies": list(image_terms()),
        "starts": list(KINDS),
        "stop_reasons": list(get_args(StopReason)),
        "volume_formats": list(image_suffixes()),
        "mesh_formats": list(MESH_FORMATS),
        "recipes": recipe_files.recipe_names(),
        "recipes_in_time": recipe_files.sequence_names(),
        "energy_terms": _with_settings(TERMS),
        "flows": _with_settings(FLOWS),
        "trace_columns": {
            name: column.help + (f" ({column.unit})" if column.unit else "")
            for name, column in TRACE_COLUMNS.items()
        },
        "exit_codes": {str(code): meaning for code, meaning in EXIT_CODES.items()},
    }


def _with_settings(entries: Mapping[str, Any]) -> dict[str, str]:
    """Names of terms or flows, with their meaning and their settings."""
    return {
        name: spec.help + (f" (settings: {', '.join(spec.settings)})" if spec.settings else "")
        for name, spec in entries.items()
    }


def _print_table(entries: Mapping[str, Any]) -> None:
    width = max(map(len, entries))
    for key, entry in entries.items():
        print(f"  {key:{width}}  {entry}")


def _print_presets() -> None:

    print("Presets (--preset NAME; other options override its values):")
    for name, preset in PRESETS.items():
        print(f"\n  {name}: {preset.summary}")
        for key, value in preset.settings.items():
            print(f"    {key} = {as_typed(value)}: {preset.reasons[key]}")
        for volume, outcome in preset.tried.items():
            print(f"    tried on {volume}: {outcome}")


def _print_settings() -> None:

    print("Settings (accelsurf segment --help has their defaults):")
    _print_table({key: help_of(key) for key in SettingFields.model_fields})
