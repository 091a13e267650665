"""A case of a batch in a worker process, run as ``segment`` or ``track`` runs it, and its line in the tables.

A case starts in `run_one`, which gives `run_case` all that it needs: also the state of a run that was ended.
"""

from __future__ import annotations

import importlib
import io
import warnings
from collections.abc import Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from accelsurf.batch import records
from accelsurf.batch.outcome import CaseTask, Outcome, outcome_of_report
from accelsurf.batch.pool import Failure
from accelsurf.cases import (
    ProgressKind,
    TrackCase,
    Watcher,
    WorkerInterrupts,
    check_reference,
    report_failure,
    report_track_failure,
    run_case,
    run_track_case,
)
from accelsurf.errors import AccelsurfError, AccelsurfWarning, InputError
from accelsurf.io import InputFiles, read_channels, read_labels
from accelsurf.output import OutputFolder, load_report, outdated_inputs, report_name
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.batch.admission import Admission, Limits
    from accelsurf.batch.pool import Pool
    from accelsurf.image.volume import Volume

#: Modules that a case loads, so that a worker has them before its first case.
_LOADED = (
    "accelsurf.api.segment",
    "accelsurf.output.outputs",
    "accelsurf.io.itk",
    "accelsurf.measure.metrics",
)
_MEMORY_HINT = "raise --max-memory, lower --jobs, or crop or downsample the image"
#: Kind of a failure -> exit code of the case, remedy.
_FAILURES = {
    "error": (
        1,
        "this is a bug in accelsurf; report it with the details in the report of the batch",
    ),
    "memory": (3, _MEMORY_HINT),
    "timeout": (
        1,
        "raise --case-timeout, or look at this image alone: accelsurf segment shows how far it gets",
    ),
    "killed": (1, _MEMORY_HINT),
}


def load() -> None:
    """Load the modules that every case needs; from now on SIGTERM lets a case keep its state."""
    WorkerInterrupts().install()
    for name in _LOADED:
        importlib.import_module(name)


def run_one(task: CaseTask) -> Outcome:
    """Run a case and write its files; return its line, which also names an error.

    Parameters
    ----------
    task : CaseTask
    """
    silent = io.StringIO()
    with (
        redirect_stdout(silent),
        redirect_stderr(silent),
        warnings.catch_warnings(record=True) as said,
    ):
        warnings.simplefilter("always", AccelsurfWarning)
        try:
            if task.case.problem:
                raise InputError(
                    task.case.problem,
                    "rename the file; or give the image an id, in a table of cases",
                )
            outcome = _run(task)
        except AccelsurfError as error:
            outcome = _failed(task, error.message, error.hint, error.exit_code)
    texts = dict.fromkeys(
        str(warning.message) for warning in said if issubclass(warning.category, AccelsurfWarning)
    )
    return replace(outcome, warnings=(*outcome.warnings, *texts))


def run_on_cluster(task: CaseTask) -> Outcome:
    """The same on a cluster, which runs a case again when its worker was lost: perhaps after its files were written.

    Parameters
    ----------
    task : CaseTask
    """
    if task.overwrite:
        return run_one(task)
    done = records.finished(task)
    return run_one(replace(task, resume=True)) if done is None else done


def lost_outcome(task: CaseTask, failure: Failure) -> Outcome:
    """Return the line of a case whose worker did not say how it ended; remove its staging files, write its report.

    Parameters
    ----------
    task : CaseTask
    failure : Failure
    """
    code, hint = _FAILURES[failure.kind]
    error = (InputError if failure.kind == "memory" else LostCaseError)(failure.message, hint)
    with redirect_stderr(io.StringIO()):
        if isinstance(task.config, TrackConfig):
            report_track_failure(TrackCase(place_of(task), task.config), error)
        elif (
            failure.kind != "error"
        ):  # an exception has removed the staging files and written a report
            report_failure(place_of(task), error)
    return _failed(task, failure.message, hint, code, failure.details)


def place_of(task: CaseTask) -> OutputFolder:
    """Return the image of a case and the folder of its files."""
    further = (task.case.reference,)
    return OutputFolder(
        task.folder, task.case.id, task.case.image, task.overwrite, task.resume, further=further
    )


def refuse_inputs_of(
    tasks: Sequence[CaseTask], tables: Sequence[Path], given: Sequence[Path]
) -> None:
    """Refuse a batch that would write its tables, or files of a case, over a file that it or one of its cases reads.

    Raises
    ------
    OutputError
        With the file.
    """
    places = [(place_of(task), task.config) for task in tasks]
    read = InputFiles(
        [*given, *(path for place, config in places for path in place.inputs(config))]
    )
    read.refuse(tables)
    for place, config in places:
        read.refuse(outdated_inputs(place.report, read))
        read.refuse(_outputs(place, config))


def _outputs(place: OutputFolder, config: RunConfig | TrackConfig) -> Iterable[Path]:
    """All that a case may write."""
    if isinstance(config, TrackConfig):
        return TrackCase(place, config).files.paths(place.path, place.name).values()
    return place.plan(config).values()


def make_pool(admission: Admission, limits: Limits) -> Pool:
    """Return the workers of this machine, or of a cluster."""
    from accelsurf.batch.pool import LocalPool

    if limits.scheduler is not None:
        from accelsurf.batch.dask_pool import DaskPool

        return DaskPool(run_on_cluster, limits.scheduler)
    return LocalPool(
        run_one,
        admission.jobs,
        bytes=admission.bytes,
        timeout=limits.case_timeout,
        limit=limits.memory,
        prepare=load,
    )


class _Silent(NamedTuple):
    """Display of a worker, silent: its messages are in the tables."""

    quiet: bool = True
    progress: ProgressKind | None = "none"


class LostCaseError(AccelsurfError):
    """The process of a case is gone, or was ended."""

    kind = "lost"


def _run(task: CaseTask) -> Outcome:
    watcher = Watcher(_Silent())
    if isinstance(task.config, TrackConfig):
        run_track_case(TrackCase(place_of(task), task.config), watcher)
        return _concluded(task, task.folder / report_name(task.case.id))
    place = place_of(task)
    try:
        truth = _truth_of(task)
    except AccelsurfError as error:
        report_failure(place, error)
        raise
    done = run_case(place, task.config, watcher, task.strict)
    dice = records.dice_with(done.result.labels_volume(), truth) if truth is not None else None
    return _concluded(task, done.place.report, dice, done.error is None)


def _concluded(
    task: CaseTask, path: Path, dice: float | None = None, is_good: bool = True
) -> Outcome:
    """The line of a case that has a result, from its report; a good one leaves a record for `--resume`."""
    report = load_report(path)
    if report is None:  # somebody has removed it at this moment
        return _failed(task, f"{path}: cannot be read", "run it again", 7)
    if is_good:
        records.write_record(task, report, dice)
    return outcome_of_report(task, report, dice)


def _truth_of(task: CaseTask) -> Volume | None:
    """The reference of a case; refused before anything is computed where it lies on another grid than the image."""
    if task.case.reference is None:
        return None
    image = read_channels(task.case.image, task.run.reading)[0]
    truth = read_labels(task.case.reference, grid=image.geometry)
    check_reference(truth, image)
    return truth


def _failed(task: CaseTask, message: str, hint: str, code: int, details: str = "") -> Outcome:
    return Outcome(
        task.case.id,
        "failed",
        message,
        folder=task.shown_folder,
        hint=hint,
        exit_code=code,
        details=details,
    )
