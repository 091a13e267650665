"""Movies of a tracking: each frame with what was predicted beside what was found."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from accelsurf.errors import OutputError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.headers import UNIT_KEY
from accelsurf.report import movies
from accelsurf.report.canvas import Canvas
from accelsurf.report.movies import Picture
from accelsurf.report.slice_plot import draw_scale_bar
from accelsurf.report.track_frames import TrackSet
from accelsurf.report.track_slices import FrameContent, TrackView, draw_frame, time_text

#: Width and height of a picture, of the margin around a panel and of the lines above it, pixels.
SIZE = (960, 540)
MARGIN, TOP = 12, 58
#: Frames per second, so many that a movie takes so many seconds, within bounds.
SECONDS, SLOWEST, FASTEST = 8.0, 2.0, 15.0


def check_mp4(geometry: Geometry) -> None:
    """Refuse to begin without the encoder of mp4; errors as `accelsurf.report.movies.check_target`."""
    movies.check_target(Path("movie.mp4"), SIZE)


def check_webp(geometry: Geometry) -> None:
    """Refuse to begin without the encoder of webp; errors as `accelsurf.report.movies.check_target`."""
    movies.check_target(Path("movie.webp"), SIZE)


def write(tracks: TrackSet, path: Path) -> None:
    """Write the movie; the suffix decides the format.

    Raises
    ------
    OutputError
        When it cannot be written, or no frame was reached.
    """
    if not tracks.rows:
        raise OutputError(f"{path.name}: no frame to show")
    speed = min(max(len(tracks.rows) / SECONDS, SLOWEST), FASTEST)
    movies.write(path, pictures(tracks), SIZE, speed)


def pictures(tracks: TrackSet) -> Iterator[Picture]:
    """The pictures, one for each frame.

    Yields
    ------
    ndarray (height, width, 3), uint8
    """
    view = TrackView.of(tracks)
    wide, tall = SIZE
    half = wide / 2
    for row in tracks.rows:
        canvas = Canvas(wide, tall)
        canvas.text((half, 18), f"{tracks.name}: {time_text(tracks, row)}", 16, anchor="mm")
        frame = FrameContent.of(tracks, row)
        for left, what in ((0.0, "predicted"), (half, "corrected")):
            panel = (left + MARGIN, TOP, left + half - MARGIN, tall - MARGIN)
            shown = draw_frame(canvas, panel, tracks.geometry, frame, view, (what,))
            canvas.text((left + half / 2, 44), what, 14, anchor="mm")
        draw_scale_bar(shown, frame.image.metadata.get(UNIT_KEY, "mm"))
        yield canvas.pixels()
