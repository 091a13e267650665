"""Tracks as spots and links, for programs that show tracks: a spot for each object in each frame that shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from accelsurf.report.track_frames import FrameRow, ObjectRow, TrackSet


class Spot(NamedTuple):
    """An object in a frame.

    ``number`` counts the spots by frame and id; ``along`` is its place (x, y, z) along the grid from the middle of the
    first voxel, mm; ``radius`` that of a ball of its volume, or of a disc of its area in an image of one slice, mm.
    """

    number: int
    row: FrameRow
    own: ObjectRow
    along: tuple[float, float, float]
    radius: float


class SpotLink(NamedTuple):
    """From a spot to one in a later frame; ``kind`` is motion, division or merging."""

    source: int
    target: int
    kind: str


@dataclass(frozen=True)
class SpotGraph:
    """Spots by number, and links by source and target."""

    spots: tuple[Spot, ...]
    links: tuple[SpotLink, ...]

    def components(self) -> list[tuple[int, ...]]:
        """Numbers of the spots that links join, each rising; by the first. A spot without links is one of its own."""
        first = list(range(len(self.spots)))

        def root(number: int) -> int:
            while first[number] != number:
                first[number] = first[first[number]]
                number = first[number]
            return number

        for link in self.links:
            low, high = sorted((root(link.source), root(link.target)))
            first[high] = low
        found: dict[int, list[int]] = {}
        for number in range(len(self.spots)):
            found.setdefault(root(number), []).append(number)
        return [tuple(one) for one in found.values()]


def spots_of(tracks: TrackSet) -> SpotGraph:
    """Return the spots of a tracking, and their links.

    An object that is not seen for some frames has a link over the gap. A child is linked to where its parent was last
    seen before.
    """
    spots: list[Spot] = []
    of_object: dict[int, list[Spot]] = {}
    for row in tracks.rows:
        for own in row.objects:
            if own.seen:
                spots.append(Spot(len(spots), row, own, _along(tracks, own), _radius(tracks, own)))
                of_object.setdefault(own.id, []).append(spots[-1])
    links = [
        SpotLink(one.number, following.number, "motion")
        for line in of_object.values()
        for one, following in zip(line[:-1], line[1:], strict=True)
    ]
    for link in tracks.lineage.links:
        line = of_object.get(link.child, [])
        before = [one for one in of_object.get(link.parent, []) if line and one.row.frame < line[0].row.frame]
        if before:
            links.append(SpotLink(before[-1].number, line[0].number, link.kind))
    return SpotGraph(tuple(spots), tuple(sorted(links)))


def _along(tracks: TrackSet, own: ObjectRow) -> tuple[float, float, float]:
    index = tracks.geometry.world_to_index(own.centroid)
    z, y, x = (float(at) * step for at, step in zip(index, tracks.geometry.spacing, strict=True))
    return x, y, z


def _radius(tracks: TrackSet, own: ObjectRow) -> float:
    axis = tracks.geometry.slice_axis
    if axis is None:
        return math.cbrt(3 * own.volume_mm3 / (4 * math.pi))
    return math.sqrt(own.volume_mm3 / tracks.geometry.spacing[axis] / math.pi)
