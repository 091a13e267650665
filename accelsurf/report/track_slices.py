"""What pictures of a tracking show: which slice of a frame, which part of it, and the objects in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box as VoxelBox
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.grey_window import GreyWindow
from accelsurf.grid.orientation import IN_PLANE, DisplayOrientation
from accelsurf.grid.volume import Volume
from accelsurf.report.canvas import DARK, REFERENCE, SOLID, Box, Canvas, Dashes, object_color
from accelsurf.report.slice_plot import (
    REFERENCE_DASHES,
    Slice,
    draw_contour,
    lay_slice,
    name_section,
    write_legend,
)
from accelsurf.report.slice_views import MARGIN, MIN_MARGIN, Ranges, SliceView, displayed, native_plane
from accelsurf.report.track_frames import DrawnObject, FrameRow, TrackSet
from accelsurf.tracking.records import SurfacePiece

#: More ids than these are not written into a picture.
MAX_NAMES = 40


@dataclass(frozen=True)
class TrackView:
    """How all frames are shown, so that motion is seen: one plane, one part, one grey window.

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
        plane = native_plane(geometry) if geometry.slice_axis is None else order.index(geometry.slice_axis)
        colors = {own: object_color(n) for n, own in enumerate(tracks.by_object)}
        return cls(plane, _ranges(tracks.extent, geometry), tracks.window, colors)

    def slice_of(self, row: FrameRow, geometry: Geometry) -> SliceView:
        """The slice through the largest object of a frame that is seen, else through the middle."""
        objects = sorted(row.objects, key=lambda one: (not one.seen, -one.volume_mm3, one.id))
        middle = tuple(0.5 * (n - 1) for n in geometry.shape)
        place = geometry.world_to_index(objects[0].centroid) if objects else np.array(middle)
        at = round(displayed((float(place[0]), float(place[1]), float(place[2])), geometry)[self.plane])
        count = geometry.shape[DisplayOrientation.of(geometry).order[self.plane]]
        return SliceView(self.plane, min(max(at, 0), count - 1))


class FrameContent(NamedTuple):
    """A frame with all that is drawn of it: its ``image`` as it was read, and its objects."""

    row: FrameRow
    image: Volume
    drawn: list[DrawnObject]

    @classmethod
    def of(cls, tracks: TrackSet, row: FrameRow) -> FrameContent:
        """Read a frame, once for all panels."""
        return cls(row, tracks.sequence.frame(row.frame), tracks.store.drawn(row.frame))


def draw_frame(
    canvas: Canvas, panel: Box, geometry: Geometry, frame: FrameContent, view: TrackView, what: Sequence[str]
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
    shown = lay_slice(
        canvas, panel, frame.image.array, geometry, view.slice_of(frame.row, geometry), view.ranges, view.window
    )
    for one in frame.drawn:
        if "predicted" in what and one.predicted is not None:
            _draw_piece(shown, one.predicted, REFERENCE, REFERENCE_DASHES, geometry)
    for one in frame.drawn:
        if "corrected" in what:
            dashes = SOLID if one.seen else REFERENCE_DASHES
            section = _draw_piece(shown, one.surface, view.colors[one.id], dashes, geometry)
            if section is not None and 1 < len(view.colors) <= MAX_NAMES:
                name_section(shown, section < 0, str(one.id), view.colors[one.id])
    return shown


def write_lines(shown: Slice, view: TrackView, what: Sequence[str]) -> None:
    """Write what the lines of a frame are, in its lower left corner."""
    first = next(iter(view.colors.values()), DARK)
    names = {"predicted": ("predicted", REFERENCE, REFERENCE_DASHES), "corrected": ("corrected", first, SOLID)}
    write_legend(shown, [names[one] for one in what])


def time_text(tracks: TrackSet, row: FrameRow) -> str:
    """When a frame was: its time where it has one, and its number."""
    number = f"frame {row.frame}"
    return number if tracks.sequence.time_unit == "frame" else f"{row.time:.4g} s, {number}"


def _draw_piece(
    shown: Slice, piece: SurfacePiece, color: str, dashes: Dashes, geometry: Geometry
) -> NDArray[np.float32] | None:
    """Draw where a slice cuts a surface; its section, None where it does not."""
    up, psi = shown.up, shown.up.reorient(piece.psi)
    parts: list[slice] = []
    places: list[slice] = []
    for axis, (low, high) in enumerate(shown.ranges):
        own = up.order[axis]
        first = piece.corner[own]
        if up.flips[axis]:
            first = geometry.shape[own] - first - psi.shape[axis]
        if axis == shown.view.plane:
            low, high = shown.view.index, shown.view.index + 1
        begin, end = max(first, low), min(first + psi.shape[axis], high)
        if begin >= end:
            return None
        parts.append(slice(begin - first, end - first))
        places.append(slice(begin - low, end - low))
    section = np.full([high - low for low, high in (shown.ranges[axis] for axis in IN_PLANE[shown.view.plane])],
                      float(np.abs(piece.psi).max()), np.float32)  # fmt: skip
    vertical, horizontal = IN_PLANE[shown.view.plane]
    section[places[vertical], places[horizontal]] = psi[tuple(parts)].squeeze(axis=shown.view.plane)
    draw_contour(shown, section, color, dashes)
    return section


def _ranges(extent: VoxelBox | None, geometry: Geometry) -> Ranges:
    """Voxels around a box, along the displayed axes; all of them without one."""
    up = DisplayOrientation.of(geometry)
    ranges = []
    for axis in range(3):
        own = up.order[axis]
        n = geometry.shape[own]
        low, high = (0, n) if extent is None else (extent[own].start, extent[own].stop)
        if up.flips[axis]:
            low, high = n - high, n - low
        room = max(round(MARGIN / 2 * (high - low)), round(MIN_MARGIN * min(geometry.steps) / up.spacing[axis]), 1)
        ranges.append((max(low - room, 0), min(high + room, n)))
    return ranges[0], ranges[1], ranges[2]
