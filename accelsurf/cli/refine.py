"""``accelsurf refine``: a finished run goes on, corrected by clicks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, Token

from accelsurf.cases import Interrupts, Watcher, resuming_command
from accelsurf.cli.options import FILES, RUN, Display, File, Overwrite, Switch, required
from accelsurf.errors import InputError, OutputError, UsageError
from accelsurf.io import refuse_unfinished, sha256
from accelsurf.output import GivenImage, OutputFolder, Report
from accelsurf.settings.corrections import Correction, click_by_click, corrections_in_order
from accelsurf.settings.run_config import RunConfig

if TYPE_CHECKING:
    from accelsurf.cases import Finished, Log, Watcher
    from accelsurf.interact import StateFile
    from accelsurf.output import GivenImage, OutputFolder, Report
    from accelsurf.run import Result

_STATE = "segment writes a state with clicks, and with --keep-state yes"
_OTHER = "give that of the run with --image FILE, or run accelsurf segment again"


def _clicks_in_order(_: Any, tokens: Sequence[Token]) -> tuple[tuple[str, str], ...]:
    """Return side and place of each click, as they were typed."""
    return tuple(((token.keyword or "").removeprefix("--"), token.value) for token in tokens)


#: Both sides are one parameter, so that their order is known.
ClicksInOrder = Annotated[
    tuple[tuple[str, str], ...],
    Parameter(
        name=("--inside", "--outside"),
        group=RUN,
        metavar="WHERE",
        n_tokens=1,
        accepts_keys=False,
        negative_iterable=(),
        show_default=False,
        converter=_clicks_in_order,
    ),
]


@Parameter(name="*")
@dataclass(frozen=True)
class ObjectOptions:
    """Options that change the objects.

    Parameters
    ----------
    new
        Id of a further object, which begins at the inside clicks; the others stay. With --split: of what is split off.
    size
        About how large the new object is, with its unit: 250ml.
    merge
        Ids of objects that become the first of them: 1,3.
    split
        A point:X,Y,Z in an object of several parts: the part with the point becomes an object of its own.
    remove
        Id of an object that is not wanted.
    """

    new: Annotated[str | None, Parameter(group=RUN)] = None
    size: Annotated[str | None, Parameter(group=RUN)] = None
    merge: Annotated[str | None, Parameter(group=RUN)] = None
    split: Annotated[str | None, Parameter(group=RUN)] = None
    remove: Annotated[str | None, Parameter(group=RUN)] = None


@Parameter(name="*")
@dataclass(frozen=True)
class WholeOptions:
    """Options that mend an object as a whole, before the clicks.

    Parameters
    ----------
    to_edges
        Bring the whole border to the image's edges, by at most this length in mm; no click is needed.
    islands
        Remove parts of the object that are smaller than this, as 50mm3; the largest stays.
    holes
        Fill what the object encloses that is smaller than this, as 50mm3.
    """

    to_edges: Annotated[float | None, Parameter(group=RUN, metavar="MM")] = None
    islands: Annotated[str | None, Parameter(group=RUN, metavar="VOLUME")] = None
    holes: Annotated[str | None, Parameter(group=RUN, metavar="VOLUME")] = None


@dataclass(frozen=True)
class _Source:
    """A finished run in a folder: its ``report``, the first part of its files' ``name``, and its ``image``."""

    report: Report
    name: str
    image: GivenImage
    state: StateFile


def refine(
    result: File = None,
    *,
    clicks: ClicksInOrder = (),
    near: Annotated[str, Parameter(group=RUN)] = "auto",
    object: Annotated[str | None, Parameter(group=RUN)] = None,
    objects: ObjectOptions | None = None,
    whole: WholeOptions | None = None,
    labels: Annotated[
        str | None, Parameter(group=FILES, metavar="FILE[@IDS]", show_default=False)
    ] = None,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"), group=FILES)] = None,
    image: File = None,
    overwrite: Overwrite = False,
    strict: Switch = False,
    display: Display | None = None,
) -> int:
    """Correct the result of a run by clicks: the surface moves near them, and beyond it every byte stays.

    Or have other objects: a new one, two merged, one split. The run's files are replaced, all at once, unless another
    folder is given. A correction that fails or is interrupted leaves them as they are. What accelsurf segment or refine
    wrote with its state (NAME_state.npz) can be corrected; NAME_run.toml has all settings and corrections, for segment
    --config.

    With --labels an image and a label map are given in place of a result: a mask that is nearly right, whoever made it.
    What is not asked for keeps its labels and is not entered.

    Parameters
    ----------
    result
        Folder with the outputs of a run, or its report where several runs are in the folder; with --labels the image.
    clicks
        --inside: voxels that are in the object, and stay in it; --outside: voxels that are not in it, and stay out of
        it. WHERE is point:X,Y,Z, path:X,Y,Z,R;..., stroke:FILE, or as of --start. Both may be repeated: each click is a
        correction, made in the order given, as if each were a command of its own. A later one takes the voxels that it
        contradicts from earlier ones.
    near
        How far from the clicks the surface may move, mm; auto follows from their radius and depth.
    object
        Id of the object that is corrected, where there are several.
    labels
        Label map on the image's grid that is mended; FILE@2,5-9: only the objects with these ids.
    output
        Folder for the outputs, in place of the run's own; made when missing. Needed with --labels.
    image
        The image (a file, a folder, a pattern), where it is not any more where the run found it.
    overwrite
        Replace outputs that exist, also those that somebody has changed since.
    strict
        Exit with 4 when the correction ends before it has converged, with 5 when the result is doubtful.
    """
    again = resuming_command().removesuffix(" --resume")
    Interrupts.current().note(f"no file is changed; to begin again: {again}")
    given = {
        **{side: tuple(at for of, at in clicks if of == side) for side in ("inside", "outside")},
        "near": near,
        "object": object,
        **vars(objects or ObjectOptions()),
    }
    together = corrections_in_order({**given, **vars(whole or WholeOptions())})
    corrections = click_by_click(together, clicks)
    if labels is not None:
        return _mend(
            required(result, "the image"),
            labels,
            corrections,
            output,
            image,
            overwrite,
            strict,
            display,
        )
    from accelsurf.cases import run_case

    source = _source_of(required(result, "OUT, the folder of a result,"), image)
    folder = source.report.path.parent if output is None else output
    in_place, config = folder.resolve() == source.report.path.parent.resolve(), source.state.config
    place = OutputFolder(
        folder, source.name, source.image.path, overwrite or in_place, has_checkpoint=False
    )
    if in_place and not overwrite:
        _refuse_changed(place, source)
    compute = _CorrectedRun(source, corrections)
    watcher = Watcher(display or Display())
    done = run_case(
        place, config.replace(refine=(*config.refine, *corrections)), watcher, strict, compute
    )
    if display is None or not display.quiet:
        _print_summary(done, compute)
    return done.code


def _mend(
    image: Path,
    labels: str,
    corrections: tuple[Correction, ...],
    output: Path | None,
    other: Path | None,
    overwrite: bool,
    strict: bool,
    display: Display | None,
) -> int:
    """Mend a label map; the outputs are the same as of a run that begins with it."""
    from accelsurf.cases import run_case

    if other is not None:
        raise UsageError(
            "--image: was given with --labels", "the image comes first: refine SCAN --labels MASK"
        )
    config = RunConfig(labels=labels, refine=corrections)
    folder = required(output, "-o DIR, the output folder,")
    place = replace(OutputFolder.for_image(image, folder, overwrite), has_checkpoint=False)
    done = run_case(place, config, Watcher(display or Display()), strict)
    if display is None or not display.quiet:
        print("\n".join(done.summary_lines(place.name)))
    return done.code


class _CorrectedRun:
    """Computes a corrected result, in place of a run from the start."""

    def __init__(self, source: _Source, corrections: tuple[Correction, ...]) -> None:
        self._source, self._corrections = source, corrections
        #: Lines for the summary: the effect of each correction.
        self.lines: list[str] = []

    def __call__(
        self, place: OutputFolder, config: RunConfig, watcher: Watcher, log: Log
    ) -> Result:
        from accelsurf.cases import read_image
        from accelsurf.interact import Refiner, restored

        volume, *more = read_image(place, config, log)
        self._source.image.check([volume, *more], _OTHER)
        with watcher.watch(place.name, config.max_steps, "leaving all files as they are"):
            refiner = Refiner(log.timed("load", lambda: restored(self._source.state, volume, more)))
            for correction in self._corrections:
                changes = refiner.apply(correction, on_step=watcher.on_step)
                prefix = f"{correction}: " if len(self._corrections) > 1 else ""
                for change in changes:
                    which = f" (object {change.object_id})" if len(changes) > 1 else ""
                    self.lines.append(f"  {prefix}{change.text}{which}")
        result = refiner.result()
        log.warnings.extend(result.warnings)
        return result


def _print_summary(done: Finished, compute: _CorrectedRun) -> None:
    lines = done.summary_lines(done.place.name)
    print("\n".join([lines[0], *compute.lines, *lines[1:]]))


def _source_of(path: Path, image: Path | None) -> _Source:
    """The finished run that a path names.

    Raises
    ------
    InputError
        When there is none, or more than one, or its state is missing or damaged.
    """
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise InputError(
            f"{path}: there is no such folder or report", "give the folder that -o named"
        )
    if not path.is_dir():
        report = Report(path)
    else:
        known = [Report(path) for path in sorted(folder.glob("*_report.json"))]
        found = [report for report in known if report.state is not None]
        if not found:
            refuse_unfinished(folder)
            raise InputError(
                f"{path}: has no result that can be refined", _way_without_state(known)
            )
        if len(found) > 1:
            names = ", ".join(report.path.name for report in found[:5])
            raise InputError(
                f"{path}: there are several results: {names}", "give the report of one"
            )
        report = found[0]
    if report.state is None:
        raise InputError(
            f"{report.path}: is of a result that cannot be refined: it has no state",
            _way_without_state([report]),
        )
    state_path = report.path.parent / report.state.name
    if not state_path.is_file() or sha256(state_path) != report.state.checksum:
        raise InputError(
            f"{state_path}: is not as its report says: missing, damaged or of another run", _STATE
        )
    from accelsurf.interact import read_state  # loads modules of a run

    state = read_state(state_path)
    given = GivenImage.of_report(report.document or {}, report.path)
    given = given.found(image, "give where it is now with --image FILE, a folder or a pattern")
    return _Source(report, report.path.name.removesuffix("_report.json"), given, state)


def _way_without_state(reports: Iterable[Report]) -> str:
    """Return the hint where no report lists a state."""
    documents = [report.document for report in reports if report.document is not None]
    if any(document.get("kind") == "tracking" for document in documents):
        return "a tracking is corrected by accelsurf track --correct 'frame=N inside=point:X,Y,Z'"
    inputs = [document.get("input") for document in documents if document["status"] == "ok"]
    known = ("sha256", "voxels_sha256")
    if any(isinstance(entry, dict) and not any(map(entry.get, known)) for entry in inputs):
        return f"{_STATE}, where the image is not read in parts (--max-memory, --jobs): give --roi"
    return _STATE


def _refuse_changed(place: OutputFolder, source: _Source) -> None:
    """Refuse to replace files that are not the run's any more."""
    of_run = {*source.report.own(), source.report.path.name}
    others = [
        path
        for path in place.plan(source.state.config).values()
        if path.exists() and path.name not in of_run
    ]
    if others:
        raise OutputError(
            f"{others[0]}: was changed since the run wrote it, or was not written by a run of yours on this machine",
            "choose another folder with -o, or add --overwrite",
        )
