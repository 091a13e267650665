"""Tracks as an XML file of TrackMate, the plugin of Fiji: spots, tracks, and the grid that they lie on.

TrackMate shows a spot at its place divided by the size of a pixel, so places are along the grid from the first voxel;
those of the world (LPS) are features of their own. Its documentation, "TrackMate file format", has the elements.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as Xml

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from accelsurf.io.files import write_bytes
from accelsurf.track.output.document import ML
from accelsurf.track.output.frames import FrameRow, ObjectRow, TrackSet

_VERSION = "7.11.1"
#: Features of spots, edges and tracks: name, what it is, dimension, whether it is a whole number.
_SPOT = (
    ("QUALITY", "Quality", "QUALITY", False),
    ("POSITION_X", "X", "POSITION", False),
    ("POSITION_Y", "Y", "POSITION", False),
    ("POSITION_Z", "Z", "POSITION", False),
    ("POSITION_T", "T", "TIME", False),
    ("FRAME", "Frame", "NONE", True),
    ("RADIUS", "Radius", "LENGTH", False),
    ("VISIBILITY", "Visibility", "NONE", True),
    ("OBJECT_ID", "Object", "NONE", True),
    ("WORLD_X", "World x LPS", "POSITION", False),
    ("WORLD_Y", "World y LPS", "POSITION", False),
    ("WORLD_Z", "World z LPS", "POSITION", False),
    ("VELOCITY_X", "Velocity x LPS", "VELOCITY", False),
    ("VELOCITY_Y", "Velocity y LPS", "VELOCITY", False),
    ("VELOCITY_Z", "Velocity z LPS", "VELOCITY", False),
    ("VOLUME_ML", "Volume ml", "NONE", False),
    ("SURFACE_AREA", "Surface area", "AREA", False),
)
_EDGE = (
    ("SPOT_SOURCE_ID", "Source spot ID", "NONE", True),
    ("SPOT_TARGET_ID", "Target spot ID", "NONE", True),
    ("LINK_COST", "Edge cost", "COST", False),
    ("DISPLACEMENT", "Displacement", "LENGTH", False),
    ("EDGE_TIME", "Edge time", "TIME", False),
)
_TRACK = (
    ("TRACK_ID", "Track ID", "NONE", True),
    ("TRACK_INDEX", "Track index", "NONE", True),
    ("NUMBER_SPOTS", "Number of spots in track", "NONE", True),
    ("NUMBER_GAPS", "Number of gaps", "NONE", True),
    ("NUMBER_SPLITS", "Number of split events", "NONE", True),
    ("NUMBER_MERGES", "Number of merge events", "NONE", True),
    ("TRACK_START", "Track start", "TIME", False),
    ("TRACK_STOP", "Track stop", "TIME", False),
)


def write_trackmate(tracks: TrackSet, path: Path) -> None:
    """Write the XML file; the same tracks give the same bytes.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    graph = spots_of(tracks)
    root = Xml.Element("TrackMate", version=_VERSION)
    Xml.SubElement(root, "Log").text = "Written by accelsurf"
    model = Xml.SubElement(root, "Model", spatialunits="mm", timeunits=tracks.sequence.time_unit)
    declared = Xml.SubElement(model, "FeatureDeclarations")
    for kind, features in (("SpotFeatures", _SPOT), ("EdgeFeatures", _EDGE), ("TrackFeatures", _TRACK)):
        group = Xml.SubElement(declared, kind)
        for name, words, dimension, whole in features:
            Xml.SubElement(
                group, "Feature", feature=name, name=words, shortname=words, dimension=dimension, isint=_text(whole)
            )
    _add_spots(model, tracks, graph)
    _add_tracks(model, graph)
    _add_settings(root, tracks)
    Xml.indent(root)
    write_bytes(path, Xml.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


def _add_spots(model: Xml.Element, tracks: TrackSet, graph: SpotGraph) -> None:
    group = Xml.SubElement(model, "AllSpots", nspots=str(len(graph.spots)))
    in_frame = {row.frame: Xml.SubElement(group, "SpotsInFrame", frame=str(row.frame)) for row in tracks.rows}
    for spot in graph.spots:
        x, y, z = spot.along
        values = {
            "ID": spot.number, "name": f"object {spot.tracked.id}", "QUALITY": spot.tracked.quality,
            "POSITION_X": x, "POSITION_Y": y, "POSITION_Z": z, "POSITION_T": spot.row.time, "FRAME": spot.row.frame,
            "RADIUS": spot.radius, "VISIBILITY": 1, "OBJECT_ID": spot.tracked.id,
            **dict(zip(("WORLD_X", "WORLD_Y", "WORLD_Z"), spot.tracked.centroid, strict=True)),
            **dict(zip(("VELOCITY_X", "VELOCITY_Y", "VELOCITY_Z"), spot.tracked.velocity, strict=True)),
            "VOLUME_ML": spot.tracked.volume_mm3 * ML, "SURFACE_AREA": spot.tracked.area_mm2,
        }
        Xml.SubElement(in_frame[spot.row.frame], "Spot", {name: _text(value) for name, value in values.items()})


def _add_tracks(model: Xml.Element, graph: SpotGraph) -> None:
    """Add a track for each set of spots that links join; a spot without links is in none."""
    group, shown = Xml.SubElement(model, "AllTracks"), Xml.SubElement(model, "FilteredTracks")
    joined = [numbers for numbers in graph.components() if len(numbers) > 1]
    for index, numbers in enumerate(joined):
        members = set(numbers)
        links = [link for link in graph.links if link.source in members]
        spots = [graph.spots[number] for number in numbers]
        sources, targets = [link.source for link in links], [link.target for link in links]
        values = {
            "name": f"Track_{index}", "TRACK_ID": index, "TRACK_INDEX": index, "NUMBER_SPOTS": len(numbers),
            "NUMBER_GAPS": sum(_frames_between(graph, a, b) > 1 for a, b in zip(sources, targets, strict=True)),
            "NUMBER_SPLITS": sum(sources.count(number) > 1 for number in members),
            "NUMBER_MERGES": sum(targets.count(number) > 1 for number in members),
            "TRACK_START": spots[0].row.time, "TRACK_STOP": spots[-1].row.time,
        }
        track = Xml.SubElement(group, "Track", {name: _text(value) for name, value in values.items()})
        for link in links:
            a, b = graph.spots[link.source], graph.spots[link.target]
            of_edge = {
                "SPOT_SOURCE_ID": a.number, "SPOT_TARGET_ID": b.number, "LINK_COST": -1.0,
                "DISPLACEMENT": _distance(a, b), "EDGE_TIME": 0.5 * (a.row.time + b.row.time),
            }
            Xml.SubElement(track, "Edge", {name: _text(value) for name, value in of_edge.items()})
        Xml.SubElement(shown, "TrackID", TRACK_ID=str(index))


def _add_settings(root: Xml.Element, tracks: TrackSet) -> None:
    sequence, source = tracks.sequence, Path(tracks.sequence.source)
    nz, ny, nx = sequence.geometry.shape
    dz, dy, dx = sequence.geometry.spacing
    steps = [b - a for a, b in zip(sequence.times[:-1], sequence.times[1:], strict=True)]
    group = Xml.SubElement(root, "Settings")
    image = {
        "filename": source.name, "folder": str(source.absolute().parent) if sequence.source else "", "width": nx,
        "height": ny, "nslices": nz, "nframes": len(sequence), "pixelwidth": dx, "pixelheight": dy, "voxeldepth": dz,
        "timeinterval": float(statistics.median(steps)) if steps else 1.0,
    }
    Xml.SubElement(group, "ImageData", {name: _text(value) for name, value in image.items()})
    ends = {"x": nx, "y": ny, "z": nz, "t": len(sequence)}
    box = {f"{axis}start": "0" for axis in ends} | {f"{axis}end": str(n - 1) for axis, n in ends.items()}
    Xml.SubElement(group, "BasicSettings", box)
    Xml.SubElement(group, "DetectorSettings", DETECTOR_NAME="MANUAL_DETECTOR", RADIUS="1.0")
    Xml.SubElement(group, "InitialSpotFilter", feature="QUALITY", value="-1.0", isabove="true")
    Xml.SubElement(group, "SpotFilterCollection")
    Xml.SubElement(group, "TrackerSettings", TRACKER_NAME="MANUAL_TRACKER")
    Xml.SubElement(group, "TrackFilterCollection")
    analyzers = Xml.SubElement(group, "AnalyzerCollection")
    for kind in ("SpotAnalyzers", "EdgeAnalyzers", "TrackAnalyzers"):
        Xml.SubElement(analyzers, kind)
    Xml.SubElement(root, "GUIState", state="ConfigureViews")


def _frames_between(graph: SpotGraph, source: int, target: int) -> int:
    return graph.spots[target].row.frame - graph.spots[source].row.frame


def _distance(a: Spot, b: Spot) -> float:
    return float(sum((q - p) ** 2 for p, q in zip(a.along, b.along, strict=True)) ** 0.5)


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class Spot(NamedTuple):
    """An object in a frame.

    ``number`` counts the spots by frame and id; ``along`` is its place (x, y, z) along the grid from the middle of the
    first voxel, mm; ``radius`` that of a ball of its volume, or of a disc of its area in an image of one slice, mm.
    """

    number: int
    row: FrameRow
    tracked: ObjectRow
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
        ends = np.array([(link.source, link.target) for link in self.links], np.int64).reshape(-1, 2).T
        shape = (len(self.spots), len(self.spots))
        count, part = csgraph.connected_components(sparse.coo_matrix((np.ones(ends.shape[1]), ends), shape), False)
        return [tuple(np.flatnonzero(part == number).tolist()) for number in range(count)]


def spots_of(tracks: TrackSet) -> SpotGraph:
    """Return the spots of a tracking, and their links.

    An object that is not seen for some frames has a link over the gap. A child is linked to where its parent was last
    seen before.
    """
    spots: list[Spot] = []
    of_object: dict[int, list[Spot]] = {}
    for row in tracks.rows:
        for tracked in row.objects:
            if tracked.seen:
                spots.append(Spot(len(spots), row, tracked, _along(tracks, tracked), _radius(tracks, tracked)))
                of_object.setdefault(tracked.id, []).append(spots[-1])
    links = [
        SpotLink(spot.number, following.number, "motion")
        for line in of_object.values()
        for spot, following in zip(line[:-1], line[1:], strict=True)
    ]
    for link in tracks.lineage.links:
        line = of_object.get(link.child, [])
        before = [spot for spot in of_object.get(link.parent, []) if line and spot.row.frame < line[0].row.frame]
        if before:
            links.append(SpotLink(before[-1].number, line[0].number, link.kind))
    return SpotGraph(tuple(spots), tuple(sorted(links)))


def _along(tracks: TrackSet, tracked: ObjectRow) -> tuple[float, float, float]:
    index = tracks.geometry.world_to_index(tracked.centroid)
    z, y, x = (float(at) * step for at, step in zip(index, tracks.geometry.spacing, strict=True))
    return x, y, z


def _radius(tracks: TrackSet, tracked: ObjectRow) -> float:
    axis = tracks.geometry.slice_axis
    if axis is None:
        return math.cbrt(3 * tracked.volume_mm3 / (4 * math.pi))
    return math.sqrt(tracked.volume_mm3 / tracks.geometry.spacing[axis] / math.pi)
