"""One segmentation from file to files: `segment` does it once, `batch` for each case.

Existing outputs are refused before anything is computed. The files of a run appear all at once or not at all. A report
says how the case ended, also when it failed; a failed run leaves an earlier result as it was. ``--resume`` goes on from
what an earlier run has left.
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
from accelsurf.errors import AccelsurfError, GeometryError, OutputError, exit_code_of
from accelsurf.io import sha256
from accelsurf.io.file_set import finish_killed_runs
from accelsurf.io.files import write_bytes, written_at
from accelsurf.output import document, label_files, layouts, result_sets
from accelsurf.output import folder as output_folder
from accelsurf.output import names as output_names
from accelsurf.output.document import describe_input, describe_staged
from accelsurf.output.folder import inputs_of
from accelsurf.output.given_image import is_there
from accelsurf.output.mesh_files import MeshNotes, check_mesh_settings
from accelsurf.settings.file_formats import IMAGE_FORMATS
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.track_config import TrackConfig

if TYPE_CHECKING:
    from accelsurf.cases.watcher import Watcher
    from accelsurf.grid.geometry import Geometry
    from accelsurf.image.volume import Volume
    from accelsurf.io.file_set import FileSet
    from accelsurf.run.checkpoint_file import CheckpointFile
    from accelsurf.run.result import Result

T = TypeVar("T")
#: Bytes of the largest image whose checksum is in the report of a run that could not begin.
MAX_HASHED = 1 << 31


@dataclass(frozen=True)
class Place:
    """The image of a case, and the folder and names of its outputs.

    Attributes
    ----------
    source : Path
        The image.
    folder : Path
    name : str
        First part of every output's name.
    overwrite : bool
        Whether existing outputs may be replaced.
    resume : bool
        Whether the run goes on from the checkpoint of an earlier one.
    has_checkpoint : bool
        Whether it may have one: a correction has none.
    further : tuple of Path or None
        Files that the command reads beside the image and what its settings name.
    """

    source: Path
    folder: Path
    name: str
    overwrite: bool = False
    resume: bool = False
    has_checkpoint: bool = True
    further: tuple[Path | None, ...] = ()

    @classmethod
    def for_image(
        cls, source: Path, folder: Path, overwrite: bool = False, *further: Path | None
    ) -> Place:
        """The place of an image whose outputs have its name, without suffix; ``further`` files are read, too."""
        from accelsurf.io.headers import name_of

        return cls(source, folder, name_of(source), overwrite, further=further)

    def inputs(self, config: RunConfig | TrackConfig | None) -> list[Path]:
        """All files that the command reads: none of them may be replaced."""
        return inputs_of(self.source, config, *self.further)

    @property
    def report_path(self) -> Path:
        """Path of the report."""
        return self.folder / result_sets.report_name(self.name)

    @property
    def checkpoint_path(self) -> Path:
        """Path of the state of the run while it goes on."""
        return self.folder / f"{self.name}_checkpoint.npz"

    def refuse_left(self, *states: Path) -> None:
        """Refuse to lose the state of a run that was stopped, in one of ``states``.

        Raises
        ------
        OutputError
            When one of them is there, and the run neither goes on from it nor replaces it.
        """
        left = next((path for path in states if path.exists()), None)
        if left is not None and not (self.resume or self.overwrite):
            raise OutputError(
                f"{left}: is the state of a run that was stopped",
                "add --resume to go on from it, or --overwrite to begin anew",
            )

    def beside_result(self, config: RunConfig | None) -> Place:
        """Return the place of a failed run's files: this one, or where a result stands, beside it under other names."""
        planned = self.paths(config or RunConfig()).values()
        if result_sets.result_stands(self.folder, self.name, planned):
            return replace(self, name=self.name + result_sets.FAILED)
        return self

    def label_format(self, config: RunConfig) -> str:
        """The format of the label map."""
        from accelsurf.io import split_name

        return output_names.label_format(config, split_name(self.source)[1])

    def names(self, config: RunConfig, is_2d: bool | None = None) -> dict[str, str]:
        """Name of every output by its kind; before the image is read (``is_2d`` is None), of all possible ones."""
        names = output_names.names(config, self.label_format(config), is_2d)
        names = {kind: f"{self.name}_{name}" for kind, name in names.items()}
        return layouts.renamed(config, self.source, self.name, names)

    def laid_out(self, config: RunConfig) -> Place:
        """Return the place in the layout of the settings.

        Raises
        ------
        UsageError
            When the image cannot be in that layout.
        """
        layouts.check_layout(config, self.source, self.folder, self.name)
        return replace(self, folder=layouts.folder_of(config, self.source, self.folder))

    def paths(self, config: RunConfig) -> dict[str, Path]:
        """Every possible output by kind, the report last; of several objects those that exist already."""
        names = self.names(config)
        if not config.has_ids:
            paths = {kind: self.folder / name for kind, name in names.items()}
        else:
            paths = {
                k: self.folder / name
                for k, name in names.items()
                if not k.startswith(output_names.EACH)
            }
            paths |= {path.name: path for path in output_names.existing(self.folder, names)}
        return paths | {"report": self.report_path}


#: Computes the result of a case.
Compute = Callable[["Place", RunConfig, "Watcher", "Log"], "Result"]


@dataclass
class Log:
    """Data for the report of a case, collected while it runs.

    Attributes
    ----------
    checksum : str or None
        SHA-256 of the image's file or files, once it was read.
    voxels : str or None
        SHA-256 of what was read; None of an image that is read in parts.
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
        """Keep what tells the image from another, whatever file it comes from."""
        from accelsurf.image.volume import voxels_sha256

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

    place: Place
    files: FileSet
    log: Log


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

    def summary_lines(self, name: str) -> list[str]:
        """Return the lines printed at the end; ``name`` is that of the case."""
        log = self.log
        return summary_lines(
            name, self.result, log.outputs, log.seconds["total"], self.place.report_path
        )


def run_case(
    place: Place,
    config: RunConfig,
    watcher: Watcher,
    strict: bool = False,
    compute: Compute | None = None,
) -> Finished:
    """Run a case and write its outputs, all at once; print the shortcomings of its result.

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
    KeyboardInterrupt
        After Ctrl-C; its state is kept for ``--resume``. A correction has no state, and leaves all files as they were.
    """
    log = Log()
    inputs = place.inputs(config)
    with output_folder.opened_set(place.folder, place.name, inputs) as files:
        output_folder.refuse_existing(place.paths(config), place.overwrite, inputs)
        if place.has_checkpoint:
            place.refuse_left(place.checkpoint_path)
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
                    note_state(watcher, place.checkpoint_path)
            raise
    say_warnings(log.warnings, watcher)
    if finished.error is not None:
        say(f"error: {finished.error.message}\nhint: {finished.error.hint}")
    return finished


def _write(case: _Case, result: Result, strict: bool, watcher: Watcher) -> Finished:
    """Write the outputs of a result, those of a failed run beside a result that stands; remove its checkpoint."""
    from accelsurf.output import outputs

    place, files, log, config = case.place, case.files, case.log, result.config
    title = outputs.outcome_title(place.name, result)
    # The picture shows the surface, which is extracted here.
    content = log.timed("mesh", lambda: outputs.preview_content(result, title))
    error, warnings = shortcoming(place.name, result, strict)
    log.warnings.extend(warnings)
    gone = [place.checkpoint_path.name] if place.has_checkpoint else []
    target = place if error is None else _failed_place(place, config, error)
    case = replace(case, place=target)
    names, meshes = target.names(config, result.geometry.slice_axis is not None), MeshNotes()
    with output_folder.naming_final(files):
        written = outputs.write_result(
            result, files.staging, names, content, log.seconds, log.voxels, meshes
        )
        entries = describe_staged(files, {path.name: kind for kind, path in written})
        log.outputs.extend(
            entry | meshes.statistics.get(Path(entry["path"]).name, {}) for entry in entries
        )
        log.warnings.extend(meshes.warnings)
        code = watcher.exit_code(error.exit_code if error is not None else 0)
        status: document.Status = "failed" if error is not None else "ok"
        _write_report(case, config, status, code, error, result)
        layouts.complete(config, target.source, target.folder)
        output_folder.commit(
            files, target.report_path.name, error is not None, target.overwrite, gone
        )
    if config.label_group is not None and error is None:
        log.timed("write", lambda: label_files.into_image(result, target.source, target.overwrite))
    note_result(watcher, target)
    return Finished(target, config, result, log, code, error)


def _failed_place(place: Place, config: RunConfig, error: AccelsurfError) -> Place:
    """Return the place of a failed result's files; raise its error where they would replace a result of that name."""
    target = place.beside_result(config)
    if target is not place and result_sets.result_stands(
        target.folder, target.name, target.paths(config).values()
    ):
        say(
            f"warning: the result of this failed run is not written: {target.folder} has other files {target.name}_*"
        )
        raise error
    return target


def say_warnings(warnings: Iterable[str], watcher: Watcher) -> None:
    """Print the warnings that the watcher has not printed yet."""
    for warning in warnings:
        if warning not in watcher.printed_warnings:
            say(f"warning: {warning}")


def note_result(watcher: Watcher, place: Place) -> None:
    """Note the report, for the last line after Ctrl-C."""
    watcher.note(f"the result is written: {place.report_path.absolute()}")


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


def _compute(place: Place, config: RunConfig, watcher: Watcher, log: Log) -> Result:
    volume, *more = read_image(place, config, log)
    return evolve_at(place, volume, more, config, watcher, log)


def evolve_at(
    place: Place,
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


def state_of(place: Place, config: RunConfig) -> CheckpointFile:
    """The file of a run's state, written at intervals if asked for; that of an earlier run stays only for --resume."""
    from accelsurf.run.checkpoint_file import CheckpointFile

    output_folder.refuse_folder(place.checkpoint_path)
    if not place.resume:
        place.checkpoint_path.unlink(missing_ok=True)
    return CheckpointFile(place.checkpoint_path, at_intervals=config.checkpoint is not None)


def read_image(place: Place, config: RunConfig, log: Log) -> list[Volume]:
    """Read the channels of a case's image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    InputError
        When it cannot be read; UsageError when a format cannot hold the result.
    """
    from accelsurf.io import channels
    from accelsurf.io.formats.nifti import import_nibabel_for

    log.timed("load", lambda: import_nibabel_for(place.source))
    volume, *more = log.timed("load", lambda: channels.read_channels(place.source, config.reading))
    log.timed("load", lambda: log.take_checksum(place.source))
    log.note_voxels([volume, *more])
    check_formats(place, config, volume, log)
    return [volume, *more]


def check_formats(place: Place, config: RunConfig, volume: Volume, log: Log) -> None:
    """Keep warning and grid of an image, and check that the formats of the outputs can hold a result on its grid.

    Raises
    ------
    UsageError
        When one cannot.
    """
    from accelsurf import io
    from accelsurf.io import images
    from accelsurf.io.headers import size_question

    log.note_grid(volume.geometry)
    if note := volume.metadata.get(io.WARNING_KEY):
        log.warnings.append(note)
    if volume.source is not None and (question := size_question(volume, volume.source)):
        log.warnings.append(question)
    labels = place.label_format(config)
    output_names.check_outputs(config, labels, volume.geometry)
    label_files.check_label_settings(config, volume, place.overwrite)
    check_mesh_settings(config)
    if not images.stored_grid(volume.geometry, f".{labels}").matches(volume.geometry):
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
    from accelsurf.api.segment import segment, segment_objects

    then = "leaving all files as they are" if state is None else "keeping its state"
    with watcher.watch(name, config.max_steps, then):
        if config.objects is not None:
            return segment_objects(
                volume,
                channels=channels,
                config=config,
                on_step=watcher.on_step,
                on_warning=watcher.on_warning,
                checkpoint_to=state,
            )
        return segment(
            volume,
            channels=channels,
            config=config,
            on_step=watcher.on_step,
            on_warning=watcher.on_warning,
            checkpoint_to=state,
        )


def report_failure(place: Place, error: BaseException) -> None:
    """Write the report of a run that could not begin; print a warning when that fails too.

    Parameters
    ----------
    place : Place
    error : BaseException
    """
    with (
        warning_without_report(),
        output_folder.opened_set(place.folder, place.name, place.inputs(None)) as files,
    ):
        _write_failure(_Case(place, files, Log()), None, error)


def _write_failure(case: _Case, config: RunConfig | None, error: BaseException) -> None:
    """Write the report of a run without a result, beside a result that stands; a warning when that fails too."""
    stopped, image = isinstance(error, KeyboardInterrupt), case.place.source
    code = Interrupts.current().exit_code(INTERRUPTED if stopped else exit_code_of(error))
    target = case.place.beside_result(config)
    with warning_without_report():
        if target is not case.place and result_sets.result_stands(target.folder, target.name, ()):
            raise OutputError(
                f"{target.report_path}: is the report of a result"
            )  # of an image that is called so
        if not stopped and image.is_file() and image.stat().st_size <= MAX_HASHED:
            case.log.take_checksum(image)
        case = replace(case, place=target)
        with output_folder.naming_final(case.files):
            _write_report(case, config, "interrupted" if stopped else "failed", code, error, None)
            output_folder.commit(case.files, target.report_path.name, True, target.overwrite)


def _write_report(
    case: _Case,
    config: RunConfig | None,
    status: document.Status,
    code: int,
    error: BaseException | None,
    result: Result | None,
) -> None:
    place, log = case.place, case.log
    log.seconds["total"] = time.perf_counter() - log.began
    of_result = set(result.warnings) if result is not None else set()
    contents: dict[str, Any] = document.build(
        status=status,
        exit_code=code,
        argv=sys.argv,
        config=config,
        source=describe_input(
            place.source,
            geometry=log.geometry,
            checksum=log.checksum,
            voxels=log.voxels,
            written=log.written,
        ),
        result=result,
        error=document.describe_error(error) if error is not None else None,
        seconds=log.seconds,
        outputs=log.outputs,
        warnings=[warning for warning in log.warnings if warning not in of_result],
    )
    write_bytes(
        case.files.staging / place.report_path.name, (document.to_json(contents) + "\n").encode()
    )


def exit_code_of_finished(
    place: Place, config: RunConfig | TrackConfig, quiet: bool = False
) -> int | None:
    """The exit code of a run or a tracking that has ended with these settings, of this image; said unless ``quiet``.

    None where there is something to do.

    Raises
    ------
    OutputError
        When files of a killed run cannot be put in place.
    """
    if not place.folder.is_dir():
        return None
    finish_killed_runs(place.folder)
    document = result_sets.load_report(place.report_path)
    if document is None or document["status"] != "ok" or not is_there(place.source):
        return None
    if not result_sets.is_of(document, config, place.source):
        return None
    there = result_sets.unchanged_outputs(place.report_path, ())
    if len(there) < len(document["outputs"]):
        return None
    if not quiet:
        print(f"{place.name}: has ended already, see {place.report_path.absolute()}")
    return int(document["exit_code"])


def resumed_place(place: Place, planned: Iterable[Path]) -> Place:
    """The place to go on at: the ``planned`` files of a run that was interrupted or failed may be replaced."""
    is_free = result_sets.unfinished_alone(place.report_path, planned)
    return replace(place, resume=True, overwrite=place.overwrite or is_free)
