"""Tracks as the Cell Tracking Challenge has them: ``res_track.txt``, and a 16-bit TIFF of labels for each frame.

Its "Naming and file content conventions" want a line "L B E P" for each track: label, first and last frame, parent or
0; and a track has its label in every frame from B to E. So an object that is not seen for some frames becomes several
tracks, each the parent of the next: its "Annotation procedure" says of an object that reappears "link its track to its
predecessor using a parent link". A track has one parent at most: of several that merged, the one of the lowest id.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from accelsurf import io
from accelsurf.analysis.tracking_scores import Stretch, stretches
from accelsurf.errors import OutputError
from accelsurf.image.volume import Volume
from accelsurf.io.files import write_bytes
from accelsurf.report.track_frames import TrackSet, frame_digits

#: The largest label of 16 bits.
MAX_LABEL = 65535


def write(tracks: TrackSet, folder: Path) -> None:
    """Write the folder of a sequence: ``res_track.txt`` and ``maskTTT.tif``.

    Raises
    ------
    OutputError
        When a file cannot be written, or labels do not fit.
    """
    lineage = tracks.lineage
    found = stretches(tracks.frames_shown(), {track.id: lineage.parents(track.id) for track in lineage.tracks})
    largest = max((stretch.label for stretch in found), default=0)
    if largest > MAX_LABEL:
        raise OutputError(
            f"{folder.name}: a track has the label {largest}, the Cell Tracking Challenge has 1 to {MAX_LABEL}",
            "leave --also ctc out",
        )
    folder.mkdir()
    digits = frame_digits(len(tracks.sequence))
    for number in range(len(tracks.sequence)):
        label_of = np.zeros(max((stretch.id for stretch in found), default=0) + 1, np.uint16)
        for stretch in found:
            if stretch.first <= number <= stretch.last:
                label_of[stretch.id] = stretch.label
        io.write(Volume(label_of[tracks.labels(number)], tracks.geometry), folder / f"mask{number:0{digits}d}.tif")
    write_bytes(folder / "res_track.txt", track_lines(found).encode())


def track_lines(found: Iterable[Stretch]) -> str:
    """The text of ``res_track.txt``.

    Examples
    --------
    >>> track_lines([Stretch(1, 1, 0, 4), Stretch(2, 2, 5, 9, (1, 7))]).splitlines()
    ['1 0 4 0', '2 5 9 1']
    """
    return "".join(f"{track.label} {track.first} {track.last} {(*track.parents, 0)[0]}\n" for track in found)
