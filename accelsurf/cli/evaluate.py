"""``accelsurf evaluate``: agreement of label maps, or of tracks, with their references."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from accelsurf.batch import LabelFile, Pair, in_folders, in_table, is_folder_of_maps, label_file
from accelsurf.cases import say
from accelsurf.cli.options import FILES, Overwrite
from accelsurf.cli.progress import table
from accelsurf.errors import AccelsurfError, InputError, OutputError, UsageError
from accelsurf.image.volume import Volume
from accelsurf.io import InputFiles, read_label_table, refuse_unfinished, table_text, write_bytes
from accelsurf.output import report_json
from accelsurf.settings.labels import IdRanges, LabelTable, parse_ids

if TYPE_CHECKING:
    from accelsurf.measure import LabelMap
    from accelsurf.output import CaseResult
    from accelsurf.track import TrackedFile, TrackingScores

SOME_FAILED = 9
#: Labels that a message names.
_NAMED = 20
#: A leading hyphen is allowed for `-`, which prints the table.
Table = Annotated[
    str | None, Parameter(name="--csv", metavar="FILE", group=FILES, allow_leading_hyphen=True)
]


@dataclass(frozen=True)
class Request:
    """Requested measures: ``labels`` one by one (None: all as one object); ``tolerances`` of surface Dice, mm."""

    labels: IdRanges | None
    tolerances: tuple[float, ...]


def evaluate(
    pred: Annotated[str | None, Parameter(name="PRED")] = None,
    ref: Annotated[str | None, Parameter(name="REF")] = None,
    *,
    labels: Annotated[str | None, Parameter(name="--labels", metavar="IDS")] = None,
    tolerance: Annotated[str | None, Parameter(name="--tolerance", metavar="MM")] = None,
    pairs: Annotated[Path | None, Parameter(name="--pairs", metavar="TABLE")] = None,
    tracks: Annotated[bool, Parameter(name="--tracks", negative=(), show_default=False)] = False,
    names: Annotated[
        Path | None, Parameter(name=("--label-table", "--names"), metavar="TABLE")
    ] = None,
    as_json: Annotated[bool, Parameter(name="--json", negative=(), show_default=False)] = False,
    table: Table = None,
    overwrite: Overwrite = False,
) -> int:
    """Measure how well label maps agree: overlap, volume, and surface distances in mm.

    Both maps must lie on the same grid. Without --labels every label above 0 is the one object. PRED and REF may be
    folders: files of the same name are compared, and mean and median over the cases follow. A case that fails does not
    stop the others (exit code 9). A number that is not defined, such as the distance to an empty map, is shown as -
    (null in JSON). A label that only one map has gets Dice 0; one that neither has does not count in means.

    Parameters
    ----------
    pred
        The label map to judge; FILE@2,5-9 means these labels only.
    ref
        The reference, in the same way.
    labels
        Compare each label with the same label of the other map: all, or ids and ranges, as in 1,3-5.
    tolerance
        Surface Dice (NSD): the part of both surfaces that lies so near the other one, in mm; several with commas.
    pairs
        A table of many pairs: CSV with the columns pred, ref and, if wanted, case.
    tracks
        PRED and REF are tracked sequences: folders of the Cell Tracking Challenge, or label maps with time and
        NAME_tracks.csv beside NAME_labels.*. Prints SEG, DET and TRA of the challenge, Dice by identity, and how often
        an identity is switched; --csv has a row for each frame.
    names
        Names of labels: a table as --label-table of segment takes it (ITK-SNAP, 3D Slicer, BIDS, CSV, .seg.nrrd).
    as_json
        Print JSON.
    table
        Write a table in CSV, a row for each case and label; - prints it.
    overwrite
        Replace a table that exists.
    """
    requested = Request(_labels(labels), _tolerances(tolerance))
    _check_table(table, as_json, overwrite)
    if tracks:
        _refuse_with_tracks(
            {"labels": labels, "tolerance": tolerance, "pairs": pairs, "label-table": names}
        )
        return _evaluate_tracks(pred, ref, as_json, table)
    known = _names(names)
    found, many = _pairs(pred, ref, pairs)
    sides = [side for pair in found for side in (pair.pred, pair.ref) if side is not None]
    _refuse_input_as_table(table, [pairs, names, *(side.path for side in sides)])
    results = [(_try if many else _result)(pair, requested) for pair in found]
    from accelsurf.output import evaluation_csv, evaluation_document, evaluation_rows

    _put(
        table,
        as_json,
        lambda: evaluation_csv(evaluation_rows(results, known)),
        lambda: evaluation_document(results, known) if many else _one_pair(results[0], known),
        lambda: _show(results, known, many),
    )
    return SOME_FAILED if any(result.failure for result in results) else 0


def _check_table(table: str | None, as_json: bool, overwrite: bool) -> None:
    """Refuse a table that cannot be written, before anything is read."""
    if table is None:
        return
    if table == "-":
        if as_json:
            raise UsageError("--json, --csv -: both would be printed", "name a file for the table")
    elif table.startswith("-"):
        raise UsageError(
            f"--csv: {table} was given, expected the name of a file",
            "as in --csv table.csv, or --csv -",
        )
    elif Path(table).exists() and not overwrite:
        raise OutputError(f"{table}: exists already", "choose another name, or add --overwrite")


def _refuse_input_as_table(table: str | None, inputs: Iterable[Path | None]) -> None:
    """Refuse a table in the place of a file that is read."""
    if table is not None and table != "-":
        read = InputFiles([path for path in inputs if path is not None])
        read.refuse([Path(table)], "name of the table with --csv")


def _refuse_with_tracks(given: dict[str, Any]) -> None:
    """Refuse options that say nothing of tracks."""
    for name, value in given.items():
        if value is not None:
            raise UsageError(f"--{name}: has no effect with --tracks", "leave it out")


def _labels(text: str | None) -> IdRanges | None:
    if text is None:
        return None
    return () if text == "all" else parse_ids(text, "--labels", "--labels 1,3-5, or --labels all")


def _names(path: Path | None) -> LabelTable:

    return LabelTable() if path is None else read_label_table(path)


def _tolerances(text: str | None) -> tuple[float, ...]:
    try:
        values = (
            tuple(dict.fromkeys(float(part) for part in text.split(",")))
            if text is not None
            else ()
        )
    except ValueError:
        values = (math.nan,)
    if not all(0 <= value < math.inf for value in values):
        raise UsageError(
            f"--tolerance: {text} was given, expected mm, at least 0", "as in --tolerance 1,2.5"
        )
    return values


def _pairs(pred: str | None, ref: str | None, table: Path | None) -> tuple[list[Pair], bool]:
    """Return one pair, or the pairs of a table or of two folders, and whether they may be many."""
    if table is not None:
        if pred is not None:
            raise UsageError(
                "--pairs: was given with PRED, which the table names", "leave one of them out"
            )
        return in_table(table), True
    pred, ref = _both(pred, ref)
    sides = label_file(pred), label_file(ref)
    folders = [is_folder_of_maps(side.path) for side in sides]
    if any(folders) and not all(folders):
        raise InputError(
            f"{pred}, {ref}: one of them is a folder of files", "name two files, or two folders"
        )
    return (in_folders(*sides), True) if all(folders) else ([Pair("", *sides)], False)


def _try(pair: Pair, requested: Request) -> CaseResult:
    """Compare a pair; an error is noted and does not stop the others."""
    from accelsurf.output import CaseResult

    try:
        return _result(pair, requested)
    except (AccelsurfError, MemoryError) as error:
        failure = str(error) or "not enough memory"
        say(f"warning: {pair.case}: {failure}")
        return CaseResult(pair.case, _written(pair.pred), _written(pair.ref), (), failure)


def _result(pair: Pair, requested: Request) -> CaseResult:
    """Compare a pair."""
    from accelsurf import io
    from accelsurf.measure import LabelMap, evaluate_labels, evaluate_object
    from accelsurf.output import CaseResult

    if pair.pred is None or pair.ref is None:
        raise InputError(
            f"there is no {'prediction' if pair.pred is None else 'reference'} of this name"
        )
    for path in (pair.pred.path, pair.ref.path):
        refuse_unfinished(path.parent)
    volumes = io.on_one_grid(*(_read(side) for side in (pair.pred, pair.ref)))
    pred, ref = (
        LabelMap(volume, side.ids)
        for volume, side in zip(volumes, (pair.pred, pair.ref), strict=True)
    )
    if not pair.case:  # of many, some may lack an object
        _check_asked(pair.pred, pred, pair.ref, ref)
    if requested.labels is None:
        agreements = [evaluate_object(pred, ref, requested.tolerances)]
    else:
        agreements = evaluate_labels(pred, ref, requested.labels, requested.tolerances)
    return CaseResult(pair.case, _written(pair.pred), _written(pair.ref), tuple(agreements))


def _check_asked(pred_file: LabelFile, pred: LabelMap, ref_file: LabelFile, ref: LabelMap) -> None:
    """Refuse labels that the reference has not; a prediction without them has found nothing, which a warning says.

    Raises
    ------
    InputError
        With the labels that are there.
    """
    if ref.absent:
        raise InputError(
            f"{ref_file.path}: has no label {', '.join(ref.absent)}",
            f"there are {_labels_in(ref_file)}",
        )
    if pred.absent:
        say(
            f"warning: {pred_file.path}: has no label {', '.join(pred.absent)}, which counts as nothing found; "
            f"there are {_labels_in(pred_file)}"
        )


def _labels_in(side: LabelFile) -> str:
    """The labels of a map, in words; it is read again, as of a DICOM segmentation only those asked for were read."""
    import numpy as np

    from accelsurf import io

    there = [int(label) for label in np.unique(io.read_labels(side.path).array) if label > 0]
    more = f" and {len(there) - _NAMED} more" if len(there) > _NAMED else ""
    return f"{', '.join(map(str, there[:_NAMED]))}{more}" if there else "none above 0"


def _read(side: LabelFile) -> Volume:
    """A label map; notes about its file are printed."""
    from accelsurf import io

    labels = io.read_labels(side.path, ids=side.ids)
    if note := labels.metadata.get(io.WARNING_KEY):
        say(f"warning: {side.path}: {note}")
    return labels


def _written(side: LabelFile | None) -> str:
    """A label map as a person writes it."""
    if side is None:
        return ""
    ids = ",".join(str(low) if low == high else f"{low}-{high}" for low, high in side.ids)
    return str(side.path.absolute()) + (f"@{ids}" if ids else "")


def _put(
    table: str | None,
    as_json: bool,
    csv: Callable[[], str],
    found: Callable[[], Any],
    show: Callable[[], None],
) -> None:
    """Write the table, and print it, or the numbers as JSON or for a person."""
    if table == "-":
        print(csv(), end="")
        return
    if table is not None:
        write_bytes(Path(table), csv().encode())
    if as_json:
        print(report_json(found()))
        return
    show()
    if table is not None:
        print(f"table  {Path(table).absolute()}")


def _one_pair(result: CaseResult, names: LabelTable) -> dict[str, Any]:
    """One pair for JSON: the numbers of the object, or a list of labels."""
    from accelsurf.output import evaluation_document

    case = evaluation_document([result], names)["cases"][0]
    head, said = {"pred": result.pred, "ref": result.ref}, {"notes": case["notes"]}
    found = result.agreements
    return {
        **head,
        **(found[0].values() if found and found[0].label is None else {"labels": case["labels"]}),
        **said,
    }


def _show(results: list[CaseResult], names: LabelTable, many: bool) -> None:
    from accelsurf.output import evaluation_notes

    agreements = results[0].agreements if results else ()
    if many or not agreements or agreements[0].label is not None:
        _print_table(results, names, many)
    else:
        _print_values(agreements[0].values(), evaluation_notes(agreements[0]))


def _print_values(
    values: Mapping[str, float | int | None], evaluation_notes: Iterable[str]
) -> None:
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:{width}}  {'-' if value is None else format(value, '.6g')}")
    for line in evaluation_notes:
        print(f"note: {line}")


def _print_table(results: list[CaseResult], names: LabelTable, many: bool) -> None:
    from accelsurf.output import evaluation_notes, evaluation_rows, printed_rows

    print(table(*printed_rows(evaluation_rows(results, names), many)))
    for result in results:
        where = f"{result.case}: " if many else ""
        for line in (line for found in result.agreements for line in evaluation_notes(found)):
            print(f"note: {where}{line}")
    if many:
        print(f"{len(results)} cases, {sum(bool(result.failure) for result in results)} failed")


def _evaluate_tracks(pred: str | None, ref: str | None, as_json: bool, table: str | None) -> int:
    """Compare tracks with a reference; the table has a row for each frame."""
    from accelsurf.track import compare, open_tracks

    sides = [Path(name) for name in _both(pred, ref)]
    for path in sides:
        refuse_unfinished(path.parent)
    _refuse_input_as_table(table, (path for side in sides for path in (side, *side.rglob("*"))))
    given, wanted = (open_tracks(side) for side in sides)
    found = compare(given, wanted)
    _put(
        table,
        as_json,
        lambda: table_text(found.frames[0]._fields if found.frames else (), found.frames),
        lambda: _document(given, wanted, found),
        lambda: _print_values(found.values(), _notes(given, wanted)),
    )
    return 0


def _both(pred: str | None, ref: str | None) -> tuple[str, str]:
    if pred is None or ref is None:
        lacking = "PRED" if pred is None else "REF"
        raise UsageError(
            f"evaluate: no {lacking} was given", "accelsurf evaluate --help lists the options"
        )
    return pred, ref


def _document(given: TrackedFile, wanted: TrackedFile, found: TrackingScores) -> dict[str, Any]:
    frames = [frame._asdict() for frame in found.frames]
    return {
        "pred": str(given.path.absolute()),
        "ref": str(wanted.path.absolute()),
        **found.values(),
        "identities": found.identities,
        "frames": frames,
        "notes": _notes(given, wanted),
    }


def _notes(given: TrackedFile, wanted: TrackedFile) -> list[str]:
    """Return notes on the numbers."""
    said = [
        f"{side.path.name}: no table of tracks beside it; an id is a track, and nothing says who came from whom"
        for side in (given, wanted)
        if side.table is None
    ]
    if wanted.outlines:
        slices = sum(outline.plane is not None for outline in wanted.outlines)
        whole = len(wanted.outlines) - slices
        parts = (f"{whole} frames" * bool(whole), f"{slices} slices" * bool(slices))
        said.append(
            f"SEG is measured on the {' and '.join(filter(None, parts))} with outlines of their own"
        )
    return said
