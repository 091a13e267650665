"""One segmentation from file to files: what `segment` does once and `demo` for each flow.

Existing outputs are refused before anything is computed. The files of a run appear all at once or not at all. A report
says how the case ended, also when it failed; a failed run leaves an earlier result as it was.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from accelsurf.cli import INTERRUPTED
from accelsurf.cli.error_lines import doubt_line
from accelsurf.cli.interrupts import Interrupts, say
from accelsurf.cli.outcome import shortcoming
from accelsurf.cli.place import Place
from accelsurf.errors import AccelsurfError, OutputError
from accelsurf.io import sha256
from accelsurf.io.files import write_bytes
from accelsurf.report import document, label_files, layouts, mesh_files, output_folder, output_names, result_sets
from accelsurf.report.document import describe_drafts, describe_input
from accelsurf.report.mesh_files import MeshNotes
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cli.progress import Watcher
    from accelsurf.grid.geometry import Geometry
    from accelsurf.grid.volume import Volume
    from accelsurf.io.file_set import FileSet
    from accelsurf.segmentation.result import Result

T = TypeVar("T")
#: Bytes of the largest image whose checksum is in the report of a run that could not begin.
MAX_HASHED = 1 << 31
#: Computes the result of a case.
Compute = Callable[["Place", RunConfig, "Watcher", "Log"], "Result"]


@dataclass
class Log:
    """Data for the report of a case, collected while it runs.

    Attributes
    ----------
    checksum : str or None
        SHA-256 of the image, once it was read.
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


@dataclass(frozen=True)
class Finished:
    """A case that ended with a result.

    Attributes
    ----------
    place : Place
    config : RunConfig
    result : Result
    log : Log
    code : int
        0 for a good result, or the exit code of what is wrong with it.
    error : AccelsurfError or None
        What is wrong with it.
    """

    place: Place
    config: RunConfig
    result: Result
    log: Log
    code: int
    error: AccelsurfError | None = None


def run_case(
    place: Place, config: RunConfig, watcher: Watcher, strict: bool = False, compute: Compute | None = None
) -> Finished:
    """Run a case and write its outputs, all at once; what is wrong with its result is printed.

    Parameters
    ----------
    place : Place
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
    """
    log = Log()
    inputs = place.inputs(config)
    with output_folder.opened_set(place.folder, place.name, inputs) as files:
        output_folder.refuse_existing(place.paths(config), place.overwrite, inputs)
        if place.has_checkpoint:
            _refuse_checkpoint(place)
        try:
            result = (compute or _compute)(place, config, watcher, log)
            config = result.config
            with watcher.writing():
                ended = place.has_checkpoint and result.stop.reason != "interrupted"
                gone = [place.checkpoint_path.name] if ended else []
                finished = _write(place, config, result, log, files, strict, watcher, gone)
        except BaseException as failure:
            if not files.committed:
                files.discard()
                log.outputs.clear()
                _write_failure(place, config, failure, log, files)
            raise
    _warn(log, finished.error, watcher)
    return finished


def _write(
    place: Place,
    config: RunConfig,
    result: Result,
    log: Log,
    files: FileSet,
    strict: bool,
    watcher: Watcher,
    gone: Sequence[str],
) -> Finished:
    """Write the outputs of a result, those of a failed run beside a result that stands; ``gone`` are removed."""
    from accelsurf.report import outputs

    title = outputs.outcome_title(place.name, result)
    # The picture shows the surface, which is extracted here.
    content = log.timed("mesh", lambda: outputs.preview_content(result, title))
    error, warnings = shortcoming(place.name, result, strict)
    log.warnings += warnings
    target = place if error is None else _failed_place(place, config, error)
    names, meshes = target.names(config, result.geometry.slice_axis is not None), MeshNotes()
    with output_folder.naming_final(files):
        written = outputs.write_result(result, files.drafts, names, content, log.seconds, log.checksum, meshes)
        entries = describe_drafts(files, {path.name: kind for kind, path in written})
        log.outputs += [entry | meshes.statistics.get(Path(entry["path"]).name, {}) for entry in entries]
        log.warnings += meshes.warnings
        interrupted = result.stop.reason == "interrupted"
        code = INTERRUPTED if interrupted else error.exit_code if error is not None else 0
        code = watcher.exit_code(code)
        status: document.Status = "interrupted" if interrupted else "failed" if error is not None else "ok"
        _write_report(target, config, log, status, code, error, result, files)
        layouts.complete(config, target.source, target.folder)
        _commit(target, files, error is not None, gone)
    if config.label_group is not None and error is None:
        log.timed("write", lambda: label_files.into_image(result, target.source, target.overwrite))
    watcher.outcome = f"the {'result so far' if interrupted else 'result'} is written: {target.report_path.absolute()}"
    return Finished(target, config, result, log, code, error)


def _failed_place(place: Place, config: RunConfig, error: AccelsurfError) -> Place:
    """Where the files of a failed result go; raises its error where they would replace a result that is called so."""
    target = place.beside_result(config)
    if target is not place and result_sets.result_stands(target.folder, target.name, target.paths(config).values()):
        say(f"warning: the result of this failed run is not written: {target.folder} has other files {target.name}_*")
        raise error
    return target


def _commit(target: Place, files: FileSet, failed: bool, gone: Sequence[str] = ()) -> None:
    """Put the drafts in place, and take away ``gone`` and what the earlier run wrote and this one does not."""
    written = [path.name for path in files.drafts.iterdir()]
    if not (failed or target.overwrite):  # another program may have put a file there while the run went on
        report = target.report_path
        output_folder.refuse_existing({"report" if n == report.name else n: files.folder / n for n in written}, False)
    outdated = result_sets.outdated(files.folder, target.name, written, failed, target.overwrite)
    files.commit(last=target.report_path.name, remove=[*outdated, *gone])


def _warn(log: Log, error: AccelsurfError | None, watcher: Watcher) -> None:
    for warning in log.warnings:
        if warning in watcher.said:
            continue
        say(doubt_line(warning))
    if error is not None:
        say(f"error: {error.message}\nhint: {error.hint}")


def _compute(place: Place, config: RunConfig, watcher: Watcher, log: Log) -> Result:
    volume, *more = read_image(place, config, log)
    return evolve_at(place, volume, more, config, watcher, log)


def evolve_at(
    place: Place, volume: Volume, channels: list[Volume], config: RunConfig, watcher: Watcher, log: Log
) -> Result:
    """Run a case from its start, or from its checkpoint where it is to go on and there is one."""
    result = evolve(place.name, volume, channels, config, watcher, state_of(place, config))
    log.warnings.extend(result.warnings)
    return result


def state_of(place: Place, config: RunConfig) -> Path | None:
    """The file of a run's state, where it has one; that of an earlier run is removed unless it is to go on."""
    state = place.checkpoint_path
    output_folder.refuse_folder(state)
    if not place.resume:
        state.unlink(missing_ok=True)
    return state if config.checkpoint is not None or state.exists() else None


def _refuse_checkpoint(place: Place) -> None:
    """Refuse to lose the work of a killed run."""
    if place.checkpoint_path.exists() and not (place.resume or place.overwrite):
        raise OutputError(
            f"{place.checkpoint_path}: is the state of a run that was stopped",
            "add --resume to go on from it, or --overwrite to begin anew",
        )


def read_image(place: Place, config: RunConfig, log: Log) -> list[Volume]:
    """Read the channels of a case's image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    InputError
        When it cannot be read; UsageError when a format cannot hold the result.
    """
    from accelsurf import io
    from accelsurf.io import channels
    from accelsurf.io.formats.nibabel_import import import_nibabel_for

    log.timed("load", lambda: import_nibabel_for(place.source))
    volume, *more = log.timed("load", lambda: channels.read(place.source, config.reading))
    if log.checksum is None:
        log.checksum = log.timed("load", lambda: io.sha256(place.source))
    check_formats(place, config, volume, log)
    return [volume, *more]


def check_formats(place: Place, config: RunConfig, volume: Volume, log: Log) -> None:
    """Note what is said about an image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    UsageError
        When one cannot.
    """
    from accelsurf import io
    from accelsurf.io import images

    log.geometry = volume.geometry
    if note := volume.metadata.get(io.WARNING_KEY):
        log.warnings.append(note)
    labels = place.label_format(config)
    output_names.check(config, labels, volume.geometry)
    label_files.check(config, volume, place.overwrite)
    mesh_files.check(config)
    if not images.stored_grid(volume.geometry, f".{labels}").matches(volume.geometry):
        keeps_size = IMAGE_FORMATS[labels].keeps != "none"
        what = "the size of a pixel but not" if keeps_size else "neither the size of a voxel nor"
        log.warnings.append(f"{labels} keeps {what} where the image lies in the world")


def evolve(
    name: str, volume: Volume, channels: list[Volume], config: RunConfig, watcher: Watcher, state: Path | None = None
) -> Result:
    """Run one or several objects with progress, without writing anything but checkpoints to the file ``state``."""
    from accelsurf.segmentation.api import segment, segment_objects

    with watcher.watch(name, config.max_steps):
        if config.objects is not None:
            return segment_objects(
                volume, channels=channels, config=config, on_step=watcher.on_step, on_warning=watcher.on_warning,
                checkpoint_to=state,
            )
        return segment(
            volume, channels=channels, config=config, on_step=watcher.on_step, on_warning=watcher.on_warning,
            checkpoint_to=state,
        )


def report_failure(place: Place, error: BaseException) -> None:
    """Write the report of a run that could not begin; print a warning when that fails too.

    Parameters
    ----------
    place : Place
    error : BaseException
    """
    try:
        with output_folder.opened_set(place.folder, place.name, place.inputs(None)) as files:
            _write_failure(place, None, error, Log(), files)
    except AccelsurfError as second:
        say(f"warning: the report could not be written: {second.message}")


def _write_failure(
    place: Place, config: RunConfig | None, error: BaseException, log: Log, files: FileSet
) -> None:
    """Write the report of a run without a result, beside a result that stands; a warning when that fails too."""
    stopped = isinstance(error, KeyboardInterrupt)
    code = error.exit_code if isinstance(error, AccelsurfError) else 3 if isinstance(error, MemoryError) else 1
    code = Interrupts.current().exit_code(INTERRUPTED if stopped else code)
    target = place.beside_result(config)
    try:
        if target is not place and result_sets.result_stands(target.folder, target.name, ()):
            raise OutputError(f"{target.report_path}: is the report of a result")  # of an image that is called so
        if log.checksum is None and not stopped:
            log.checksum = _checksum(place.source)
        with output_folder.naming_final(files):
            _write_report(target, config, log, "interrupted" if stopped else "failed", code, error, None, files)
            _commit(target, files, failed=True)
    except AccelsurfError as second:
        say(f"warning: the report could not be written: {second.message}")


def _checksum(image: Path) -> str | None:
    """That of an image that could not be used; None where there is none, or where it would take long."""
    if not image.is_file() or image.stat().st_size > MAX_HASHED:
        return None
    return sha256(image)


def _write_report(
    place: Place,
    config: RunConfig | None,
    log: Log,
    status: document.Status,
    code: int,
    error: BaseException | None,
    result: Result | None,
    files: FileSet,
) -> None:
    log.seconds["total"] = time.perf_counter() - log.began
    own = set(result.warnings) if result is not None else set()
    contents: dict[str, Any] = document.build(
        status=status,
        exit_code=code,
        argv=sys.argv,
        config=config,
        source=describe_input(place.source, geometry=log.geometry, checksum=log.checksum),
        result=result,
        error=document.describe_error(error) if error is not None else None,
        seconds=log.seconds,
        outputs=log.outputs,
        warnings=[warning for warning in log.warnings if warning not in own],
    )
    write_bytes(files.drafts / place.report_path.name, (document.to_json(contents) + "\n").encode())
