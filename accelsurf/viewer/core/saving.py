"""Saving a session: the files of `accelsurf segment`, and the run itself as TOML."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from accelsurf.errors import UsageError, check_known
from accelsurf.image.volume import Volume, voxels_sha256
from accelsurf.interact import result_of
from accelsurf.io import FileSet, InputFiles, write_bytes
from accelsurf.output import (
    OutputFolder,
    Report,
    build_report,
    check_label_settings,
    check_outputs,
    describe_input,
    describe_staged,
    naming_final,
    outcome_title,
    preview_content,
    refuse_existing,
    report_json,
    write_result,
)
from accelsurf.run import Result, Run
from accelsurf.settings.run_config import RunConfig
from accelsurf.version import __version__
from accelsurf.viewer.core.status import SAVED_KINDS

#: Suffix of the settings' name, after the image's.
RUN_FILE = "_run.toml"


def save(
    result: Result,
    folder: Path,
    name: str,
    source: Path | None,
    what: Collection[str],
    replaceable: Collection[Path] | None,
    others: Mapping[str, Any] | None = None,
    channels: Sequence[Volume] = (),
) -> list[Path]:
    """Write a result into a folder, all files at once.

    Beside a report of this name, all files that it lists are written too: they show the same state then.

    Parameters
    ----------
    result : Result
        With settings that repeat it, see `present_result`.
    folder : Path
    name : str
        First part of the files' names.
    source : Path or None
        The image's file, for the report and the format of the labels.
    what : collection of str
        Of `SAVED_KINDS`.
    replaceable : collection of Path or None
        Files that may be replaced; None: all.
    others : mapping of str to value, optional
        Settings of files in place of the run's: names, colours, formats.
    channels : sequence of Volume, optional
        Further channels of the image.

    Returns
    -------
    list of Path
        Written files, the configuration first.

    Raises
    ------
    UsageError
        For another kind, or when there is no surface to write.
    OutputError
        When a file is there already or cannot be written.
    """
    for kind in what:
        check_known("save", kind, SAVED_KINDS)
    config = result.config.replace(**(others or {}))
    result = dataclasses.replace(result, config=config)
    empty = not result.labels.any() or bool(result.labels.all())
    if empty and set(what) & {"labels", "mesh"}:
        raise UsageError("there is no surface to save", "go back, or restart")
    place = OutputFolder(folder, name, source, overwrite=True)
    check_outputs(config, place.label_format(config), result.volume.geometry)
    check_label_settings(config, result.volume)
    inputs = place.inputs(config)
    with place.stage(inputs=inputs) as files:
        what = _all_beside_report(place.report, what)
        plain, is_2d = config.replace(layout="plain"), result.volume.geometry.slice_axis is not None
        names = {k: last for k, last in place.names(plain, is_2d).items() if _kind(k) in what}
        planned = place.plan(plain, is_2d)
        paths = {kind: path for kind, path in planned.items() if _kind(kind) in what}
        paths |= {"run": folder / f"{name}{RUN_FILE}"} if "run" in what else {}
        InputFiles(inputs).refuse(paths.values())
        _check_paths(paths, replaceable)
        with naming_final(files):
            return _write(files, paths, names, place, result, channels)


def _all_beside_report(report: Path, what: Collection[str]) -> set[str]:
    """Return the kinds that are saved; beside a report also all that it lists, to show one state."""
    found = Report(report)
    if found.document is None or found.is_failure:
        return set(what)
    return {
        *what,
        "report",
        *("run" if kind == "config" else _kind(kind) for kind in found.names),
    } & set(SAVED_KINDS)


def _write(
    files: FileSet,
    paths: Mapping[str, Path],
    names: Mapping[str, str],
    place: OutputFolder,
    result: Result,
    channels: Sequence[Volume],
) -> list[Path]:
    """Write all files at once; return them, the configuration first and the report last."""
    kinds, source = {}, place.source
    if "run" in paths:
        write_bytes(
            files.staging / paths["run"].name, _toml(paths["run"].name, result, source).encode()
        )
        kinds[paths["run"].name] = "run"
    content = preview_content(result, outcome_title(place.name, result))
    has_image = source is not None and ("state" in names or "report" in paths)
    image = voxels_sha256([result.volume, *channels]) if has_image else None
    by_kind = write_result(result, files.staging, names, content, image=image)
    kinds |= {path.name: kind for kind, path in by_kind}
    if "report" in paths:
        _write_report(files, place.report.name, kinds, source, result, image)
        kinds[place.report.name] = "report"
    place.commit(files)
    return [files.folder / written for written in kinds]


def _check_paths(paths: dict[str, Path], replaceable: Collection[Path] | None) -> None:
    """Refuse to replace other files, and folders that cannot be written."""
    others = {
        kind: path
        for kind, path in paths.items()
        if replaceable is not None and path not in replaceable
    }
    refuse_existing(others, overwrite=False)
    refuse_existing(paths, overwrite=True)


def _write_report(
    files: FileSet,
    report: str,
    kinds: Mapping[str, str],
    source: Path | None,
    result: Result,
    image: str | None,
) -> None:
    """Write the report that names the staging files of these ``kinds``."""
    contents = build_report(
        status="ok",
        exit_code=0,
        argv=sys.argv,
        config=result.config,
        source=None
        if source is None
        else describe_input(source, geometry=result.geometry, voxels=image),
        result=result,
        outputs=describe_staged(files, kinds),
    )
    write_bytes(files.staging / report, (report_json(contents) + "\n").encode())


def _kind(output: str) -> str:
    """The one of `SAVED_KINDS` that an output belongs to."""
    kinds = {
        "labels": "labels",
        "data": "labels",
        "sdf": "labels",
        "objects": "report",
        "trace": "trace",
    }
    kinds |= {"preview": "picture", "run": "run", "state": "report", "config": ""}
    kinds |= {"report": "report"}
    return kinds.get(output, "mesh")


def present_result(run: Run) -> Result:
    """Return the result of a run between two steps, its edits applied, with settings that repeat it."""
    return dataclasses.replace(result_of(run), config=repeating(run))


def repeating(run: Run) -> RunConfig:
    """Return the configuration that repeats this run from the start up to the present step."""
    # The last step of a run that has ended moves nothing.
    steps = run.step_number if run.stop is None else run.step_number - 1
    edits = tuple(edit for edit in run.config.edit if edit.step <= steps)
    # A run that met its stop rule meets it again; a paused one ends here.
    reasons = [
        "interrupted" if evolving.stop is None else evolving.stop.reason for evolving in run.objects
    ]
    ends = not {"interrupted", "max-steps"} & set(reasons)
    if ends:
        return run.config.replace(edit=edits, max_steps=max(run.config.max_steps, steps + 1))
    # A paused run is saved as it is seen, also where its energy is not the lowest so far.
    end = "present" if "interrupted" in reasons else run.config.end
    return run.config.replace(edit=edits, max_steps=steps, end=end)


def _toml(name: str, result: Result, source: Path | None) -> str:
    image = "INPUT" if source is None else source.name
    lines = [
        f"# accelsurf {__version__}: {result.stop.reason} after {result.stop.steps} steps.",
        f"# The same run: accelsurf segment {image} --config {name} -o DIR",
    ]
    if result.stop.reason == "interrupted":
        lines.append("# max_steps ends it where it was saved; raise it to continue the run.")
    return "\n".join(lines) + "\n\n" + result.config.to_toml()
