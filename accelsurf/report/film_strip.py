"""The preview of a tracking: slices of some frames side by side, with what was predicted and what was found."""

from __future__ import annotations

import math

import numpy as np

from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.io.headers import UNIT_KEY
from accelsurf.report.canvas import PALE, Canvas, fitting
from accelsurf.report.slice_plot import Slice, draw_scale_bar
from accelsurf.report.track_frames import FrameRow, TrackSet
from accelsurf.report.track_slices import FrameContent, TrackView, draw_frame, time_text, write_lines

#: Frames in a strip at most, and in a line of it.
MAX_FRAMES, COLUMNS = 12, 4
#: Width of a panel, of the space between panels, of the title and below a panel, pixels; a panel's height.
PANEL, GAP, TOP, BELOW = 320, 14, 56, 34
LOWEST, HIGHEST = 100.0, 480.0


def film_strip_png(tracks: TrackSet) -> bytes:
    """Draw frames evenly spaced from the first to the last that was reached.

    All have the same part of the image and the same grey window. The slice is the one through the largest object. Of
    each object the surface is drawn in its colour, dashed where the frame does not show it, and where it was predicted
    in blue, dashed.

    Returns
    -------
    bytes
        A PNG file.
    """
    rows = picked(tracks.rows)
    view = TrackView.of(tracks)
    columns = min(COLUMNS, max(len(rows), 1))
    width = max(columns * (PANEL + GAP) + GAP, 700)
    left = (width - columns * (PANEL + GAP) + GAP) / 2
    lines, tall = math.ceil(max(len(rows), 1) / columns), _height(tracks, view)
    canvas = Canvas(width, TOP + lines * (tall + BELOW) + 24, fitting(_title(tracks), 17, width - 40))
    for number, row in enumerate(rows):
        line, column = divmod(number, columns)
        x, y = left + column * (PANEL + GAP), TOP + line * (tall + BELOW)
        panel = (x, y, x + PANEL, y + tall)
        frame = FrameContent.of(tracks, row)
        shown = draw_frame(canvas, panel, tracks.geometry, frame, view, ("predicted", "corrected"))
        canvas.text((x + PANEL / 2, shown.axes.box[3] + 8), _caption(tracks, row, shown), 14, anchor="ma")
        if number == 0:
            write_lines(shown, view, ("predicted", "corrected"))
            draw_scale_bar(shown, frame.image.metadata.get(UNIT_KEY, "mm"))
    canvas.text((canvas.width - 10, canvas.height - 8), f"window {view.window.text}", 11, PALE, "rd")
    return canvas.png()


def _height(tracks: TrackSet, view: TrackView) -> float:
    """Of a panel: as the part of the image that is shown."""
    spacing = DisplayOrientation.of(tracks.geometry).spacing
    tall, wide = (
        (view.ranges[axis][1] - view.ranges[axis][0]) * spacing[axis] for axis in IN_PLANE[view.plane]
    )
    return min(max(PANEL * tall / wide, LOWEST), HIGHEST)


def _caption(tracks: TrackSet, row: FrameRow, shown: Slice) -> str:
    """When the frame was, and of a volume where the slice is."""
    if tracks.geometry.slice_axis is not None:
        return time_text(tracks, row)
    plane = shown.view.plane
    place = f"{shown.up.names[plane]} = {shown.up.coordinate(plane, shown.view.index):.4g} mm"
    return f"{time_text(tracks, row)}, {place}"


def picked(rows: tuple[FrameRow, ...]) -> list[FrameRow]:
    """Rows evenly spaced, the first and the last among them.

    Examples
    --------
    >>> rows = tuple(FrameRow(n, float(n), 0.0, ()) for n in range(30))
    >>> [row.frame for row in picked(rows)]
    [0, 3, 5, 8, 11, 13, 16, 18, 21, 24, 26, 29]
    """
    if len(rows) <= MAX_FRAMES:
        return list(rows)
    return [rows[int(place)] for place in np.rint(np.linspace(0, len(rows) - 1, MAX_FRAMES))]


def _title(tracks: TrackSet) -> str:
    count = len(tracks.by_object)
    objects = "one object" if count == 1 else f"{count} objects"
    return f"{tracks.name}: {objects} in {len(tracks.rows)} of {len(tracks.sequence)} frames"
