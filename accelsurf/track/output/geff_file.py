"""Tracks as GEFF, the Graph Exchange File Format: a folder of Zarr with nodes, edges and their properties.

Written to version 1 of its specification (live-image-tracking-tools/geff, MIT). Zarr of version 2, as its own library
writes by default, and uncompressed: the arrays are small, and any reader opens them.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from accelsurf.io import zarr_library
from accelsurf.track.output.document import ML
from accelsurf.track.output.frames import FrameRow, ObjectRow, TrackSet

VERSION = "1.1"
#: Unit and meaning of a node's properties.
_NODES = {
    "t": ("frame", "frame number, from 0"),
    "time": (None, "time of the frame"),
    "z": ("millimeter", "centroid, world LPS"),
    "y": ("millimeter", "centroid, world LPS"),
    "x": ("millimeter", "centroid, world LPS"),
    "vz": (None, "mean velocity, millimeter per unit of time"),
    "vy": (None, "mean velocity, millimeter per unit of time"),
    "vx": (None, "mean velocity, millimeter per unit of time"),
    "id": (None, "identity of the object, its value in the label maps"),
    "lineage": (None, "objects that come from each other have the same"),
    "radius": ("millimeter", "of a ball of the same volume, or of a disc of the same area"),
    "volume_ml": (None, "volume, ml"),
    "area_mm2": (None, "area of the surface, mm2"),
    "quality": (None, "chance that the surface is good"),
}
_EDGES = {
    "division": (None, "whether the parent divides here"),
    "merging": (None, "whether several parents merge here"),
}


def check_geff() -> None:
    """Refuse to begin without the package that writes it.

    Raises
    ------
    InputError
        With how to get it.
    """
    zarr_library()


def write_geff(tracks: TrackSet, folder: Path) -> None:
    """Write the folder; the same tracks give the same bytes.

    Raises
    ------
    OSError
        When it cannot be written.
    """
    spots = spots_of(tracks)
    links = links_of(tracks, spots)
    ends = np.array([[link.source, link.target] for link in links], np.uint64).reshape(-1, 2)
    nodes = _node_values(tracks, spots, ends)
    edges = {kind: np.array([link.kind == kind for link in links], np.bool_) for kind in _EDGES}
    root = zarr_library().create_group(
        folder, zarr_format=2, attributes={"geff": _metadata(tracks, nodes, edges)}
    )
    _put(root, "nodes/ids", np.arange(len(spots), dtype=np.uint64))
    _put(root, "edges/ids", ends)
    for group, values in (("nodes", nodes), ("edges", edges)):
        for name, array in values.items():
            _put(root, f"{group}/props/{name}/values", array)


def _put(root: Any, path: str, array: NDArray[Any]) -> None:
    chunks = tuple(max(n, 1) for n in array.shape)
    made = root.create_array(
        path, shape=array.shape, dtype=array.dtype, chunks=chunks, compressors=None
    )
    if array.size:
        made[...] = array


class Spot(NamedTuple):
    """An object in a frame that shows it."""

    row: FrameRow
    tracked: ObjectRow


class SpotLink(NamedTuple):
    """From a spot, by its number, to one in a later frame; ``kind`` is motion, division or merging."""

    source: int
    target: int
    kind: str


def spots_of(tracks: TrackSet) -> list[Spot]:
    """Return the spots of a tracking, by frame and id."""
    return [Spot(row, tracked) for row in tracks.rows for tracked in row.objects if tracked.seen]


def links_of(tracks: TrackSet, spots: list[Spot]) -> list[SpotLink]:
    """Return the links between spots.

    An object that is not seen for some frames has a link over the gap. A child is linked to where its parent was last
    seen before.
    """
    of_object: dict[int, list[int]] = {}
    for number, spot in enumerate(spots):
        of_object.setdefault(spot.tracked.id, []).append(number)
    links: list[SpotLink] = []
    for line in of_object.values():
        links += [SpotLink(source, target, "motion") for source, target in pairwise(line)]
    for link in tracks.lineage.links:
        if link.child not in of_object:
            continue
        line = of_object[link.child]
        born = spots[line[0]].row.frame
        before = [n for n in of_object.get(link.parent, []) if spots[n].row.frame < born]
        if before:
            links.append(SpotLink(before[-1], line[0], link.kind))
    return sorted(links)


def _node_values(
    tracks: TrackSet, spots: list[Spot], ends: NDArray[np.uint64]
) -> dict[str, NDArray[Any]]:
    matrix = sparse.coo_matrix(
        (np.ones(len(ends)), ends.T.astype(np.int64)), (len(spots), len(spots))
    )
    objects = [spot.tracked for spot in spots]
    place = np.array([tracked.centroid for tracked in objects], np.float64).reshape(-1, 3)
    velocity = np.array([tracked.velocity for tracked in objects], np.float64).reshape(-1, 3)
    return {
        "t": np.array([spot.row.frame for spot in spots], np.int64),
        "time": np.array([spot.row.time for spot in spots], np.float64),
        **{axis: place[:, column] for axis, column in (("z", 2), ("y", 1), ("x", 0))},
        **{f"v{axis}": velocity[:, column] for axis, column in (("z", 2), ("y", 1), ("x", 0))},
        "id": np.array([tracked.id for tracked in objects], np.int64),
        "lineage": csgraph.connected_components(matrix, False)[1].astype(np.int64),
        "radius": np.array([_radius(tracks, tracked) for tracked in objects], np.float64),
        "volume_ml": np.array([tracked.volume_mm3 * ML for tracked in objects], np.float64),
        "area_mm2": np.array([tracked.area_mm2 for tracked in objects], np.float64),
        "quality": np.array([tracked.quality for tracked in objects], np.float64),
    }


def _radius(tracks: TrackSet, tracked: ObjectRow) -> float:
    axis = tracks.geometry.slice_axis
    if axis is None:
        return math.cbrt(3 * tracked.volume_mm3 / (4 * math.pi))
    return math.sqrt(tracked.volume_mm3 / tracks.geometry.spacing[axis] / math.pi)


def _metadata(
    tracks: TrackSet, nodes: dict[str, NDArray[Any]], edges: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    axes = [_axis("t", "time", "frame", nodes["t"]) | _interval(tracks)]
    axes += [_axis(axis, "space", "millimeter", nodes[axis]) for axis in "zyx"]
    return {
        "geff_version": VERSION,
        "directed": True,
        "axes": axes,
        "node_props_metadata": {
            name: _described(name, array, *_NODES[name]) for name, array in nodes.items()
        },
        "edge_props_metadata": {
            name: _described(name, array, *_EDGES[name]) for name, array in edges.items()
        },
        "sphere": "radius",
        "track_node_props": {"lineage": "lineage"},
        "display_hints": {
            "display_horizontal": "x",
            "display_vertical": "y",
            "display_depth": "z",
            "display_time": "t",
        },
        "extra": {"accelsurf": {"time_unit": tracks.sequence.time_unit, "space": "LPS"}},
    }


def _axis(name: str, kind: str, unit: str, values: NDArray[Any]) -> dict[str, Any]:
    ends = {"min": float(values.min()), "max": float(values.max())} if len(values) else {}
    return {"name": name, "type": kind, "unit": unit, **ends}


def _interval(tracks: TrackSet) -> dict[str, Any]:
    """Seconds per frame, where the frames are evenly spaced."""
    times = np.asarray(tracks.sequence.times)
    steps = np.diff(times)
    if tracks.sequence.time_unit != "s" or not len(steps) or np.ptp(steps) > 1e-6 * steps[0]:
        return {}
    found = {"scale": float(steps.mean()), "scaled_unit": "second"}
    return found | ({"offset": float(times[0])} if times[0] else {})


def _described(name: str, array: NDArray[Any], unit: str | None, words: str) -> dict[str, Any]:
    found = {
        "identifier": name,
        "dtype": array.dtype.name,
        "varlength": False,
        "description": words,
    }
    return found | ({"unit": unit} if unit else {})
