"""Pictures of a tracking: a strip of frames, a movie with predictions beside corrections, and volumes against time.

All frames show the same part of the image in the same grey window, so that motion is seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import OutputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.image.grey_window import GreyWindow
from accelsurf.image.volume import Volume
from accelsurf.output import (
    DARK,
    MARGIN,
    PALE,
    REFERENCE_COLOR,
    REFERENCE_DASHES,
    SOLID,
    TICK_SIZE,
    TITLE_SIZE,
    Box,
    Canvas,
    Dashes,
    NamedLine,
    Picture,
    Ranges,
    ShownImage,
    Slice,
    SliceView,
    across_text,
    check_target,
    displayed,
    draw_contour,
    draw_slice_scale,
    lay_slice,
    name_section,
    native_plane,
    object_color,
    range_of,
    ranges_around,
    write_legend,
    write_line_names,
    write_movie,
    write_scales,
)
from accelsurf.settings.wording import in_unit
from accelsurf.track.output.frames import DrawnObject, FrameRow, TrackSet
from accelsurf.track.records import SurfacePiece

#: Ids are not written into a picture of more objects than these.
MAX_NAMES = 40
#: Frames in a strip at most, and in a line of it.
MAX_FRAMES = 12
COLUMNS = 4
#: Width of a panel of a strip, of the space between panels, of the title and below a panel, pixels; a panel's height.
PANEL = 320
GAP = 14
TOP = 56
BELOW = 34
LOWEST = 100.0
HIGHEST = 480.0
#: Width and height of a movie, of the margin around a panel and of the lines above it, pixels.
MOVIE_SIZE = (960, 540)
MOVIE_MARGIN = 12
MOVIE_TOP = 58
#: Surfaces that a movie shows side by side.
PANELS = ("predicted", "corrected")
#: Length of a movie, s, and its frames per second at least and at most.
SECONDS = 8.0
SLOWEST = 2.0
FASTEST = 15.0
#: Width and height of the curves, pixels; how many are named, and drawn, at most.
CURVES_SIZE = (900, 460)
MAX_NAMED_CURVES = 18
MAX_CURVES = 200
#: Volumes below this, ml, are written as mm3.
SMALL = 0.1


@dataclass(frozen=True)
class TrackView:
    """The view of all frames: one plane, one part, one grey window.

    Attributes
    ----------
    plane : int
        Axis across the slices, as displayed.
    ranges : tuple of (int, int)
        Voxels that are shown, along the displayed axes.
    window : GreyWindow
    colors : dict of int to str
        Of the objects.
    """

    plane: int
    ranges: Ranges
    window: GreyWindow
    colors: dict[int, str]

    @classmethod
    def of(cls, tracks: TrackSet) -> TrackView:
        """Show all places where objects come by; the whole frame where there is none."""
        geometry = tracks.geometry
        order = DisplayOrientation.of(geometry).order
        plane = (
            native_plane(geometry)
            if geometry.slice_axis is None
            else order.index(geometry.slice_axis)
        )
        colors = {number: object_color(n) for n, number in enumerate(tracks.by_object)}
        box = tracks.extent or tuple(slice(0, n) for n in geometry.shape)
        ranges = ranges_around([(side.start, side.stop) for side in box], geometry, MARGIN / 2)
        return cls(plane, ranges, tracks.window, colors)

    def slice_of(self, row: FrameRow, geometry: Geometry) -> SliceView:
        """The slice through the largest object of a frame that is seen, else through the middle."""
        objects = sorted(
            row.objects, key=lambda found: (not found.seen, -found.volume_mm3, found.id)
        )
        middle = tuple(0.5 * (n - 1) for n in geometry.shape)
        place = geometry.world_to_index(objects[0].centroid) if objects else np.array(middle)
        at = round(
            displayed((float(place[0]), float(place[1]), float(place[2])), geometry)[self.plane]
        )
        count = geometry.shape[DisplayOrientation.of(geometry).order[self.plane]]
        return SliceView(self.plane, min(max(at, 0), count - 1))


class FrameContent(NamedTuple):
    """A frame as it is drawn: its ``image`` as it was read, and its objects."""

    row: FrameRow
    image: Volume
    drawn: list[DrawnObject]

    @classmethod
    def of(cls, tracks: TrackSet, row: FrameRow) -> FrameContent:
        """Read a frame, once for all panels."""
        return cls(row, tracks.sequence.frame(row.frame), tracks.store.drawn(row.frame))


def draw_frame(
    canvas: Canvas,
    panel: Box,
    geometry: Geometry,
    frame: FrameContent,
    view: TrackView,
    what: Sequence[str],
) -> Slice:
    """Draw a frame with its objects.

    Parameters
    ----------
    canvas, panel : Canvas, (left, top, right, bottom)
    geometry : Geometry
    frame : FrameContent
    view : TrackView
    what : sequence of {"predicted", "corrected"}
        Which surfaces.
    """
    image = ShownImage(frame.image.array, geometry, view.window)
    shown = lay_slice(canvas, panel, image, view.slice_of(frame.row, geometry), view.ranges)
    for found in frame.drawn:
        if "predicted" in what and found.predicted is not None:
            _draw_piece(shown, found.predicted, REFERENCE_COLOR, REFERENCE_DASHES, geometry)
    for found in frame.drawn:
        if "corrected" in what:
            dashes = SOLID if found.seen else REFERENCE_DASHES
            section = _draw_piece(shown, found.surface, view.colors[found.id], dashes, geometry)
            if section is not None and 1 < len(view.colors) <= MAX_NAMES:
                name_section(shown, section < 0, str(found.id), view.colors[found.id])
    return shown


def time_text(tracks: TrackSet, row: FrameRow) -> str:
    """Return the time of a frame, where it has one, and its number."""
    number = f"frame {row.frame}"
    return number if tracks.sequence.time_unit == "frame" else f"{row.time:.4g} s, {number}"


def _draw_piece(
    shown: Slice, piece: SurfacePiece, color: str, dashes: Dashes, geometry: Geometry
) -> NDArray[np.float32] | None:
    """Draw the cut of a slice through a surface; returns its section, None where there is none."""
    up, psi = shown.up, shown.up.reorient(piece.psi)
    parts: list[slice] = []
    places: list[slice] = []
    for axis, (low, high) in enumerate(shown.ranges):
        first = piece.corner[up.order[axis]]
        if up.flips[axis]:
            first = geometry.shape[up.order[axis]] - first - psi.shape[axis]
        if axis == shown.view.plane:
            low, high = shown.view.index, shown.view.index + 1
        begin, end = max(first, low), min(first + psi.shape[axis], high)
        if begin >= end:
            return None
        parts.append(slice(begin - first, end - first))
        places.append(slice(begin - low, end - low))
    section = np.full(
        [high - low for low, high in (shown.ranges[axis] for axis in IN_PLANE[shown.view.plane])],
        float(np.abs(piece.psi).max()),
        np.float32,
    )
    vertical, horizontal = IN_PLANE[shown.view.plane]
    section[places[vertical], places[horizontal]] = psi[tuple(parts)].squeeze(axis=shown.view.plane)
    draw_contour(shown, section, color, dashes)
    return section


def film_strip_png(tracks: TrackSet) -> bytes:
    """Draw frames evenly spaced from the first to the last that was reached.

    The slice is the one through the largest object. Of each object the surface is drawn in its colour, dashed where the
    frame does not show it, and its prediction in blue, dashed.

    Returns
    -------
    bytes
        A PNG file.
    """
    rows, view = picked(tracks.rows), TrackView.of(tracks)
    columns = min(COLUMNS, max(len(rows), 1))
    width = max(columns * (PANEL + GAP) + GAP, 700)
    left = (width - columns * (PANEL + GAP) + GAP) / 2
    lines, tall = math.ceil(max(len(rows), 1) / columns), _height(tracks, view)
    count = len(tracks.by_object)
    objects = "one object" if count == 1 else f"{count} objects"
    title = f"{tracks.name}: {objects} in {len(tracks.rows)} of {len(tracks.sequence)} frames"
    canvas = Canvas(width, TOP + lines * (tall + BELOW) + 24, title)
    for number, row in enumerate(rows):
        line, column = divmod(number, columns)
        x, y = left + column * (PANEL + GAP), TOP + line * (tall + BELOW)
        frame = FrameContent.of(tracks, row)
        panel = Box(x, y, x + PANEL, y + tall)
        shown = draw_frame(canvas, panel, tracks.geometry, frame, view, ("predicted", "corrected"))
        below = canvas.height - shown.axes.bbox.y0 + 8
        canvas.text((x + PANEL / 2, below), _caption(tracks, frame, shown), TITLE_SIZE, anchor="ma")
        if number == 0:
            color = next(iter(view.colors.values()), DARK)
            predicted = NamedLine("predicted", REFERENCE_COLOR, REFERENCE_DASHES)
            write_line_names(shown, [predicted, NamedLine("corrected", color)])
            draw_slice_scale(shown, frame.image.geometry.unit)
    canvas.text(
        (canvas.width - 10, canvas.height - 8), f"window {view.window.text}", TICK_SIZE, PALE, "rd"
    )
    return canvas.png()


def _height(tracks: TrackSet, view: TrackView) -> float:
    """Return the height of a panel: as the part of the image that is shown."""
    spacing = DisplayOrientation.of(tracks.geometry).spacing
    tall, wide = (
        (view.ranges[axis][1] - view.ranges[axis][0]) * spacing[axis]
        for axis in IN_PLANE[view.plane]
    )
    return min(max(PANEL * tall / wide, LOWEST), HIGHEST)


def _caption(tracks: TrackSet, frame: FrameContent, shown: Slice) -> str:
    """Return the time of a frame, and of a volume the place of the slice."""
    time = time_text(tracks, frame.row)
    if tracks.geometry.slice_axis is not None:
        return time
    return f"{time}, {across_text(shown, frame.image.geometry.unit)}"


def picked(rows: tuple[FrameRow, ...]) -> list[FrameRow]:
    """Return rows evenly spaced, the first and the last among them.

    Examples
    --------
    >>> rows = tuple(FrameRow(n, float(n), 0.0, ()) for n in range(30))
    >>> [row.frame for row in picked(rows)]
    [0, 3, 5, 8, 11, 13, 16, 18, 21, 24, 26, 29]
    """
    if len(rows) <= MAX_FRAMES:
        return list(rows)
    return [rows[int(place)] for place in np.rint(np.linspace(0, len(rows) - 1, MAX_FRAMES))]


def check_movie(suffix: str) -> None:
    """Refuse to begin without the encoder of a movie; errors as `accelsurf.output.pictures.movies.check_target`."""
    check_target(Path(f"movie{suffix}"), MOVIE_SIZE)


def write_track_movie(tracks: TrackSet, path: Path, panels: Sequence[str] = PANELS) -> None:
    """Write the movie; the suffix decides the format.

    Parameters
    ----------
    tracks : TrackSet
    path : Path
    panels : sequence of {"predicted", "corrected"}, optional
        Which surfaces, each in a panel of its own.

    Raises
    ------
    OutputError
        When it cannot be written, or no frame was reached.
    """
    if not tracks.rows:
        raise OutputError(f"{path.name}: no frame to show")
    speed = min(max(len(tracks.rows) / SECONDS, SLOWEST), FASTEST)
    write_movie(path, movie_frames(tracks, panels), MOVIE_SIZE, speed)


def movie_frames(tracks: TrackSet, panels: Sequence[str] = PANELS) -> Iterator[Picture]:
    """Draw the pictures of a movie, one for each frame; parameters as of `write_track_movie`.

    Yields
    ------
    ndarray (height, width, 3), uint8
    """
    view = TrackView.of(tracks)
    wide, tall = MOVIE_SIZE
    share = wide / len(panels)
    for row in tracks.rows:
        canvas = Canvas(wide, tall)
        canvas.text((wide / 2, 18), f"{tracks.name}: {time_text(tracks, row)}", 16, anchor="mm")
        frame = FrameContent.of(tracks, row)
        for number, what in enumerate(panels):
            left = number * share
            panel = Box(
                left + MOVIE_MARGIN, MOVIE_TOP, left + share - MOVIE_MARGIN, tall - MOVIE_MARGIN
            )
            shown = draw_frame(canvas, panel, tracks.geometry, frame, view, (what,))
            canvas.text((left + share / 2, 44), what, TITLE_SIZE, anchor="mm")
        draw_slice_scale(shown, frame.image.geometry.unit)
        yield canvas.pixels()


def curves_png(tracks: TrackSet) -> bytes:
    """Draw the volume of each object against time, with a gap where it is not seen.

    Volumes are in ml or mm3, of an image in um or nm in these.

    Returns
    -------
    bytes
        A PNG file.
    """
    largest = max((shape.volume_mm3 for row in tracks.rows for shape in row.objects), default=0.0)
    unit, scale = f"{tracks.unit}\u00b3", in_unit(1.0, tracks.unit, 3)
    if tracks.unit == "mm" and largest >= 1e3 * SMALL:
        unit, scale = "ml", 1e-3
    curves = {}
    for number, life in list(tracks.by_object.items())[:MAX_CURVES]:
        volumes = [scale * shape.volume_mm3 if shape.seen else np.nan for _, shape in life]
        curves[number] = list(zip([row.time for row, _ in life], volumes, strict=True))
    width, height = CURVES_SIZE
    canvas = Canvas(width, height, f"{tracks.name}: volume")
    times = [row.time for row in tracks.rows] or [0.0]
    first, last = (
        (min(times), max(times))
        if max(times) > min(times)
        else (min(times) - 0.5, min(times) + 0.5)
    )
    low, high = range_of([value for curve in curves.values() for _, value in curve])
    box = Box(90, 56, width - (130 if len(curves) > 1 else 30), height - 58)
    axes = canvas.axes(box, (first, last), (max(low, 0.0), high))
    write_scales(
        axes,
        "time (s)" if tracks.sequence.time_unit == "s" else "frame",
        f"volume ({unit})",
        grid=True,
    )
    lines = []
    for number, curve in enumerate(curves.values()):
        lines += axes.plot(
            *zip(*curve, strict=True),
            color=object_color(number),
            linestyle="-",
            linewidth=2,
            clip_on=False,
            marker="o" if len(curve) <= MAX_CURVES else "",
            markersize=5,
            markeredgecolor="none",
        )
    if len(lines) > 1:
        names = [f"object {number}" for number in curves][:MAX_NAMED_CURVES]
        write_legend(axes, lines[:MAX_NAMED_CURVES], names, "upper left", bbox_to_anchor=(1.0, 1.0))
    return canvas.png()
