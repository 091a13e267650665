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
        Of the grid, refuses what cannot be written here, before anything is computed.
    mark : str
        A file in it, where it is a folder: by this it is known as one that may be replaced. Empty: it is a file.
    """

    name: str
    help: str
    ending: str
    write: Function
    check: Function | None = None
    mark: str = ""


TRACK_FORMATS: Registry[TrackFormat] = Registry(
    "format of tracks",
    TrackFormat(
        "ctc", "folder of the Cell Tracking Challenge: res_track.txt and a TIFF for each frame", "RES",
        "accelsurf.report.challenge_files:write", mark="res_track.txt",
    ),
    TrackFormat(
        "geff", "folder of the Graph Exchange File Format", "tracks.geff", "accelsurf.report.geff_file:write",
        "accelsurf.report.geff_file:check", mark=".zattrs",
    ),
    TrackFormat(
        "surfaces", "folder of surfaces, prediction beside correction, for accelsurf view --tracks", "surfaces",
        "accelsurf.report.track_surfaces:write", mark="surfaces.json",
    ),
    TrackFormat("trackmate", "XML file of TrackMate", "trackmate.xml", "accelsurf.report.trackmate_file:write"),
    TrackFormat(
        "mp4", "movie of slices, prediction beside correction", "movie.mp4",
        "accelsurf.report.track_slices:write_movie", "accelsurf.report.track_slices:check_mp4",
    ),
    TrackFormat("gif", "the same as GIF", "movie.gif", "accelsurf.report.track_slices:write_movie"),
    TrackFormat(
        "webp", "the same as WebP", "movie.webp", "accelsurf.report.track_slices:write_movie",
        "accelsurf.report.track_slices:check_webp",
    ),
)


def track_format_help() -> str:
    """The formats with what each is, as the help of ``--also`` says them."""
    return ", ".join(f"{name} ({entry.help})" for name, entry in TRACK_FORMATS.items())
