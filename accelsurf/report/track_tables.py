"""Tables of a tracking as CSV text; pure functions from values to text."""

from __future__ import annotations

from accelsurf.report.tables import csv_text
from accelsurf.report.track_frames import TrackSet

#: A line for each object in each frame. Velocities are mm per unit of time.
TRACK_COLUMNS = (
    "frame", "time", "time_unit", "id", "parent", "x_mm", "y_mm", "z_mm", "vx", "vy", "vz", "volume_ml",
    "area_mm2", "quality", "seen",
)
ML = 1e-3  # mm3


def tracks_csv(tracks: TrackSet) -> str:
    """Return a line for each object in each frame, by frame and id; an object that merged of several has all parents.

    ``parent`` stands in every line of an object, with ; between several, and is empty where there is none. Positions
    are those of the centroid, world mm (LPS). ``seen`` is 0 where the frame does not show the object: the line then
    has its prediction.
    """
    parents = {row.id: ";".join(map(str, tracks.lineage.parents(row.id))) for row in tracks.lineage.tracks}
    unit = tracks.sequence.time_unit
    return csv_text(TRACK_COLUMNS, (
        (
            row.frame, row.time, unit, one.id, parents.get(one.id, ""), *one.centroid, *one.velocity,
            one.volume_mm3 * ML, one.area_mm2, one.quality, one.seen,
        )
        for row in tracks.rows for one in row.objects
    ))


def curves_csv(tracks: TrackSet) -> str:
    """Return the volumes of all objects against time, ml: a line for each frame, a column for each object.

    A cell is empty where an object is not seen.
    """
    ids = list(tracks.by_object)
    lines = []
    for row in tracks.rows:
        seen = {one.id: one.volume_mm3 * ML for one in row.objects if one.seen}
        lines.append((row.frame, row.time, *(seen.get(own) for own in ids)))
    return csv_text(("frame", f"time_{tracks.sequence.time_unit}", *(f"object_{own}_ml" for own in ids)), lines)
