"""The report of a run as JSON: pure functions from values to text.

The report has input, settings, how the run ended, measures and files, so that a run can be repeated and a batch can be
filtered without pictures. Lengths are mm, order x, y, z, LPS. Entries about files are here too,
tables in `tables`, pictures in `preview`.
"""

from __future__ import annotations

import json
import math
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from accelsurf.errors import AccelsurfError
from accelsurf.io import seal, sha256

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry
    from accelsurf.grid.window import Window
    from accelsurf.io import FileSet
    from accelsurf.measure import Intervals, Quality
    from accelsurf.run import Result, SegmentedObject
    from accelsurf.settings.run_config import RunConfig

#: Raised when a key of the report or a column of the trace changes its name or its meaning.
SCHEMA_VERSION = 4
Status = Literal["ok", "failed", "interrupted"]

#: Measures of a result and of each of its objects.
_MEASURES = ("volume_mm3", "area_mm2", "enclosed_mm2", "length_mm", "components", "touches_border")
#: Parts of a run that are timed, in the order they happen.
TIMED = ("load", "start", "evolve", "refine", "mesh", "write", "total")
#: Packages that a result can depend on.
PACKAGES = (
    "accelsurf",
    "numpy",
    "scipy",
    "numba",
    "scikit-image",
    "SimpleITK",
    "nibabel",
    "trimesh",
    "Pillow",
    "pydantic",
    "matplotlib",
)


def build_report(  # noqa: PLR0913
    *,
    status: Status,
    exit_code: int,
    argv: Sequence[str] = (),
    config: RunConfig | None = None,
    source: Mapping[str, Any] | None = None,
    result: Result | None = None,
    error: Mapping[str, str] | None = None,
    seconds: Mapping[str, float] | None = None,
    outputs: Sequence[Mapping[str, str]] = (),
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """Put the report of a run together. It always has every key; unknown values are null.

    Parameters
    ----------
    status, exit_code : {"ok", "failed", "interrupted"}, int
        How the run ended, and the exit code of the command.
    argv : sequence of str, optional
        The command line.
    config : RunConfig, optional
        Settings of the run; None when they were not valid.
    source, error : mapping, optional
        The input, from `describe_input`; the error, from `describe_error`.
    result : Result, optional
        None when the run failed before there was one.
    seconds : mapping of str to float, optional
        Durations by part of the run, as in `TIMED`; the result's are used for parts not named here.
    outputs : sequence of mapping, optional
        Files written, from `describe_output`.
    warnings : sequence of str, optional
        Warnings besides the result's own.

    Returns
    -------
    dict
        Ready for `report_json`.
    """
    if result is not None:
        config = result.config  # with the seed that was drawn
        seconds, warnings = {**result.seconds, **(seconds or {})}, [*result.warnings, *warnings]
    return {
        "schema_version": SCHEMA_VERSION,
        "status": status,
        "exit_code": exit_code,
        "error": dict(error) if error is not None else None,
        "versions": versions(),
        "argv": list(argv),
        "config": describe_config(config, result),
        "input": dict(source) if source is not None else None,
        "seed": config.seed if config is not None else None,
        "threads": config.threads if config is not None else None,
        **describe_result(result),
        "seconds": {part: (seconds or {}).get(part) for part in TIMED},
        "peak_rss_mb": peak_rss_mb(),
        "warnings": list(warnings),
        "outputs": [dict(output) for output in outputs],
    }


def report_of(result: Result) -> dict[str, Any]:
    """Return the document of a run that ended or was interrupted, without files."""
    interrupted = result.stop.reason == "interrupted"
    return build_report(
        status="interrupted" if interrupted else "ok",
        exit_code=130 if interrupted else 0,
        config=result.config,
        result=result,
    )


def describe_config(config: RunConfig | None, result: Result | None) -> dict[str, Any] | None:
    """Return the settings of a run; ``energy`` is the one used: ``custom: ClassName`` for one of the user's own."""
    if config is None:
        return None
    settings = config.model_dump(mode="json")
    if result is None:
        return settings
    return {**settings, "energy": result.energy, **dict.fromkeys(result.given, "given as an array")}


def describe_result(result: Result | None) -> dict[str, Any]:
    """Return the part of the report that comes from the evolution: stop, levels, energy and measures of the surface.

    ``resolved_settings`` has the values used for settings that depend on image and grid: ``flow`` and why;
    ``presmooth_mm``; ``scale``, the values of each channel that became 0 and 1; ``step_voxels`` and
    ``limiter_percentile``; ``diffusion``, a rate or free; ``stop``: motion below a number of voxels in a number of
    steps; ``half_width_voxels`` of the band; ``levels``; after corrections ``reach_mm``, how far from its clicks each
    could move the surface, and ``moved_mm``, how far the farthest voxel is that it moved.

    Parameters
    ----------
    result : Result or None
        Of several objects the sums, and an entry for each in ``objects``. With None every value is null.
    """
    if result is None:
        keys = ("stop", "window", "resolved_settings", "levels", "edits", "energy", "mass")
        return dict.fromkeys((*keys, *_MEASURES, "estimates", "intervals", "quality", "objects"))
    # Of the run alone: the potential of a correction is that of its box.
    ran = result.run_history
    last = ran[-1] if ran else None
    # Coarse levels have another image, with less noise: energies are comparable on one level only.
    first = next((row for row in ran if row.level == 0), None)
    return {
        "stop": result.stop._asdict(),
        "window": describe_window(result.window),
        "resolved_settings": result.resolved_settings,
        "levels": describe_levels(result),
        "edits": [
            {**edit.model_dump(mode="json"), "done": number < result.edits_done}
            for number, edit in enumerate(result.config.edit)
        ],
        "energy": {
            "name": result.energy,
            "terms": result.terms,
            "first": first.potential if first else None,
            "last": last.potential if last else None,
            "kinetic_last": getattr(last, "kinetic", None),
            "mass_potential_last": getattr(last, "mass_potential", None),
            **{
                key: getattr(last, key, None)
                for key in ("friction_work", "smoothing_work", "noise_work")
            },
            "steps_of_corrections": len(result.history) - len(ran),
        },
        "mass": describe_mass(result),
        **{key: getattr(result, key) for key in _MEASURES},
        "estimates": result.estimates._asdict(),
        "intervals": describe_intervals(result.intervals),
        "quality": describe_quality(result.quality),
        "objects": [*map(describe_object, result.objects)] if result.has_ids else None,
    }


def describe_window(window: Window | None) -> dict[str, Any] | None:
    """Return the part of the report about the window of a large image that the run was made in, x before y and z."""
    if window is None:
        return None
    return {"first_voxel": list(reversed(window.corner)), "size": list(reversed(window.shape))}


def describe_intervals(intervals: Intervals | None) -> dict[str, list[float] | None] | None:
    """Return the part of the report about the intervals of an object's measures."""
    if intervals is None:
        return None
    return {key: interval and list(interval) for key, interval in intervals._asdict().items()}


#: Keys of the report whose names differ from the attributes: files that users have keep theirs.
_QUALITY_KEYS = {"plateaus": "rests", "next_uncertainty": "next_doubt", "disagreement": "surprise"}


def describe_quality(quality: Quality | None) -> dict[str, Any] | None:
    """Return the part of the report about the quality of an object; None for several, which have their own."""
    if quality is None:
        return None
    plateaus = [{**note._asdict(), "place": list(note.place)} for note in quality.plateaus]
    place = None if quality.next_click is None else list(quality.next_click)
    lists = {"rests": plateaus, "warnings": list(quality.warnings), "notes": list(quality.notes)}
    answers = [answer._asdict() for answer in quality.answers]
    values = {_QUALITY_KEYS.get(key, key): value for key, value in quality._asdict().items()}
    return {**values, "next_click": place, **lists, "answers": answers}


def describe_object(segmented: SegmentedObject) -> dict[str, Any]:
    """Return the entry of one of several objects; ``centroid`` is (x, y, z) mm, LPS."""
    return {
        "id": segmented.id,
        **{key: getattr(segmented.stop, key) for key in ("reason", "steps", "message")},
        **{key: getattr(segmented, key) for key in _MEASURES},
        "estimates": segmented.estimates._asdict(),
        "intervals": describe_intervals(segmented.intervals),
        "centroid": _centroid(segmented),
        "cells_visited": sum(row.cells_visited for row in segmented.history),
        "terms": segmented.terms,
        "quality": describe_quality(segmented.quality if segmented.labels.any() else None),
    }


def _centroid(result: SegmentedObject) -> list[float] | None:
    inside = result.labels.nonzero()
    if inside[0].size == 0:
        return None
    middle = [float(axis.mean()) for axis in inside]
    return [float(v) for v in result.geometry.index_to_world(middle)]


def describe_levels(result: Result) -> list[dict[str, Any]]:
    """Return the part of the report about the grids that the run went over, coarsest first; 0 is the image's own."""
    entries = []
    for grid, steps, reason in result.levels:
        visited = (row.cells_visited for row in result.history if row.level == grid.number)
        entry = {
            "level": grid.number,
            "size": list(reversed(grid.shape)),
            "spacing": list(reversed(grid.spacing)),
            "steps": steps,
            "reason": reason,
            "cells_visited": sum(visited),
        }
        entries.append(entry)
    return entries


def describe_mass(result: Result) -> dict[str, Any] | None:
    """Return the part of the report about conserved mass; None for a flow that has none.

    ``correction`` is the part of the mass that had to be added to conserve it, ``cure`` the remedy where the mass
    potential would make the flow ill-posed, and ``clamped_fraction_largest`` the largest share of surface where it was.
    """
    cure = {
        "flowable-mass": "negative tension clamped at -smoothness, normal part only",
        "region-mass": "no pressure at the surface where the force pulls stronger than gravity times the mass holds",
    }.get(result.config.flow.name)
    if cure is None or not result.history:
        return None
    first, last = result.history[0], result.history[-1]
    return {
        "first": first.mass,
        "last": last.mass,
        "correction": last.mass_correction,
        "cure": cure if result.config.flow.numbers.get("gravity", 0.0) > 0 else None,
        "clamped_fraction_largest": max(row.clamped_fraction for row in result.history),
    }


def describe_error(error: BaseException) -> dict[str, str]:
    """Return the report's entry about an error: its type, one line, and a hint.

    Examples
    --------
    >>> from accelsurf.errors import InputError
    >>> describe_error(InputError("scan.nii: the file is empty", "copy it again"))
    {'type': 'InputError', 'message': 'scan.nii: the file is empty', 'hint': 'copy it again'}
    """
    if isinstance(error, AccelsurfError):
        return {"type": type(error).__name__, "message": error.message, "hint": error.hint}
    if isinstance(error, KeyboardInterrupt):
        hint = "where a state was kept, the same command with --resume goes on from it"
        return {"type": "KeyboardInterrupt", "message": "ended by Ctrl-C or SIGTERM", "hint": hint}
    message = " ".join(str(error).split()) or type(error).__name__
    hint = "run again with --debug for the full traceback; it belongs in a bug report"
    return {"type": type(error).__name__, "message": message, "hint": hint}


def report_json(report: Mapping[str, Any]) -> str:
    """Return a report as JSON text, strictly: NaN and infinity, which JSON lacks, become null.

    Examples
    --------
    >>> print(report_json({"dice": float("nan"), "steps": 3}))
    {
      "dice": null,
      "steps": 3
    }
    """
    text = json.dumps(_plain(report), indent=2, ensure_ascii=False, allow_nan=False)
    # The bytes of a file name that are no UTF-8, which Python holds as lone surrogates, become JSON's escapes of them.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _plain(value: Any) -> Any:
    """Replace numpy scalars, tuples and non-finite numbers by JSON values."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def versions() -> dict[str, str | None]:
    """Return the versions that a result can depend on: Python, the platform and the packages.

    Examples
    --------
    >>> sorted(versions())[:3]
    ['Pillow', 'SimpleITK', 'accelsurf']
    """
    found: dict[str, str | None] = {
        "python": platform.python_version(),
        "platform": platform.platform(),
    }
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    if found["accelsurf"] is None:  # run from a source tree that is not installed
        from accelsurf.version import __version__

        found["accelsurf"] = __version__
    return found


def peak_rss_mb() -> float | None:
    """Return the peak memory of this process so far, in MB (10^6 bytes); None where the system does not report it."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak * (1 if sys.platform == "darwin" else 1024) / 1e6, 1)


def describe_input(
    path: str | Path,
    *,
    geometry: Geometry | None = None,
    checksum: str | None = None,
    voxels: str | None = None,
    written: Sequence[int] | None = None,
) -> dict[str, Any]:
    """Return the report's entry about the input.

    Parameters
    ----------
    path : str or Path
        The input file.
    geometry : Geometry, optional
        Its grid; None when it could not be read, and then the entries are null.
    checksum : str, optional
        SHA-256 of the file, from `accelsurf.io.sha256`.
    voxels : str, optional
        SHA-256 of the values read, from `accelsurf.image.volume.voxels_sha256`.
    written : sequence of int, optional
        Of an image that is read in parts, from `accelsurf.io.files.written_at`.

    Examples
    --------
    >>> from accelsurf.grid.geometry import Geometry
    >>> entry = describe_input("scan.nii", geometry=Geometry((5, 4, 3), (2.0, 1.0, 0.5)))
    >>> entry["size"], entry["spacing"]
    ([3, 4, 5], [0.5, 1.0, 2.0])
    """
    grid: dict[str, Any] = dict.fromkeys(("size", "spacing", "origin", "direction", "unit"))
    if geometry is not None:
        grid = {
            "size": list(geometry.size),
            "spacing": list(geometry.spacing_xyz),
            "origin": list(geometry.origin),
            "direction": geometry.direction.tolist(),
            "unit": geometry.unit,
        }
    known: dict[str, Any] = {"sha256": checksum, "voxels_sha256": voxels}
    if written is not None:
        known["written"] = list(written)
    return {"path": str(Path(path).absolute()), **known, **grid}


def describe_output(path: str | Path, kind: str, staged: Path | None = None) -> dict[str, str]:
    """Return the report's entry about a file that is written.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        Kind of file: labels, surface, contour, trace, preview, sdf, ...
    staged : Path, optional
        Where its content is until all files of the run are complete.
    """
    path, checksum = Path(path), sha256(staged or path)
    sealed = seal(path.name, checksum)
    entry = {"path": str(path.absolute()), "kind": kind, "sha256": checksum}
    return entry | ({"seal": sealed} if sealed else {})


def describe_staged(files: FileSet, kinds: Mapping[str, str]) -> list[dict[str, str]]:
    """Return the report's entries about all staging files of a set, those with a kind first.

    Parameters
    ----------
    files : FileSet
    kinds : mapping of str to str
        Kind by name; a file that belongs to another one, like the voxels of an .mhd header, has none: it is "data".
    """
    names = [
        *kinds,
        *sorted(path.name for path in files.staging.iterdir() if path.name not in kinds),
    ]
    return [
        describe_output(files.folder / name, kinds.get(name, "data"), files.staging / name)
        for name in names
    ]
