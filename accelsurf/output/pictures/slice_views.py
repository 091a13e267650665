"""Slices that a picture shows, and the part of them: through clicks, late growth, or the largest section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, bounding_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.orientation import IN_PLANE, PLANES, DisplayOrientation
from accelsurf.output.pictures.preview_content import PreviewContent

#: Margin around the object: a share of its extent to each side, and a number of voxels at least.
MARGIN = 0.3
MIN_MARGIN = 6
#: Slices through further clicks at most, the latest.
MAX_CLICK_SLICES = 3

#: First and one past the last voxel along each displayed axis.
Ranges = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class SliceView:
    """A slice, on the axes as they are displayed.

    Attributes
    ----------
    plane : int
        Axis across the slice: 0 is axial, 1 coronal, 2 sagittal.
    index : int
        Voxel along it.
    why : str
        Its title, above the slice; empty for a slice through the first click or the largest section.
    """

    plane: int
    index: int
    why: str = ""


def shown_ranges(content: PreviewContent) -> Ranges:
    """The voxels around the object and its clicks that are shown; the whole image without an object."""
    box = bounding_box(content.inside())
    if box is None:
        return whole_ranges(content.geometry)
    ends = [(part.start, part.stop) for part in box]
    for mark in content.clicks:
        ends = [
            (min(a, part.start), max(b, part.stop))
            for (a, b), part in zip(ends, mark.box, strict=True)
        ]
    return ranges_around(ends, content.geometry, MARGIN)


def ranges_around(ends: Sequence[tuple[int, int]], geometry: Geometry, margin: float) -> Ranges:
    """Return the voxels of a box (first and one past the last along each axis of the array) and a margin around it."""
    up = DisplayOrientation.of(geometry)
    ranges = []
    for axis, (n, flip) in enumerate(
        zip(np.take(geometry.shape, up.order).tolist(), up.flips, strict=True)
    ):
        low, high = ends[up.order[axis]]
        if flip:
            low, high = n - high, n - low
        room = max(
            round(margin * (high - low)),
            round(MIN_MARGIN * min(geometry.steps) / up.spacing[axis]),
            1,
        )
        ranges.append((max(low - room, 0), min(high + room, n)))
    return ranges[0], ranges[1], ranges[2]


def whole_ranges(geometry: Geometry) -> Ranges:
    """All voxels."""
    order = DisplayOrientation.of(geometry).order
    return (
        (0, geometry.shape[order[0]]),
        (0, geometry.shape[order[1]]),
        (0, geometry.shape[order[2]]),
    )


def box_of(ranges: Ranges, geometry: Geometry) -> Box:
    """The part of the array that ranges of the displayed axes cover."""
    up = DisplayOrientation.of(geometry)
    parts: list[slice] = [slice(None)] * 3
    for axis, (low, high) in enumerate(ranges):
        n = geometry.shape[up.order[axis]]
        parts[up.order[axis]] = slice(n - high, n - low) if up.flips[axis] else slice(low, high)
    return parts[0], parts[1], parts[2]


def fitted(ranges: Ranges, plane: int, geometry: Geometry, width_to_height: float) -> Ranges:
    """Ranges widened within the image so that a slice fills a panel of this shape as far as it can."""
    up, out = DisplayOrientation.of(geometry), list(ranges)
    vertical, horizontal = IN_PLANE[plane]
    tall, wide = (
        (out[axis][1] - out[axis][0]) * up.spacing[axis] for axis in (vertical, horizontal)
    )
    axis, mm = (
        (horizontal, tall * width_to_height)
        if wide < tall * width_to_height
        else (vertical, wide / width_to_height)
    )
    low, high = out[axis]
    n, more = geometry.shape[up.order[axis]], max(round(mm / up.spacing[axis]) - (high - low), 0)
    low = max(low - more // 2, 0)
    high = min(high + more - more // 2, n)
    out[axis] = (low, high)
    return out[0], out[1], out[2]


def displayed(
    place: tuple[float, float, float] | tuple[int, int, int], geometry: Geometry
) -> tuple[float, ...]:
    """A (continuous) index (z, y, x) of the image, on the axes as they are displayed."""
    up = DisplayOrientation.of(geometry)
    return tuple(
        geometry.shape[axis] - 1 - place[axis] if flip else float(place[axis])
        for axis, flip in zip(up.order, up.flips, strict=True)
    )


def native_plane(geometry: Geometry) -> int:
    """The plane across the thickest voxels, in which scans are read; the axial one where they are cubes."""
    spacing = DisplayOrientation.of(geometry).spacing
    return int(np.argmax(np.round(np.asarray(spacing) / min(spacing), 3)))


def main_views(content: PreviewContent) -> list[SliceView]:
    """The slice of each plane through the first inside click, else through the object's largest section there."""
    inside = next((mark for mark in content.clicks if mark.side == "inside"), None)
    if inside is not None:
        return [
            SliceView(plane, round(at))
            for plane, at in enumerate(displayed(inside.place, content.geometry))
        ]
    up, found = DisplayOrientation.of(content.geometry), content.inside()
    if not found.any():
        return [
            SliceView(plane, content.geometry.shape[up.order[plane]] // 2) for plane in range(3)
        ]
    return [SliceView(plane, _largest_section(up.reorient(found), plane)) for plane in range(3)]


def _largest_section(inside: NDArray[np.bool_], plane: int) -> int:
    """The slice with most voxels inside; of several equal ones next to each other the middle one."""
    counts = np.count_nonzero(inside, axis=IN_PLANE[plane])
    most = np.flatnonzero(counts == counts.max())
    return int(most[(len(most) - 1) // 2])


def uncertain_views(content: PreviewContent) -> list[SliceView]:
    """The slices of the fastest late growth and of where to click next, of the latter where none else shows it."""
    views, plane = [], native_plane(content.geometry)
    if content.late_growth is not None:
        place = displayed(content.late_growth, content.geometry)
        views.append(SliceView(plane, round(place[plane]), "latest growth"))
    if content.next_clicks:
        place = displayed(content.next_clicks[0], content.geometry)
        others = (*main_views(content), *click_views(content), *views)
        if all(round(place[view.plane]) != view.index for view in others):
            views.append(SliceView(plane, round(place[plane]), "most doubtful place"))
    return views


def second_view(content: PreviewContent, is_flat: bool) -> SliceView | None:
    """The slice beside the main ones: of late growth, where to click next, a click; else another place of the object.

    A place to click next that a main slice shows already is shown in the plane across; with ``is_flat`` the other
    planes are low, and the slice half-way to an end of the object says more.
    """
    views = uncertain_views(content)
    main = main_views(content)
    geometry = content.geometry
    if content.next_clicks and not is_flat:
        place = displayed(content.next_clicks[0], geometry)
        views += [
            SliceView(view.plane, round(place[view.plane]), "most doubtful place")
            for view in main[::-1]
            if round(place[view.plane]) != view.index
        ]
    views += click_views(content)[::-1]
    inside = content.inside()
    if not views and inside.any():
        plane, up = native_plane(geometry), DisplayOrientation.of(geometry)
        found = np.flatnonzero(up.reorient(inside).any(axis=IN_PLANE[plane]))
        index = main[plane].index
        far = int(max(found[0], found[-1], key=lambda end: abs(end - index)))
        if abs(far - index) > 1:
            views = [SliceView(plane, (far + index) // 2, "half-way to an end")]
    return views[0] if views else None


def click_views(content: PreviewContent) -> list[SliceView]:
    """Slices through the latest clicks that the main views do not show."""
    plane, main = native_plane(content.geometry), main_views(content)
    views: dict[int, str] = {}
    for number, mark in enumerate(content.clicks, 1):
        index = round(displayed(mark.place, content.geometry)[plane])
        if index != main[plane].index:
            views.pop(index, None)
            views[index] = f"click {number}, {mark.side}"
    return [SliceView(plane, index, why) for index, why in list(views.items())[-MAX_CLICK_SLICES:]]


def plane_name(plane: int, anatomical: bool) -> str:
    """Return the name of a plane."""
    return PLANES[plane] if anatomical else "Slice"
