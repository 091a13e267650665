"""The files of an earlier run, by its report: which of them a new run replaces, and which it may not touch."""

from __future__ import annotations

import errno
import os
import re
import warnings
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple

from accelsurf.errors import AccelsurfError, AccelsurfWarning, InputError, UsageError
from accelsurf.io import is_stored, sha256, split_name
from accelsurf.io.file_set import InputFiles
from accelsurf.io.files import read_json
from accelsurf.io.seals import is_sealed
from accelsurf.output.given_image import GivenImage
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.older import modern
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.settings.track_fields import TRACK_FORMATS, TrackFields

#: What the names of a failed run's files have after the name of the case, where a result stands already.
FAILED = "_failed"
#: What follows the name of a case in the names of its files.
_KINDS = re.compile(
    r"(seg|labels|segmentation|labelmap|rtstruct|dseg|rest\d+_seg|sdf|surface|contour|objects|state|run|trace|preview|"
    r"statistics|report|case|tracks|curves|surfaces|geff|res|movie|film)([._].*)?",
    re.IGNORECASE,
)
#: Kinds of the values of a report; what need not be there may be None.
_REPORT: dict[str, Any] = {
    "status": str,
    "outputs": list,
    "exit_code": int,
    "input": (dict, NoneType),
    "config": (dict, NoneType),
    "objects": (list, NoneType),
    "quality": (dict, NoneType),
}
#: Settings that change nothing of what a run leaves, and those that it may set itself.
_WITHOUT_EFFECT, _OPEN = ("threads", "checkpoint"), ("seed", "energy")


def report_name(name: str) -> str:
    """Return the name of the report of a case.

    Examples
    --------
    >>> report_name("scan"), report_name("scan" + FAILED)
    ('scan_report.json', 'scan_failed_report.json')
    """
    return f"{name}_report.json"


def is_output(path: Path) -> bool:
    """Test if a path names a file, or a folder that accelsurf writes as a whole: an image, or tracks.

    Examples
    --------
    >>> is_output(Path("absent_RES"))
    False
    """
    return is_stored(path) or any(
        (path / form.mark).is_file() for form in TRACK_FORMATS.values() if form.mark
    )


def load_report(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the report in a file; None where there is none, or where it is none of accelsurf.

    A report may have come with somebody's data. Its file is read only when it is a file, and no larger than a report
    can be; ``status``, ``outputs``, ``exit_code``, ``input``, ``config``, ``objects`` and ``quality`` are of the kinds
    that a run writes.

    Parameters
    ----------
    path : path-like
        The file.
    """
    try:
        document = read_json(path)
    except InputError:
        return None
    if not isinstance(document, dict) or not all(
        isinstance(document.get(key), kind) for key, kind in _REPORT.items()
    ):
        return None
    if not all(_is_output_entry(entry) for entry in document["outputs"]):
        return None
    named = document["input"].get("path") if document.get("input") else None
    return document if not isinstance(named, str) or _is_path(named) else None


def _is_output_entry(entry: object) -> bool:
    return isinstance(entry, dict) and all(
        isinstance(entry.get(key), str) for key in ("path", "kind")
    )


def _is_path(text: str) -> bool:
    """Test if a text can be the path of a file: of what is none, systems do not say that it is not there."""
    try:
        os.lstat(text)
    except ValueError:  # no text of this system
        return False
    except OSError as error:
        return error.errno not in (errno.ENAMETOOLONG, errno.EINVAL)
    return True


def is_failure_report(path: Path) -> bool:
    """Test if a file is the report of a run that failed, or that was ended before it had a result."""
    document = load_report(path)
    return document is not None and (document["status"] == "failed" or not document["outputs"])


def state_of(report: Path) -> tuple[str, str] | None:
    """Return name and checksum of the state that a report lists; None without one."""
    document = load_report(report)
    if document is None or document["status"] == "failed":
        return None
    listed = [
        entry
        for entry in document["outputs"]
        if isinstance(entry, dict) and entry.get("kind") == "state"
    ]
    found = _entries(listed)
    return found[0] if found else None


def is_of(document: Mapping[str, Any], config: RunConfig | TrackConfig, image: Path) -> bool:
    """Test if a report is of a run or a tracking with these settings, of this image, which is read where they fit.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    fits = (
        had_track_settings(document, config)
        if isinstance(config, TrackConfig)
        else had_settings(document, config)
    )
    run = config.run if isinstance(config, TrackConfig) else config
    return fits and GivenImage.of_entry(document.get("input"), image, run.reading).is_same


def had_track_settings(document: Mapping[str, Any], config: TrackConfig) -> bool:
    """Return whether a report is of a tracking with these settings; a seed that is not given may be any."""
    written = document.get("config")
    if not isinstance(written, dict) or not had_settings(
        {"config": written.get("run")}, config.run
    ):
        return False
    defaults = {key: _plain(field.default) for key, field in TrackFields.model_fields.items()}
    wanted = config.model_dump(mode="json", exclude={"run"})
    return all(written.get(key, defaults[key]) == value for key, value in wanted.items())


def had_settings(document: Mapping[str, Any], config: RunConfig) -> bool:
    """Return whether a report is of a run with these settings; later corrections do not count.

    A seed that is not given may be any, and so may an energy that clicks choose.
    """
    written = document.get("config")
    if not isinstance(written, dict):
        return False
    try:
        written = modern(written)
    except UsageError:
        return False
    wanted = config.model_dump(mode="json")
    corrections = wanted.pop("refine")
    free = {*_WITHOUT_EFFECT, *(key for key in _OPEN if key not in config.model_fields_set)}
    refined = written.get("refine") or []
    return (
        isinstance(refined, list)
        and refined[: len(corrections)] == corrections
        and all(
            written.get(key, _default(key)) == value
            for key, value in wanted.items()
            if key not in free
        )
    )


def _default(key: str) -> Any:
    """Return the value of a setting before it existed."""
    return _plain(default_of(key))


def _plain(value: Any) -> Any:
    """A value as it is read from JSON."""
    return list(value) if isinstance(value, tuple) else value


def names_of_outputs(report: Path) -> dict[str, str]:
    """Return the names of the files that a report lists, by kind; of several of a kind the last."""
    document = load_report(report)
    listed = document["outputs"] if document is not None else ()
    named = [
        (str(entry.get("kind")), _entries([entry])) for entry in listed if isinstance(entry, dict)
    ]
    return {kind: found[0][0] for kind, found in named if found}


def unchanged_outputs(report: Path, besides: Collection[str]) -> list[str]:
    """Return the names of the files beside a report that are still as it lists them.

    A file that somebody has changed since is not the run's any more, and does not go with it. A report may have come
    with somebody's data and list any file, so names that no run of the case writes count for nothing.

    Parameters
    ----------
    report : Path
    besides : collection of str
        Names to leave out: those are replaced anyway.
    """
    return [entry.name for entry in _unchanged(report, besides)]


def own_outputs(report: Path, besides: Collection[str] = ()) -> list[str]:
    """Return the names of the files beside a report that this user's run has written, and that are still so.

    Only these are removed, or replaced without being asked for: the seal of each says who wrote it.

    Parameters
    ----------
    report : Path
    besides : collection of str
        Names to leave out: those are replaced anyway.
    """
    return [entry.name for entry in _unchanged(report, besides) if entry.is_own]


class _Listed(NamedTuple):
    """A file that a report lists, and whether this user's run has written it."""

    name: str
    is_own: bool


def _unchanged(report: Path, besides: Collection[str]) -> list[_Listed]:
    """Return the files beside a report that are as it lists them; each is read once."""
    document = load_report(report)
    return [
        _Listed(name, is_sealed(name, checksum, entry.get("seal")))
        for entry in (document["outputs"] if document is not None else ())
        for name, checksum in _entries([entry])
        if _is_unchanged(report, name, checksum, besides)
    ]


def _is_unchanged(report: Path, name: str, checksum: str, besides: Collection[str]) -> bool:
    path, case = report.parent / name, report.name.removesuffix(report_name(""))
    try:
        return (
            name not in besides
            and is_named_as_output(name, case)
            and is_output(path)
            and not has_guests(path)
            and sha256(path) == checksum
        )
    except AccelsurfError:
        return False


def outdated_inputs(report: Path, inputs: InputFiles) -> list[Path]:
    """Return the inputs among the files that go with an earlier result; only their checksums are computed."""
    document = load_report(report)
    listed = [name for name, _ in _entries(document["outputs"] if document is not None else ())]
    others = {name for name in listed if inputs.at(report.parent / name) is None}
    return (
        [report.parent / name for name in own_outputs(report, others)] if others < {*listed} else []
    )


def unfinished_alone(report: Path, planned: Iterable[Path]) -> bool:
    """Test if those of some planned files that exist are of an interrupted or failed run: they may be replaced."""
    document = load_report(report)
    known: set[str] = set()
    if document is not None and document["status"] != "ok":
        known = {report.name, *own_outputs(report)}
    return all(path.name in known for path in planned if os.path.lexists(path))


def is_named_as_output(name: str, case: str) -> bool:
    """Test if a run or a tracking of a case may have written a file of this name.

    Examples
    --------
    >>> is_named_as_output("scan_seg.nii.gz", "scan"), is_named_as_output("scan_failed_trace.csv", "scan")
    (True, True)
    >>> is_named_as_output("thesis.docx", "scan"), is_named_as_output("scan_thesis.docx", "scan")
    (False, False)
    """
    case = case.removesuffix(FAILED)
    for begin in (f"{case}{FAILED}_", f"{case}_"):
        if name.startswith(begin):
            return _KINDS.fullmatch(name[len(begin) :]) is not None
    stem, suffix = split_name(name)  # of the layouts, see `accelsurf.output.layouts`
    return "_seg-accelsurf_" in name or (
        bool(suffix) and stem in (case, re.sub(r"_\d{4}$", "", case))
    )


def has_guests(path: Path) -> bool:
    """Test if somebody has added label maps to a store: they would go with it."""
    return any((path / "labels").glob("*/zarr.json")) if path.is_dir() else False


def result_stands(folder: Path, name: str, planned: Iterable[Path]) -> bool:
    """Test if a folder has files of a case that a failed run must not replace: any but those of an earlier failure.

    Parameters
    ----------
    folder : Path
    name : str
        Of the case.
    planned : iterable of Path
        All files that a run of the case may write.
    """
    report = folder / report_name(name)
    replaced = {report.name, *own_outputs(report)} if is_failure_report(report) else set()
    there = [path for path in {*planned, report} if os.path.lexists(path)]
    return any(path.name not in replaced for path in there)


def outdated(
    folder: Path, name: str, written: Collection[str], failed: bool, overwrite: bool = True
) -> list[str]:
    """Return the names of the files that go when those of a new run come.

    Parameters
    ----------
    folder : Path
    name : str
        First part of the new files' names.
    written : collection of str
        The new files.
    failed : bool
        Whether the new run failed. Of a run that did not, the files of a failed one before it go too.
    overwrite : bool
        Whether files of an earlier result may go; else only reports, and what is named as of a failed run.
    """
    reports = (
        [folder / report_name(name)] if load_report(folder / report_name(name)) is not None else []
    )
    if not failed and is_failure_report(folder / report_name(name + FAILED)):
        reports.append(folder / report_name(name + FAILED))
    listed = {report.name: _unchanged(report, written) for report in reports}
    gone = [
        file
        for report, entries in listed.items()
        for file in (*(entry.name for entry in entries if entry.is_own), report)
    ]
    stays = [
        entry.name for entries in listed.values() for entry in entries if entry.name not in gone
    ]
    if not overwrite:
        failures = f"{name.removesuffix(FAILED)}{FAILED}_", report_name(name)
        gone, stays = (
            [file for file in files if file.startswith(failures)] for files in (gone, stays)
        )
    if stays:
        named = ", ".join(str(folder / file) for file in stays[:3])
        warnings.warn(
            f"{named}{' and more' if len(stays) > 3 else ''}: the earlier report lists it, but no run of yours on this "
            "machine wrote it, so it stays; remove it if it is not needed",
            AccelsurfWarning,
            stacklevel=2,
        )
    return [file for file in gone if file not in written]


def _entries(outputs: Any) -> list[tuple[str, str]]:
    """Name and checksum of each file; a report may have been moved with its folder, so the folder does not count."""
    found = []
    for entry in outputs if isinstance(outputs, list) else ():
        if (
            isinstance(entry, dict)
            and isinstance(entry.get("path"), str)
            and isinstance(entry.get("sha256"), str)
        ):
            name = entry["path"].replace("\\", "/").rpartition("/")[2]
            if name not in ("", ".", "..") and _is_path(name):
                found.append((name, entry["sha256"]))
    return found
