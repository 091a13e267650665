"""What may be written of tracked objects beside label maps, meshes and tables: an entry each, the values of ``--also``.

Functions are named as in `accelsurf.settings.file_formats`.
"""

from __future__ import annotations

from dataclasses import dataclass

from accelsurf.settings.file_formats import Function
from accelsurf.settings.registry import Registry


@dataclass(frozen=True)
class TrackFormat:
    """A file, or a folder, of tracks.

    Attributes
    ----------
    name : str
        As it is given to ``--also``.
    help : str
        What it is, in a few words.
    ending : str
        Of its name, after the name of the sequence.
    write : str or callable
        Of an `accelsurf.report.track_frames.TrackSet` and a Path, writes it.
    check : str or callable, optional
        Of the grid, refuses with a UsageError what cannot be written here, before anything is computed.
    """

    name: str
    help: str
    ending: str
    write: Function
    check: Function | None = None


TRACK_FORMATS: Registry[TrackFormat] = Registry(
    "format of tracks",
    TrackFormat(
        "ctc", "folder of the Cell Tracking Challenge: res_track.txt and a TIFF for each frame", "RES",
        "accelsurf.report.challenge_files:write",
    ),
    TrackFormat(
        "geff", "folder of the Graph Exchange File Format", "tracks.geff", "accelsurf.report.geff_file:write",
        "accelsurf.report.geff_file:check",
    ),
    TrackFormat("trackmate", "XML file of TrackMate", "trackmate.xml", "accelsurf.report.trackmate_file:write"),
)


def track_format_help() -> str:
    """The formats with what each is, as the help of ``--also`` says them."""
    return ", ".join(f"{name} ({entry.help})" for name, entry in TRACK_FORMATS.items())
