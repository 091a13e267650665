"""One segmentation from file to files: what `segment` does once and `demo` for each flow.

The order keeps promises: existing outputs are refused before anything is computed; each file appears whole or not at
all; and whatever happens after that, a report says how it ended.
"""

from __future__ import annotations

import functools
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.cli import INTERRUPTED, objects
from accelsurf.errors import AccelsurfError, DivergedError, DoubtfulError, EmptyResultError, NotConvergedError
from accelsurf.io.files import write_bytes
from accelsurf.report import document, outputs, preview
from accelsurf.report.outputs import make_writable, refuse_existing, tells_of_failure
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from typing_extensions import TypeIs

    from accelsurf.cli.progress import Watcher
    from accelsurf.grid.volume import Volume
    from accelsurf.segmentation.api import Result
    from accelsurf.segmentation.several import ObjectsResult


@dataclass
class Case:
    """One input, its settings, and where its outputs go.

    Attributes
    ----------
    source : Path
        The image.
    folder : Path
        Where the outputs go.
    config : RunConfig or None
        Settings; None when they were no good, and only a report of that can be written.
    name : str
        First part of every output's name; the input's name without suffix unless given.
    overwrite : bool
        Whether existing outputs may be replaced.
    strict : bool
        Whether a run that did not converge, or whose result is doubtful, counts as failed.
    """

    source: Path
    folder: Path
    config: RunConfig | None = None
    name: str = ""
    overwrite: bool = False
    strict: bool = False
    volume: Volume | None = None
    result: Result | ObjectsResult | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    outputs: list[dict[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    checksum: str | None = None

    def __post_init__(self) -> None:
        from accelsurf.io import split_name

        self.begin()
        stem, suffix = split_name(self.source)
        self.name = self.name or stem
        self._suffix = suffix

    def begin(self) -> None:
        """Start the clock of the total time."""
        self._began = time.perf_counter()

    @property
    def is_2d(self) -> bool:
        """Whether the image that was read has one slice."""
        return self.volume is not None and self.volume.geometry.slice_axis is not None

    def label_format(self, config: RunConfig) -> str:
        """Return the format of the label map."""
        return outputs.label_format(config, self._suffix)

    @property
    def report_path(self) -> Path:
        """Where the report goes."""
        return self.folder / f"{self.name}_report.json"

    def names(self, config: RunConfig) -> dict[str, str]:
        """Return the last part of every output's name by its kind; before the image is read, all that there may be."""
        return outputs.names(config, self.label_format(config), None if self.volume is None else self.is_2d)

    def paths(self, config: RunConfig) -> dict[str, Path]:
        """Return every output of the run by kind, the report last; before the image is read, all that there may be."""
        names = self.names(config)
        if config.objects is not None:
            return objects.paths(self, names) | {"report": self.report_path}
        return {kind: self.folder / f"{self.name}_{name}" for kind, name in names.items()} | {
            "report": self.report_path
        }


def run_case(case: Case, watcher: Watcher) -> int:
    """Run a case and write its outputs.

    Parameters
    ----------
    case : Case
        What to run; afterwards its ``result`` and ``outputs`` tell what came out.
    watcher : Watcher
        Shows progress, and passes Ctrl-C on.

    Returns
    -------
    int
        0 when there is a result, or the exit code that tells why it is not what was wanted; the reason is printed.

    Raises
    ------
    AccelsurfError
        When there is no result; the report of it is written already.
    """
    assert case.config is not None
    case.begin()
    refuse_existing(case.paths(case.config), case.overwrite)
    try:
        _compute(case, watcher)
        _write(case, case.config)
        error = _shortcoming(case)
    except BaseException as failure:
        report_failure(case, failure)
        raise
    interrupted = case.result is not None and case.result.stop.reason == "interrupted"
    code = INTERRUPTED if interrupted else error.exit_code if error is not None else 0
    status: document.Status = "interrupted" if interrupted else "failed" if error is not None else "ok"
    _write_report(case, status, code, error)
    for warning in case.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if error is not None:
        print(f"error: {error.message}\nhint: {error.hint}", file=sys.stderr)
    return code


def _compute(case: Case, watcher: Watcher) -> None:
    from accelsurf import io
    from accelsurf.io import channels
    from accelsurf.io.formats import raster
    from accelsurf.segmentation.api import segment
    from accelsurf.segmentation.several import segment_objects

    assert case.config is not None
    case.volume, *more = _timed(case, "load", lambda: channels.read(case.source))
    case.checksum = _timed(case, "load", lambda: io.sha256(case.source))
    if note := case.volume.metadata.get(io.WARNING_KEY):
        case.warnings.append(note)
    labels = case.label_format(case.config)
    outputs.check(case.config, labels, case.volume.geometry)
    if not raster.preserves(case.volume.geometry, f".{labels}"):
        case.warnings.append(f"{labels} keeps the size of a pixel but not where the image lies in the world")
    preview.load_meanwhile()
    with watcher.watch(case.name, case.config.max_steps):
        if case.config.objects is not None:
            case.result = segment_objects(case.volume, channels=more, config=case.config, on_step=watcher.on_step)
        else:
            case.result = segment(case.volume, channels=more, config=case.config, on_step=watcher.on_step)
    case.warnings.extend(case.result.warnings)


def _is_many(result: Result | ObjectsResult) -> TypeIs[ObjectsResult]:
    return hasattr(result, "objects")


def _timed(case: Case, part: str, work: Callable[[], Any]) -> Any:
    """Do some work and add its duration to a part of the run."""
    began = time.perf_counter()
    try:
        return work()
    finally:
        case.seconds[part] = case.seconds.get(part, 0.0) + time.perf_counter() - began


def _write(case: Case, config: RunConfig) -> None:
    """Write everything but the report. A run that left no surface leaves a trace and a picture only."""
    assert case.result is not None
    if _is_many(case.result):
        names, picture = case.names(config), scene(case)
        writers = objects.writers(case, config, case.result, names, picture)
        for path, (kind, writer) in writers.items():
            _timed(case, "write", functools.partial(writer, path))
            case.outputs.append(document.describe_output(path, kind))
        objects.remove_old(case, names, writers)
        return
    names = {kind: path.name for kind, path in case.paths(config).items() if kind != "report"}
    for kind, path in outputs.write_result(case.result, case.folder, names, scene(case), case.seconds):
        case.outputs.append(document.describe_output(path, kind))


def scene(case: Case, title: str = "", reference: Any = None) -> preview.Scene:
    """Return what a picture of a finished case shows.

    Parameters
    ----------
    case : Case
        With a result.
    title : str, optional
        Its heading; says how the run ended unless given.
    reference : ndarray, optional
        Labels to draw as a second contour.
    """
    assert case.result is not None and case.config is not None
    return outputs.scene(case.result, title or outputs.told(case.name, case.result), reference)


def _shortcoming(case: Case) -> AccelsurfError | None:
    """Say what is wrong with a run that did end, or None. Short of an error it is a warning."""
    assert case.result is not None
    if _is_many(case.result):
        return objects.shortcoming(case, case.result)
    stop = case.result.stop
    told = f"{case.name}: {stop.reason} after {stop.steps} steps: {stop.message}"
    match stop.reason:
        case "vanished" | "filled":
            return EmptyResultError(told, "start closer to the object, or with less --smoothness")
        case "diverged":
            return DivergedError(told, "use a smaller --cfl; and please report this image and its settings")
        case "max-steps" | "stalled" if case.strict:
            return NotConvergedError(told, "raise --max-steps; the outputs show how far it got")
        case "max-steps" | "stalled":
            case.warnings.append(told)
    doubts = case.result.quality.warnings
    if doubts and case.strict:
        more = f" (and {len(doubts) - 1} more)" if len(doubts) > 1 else ""
        return DoubtfulError(f"{case.name}: {doubts[0]}{more}", "look at the picture; without --strict it is a warning")
    case.warnings.extend(doubts)
    return None


def report_failure(case: Case, error: BaseException) -> None:
    """Write the report of a run that left no result; say so on stderr when even that fails.

    A report that stands for a result is not replaced, unless outputs may be.
    """
    if os.path.lexists(case.report_path) and not (case.overwrite or tells_of_failure(case.report_path)):
        return
    stopped = isinstance(error, KeyboardInterrupt)
    code = INTERRUPTED if stopped else error.exit_code if isinstance(error, AccelsurfError) else 1
    code = 3 if isinstance(error, MemoryError) else code
    try:
        make_writable(case.folder)
        if case.checksum is None and case.source.is_file():
            from accelsurf.io import sha256

            case.checksum = sha256(case.source)
        _write_report(case, "interrupted" if stopped else "failed", code, error)
    except AccelsurfError as second:
        print(f"warning: the report could not be written: {second.message}", file=sys.stderr)


def _write_report(case: Case, status: document.Status, code: int, error: BaseException | None) -> None:
    geometry = case.volume.geometry if case.volume is not None else None
    case.seconds["total"] = time.perf_counter() - case._began
    own = set(case.result.warnings) if case.result is not None else set()
    contents = document.build(
        status=status,
        exit_code=code,
        argv=sys.argv,
        config=case.config,
        source=document.describe_input(case.source, geometry=geometry, checksum=case.checksum),
        result=case.result,
        error=document.describe_error(error) if error is not None else None,
        seconds=case.seconds,
        outputs=case.outputs,
        warnings=[warning for warning in case.warnings if warning not in own],
    )
    write_bytes(case.report_path, (document.to_json(contents) + "\n").encode())
