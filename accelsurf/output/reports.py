"""Reports of earlier runs: their settings, their files, and which of these the user's own runs have written.

A report may have come with somebody's data. It is read through one guarded reader, and nothing that it says orders
anything: a file counts as of a run only where the seal of its entry says so.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple

from accelsurf.errors import AccelsurfError, InputError, UsageError
from accelsurf.io import is_sealed, is_stored, read_json, sha256, split_name
from accelsurf.output.given_image import GivenImage
from accelsurf.settings.catalogue import default_of
from accelsurf.settings.older import modern
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig
from accelsurf.settings.track_fields import TRACK_FORMATS, TrackFields

#: Suffix of a failed run's case name in the names of its files, where a result stands already.
FAILED = "_failed"
#: Ends of the names of a case's files, after the name of the case.
_KINDS = re.compile(
    r"(seg|labels|segmentation|labelmap|rtstruct|dseg|rest\d+_seg|sdf|surface|contour|objects|state|run|trace|preview|"
    r"statistics|report|case|tracks|curves|surfaces|geff|res|movie|film)([._].*)?",
    re.IGNORECASE,
)
#: Kinds of the values of a report; optional ones may be None.
_REPORT: dict[str, Any] = {
    "status": str,
    "outputs": list,
    "exit_code": int,
    "input": (dict, NoneType),
    "config": (dict, NoneType),
    "objects": (list, NoneType),
    "quality": (dict, NoneType),
}
#: Settings that change no file of a run, and settings that it may choose itself.
_WITHOUT_EFFECT = ("threads", "checkpoint")
_OPEN = ("seed", "energy")


def report_name(name: str) -> str:
    """Return the name of the report of a case.

    Examples
    --------
    >>> report_name("scan"), report_name("scan" + FAILED)
    ('scan_report.json', 'scan_failed_report.json')
    """
    return f"{name}_report.json"


class ListedFile(NamedTuple):
    """A file that a report lists: its ``kind``, ``name``, ``checksum``, and the ``seal`` of whoever wrote it."""

    kind: str
    name: str
    checksum: str
    seal: object

    @property
    def is_own(self) -> bool:
        """True if a run of this user has written the file."""
        return is_sealed(self.name, self.checksum, self.seal)


class Report:
    """The report of a run: its entries, and the files that are still as listed. Of another file it is empty.

    Parameters
    ----------
    path : Path
        It may have been moved with its folder.
    folder : Path, optional
        Where the files that it lists are looked for; beside it by default.

    Attributes
    ----------
    path, folder : Path
    document : dict or None
        As of `load_report`.
    """

    def __init__(self, path: Path, folder: Path | None = None) -> None:
        self.path, self.folder = path, path.parent if folder is None else folder
        self.document = load_report(path)

    @property
    def is_failure(self) -> bool:
        """True if it is of a run that failed, or that was ended before it had a result."""
        return self.document is not None and (
            self.document["status"] == "failed" or not self.document["outputs"]
        )

    @cached_property
    def listed(self) -> list[ListedFile]:
        """The files that it lists, by their names; paths that are none are left out."""
        entries = self.document["outputs"] if self.document is not None else ()
        listed = []
        for entry in entries:
            if not isinstance(entry.get("sha256"), str):
                continue
            name = entry["path"].replace("\\", "/").rpartition("/")[2]
            if name not in ("", ".", "..") and _is_path(name):
                listed.append(ListedFile(entry["kind"], name, entry["sha256"], entry.get("seal")))
        return listed

    @property
    def names(self) -> dict[str, str]:
        """Names of the files by kind; of several of a kind the last."""
        return {file.kind: file.name for file in self.listed}

    @property
    def state(self) -> ListedFile | None:
        """The state that a result can be corrected from, if it has one."""
        if self.document is None or self.document["status"] == "failed":
            return None
        return next((file for file in self.listed if file.kind == "state"), None)

    def unchanged(self, besides: Collection[str] = ()) -> list[ListedFile]:
        """Return the files that are still as it lists them.

        A file that somebody has changed since is not the run's any more, and does not go with it. A report may list any
        file, so names that no run of the case writes count for nothing.

        Parameters
        ----------
        besides : collection of str
            Names to leave out: those are replaced anyway.
        """
        return [
            file for file in self.listed if file.name not in besides and self._is_unchanged(file)
        ]

    def own(self, besides: Collection[str] = ()) -> list[str]:
        """Return the names of the unchanged files that this user's run has written.

        Only these are removed, or replaced without being asked for.
        """
        return [file.name for file in self.unchanged(besides) if file.is_own]

    def _is_unchanged(self, file: ListedFile) -> bool:
        path, case = self.folder / file.name, self.path.name.removesuffix(report_name(""))
        try:
            return (
                is_named_as_output(file.name, case)
                and is_output(path)
                and not has_guests(path)
                and sha256(path) == file.checksum
            )
        except AccelsurfError:
            return False


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
    """Test if a text can be the path of a file: for other texts systems do not say that it is not there."""
    try:
        os.lstat(text)
    except ValueError:  # no text of this system
        return False
    except OSError as error:
        return error.errno not in (errno.ENAMETOOLONG, errno.EINVAL)
    return True


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
    corrections_written = written.get("refine") or []
    return (
        isinstance(corrections_written, list)
        and corrections_written[: len(corrections)] == corrections
        and all(
            written.get(key, _plain(default_of(key))) == value
            for key, value in wanted.items()
            if key not in free
        )
    )


def _plain(value: Any) -> Any:
    """A value as it is read from JSON."""
    return list(value) if isinstance(value, tuple) else value


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
