"""The report of a tracking as JSON, after the model of `accelsurf.output.document`, and its tables as CSV text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from accelsurf.image.sequence import ImageSequence
from accelsurf.io import table_text
from accelsurf.output import (
    SCHEMA_VERSION,
    Status,
    describe_error,
    describe_input,
    peak_rss_mb,
    report_json,
    versions,
)
from accelsurf.track.output.frames import TrackSet

__all__ = ["Status", "build", "report_json"]
#: A line for each object in each frame. Velocities are mm per unit of time.
TRACK_COLUMNS = (
    "frame",
    "time",
    "time_unit",
    "id",
    "parent",
    "x_mm",
    "y_mm",
    "z_mm",
    "vx",
    "vy",
    "vz",
    "volume_ml",
    "area_mm2",
    "quality",
    "seen",
)
ML = 1e-3  # mm3


class TrackRun(NamedTuple):
    """Command and settings of a tracking, for its files.

    ``settings``, for the report; the same as ``toml``, with which the tracking can be repeated (without it there is no
    ``NAME_run.toml``); the command line ``argv``; the ``inputs``, files that are read and so may not be replaced.
    """

    settings: Mapping[str, Any] | None = None
    toml: str = ""
    argv: Sequence[str] = ()
    inputs: Sequence[Path] = ()


def build(
    tracks: TrackSet | None,
    *,
    images: ImageSequence | Path | None = None,
    status: Status,
    exit_code: int,
    run: TrackRun,
    error: BaseException | None = None,
    warnings: Sequence[str] = (),
    outputs: Sequence[Mapping[str, str]] = (),
) -> dict[str, Any]:
    """Put the report of a tracking together. It always has every key; unknown values are null.

    Parameters
    ----------
    tracks : TrackSet or None
        None when the run failed.
    images : ImageSequence or Path, optional
        The sequence of a run that failed; or its path, where it could not be opened.
    status, exit_code : {"ok", "failed", "interrupted"}, int
    run : TrackRun
    error : BaseException, optional
    warnings : sequence of str, optional
    outputs : sequence of mapping, optional
        From `accelsurf.output.document.describe_output`.

    Returns
    -------
    dict
        Ready for `to_json`.
    """
    images = images if tracks is None else tracks.sequence
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "tracking",
        "status": status,
        "exit_code": exit_code,
        "error": None if error is None else describe_error(error),
        "versions": versions(),
        "argv": list(run.argv),
        "config": dict(run.settings) if run.settings else None,
        "input": describe_sequence(images)
        if isinstance(images, ImageSequence)
        else _describe_source(images),
        "tracks": None if tracks is None else describe_tracks(tracks),
        "links": None if tracks is None else [link._asdict() for link in tracks.lineage.links],
        "frames": None if tracks is None else describe_frames(tracks),
        "seconds": {},
        "peak_rss_mb": peak_rss_mb(),
        "warnings": list(warnings),
        "outputs": [dict(output) for output in outputs],
    }


def describe_sequence(sequence: ImageSequence) -> dict[str, Any]:
    """Return the report's entry about the sequence."""
    entry: dict[str, Any] = {"path": None, "sha256": None}
    if sequence.source:
        checksum = _checksum(Path(sequence.source))
        entry = describe_input(sequence.source, geometry=sequence.geometry, checksum=checksum)
    return entry | {"times": list(sequence.times), "time_unit": sequence.time_unit}


def _describe_source(source: Path | None) -> dict[str, Any] | None:
    """The entry about a sequence that could not be opened."""
    return None if source is None else describe_input(source) | {"times": None, "time_unit": None}


def _checksum(source: Path) -> str | None:
    from accelsurf import io
    from accelsurf.errors import InputError

    try:
        return io.sha256(source)
    except InputError:
        return None  # no file: the frames have another source


def describe_tracks(tracks: TrackSet) -> list[dict[str, Any]]:
    """Return an entry for each identity: its life, where it came from, and how large it was."""
    entries = []
    for track in tracks.lineage.tracks:
        seen = [tracked for _, tracked in tracks.by_object.get(track.id, ()) if tracked.seen]
        volumes = [tracked.volume_mm3 * ML for tracked in seen]
        entries.append(
            {
                "id": track.id,
                "first": track.first,
                "last": track.last,
                "gaps": list(track.gaps),
                "end": track.end,
                "parents": list(tracks.lineage.parents(track.id)),
                "children": list(tracks.lineage.children(track.id)),
                "frames_seen": len(seen),
                "volume_ml_smallest": min(volumes, default=None),
                "volume_ml_largest": max(volumes, default=None),
                "quality_lowest": min((tracked.quality for tracked in seen), default=None),
            }
        )
    return entries


def describe_frames(tracks: TrackSet) -> list[dict[str, Any]]:
    """Return an entry for each frame: which objects it shows, how good each is, and how long it took."""
    entries = []
    for row in tracks.rows:
        entry = {
            "frame": row.frame,
            "time": row.time,
            "seen": [tracked.id for tracked in row.objects if tracked.seen],
            "not_seen": [tracked.id for tracked in row.objects if not tracked.seen],
            "quality": {str(tracked.id): tracked.quality for tracked in row.objects},
            "seconds": row.seconds,
        }
        entries.append(entry)
    return entries


def tracks_csv(tracks: TrackSet) -> str:
    """Return a line for each object in each frame, by frame and id; an object that merged of several has all parents.

    ``parent`` stands in every line of an object, with ; between several, and is empty where there is none. Positions
    are the centroid's, world mm (LPS). ``seen`` is 0 where the frame does not show the object: the line then
    has its prediction.
    """
    parents = {
        row.id: ";".join(map(str, tracks.lineage.parents(row.id))) for row in tracks.lineage.tracks
    }
    unit = tracks.sequence.time_unit
    lines = []
    for row in tracks.rows:
        for tracked in row.objects:
            which = row.frame, row.time, unit, tracked.id, parents.get(tracked.id, "")
            place = *tracked.centroid, *tracked.velocity
            size = tracked.volume_mm3 * ML, tracked.area_mm2
            lines.append((*which, *place, *size, tracked.quality, tracked.seen))
    return table_text(TRACK_COLUMNS, lines)


def curves_csv(tracks: TrackSet) -> str:
    """Return the volumes of all objects against time, ml: a line for each frame, a column for each object.

    A cell is empty where an object is not seen.
    """
    ids = list(tracks.by_object)
    lines = []
    for row in tracks.rows:
        seen = {tracked.id: tracked.volume_mm3 * ML for tracked in row.objects if tracked.seen}
        lines.append((row.frame, row.time, *(seen.get(object_id) for object_id in ids)))
    columns = (f"object_{object_id}_ml" for object_id in ids)
    return table_text(("frame", f"time_{tracks.sequence.time_unit}", *columns), lines)
