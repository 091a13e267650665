"""Finished cases: a result stands, of the same image with the same settings.

Beside the report of a run lies a record of data that it lacks: the checksums of the other files that its settings
name, and the Dice. Cases whose result somebody has corrected since, by ``accelsurf refine``, are finished too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from accelsurf import io
from accelsurf.batch.outcome import CaseTask, Outcome, outcome_of_report
from accelsurf.errors import AccelsurfError, InputError
from accelsurf.image.volume import Volume
from accelsurf.io import read_json, write_bytes
from accelsurf.output import is_of, is_output, load_report, named_files, report_json, report_name


def record_path(task: CaseTask) -> Path:
    """Return the path of the record of a case."""
    return task.folder / f"{task.case.id}_case.json"


def write_record(task: CaseTask, report: Mapping[str, Any], dice: float | None) -> None:
    """Write the record of a case that has a result.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    reference = task.case.reference
    record = {
        "id": task.case.id,
        "files": {str(path): io.sha256(path) for path in named_files(task.config)},
        "reference": {"path": str(reference), "sha256": io.sha256(reference)}
        if reference is not None
        else None,
        "labels": _checksum_of_labels(report),
        "dice": dice,
    }
    write_bytes(record_path(task), (report_json(record) + "\n").encode())


def finished(task: CaseTask) -> Outcome | None:
    """Return the line of a case that need not be run again; None for any other.

    Parameters
    ----------
    task : CaseTask
    """
    report = load_report(task.folder / report_name(task.case.id))
    if report is None or report["status"] != "ok":
        return None
    if not all(
        is_output(task.folder / Path(str(output.get("path"))).name) for output in report["outputs"]
    ):
        return None
    record = _read(record_path(task))
    try:
        if not is_of(report, task.config, task.case.image):
            return None
        if record.get("files", {}) != {
            str(path): io.sha256(path) for path in named_files(task.config)
        }:
            return None
        return outcome_of_report(task, report, _dice(task, report, record))
    except (AccelsurfError, LookupError, TypeError, AttributeError):
        return None  # it is run again, and its error is reported


def _dice(task: CaseTask, report: Mapping[str, Any], record: Mapping[str, Any]) -> float | None:
    """The Dice of a result: as recorded for these labels and this reference, or measured anew."""
    reference = task.case.reference
    if reference is None:
        return None
    labels = _checksum_of_labels(report)
    same = {"path": str(reference), "sha256": io.sha256(reference)} == record.get("reference")
    if same and labels is not None and labels == record.get("labels"):
        value = record["dice"]
        return None if value is None else float(value)
    (path,) = [output["path"] for output in report["outputs"] if output["kind"] == "labels"]
    found = io.read_labels(task.folder / Path(path).name)
    return dice_with(found, io.read_labels(reference, grid=found.geometry))


def dice_with(found: Volume, truth: Volume) -> float | None:
    """Return the Dice of all labels above 0; None where both are empty."""
    from accelsurf.measure import dice

    value = dice(found.array, truth.array)
    return None if math.isnan(value) else value


def _checksum_of_labels(report: Mapping[str, Any]) -> str | None:
    return next(
        (output["sha256"] for output in report["outputs"] if output["kind"] == "labels"), None
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path)
    except InputError:
        return {}
    return found if isinstance(found, dict) else {}
