"""Agreement of tracks with a reference: the measures of the Cell Tracking Challenge, and identities.

Maska et al., Bioinformatics 30(11), 2014: SEG. Matula et al., PLoS ONE 10(12), 2015: DET and TRA. Both match an object
R of the reference to the object C of the result with |R and C| > |R| / 2; there is one at most.

TRA compares graphs: a vertex for each object in each frame, an edge from each to the next of its track, and from the
last of a parent to the first of a child. It counts the changes by which a person would turn the result's graph into the
reference's, each with a weight, relative to making the whole graph anew:

    TRA = 1 - min(AOGM, AOGM_0) / AOGM_0,   AOGM = 5 NS + 10 FN + FP + ED + 1.5 EA + EC
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

#: Weights of the challenge: split an object, add one, delete one, delete an edge, add one, change its meaning.
SPLIT = 5.0
ADD = 10.0
DELETE = 1.0
DELETE_EDGE = 1.0
ADD_EDGE = 1.5
CHANGE_EDGE = 1.0

#: An object in a frame: frame and id.
Vertex = tuple[int, int]


@dataclass(frozen=True)
class TrackedLabels:
    """Label maps of a sequence with their tracks.

    Attributes
    ----------
    frames : int
    labels : callable
        Label map (nz, ny, nx) of a frame. Nothing is held of it afterwards.
    tracks : sequence of Stretch
        With the ids of the label maps. The label map of a frame may lack one: then its edges lead over that frame.
    """

    frames: int
    labels: Callable[[int], NDArray[Any]]
    tracks: Sequence[Stretch]


class FrameScore(NamedTuple):
    """Counts of one frame: objects of the reference, of the result, those that match; and their mean Dice by identity.

    ``dice`` is over the objects of the reference; None where there is none.
    """

    frame: int
    reference: int
    result: int
    matched: int
    dice: float | None


class Operations(NamedTuple):
    """Operations that would turn the result's graph into the reference's.

    Objects to split, to add and to delete; edges to delete, to add and to change from "same object" to "child".
    """

    splits: int
    missing: int
    false: int
    false_edges: int
    missing_edges: int
    changed_edges: int

    @property
    def of_objects(self) -> float:
        """Their weights, without edges."""
        return SPLIT * self.splits + ADD * self.missing + DELETE * self.false

    @property
    def weight(self) -> float:
        """AOGM: the weights of all."""
        edges = (
            DELETE_EDGE * self.false_edges
            + ADD_EDGE * self.missing_edges
            + CHANGE_EDGE * self.changed_edges
        )
        return self.of_objects + edges


@dataclass(frozen=True)
class TrackingScores:
    """Measures of how well tracks agree.

    Attributes
    ----------
    seg : float or None
        Mean overlap (Jaccard index) of the reference's objects with their matches, 0 for one that matches nothing.
    det, tra : float or None
        Of objects, and of objects and edges; None where the reference has no object.
    operations : Operations
    dice : float or None
        Mean Dice of the reference's objects with the object of the result that has their identity: identities are
        assigned so that most voxels agree, over all frames.
    switches : int
        How often the identity that an object of the reference matches is another than when it last matched one.
    identities : dict of int to int
        Id in the result by id in the reference.
    frames : tuple of FrameScore
    """

    seg: float | None
    det: float | None
    tra: float | None
    operations: Operations
    dice: float | None
    switches: int
    identities: dict[int, int]
    frames: tuple[FrameScore, ...]

    def values(self) -> dict[str, float | int | None]:
        """The numbers by name."""
        return {
            "SEG": self.seg,
            "DET": self.det,
            "TRA": self.tra,
            "dice_by_identity": self.dice,
            "identity_switches": self.switches,
            "AOGM": self.operations.weight,
            **self.operations._asdict(),
        }


class _Frame(NamedTuple):
    """Voxels of objects in a frame, and those that two have together."""

    reference: dict[int, int]
    result: dict[int, int]
    common: dict[tuple[int, int], int]

    @property
    def matches(self) -> dict[int, int]:
        """The object that each object of the reference matches, where it matches one."""
        return {
            ref: res for (ref, res), count in self.common.items() if 2 * count > self.reference[ref]
        }


class ExactLabels(NamedTuple):
    """Labels of a ``frame``, or of its slice ``plane`` along z (1, ny, nx), that SEG is measured on."""

    frame: int
    labels: NDArray[Any]
    plane: int | None = None


def score(
    result: TrackedLabels,
    reference: TrackedLabels,
    exact: Iterable[ExactLabels] | None = None,
) -> TrackingScores:
    """Compare tracks with a reference, frame by frame.

    Parameters
    ----------
    result, reference : TrackedLabels
        Of as many frames, on one grid.
    exact : iterable of ExactLabels, optional
        Label maps that SEG is measured on, where the reference has outlines of its own for it (the ``SEG``
        folder of the challenge); by default the reference's label maps.
    """
    frames = [
        _counted(result.labels(number), reference.labels(number))
        for number in range(reference.frames)
    ]
    matches = [frame.matches for frame in frames]
    operations = _operations(frames, matches, result, reference)
    vertices = sum(len(frame.reference) for frame in frames)
    edges = len(_edges(reference, frames, "reference"))
    outlines = frames if exact is None else []
    for given in exact or ():
        planes = slice(None) if given.plane is None else slice(given.plane, given.plane + 1)
        outlines.append(_counted(result.labels(given.frame)[planes], given.labels))
    identities = _identities(frames)
    dice = [_dice_by_identity(frame, identities) for frame in frames]
    together = [value for values in dice for value in values]
    by_frame = []
    for number, (frame, matched, values) in enumerate(zip(frames, matches, dice, strict=True)):
        counts = len(frame.reference), len(frame.result), len(matched)
        by_frame.append(FrameScore(number, *counts, float(np.mean(values)) if values else None))
    return TrackingScores(
        _seg(outlines),
        _share(operations.of_objects, ADD * vertices),
        _share(operations.weight, ADD * vertices + ADD_EDGE * edges),
        operations,
        float(np.mean(together)) if together else None,
        _switches(matches),
        identities,
        tuple(by_frame),
    )


def _counted(result: NDArray[Any], reference: NDArray[Any]) -> _Frame:
    """Count voxels of a frame."""
    ref, res = reference.ravel(), result.ravel()
    either = (ref != 0) | (res != 0)
    pairs, counts = np.unique(
        np.stack([ref[either], res[either]]).astype(np.int64), axis=1, return_counts=True
    )
    of_reference: Counter[int] = Counter()
    of_result: Counter[int] = Counter()
    common = {}
    for (a, b), count in zip(pairs.T.tolist(), counts.tolist(), strict=True):
        if a:
            of_reference[a] += count
        if b:
            of_result[b] += count
        if a and b:
            common[a, b] = count
    return _Frame(dict(of_reference), dict(of_result), common)


def _operations(
    frames: Sequence[_Frame],
    matches: Sequence[dict[int, int]],
    result: TrackedLabels,
    reference: TrackedLabels,
) -> Operations:
    """Count the operations that turn the result's graph into the reference's."""
    splits = missing = false = 0
    match: dict[
        Vertex, Vertex
    ] = {}  # of the reference's vertices, where no other one matches the same
    for number, frame in enumerate(frames):
        found = Counter(matches[number].values())
        splits += sum(count - 1 for count in found.values())
        missing += len(frame.reference) - len(matches[number])
        false += len(frame.result) - len(found)
        match |= {
            (number, ref): (number, res) for ref, res in matches[number].items() if found[res] == 1
        }
    wanted, given = _edges(reference, frames, "reference"), _edges(result, frames, "result")
    unique = set(match.values())
    inner = {ends: meaning for ends, meaning in given.items() if unique.issuperset(ends)}
    placed = {
        (match[a], match[b]): meaning
        for (a, b), meaning in wanted.items()
        if a in match and b in match
    }
    same = inner.keys() & placed.keys()
    changed = sum(inner[ends] != placed[ends] for ends in same)
    return Operations(
        splits, missing, false, len(inner) - len(same), len(wanted) - len(same), changed
    )


def _edges(
    labels: TrackedLabels, frames: Sequence[_Frame], side: str
) -> dict[tuple[Vertex, Vertex], bool]:
    """Edges of a graph, with whether each leads from a parent to a child."""
    shown = [getattr(frame, side) for frame in frames]
    vertices: dict[int, list[Vertex]] = {}
    for track in labels.tracks:
        frames_of = range(track.first, min(track.last + 1, labels.frames))
        vertices[track.label] = [(n, track.id) for n in frames_of if track.id in shown[n]]
    edges: dict[tuple[Vertex, Vertex], bool] = {}
    for track in labels.tracks:
        line = vertices[track.label]
        edges |= dict.fromkeys(zip(line[:-1], line[1:], strict=True), False)
        for parent in track.parents:
            if line and vertices.get(parent):
                edges[vertices[parent][-1], line[0]] = True
    return edges


def _seg(frames: Sequence[_Frame]) -> float | None:
    """Mean Jaccard index of the reference's objects."""
    values = []
    for frame in frames:
        matches = frame.matches
        for ref, size in frame.reference.items():
            common = frame.common[ref, matches[ref]] if ref in matches else 0
            values.append(common / (size + frame.result[matches[ref]] - common) if common else 0.0)
    return float(np.mean(values)) if values else None


def _share(weight: float, anew: float) -> float | None:
    """1 for nothing to do, 0 for as much as to make all anew."""
    return 1 - min(weight, anew) / anew if anew else None


def _identities(frames: Sequence[_Frame]) -> dict[int, int]:
    """Assign ids of the result to ids of the reference, one to one, so that most voxels agree."""
    common: Counter[tuple[int, int]] = Counter()
    for frame in frames:
        common.update(frame.common)
    refs, results = sorted({a for a, _ in common}), sorted({b for _, b in common})
    table = np.array([[common[a, b] for b in results] for a in refs], np.float64).reshape(
        len(refs), len(results)
    )
    rows, columns = linear_sum_assignment(table, maximize=True)
    return {
        refs[i]: results[j]
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True)
        if table[i, j] > 0
    }


def _dice_by_identity(frame: _Frame, identities: dict[int, int]) -> list[float]:
    """Dice of each object of the reference in a frame with the one that has its identity."""
    values = []
    for ref, size in sorted(frame.reference.items()):
        identity = identities.get(ref, 0)
        values.append(
            2 * frame.common.get((ref, identity), 0) / (size + frame.result.get(identity, 0))
        )
    return values


def _switches(matches: Sequence[dict[int, int]]) -> int:
    """Count how often an object of the reference matches another identity than before."""
    last: dict[int, int] = {}
    count = 0
    for found in matches:
        count += sum(last.get(ref, res) != res for ref, res in found.items())
        last |= found
    return count


class Stretch(NamedTuple):
    """Frames in which an object is seen without a break: a track of the Cell Tracking Challenge.

    ``label`` is its own number, ``id`` the object's; ``parents`` are labels of the stretches that it continues: the one
    before a gap, those that divided or merged into it.
    """

    label: int
    id: int
    first: int
    last: int
    parents: tuple[int, ...] = ()


def stretches(
    frames: Mapping[int, Sequence[int]], parents: Mapping[int, Iterable[int]]
) -> list[Stretch]:
    """Return the stretches of objects, by label.

    The first of an object has the object's id as its label, further ones have labels above all ids.

    Parameters
    ----------
    frames : mapping of int to sequence of int
        Of each object the frames in which it is seen, rising.
    parents : mapping of int to iterable of int
        Of each object those that it came from; one that is never seen before it counts for nothing.

    Examples
    --------
    >>> for one in stretches({1: [0, 1, 4], 2: [5]}, {2: [1]}):
    ...     print(one)
    Stretch(label=1, id=1, first=0, last=1, parents=())
    Stretch(label=2, id=2, first=5, last=5, parents=(3,))
    Stretch(label=3, id=1, first=4, last=4, parents=(1,))
    """
    seen = {object_id: numbers for object_id, numbers in frames.items() if len(numbers)}
    found: list[Stretch] = []
    runs_of: dict[int, list[Stretch]] = {}
    fresh = max(seen, default=0)
    for object_id in sorted(seen, key=lambda n: (seen[n][0], n)):
        born, named = seen[object_id][0], sorted(parents.get(object_id, ()))
        before = [_before(runs_of.get(parent, ()), born) for parent in named]
        came_from = tuple(stretch.label for stretch in before if stretch is not None)
        for number, (first, last) in enumerate(runs(seen[object_id])):
            label = object_id
            if number:
                fresh += 1
                label = fresh
            found.append(Stretch(label, object_id, first, last, came_from))
            runs_of.setdefault(object_id, []).append(found[-1])
            came_from = (label,)
    return sorted(found)


def _before(of_parent: Iterable[Stretch], frame: int) -> Stretch | None:
    """The last stretch that ends before a frame."""
    return max(
        (stretch for stretch in of_parent if stretch.last < frame),
        key=attrgetter("last"),
        default=None,
    )


def runs(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each run of consecutive numbers.

    Examples
    --------
    >>> runs([0, 1, 2, 5, 7, 8])
    [(0, 2), (5, 5), (7, 8)]
    """
    places = np.asarray(numbers)
    parts = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in parts]
