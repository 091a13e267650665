"""The report of a tracking as JSON, after the model of `accelsurf.report.document`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from accelsurf.grid.sequence import ImageSequence
from accelsurf.report import document
from accelsurf.report.document import SCHEMA_VERSION, Status, to_json
from accelsurf.report.environment import peak_rss_mb, versions
from accelsurf.report.file_entries import describe_input
from accelsurf.report.track_frames import TrackSet
from accelsurf.report.track_slices import beats_of
from accelsurf.report.track_tables import ML

__all__ = ["Status", "build", "to_json"]


def build(
    tracks: TrackSet | None,
    *,
    sequence: ImageSequence | None = None,
    source: Path | None = None,
    status: Status,
    exit_code: int,
    argv: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    error: BaseException | None = None,
    warnings: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    outputs: Sequence[Mapping[str, str]] = (),
) -> dict[str, Any]:
    """Put the report of a tracking together. It always has every key; unknown values are null.

    Parameters
    ----------
    tracks : TrackSet or None
        None when the run failed.
    sequence : ImageSequence, optional
        What was tracked, where there is no ``tracks``.
    source : Path, optional
        Where that should have been, where there is no ``sequence`` either.
    status, exit_code : {"ok", "failed", "interrupted"}, int
    argv : sequence of str, optional
    settings : mapping, optional
    error : BaseException, optional
    warnings : sequence of str, optional
    seconds : mapping of str to float, optional
    outputs : sequence of mapping, optional
        From `accelsurf.report.file_entries.describe_output`.

    Returns
    -------
    dict
        Ready for `to_json`.
    """
    images = sequence if tracks is None else tracks.sequence
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "tracking",
        "status": status,
        "exit_code": exit_code,
        "error": None if error is None else document.describe_error(error),
        "versions": versions(),
        "argv": list(argv),
        "config": dict(settings) if settings else None,
        "input": _describe_source(source) if images is None else describe_sequence(images),
        "tracks": None if tracks is None else describe_tracks(tracks),
        "links": None if tracks is None else [link._asdict() for link in tracks.lineage.links],
        "frames": None if tracks is None else describe_frames(tracks),
        "seconds": dict(seconds or {}),
        "peak_rss_mb": peak_rss_mb(),
        "warnings": list(warnings),
        "outputs": [dict(output) for output in outputs],
    }


def describe_sequence(sequence: ImageSequence) -> dict[str, Any]:
    """Return the report's entry about what was tracked."""
    entry: dict[str, Any] = {"path": None, "sha256": None}
    if sequence.source:
        checksum = _checksum(Path(sequence.source))
        entry = describe_input(sequence.source, geometry=sequence.geometry, checksum=checksum)
    return entry | {"times": list(sequence.times), "time_unit": sequence.time_unit}


def _describe_source(source: Path | None) -> dict[str, Any] | None:
    """The entry about what could not be opened."""
    return None if source is None else describe_input(source) | {"times": None, "time_unit": None}


def _checksum(source: Path) -> str | None:
    from accelsurf import io
    from accelsurf.errors import InputError

    try:
        return io.sha256(source)
    except InputError:
        return None  # of what is no file: the frames have another source


def describe_tracks(tracks: TrackSet) -> list[dict[str, Any]]:
    """Return an entry for each identity: its life, where it came from, and how large it was."""
    entries, beats = [], beats_of(tracks)
    for track in tracks.lineage.tracks:
        seen = [one for _, one in tracks.by_object.get(track.id, ()) if one.seen]
        volumes = [one.volume_mm3 * ML for one in seen]
        entries.append({
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
            "beat": beats[track.id]._asdict() if track.id in beats else None,
            "quality_lowest": min((one.quality for one in seen), default=None),
        })
    return entries


def describe_frames(tracks: TrackSet) -> list[dict[str, Any]]:
    """Return an entry for each frame: which objects it shows, and how long it took."""
    return [
        {
            "frame": row.frame,
            "time": row.time,
            "seen": [one.id for one in row.objects if one.seen],
            "not_seen": [one.id for one in row.objects if not one.seen],
            "seconds": row.seconds,
        }
        for row in tracks.rows
    ]
