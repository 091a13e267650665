"""``accelsurf evaluate --tracks``: how well tracks agree with a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.errors import UsageError

if TYPE_CHECKING:
    from accelsurf.analysis.tracked_files import TrackedFile
    from accelsurf.analysis.tracking_scores import TrackingScores


def evaluate_tracks(result: str | None, reference: str | None, as_json: bool, table: str | None) -> int:
    """Compare, print and write.

    Parameters
    ----------
    result, reference : str or None
        As they were given.
    as_json : bool
        Print JSON.
    table : str or None
        A CSV file for a row of each frame; "-" prints it.
    """
    from accelsurf.analysis.tracked_files import compare, open_tracks
    from accelsurf.io.file_set import InputFiles, finish_killed_runs
    from accelsurf.io.files import write_bytes
    from accelsurf.report.document import to_json
    from accelsurf.report.tables import csv_text

    if result is None or reference is None:
        lacking = "PRED" if result is None else "REF"
        raise UsageError(f"evaluate: no {lacking} was given", "accelsurf evaluate --help lists the options")
    for path in (Path(result), Path(reference)):
        finish_killed_runs(path.parent)
    if table is not None and table != "-":
        sides = (Path(result), Path(reference))
        inputs = [path for side in sides for path in (side, *side.rglob("*"))]
        InputFiles(inputs).refuse([Path(table)], "name of the table with --csv")
    given, wanted = open_tracks(Path(result)), open_tracks(Path(reference))
    found = compare(given, wanted)
    if table is not None:
        text = csv_text(found.frames[0]._fields if found.frames else (), found.frames)
        if table == "-":
            print(text, end="")
            return 0
        write_bytes(Path(table), text.encode())
    if as_json:
        print(to_json(_document(given, wanted, found)))
        return 0
    values = found.values()
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:{width}}  {'-' if value is None else format(value, '.6g')}")
    for line in _notes(given, wanted):
        print(f"note: {line}")
    if table is not None:
        print(f"table  {Path(table).absolute()}")
    return 0


def _document(given: TrackedFile, wanted: TrackedFile, found: TrackingScores) -> dict[str, Any]:
    frames = [frame._asdict() for frame in found.frames]
    return {
        "pred": str(given.path.absolute()), "ref": str(wanted.path.absolute()), **found.values(),
        "identities": found.identities, "frames": frames, "notes": _notes(given, wanted),
    }


def _notes(given: TrackedFile, wanted: TrackedFile) -> list[str]:
    """What the numbers do not say by themselves."""
    said = [
        f"{one.path.name}: no table of tracks beside it; an id is a track, and nothing says who came from whom"
        for one in (given, wanted) if one.table is None
    ]
    if wanted.outlines:
        said.append(f"SEG is measured on the {len(wanted.outlines)} frames with outlines of their own")
    return said
