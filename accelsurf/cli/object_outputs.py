"""The files of many objects of a large image, put together from the files of their groups."""

from __future__ import annotations

import os
import shutil
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from accelsurf import io
from accelsurf.batch import SOME_FAILED
from accelsurf.cases import Interrupts, file_lines
from accelsurf.errors import OutputError
from accelsurf.io import write_bytes
from accelsurf.output import (
    OutputFolder,
    build_report,
    describe_input,
    describe_staged,
    is_named_as_output,
    naming_final,
    not_of_groups,
    objects_csv,
    report_json,
)
from accelsurf.run import overall_stop

if TYPE_CHECKING:
    from accelsurf.cli.options import Display
    from accelsurf.io import FileSet
    from accelsurf.large import LargeImage
    from accelsurf.output import GroupRecord
    from accelsurf.settings.run_config import RunConfig

_BEGIN_ANEW = "add --overwrite in place of --resume, to begin anew"
#: Sums over all objects in the report.
_SUMS = ("volume_mm3", "area_mm2", "enclosed_mm2", "length_mm", "components")


@dataclass(frozen=True)
class ObjectsDone:
    """The results of all groups.

    Attributes
    ----------
    records : list of GroupRecord
        In order of their first objects.
    failures : dict of int to str
        Why an object has no result, by its id.
    ids : list of int
        Of all objects.
    folder : Path
        The folder of the records.
    notes : list of str
        Notes about the whole image.
    """

    records: list[GroupRecord]
    failures: dict[int, str]
    ids: list[int]
    folder: Path
    notes: list[str]


def write_outputs(
    place: OutputFolder,
    config: RunConfig,
    image: LargeImage,
    done: ObjectsDone,
    files: FileSet,
    display: Display,
) -> int:
    """Write the label map, the table, the meshes and the report, all at once; returns the exit code.

    The files of the groups are removed, unless some have failed: then ``--resume`` tries these again.

    Parameters
    ----------
    place : OutputFolder
    config : RunConfig
    image : LargeImage
    done : ObjectsDone
    files : FileSet
    display : Display

    Raises
    ------
    OutputError
        When something cannot be written; nothing is then.
    """
    interrupts = Interrupts.current()
    names = place.names(config, image.geometry.slice_axis is not None)
    rows = rows_of(done)
    code = SOME_FAILED if done.failures else 0
    with interrupts.patience("finishing the files"), naming_final(files):
        kinds = {
            names["labels"]: "labels",
            names["objects"]: "objects",
            **_link_meshes(done, files, place.name),
        }
        _write_labels(files.staging / names["labels"], image, done)
        write_bytes(files.staging / names["objects"], objects_csv(rows).encode())
        outputs = describe_staged(files, kinds)
        contents = _report(place, config, image, done, rows) | {
            "exit_code": code,
            "outputs": outputs,
        }
        report = place.report.name
        write_bytes(files.staging / report, f"{report_json(contents)}\n".encode())
        place.commit(files)
    if not (done.failures or not_of_groups(done.folder)):
        shutil.rmtree(done.folder, ignore_errors=True)
    if not display.quiet:
        _print_summary(place, done, rows, outputs)
    return code


def rows_of(done: ObjectsDone) -> list[dict[str, Any]]:
    """Return an entry for each object, in order of the ids: how it ended, or why it has no result."""
    rows = {
        row["id"]: {**row, "status": "ok", "failure": ""}
        for record in done.records
        for row in record.rows
    }
    keys = next(
        iter(rows.values()), dict.fromkeys(("id", "reason", "message", "centroid", "quality"))
    )
    for label, why in done.failures.items():
        rows[label] = {**dict.fromkeys(keys), "id": label, "status": "failed", "failure": why}
    return [rows[label] for label in done.ids]


def _link_meshes(done: ObjectsDone, files: FileSet, case: str) -> dict[str, str]:
    """Put the meshes beside the other staging files; kind of each by its name."""
    kinds = {}
    for record in done.records:
        for meshes in record.meshes:
            for kind, name in meshes.items():
                if not is_named_as_output(name, case):
                    raise OutputError(
                        f"{record.folder}: has the mesh {name}, of another image", _BEGIN_ANEW
                    )
                try:
                    os.link(record.folder / name, files.staging / name)
                except FileExistsError:
                    raise OutputError(
                        f"{record.folder}: has a mesh {name} of another group", _BEGIN_ANEW
                    ) from None
                except OSError:  # a file system without links
                    shutil.copyfile(record.folder / name, files.staging / name)
                kinds[name] = kind.partition("-")[0]
    return kinds


def _write_labels(path: Path, image: LargeImage, done: ObjectsDone) -> None:
    """Write the label map box by box; no voxel is in two objects."""
    first, dtype = image.channels[0], io.label_type(done.ids[-1])
    with io.LabelStore(path, image.geometry, dtype, dict(first.metadata), first.source) as store:
        for record in done.records:
            for row, box, mask in zip(record.rows, record.boxes, record.masks(), strict=True):
                part = store.read(box)
                part[mask] = np.array(row["id"], dtype)
                store.write(box, part)


def _report(
    place: OutputFolder,
    config: RunConfig,
    image: LargeImage,
    done: ObjectsDone,
    rows: list[dict[str, Any]],
) -> dict[str, Any]:
    """The report, but for its outputs and the exit code."""
    contents = build_report(
        status="failed" if done.failures else "ok",
        exit_code=0,
        argv=sys.argv,
        config=config,
        source=describe_input(place.image, geometry=image.geometry),
        warnings=[
            *done.notes,
            *(line for record in done.records for line in record.report_entries["warnings"]),
        ],
    )
    contents["objects"] = rows
    if done.records:
        description, stops = (
            done.records[0].report_entries,
            [stop for record in done.records for stop in record.stops],
        )
        stop = overall_stop(stops)
        contents |= {
            "stop": {
                "reason": stop.reason,
                "steps": stop.steps,
                "time": stop.time,
                "message": stop.message,
            },
            "resolved_settings": description["resolved_settings"],
            "touches_border": any(row["touches_border"] for row in rows),
            **{key: _sum(done.records, key) for key in _SUMS},
        }
    if done.failures:
        label, why = next(iter(sorted(done.failures.items())))
        more = f" (and {len(done.failures) - 1} more)" if len(done.failures) > 1 else ""
        contents["error"] = {
            "type": "SomeFailed",
            "message": f"object {label}{more}: {why}",
            "hint": "the table says why; the same command with --resume tries them again",
        }
    return contents


def _sum(records: list[GroupRecord], key: str) -> Any:
    values = [row[key] for record in records for row in record.rows if row[key] is not None]
    return sum(values) if values else None


def _print_summary(
    place: OutputFolder,
    done: ObjectsDone,
    rows: list[dict[str, Any]],
    outputs: list[dict[str, str]],
) -> None:
    """Print how many objects there are, and the files."""
    counts = Counter("failed" if row["status"] == "failed" else str(row["reason"]) for row in rows)
    print(
        f"{place.name}: of {len(rows)} objects {', '.join(f'{n} {word}' for word, n in sorted(counts.items()))}"
    )
    print("\n".join(file_lines(outputs, place.report, first_alone=True)))
