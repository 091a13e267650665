"""One segmentation from file to files: `segment` does it once, `batch` for each case.

Existing outputs are refused before anything is computed. The files of a run appear all at once or not at all. A report
says how the case ended, also when it failed; a failed run leaves an earlier result as it was. ``--resume`` goes on from
the state of an earlier run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from accelsurf.cases.interrupts import INTERRUPTED, Interrupts, resuming_command, say
from accelsurf.cases.outcome import shortcoming, summary_lines
from accelsurf.cases.watcher import Watcher
from accelsurf.errors import AccelsurfError, GeometryError, OutputError, exit_code_of
from accelsurf.image.volume import Volume, voxels_sha256
from accelsurf.io import (
    WARNING_KEY,
    FileSet,
    import_nibabel_for,
    read_channels,
    sha256,
    size_question,
    stored_grid,
    write_bytes,
    written_at,
)
from accelsurf.output import (
    MeshNotes,
    OutputFolder,
    Report,
    Status,
    build_report,
    check_label_settings,
    check_mesh_settings,
    check_outputs,
    complete_layout,
    describe_error,
    describe_input,
    describe_staged,
    into_image,
    is_of,
    is_there,
    naming_final,
    refuse_folder,
    report_json,
)
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry
    from accelsurf.run import CheckpointFile, Result

T = TypeVar("T")
#: Bytes of the largest image whose checksum is in the report of a run that could not begin.
MAX_HASHED = 1 << 31


#: Computes the result of a case.
Compute = Callable[[OutputFolder, RunConfig, "Watcher", "Log"], "Result"]


@dataclass
class Log:
    """Data for the report of a case, collected while it runs.

    Attributes
    ----------
    checksum : str or None
        SHA-256 of the image's file or files, once it was read.
    voxels : str or None
        SHA-256 of the values read; None of an image that is read in parts.
    written : list of int or None
        Of an image that is read in parts: when its files were written.
    geometry : Geometry or None
        Its grid.
    seconds : dict of str to float
        Wall time by part.
    outputs : list of dict
        Files written.
    warnings : list of str
    began : float
        The clock at the beginning.
    """

    checksum: str | None = None
    voxels: str | None = None
    written: list[int] | None = None
    geometry: Geometry | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    outputs: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    began: float = field(default_factory=time.perf_counter)

    def timed(self, part: str, work: Callable[[], T]) -> T:
        """Do some work and add its duration to a part of the run."""
        began = time.perf_counter()
        try:
            return work()
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began

    def note_grid(self, geometry: Geometry) -> None:
        """Keep the image's grid."""
        self.geometry = geometry

    def note_voxels(self, channels: Sequence[Volume]) -> None:
        """Keep the checksum of the image's voxels, whatever file they come from."""
        self.voxels = self.timed("load", lambda: voxels_sha256(channels))

    def note_written(self, image: Path) -> None:
        """Keep when an image's files were written; its voxels are never all read."""
        self.written = written_at(image)

    def take_checksum(self, image: Path) -> None:
        """Read the image's checksum, unless it is known."""
        if self.checksum is None:
            self.checksum = sha256(image)


@dataclass(frozen=True)
class _Case:
    """A case: its ``place``, the ``files`` that appear all at once, and the ``log`` for the report."""

    place: OutputFolder
    files: FileSet
    log: Log


@dataclass(frozen=True)
class Finished:
    """A case that ended with a result.

    Attributes
    ----------
    place : OutputFolder
    config : RunConfig
    result : Result
    log : Log
    code : int
        0 for a good result, or the exit code of ``error``.
    error : AccelsurfError or None
        The shortcoming of the result.
    """

    place: OutputFolder
    config: RunConfig
    result: Result
    log: Log
    code: int
    error: AccelsurfError | None = None

    def summary_lines(self, name: str) -> list[str]:
        """Return the lines printed at the end; ``name`` is that of the case."""
        log = self.log
        return summary_lines(
            name, self.result, log.outputs, log.seconds["total"], self.place.report
        )


def run_case(
    place: OutputFolder,
    config: RunConfig,
    watcher: Watcher,
    strict: bool = False,
    compute: Compute | None = None,
) -> Finished:
    """Run a case and write its outputs, all at once; print the shortcomings of its result.

    Parameters
    ----------
    place : OutputFolder
    config : RunConfig
    watcher : Watcher
        Shows progress, and ends the run at Ctrl-C.
    strict : bool
        Whether a run that did not converge, or whose result is doubtful, counts as failed.
    compute : callable, optional
        Computes the result, of another image than that of ``place`` or from more than it; by default a run from the
        start.

    Raises
    ------
    AccelsurfError
        When there is no result; the report has been written then, and an earlier result is as it was.
    KeyboardInterrupt
        After Ctrl-C; its state is kept for ``--resume``. A correction has no state, and leaves all files as they were.
    """
    log = Log()
    inputs = place.inputs(config)
    with place.stage(place.plan(config), inputs) as files:
        if place.has_checkpoint:
            place.refuse_left(place.checkpoint)
        case = _Case(place, files, log)
        try:
            result = (compute or _compute)(place, config, watcher, log)
            if result.stop.reason == "interrupted":
                raise KeyboardInterrupt
            config = result.config
            with watcher.writing():
                finished = _write(case, result, strict, watcher)
        except BaseException as failure:
            if not files.committed:
                files.discard()
                log.outputs.clear()
                if place.has_checkpoint or not isinstance(failure, KeyboardInterrupt):
                    _write_failure(case, config, failure)
                if place.has_checkpoint:
                    note_state(watcher, place.checkpoint)
            raise
    say_warnings(log.warnings, watcher)
    if finished.error is not None:
        say(f"error: {finished.error.message}\nhint: {finished.error.hint}")
    return finished


def _write(case: _Case, result: Result, strict: bool, watcher: Watcher) -> Finished:
    """Write the outputs of a result, of a failed run beside a result that stands; remove its checkpoint."""
    from accelsurf.output import outcome_title, preview_content, write_result

    place = case.place
    files = case.files
    log = case.log
    config = result.config
    title = outcome_title(place.name, result)
    # The picture shows the surface, which is extracted here.
    content = log.timed("mesh", lambda: preview_content(result, title))
    error, warnings = shortcoming(place.name, result, strict)
    log.warnings.extend(warnings)
    gone = [place.checkpoint.name] if place.has_checkpoint else []
    target = place if error is None else _failed_place(place, config, error)
    case = replace(case, place=target)
    names, meshes = target.names(config, result.geometry.slice_axis is not None), MeshNotes()
    with naming_final(files):
        written = write_result(
            result, files.staging, names, content, log.seconds, log.voxels, meshes
        )
        entries = describe_staged(files, {path.name: kind for kind, path in written})
        log.outputs.extend(
            entry | meshes.statistics.get(Path(entry["path"]).name, {}) for entry in entries
        )
        log.warnings.extend(meshes.warnings)
        code = watcher.exit_code(error.exit_code if error is not None else 0)
        status: Status = "failed" if error is not None else "ok"
        _write_report(case, config, status, code, error, result)
        complete_layout(config, target.image, target.path)
        target.commit(files, error is not None, gone)
    if config.label_group is not None and error is None:
        log.timed("write", lambda: into_image(result, target.image, target.overwrite))
    note_result(watcher, target)
    return Finished(target, config, result, log, code, error)


def _failed_place(place: OutputFolder, config: RunConfig, error: AccelsurfError) -> OutputFolder:
    """Return the place of a failed result's files; raise its error where they would replace a result of that name."""
    target = place.beside_result(place.plan(config).values())
    if target is not place and target.holds_result(target.plan(config).values()):
        say(
            f"warning: the result of this failed run is not written: {target.path} has other files {target.name}_*"
        )
        raise error
    return target


def say_warnings(warnings: Iterable[str], watcher: Watcher) -> None:
    """Print the warnings that the watcher has not printed yet."""
    for warning in warnings:
        if warning not in watcher.printed_warnings:
            say(f"warning: {warning}")


def note_result(watcher: Watcher, place: OutputFolder) -> None:
    """Note the report, for the last line after Ctrl-C."""
    watcher.note(f"the result is written: {place.report.absolute()}")


def note_state(watcher: Watcher, state: Path) -> None:
    """Note how to go on from a state, if there is one, for the last line after Ctrl-C."""
    if state.exists():
        watcher.note(f"no result is written, the state is kept; to go on: {resuming_command()}")


@contextmanager
def warning_without_report() -> Iterator[None]:
    """Print a warning where a report of a failure cannot be written: the failure itself matters more."""
    try:
        yield
    except AccelsurfError as second:
        say(f"warning: the report could not be written: {second.message}")


def _compute(place: OutputFolder, config: RunConfig, watcher: Watcher, log: Log) -> Result:
    volume, *more = read_image(place, config, log)
    return evolve_at(place, volume, more, config, watcher, log)


def evolve_at(
    place: OutputFolder,
    volume: Volume,
    channels: list[Volume],
    config: RunConfig,
    watcher: Watcher,
    log: Log,
) -> Result:
    """Run a case from its start, or from its checkpoint where it is to go on and there is one."""
    state = state_of(place, config) if place.has_checkpoint else None
    result = evolve(place.name, volume, channels, config, watcher, state)
    log.warnings.extend(result.warnings)
    return result


def state_of(place: OutputFolder, config: RunConfig) -> CheckpointFile:
    """The file of a run's state, written at intervals if asked for; that of an earlier run stays only for --resume."""
    from accelsurf.run import CheckpointFile

    refuse_folder(place.checkpoint)
    if not place.resume:
        place.checkpoint.unlink(missing_ok=True)
    return CheckpointFile(place.checkpoint, at_intervals=config.checkpoint is not None)


def read_image(place: OutputFolder, config: RunConfig, log: Log) -> list[Volume]:
    """Read the channels of a case's image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    InputError
        When it cannot be read; UsageError when a format cannot hold the result.
    """
    log.timed("load", lambda: import_nibabel_for(place.image))
    volume, *more = log.timed("load", lambda: read_channels(place.image, config.reading))
    log.timed("load", lambda: log.take_checksum(place.image))
    log.note_voxels([volume, *more])
    check_formats(place, config, volume, log)
    return [volume, *more]


def check_formats(place: OutputFolder, config: RunConfig, volume: Volume, log: Log) -> None:
    """Keep warning and grid of an image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    UsageError
        When one cannot.
    """
    log.note_grid(volume.geometry)
    if note := volume.metadata.get(WARNING_KEY):
        log.warnings.append(note)
    if volume.source is not None and (question := size_question(volume, volume.source)):
        log.warnings.append(question)
    labels = place.label_format(config)
    check_outputs(config, labels, volume.geometry)
    check_label_settings(config, volume, place.overwrite)
    check_mesh_settings(config)
    if not stored_grid(volume.geometry, f".{labels}").matches(volume.geometry):
        keeps_size = IMAGE_FORMATS[labels].keeps != "none"
        what = "the size of a pixel but not" if keeps_size else "neither the size of a voxel nor"
        log.warnings.append(f"{labels} keeps {what} where the image lies in the world")


def check_reference(truth: Volume, volume: Volume) -> None:
    """Refuse a reference on another grid before anything is computed.

    Raises
    ------
    GeometryError
        When the grids differ.
    """
    if not truth.geometry.matches(volume.geometry):
        difference = truth.geometry.difference(volume.geometry)
        raise GeometryError(
            f"reference and image lie on different grids: {difference}",
            "resample the reference first",
        )


def evolve(
    name: str,
    volume: Volume,
    channels: list[Volume],
    config: RunConfig,
    watcher: Watcher,
    state: CheckpointFile | None,
) -> Result:
    """Run one or several objects with progress, without writing anything but checkpoints to the file ``state``."""
    from accelsurf.api import segment, segment_objects

    then = "leaving all files as they are" if state is None else "keeping its state"
    with watcher.watch(name, config.max_steps, then):
        run = segment if config.objects is None else segment_objects
        return run(
            volume,
            channels=channels,
            config=config,
            on_step=watcher.on_step,
            on_warning=watcher.on_warning,
            checkpoint_to=state,
        )


def report_failure(place: OutputFolder, error: BaseException) -> None:
    """Write the report of a run that could not begin; print a warning when that fails too.

    Parameters
    ----------
    place : OutputFolder
    error : BaseException
    """
    with (
        warning_without_report(),
        replace(place, overwrite=True).stage(inputs=place.inputs(None)) as files,
    ):
        _write_failure(_Case(place, files, Log()), None, error)


def _write_failure(case: _Case, config: RunConfig | None, error: BaseException) -> None:
    """Write the report of a run without a result, beside a result that stands; a warning when that fails too."""
    stopped, image = isinstance(error, KeyboardInterrupt), case.place.image
    code = Interrupts.current().exit_code(INTERRUPTED if stopped else exit_code_of(error))
    target = case.place.beside_result(case.place.plan(config or RunConfig()).values())
    with warning_without_report():
        if target is not case.place and target.holds_result():
            raise OutputError(
                f"{target.report}: is the report of a result"
            )  # of an image that is called so
        if not stopped and image.is_file() and image.stat().st_size <= MAX_HASHED:
            case.log.take_checksum(image)
        case = replace(case, place=target)
        with naming_final(case.files):
            _write_report(case, config, "interrupted" if stopped else "failed", code, error, None)
            target.commit(case.files, failed=True)


def _write_report(
    case: _Case,
    config: RunConfig | None,
    status: Status,
    code: int,
    error: BaseException | None,
    result: Result | None,
) -> None:
    place, log = case.place, case.log
    log.seconds["total"] = time.perf_counter() - log.began
    of_result = set(result.warnings) if result is not None else set()
    contents: dict[str, Any] = build_report(
        status=status,
        exit_code=code,
        argv=sys.argv,
        config=config,
        source=describe_input(
            place.image,
            geometry=log.geometry,
            checksum=log.checksum,
            voxels=log.voxels,
            written=log.written,
        ),
        result=result,
        error=describe_error(error) if error is not None else None,
        seconds=log.seconds,
        outputs=log.outputs,
        warnings=[warning for warning in log.warnings if warning not in of_result],
    )
    write_bytes(case.files.staging / place.report.name, (report_json(contents) + "\n").encode())


def exit_code_of_finished(
    place: OutputFolder, config: RunConfig | TrackConfig, quiet: bool = False
) -> int | None:
    """The exit code of a run or a tracking that has ended with these settings, of this image; said unless ``quiet``.

    None where there is something to do.
    """
    report = Report(place.report)
    document = report.document
    if document is None or document["status"] != "ok" or not is_there(place.image):
        return None
    if not is_of(document, config, place.image):
        return None
    if len(report.unchanged()) < len(document["outputs"]):
        return None
    if not quiet:
        print(f"{place.name}: has ended already, see {place.report.absolute()}")
    return int(document["exit_code"])
