"""Records of a tracking: the objects of one frame, and their identities.

An identity has its first and last frame, the frames that do not show it, its parents and children, and its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, as_corner, bounding_box, box_at, corner_of, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import label_type

#: Voxels around the inside that a surface has on its box.
BAND = 5
END = "end of sequence"


class SurfacePiece(NamedTuple):
    """A surface on its box of the frame's grid.

    ``corner`` (z, y, x), the first voxel of the box; ``psi`` (nz, ny, nx), float32, mm, negative inside, a signed
    distance near the surface.
    """

    corner: Corner
    psi: NDArray[np.float32]

    @property
    def has_inside(self) -> bool:
        """True if a voxel is inside."""
        return bool((self.psi < 0).any())

    def tight(self) -> SurfacePiece:
        """The same on the box of the inside, which is not empty, with `BAND` voxels around."""
        inner = bounding_box(self.psi < 0)
        assert inner is not None  # something is inside
        part = widened(inner, self.psi.shape, (BAND, BAND, BAND))
        corner = as_corner(np.add(corner_of(part), self.corner))
        return SurfacePiece(corner, np.ascontiguousarray(self.psi[part]))

    @property
    def box(self) -> Box:
        """The box as slices of the frame's grid."""
        return box_at(self.corner, self.psi.shape)


class TrackedMesh(NamedTuple):
    """A mesh whose vertices are the same material points in every frame in which the object is seen without a break.

    ``vertices`` (n, 3), world mm (LPS); ``faces`` (m, 3), outward; ``generation`` counts the meshes of the object:
    correspondence holds within one generation, and a new one begins where the topology changes or triangles degenerate.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    generation: int


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """One object in one frame.

    Attributes
    ----------
    id : int
        Its identity, the same in all frames, and its value in the label maps.
    surface : SurfacePiece
        After the correction on this frame.
    predicted : SurfacePiece or None
        Where the momentum took the surface from the frame before; None where the object begins.
    velocity : (x, y, z)
        Mean velocity over the surface after the correction, mm per unit of the sequence's time.
    volume_mm3, area_mm2 : float
        Sub-voxel volume, and area of the surface.
    centroid : (x, y, z)
        Of the volume, world mm (LPS).
    seen : bool
        Whether the frame showed it; otherwise the prediction stands uncorrected.
    quality : float
        Chance that the surface is good in this frame, as `accelsurf.measure.quality`; 0 where it is not seen.
    mesh : TrackedMesh or None
        With correspondence, where that was asked for.
    """

    id: int
    surface: SurfacePiece
    predicted: SurfacePiece | None
    velocity: tuple[float, float, float]
    volume_mm3: float
    area_mm2: float
    centroid: tuple[float, float, float]
    seen: bool
    quality: float
    mesh: TrackedMesh | None = None


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The objects of one frame, as `accelsurf.track.track` yields them, one frame at a time.

    Attributes
    ----------
    frame : int
        Number of the frame in the sequence, from 0.
    time : float
        Its time in the sequence's unit.
    image : Volume
        The frame, as read.
    objects : tuple of TrackedObject
        In order of their ids.
    seconds : float
        Wall time of the frame.
    """

    frame: int
    time: float
    image: Volume
    objects: tuple[TrackedObject, ...]
    seconds: float = 0.0

    @property
    def geometry(self) -> Geometry:
        """Grid of the frame."""
        return self.image.geometry

    def labels(self, *, seen_only: bool = True) -> NDArray[np.unsignedinteger]:
        """Label map (nz, ny, nx) of the frame: the ids; where surfaces overlap, the deeper one has the voxel.

        Parameters
        ----------
        seen_only : bool
            Leave out the objects that the frame does not show.
        """
        shown = [tracked for tracked in self.objects if tracked.seen or not seen_only]
        labels = np.zeros(
            self.geometry.shape, label_type(max((tracked.id for tracked in shown), default=0))
        )
        deepest = np.zeros(self.geometry.shape, np.float32)
        for tracked in shown:
            box = tracked.surface.box
            deeper = tracked.surface.psi < deepest[box]
            labels[box][deeper] = tracked.id
            deepest[box][deeper] = tracked.surface.psi[deeper]
        return labels


class Link(NamedTuple):
    """Link of two identities: ``parent`` was last in a frame before ``frame``, where ``child`` is first.

    A division is several links of one parent in a frame, a merging several links of one child.
    """

    parent: int
    child: int
    frame: int
    kind: Literal["division", "merging"]


@dataclass(frozen=True)
class Track:
    """The life of one identity: ``first`` and ``last`` frame in which it is seen, ``gaps`` frames between in which not.

    ``end`` says why it ends there: "end of sequence", "divided", "merged", "vanished", "left", or "lost":
    its place was less certain than it is thick.
    """

    id: int
    first: int
    last: int
    gaps: tuple[int, ...]
    end: str


@dataclass(frozen=True)
class Lineage:
    """All tracks and links of a sequence, known when its last frame is done."""

    tracks: tuple[Track, ...]
    links: tuple[Link, ...]

    def parents(self, child: int) -> tuple[int, ...]:
        """Identities that ``child`` came from: none, one after a division, several after a merging."""
        return tuple(link.parent for link in self.links if link.child == child)

    def children(self, parent: int) -> tuple[int, ...]:
        """Identities that came from ``parent``."""
        return tuple(link.child for link in self.links if link.parent == parent)


@dataclass
class _Life:
    """Frames in which an identity is seen, and why it ends after the last."""

    seen: set[int] = field(default_factory=set)
    end: str = END


class Identities:
    """The identities of a tracking while it goes on, in rising and in falling order of the frames.

    A division in one order of the frames is a merging in the other: tracks and links are always told in rising
    order of time.
    """

    def __init__(self) -> None:
        self._lives: dict[int, _Life] = {}
        self._links: list[Link] = []

    def new_id(self) -> int:
        """The lowest number above all so far."""
        return max(self._lives, default=0) + 1

    def see(self, id: int, frame: int) -> None:
        """Note that a frame shows an object; its identity begins there if there is none."""
        self._lives.setdefault(id, _Life()).seen.add(frame)

    def forget(self, id: int, frame: int) -> None:
        """Note that a frame shows others in place of an object."""
        self._lives[id].seen.discard(frame)

    def end(self, id: int, why: str) -> None:
        """Note why an object is not seen after its last frame."""
        self._lives[id].end = why

    def divide(self, whole: int, parts: Sequence[int], frame: int, before: int) -> None:
        """Note that an object became several.

        Parameters
        ----------
        whole : int
        parts : sequence of int
            Seen in ``frame``.
        frame, before : int
            The frame, and the one that was done before it: in falling order that is the later one.
        """
        if before < frame:
            self._link_division(whole, parts, frame)
        else:
            self._link_merging(parts, whole, before)

    def merge(self, parts: Sequence[int], union: int, frame: int, before: int) -> None:
        """Note that several objects became one, seen in ``frame``; ``before`` as for `divide`."""
        if before < frame:
            self._link_merging(parts, union, frame)
        else:
            self._link_division(union, parts, before)

    def _link_division(self, whole: int, parts: Sequence[int], frame: int) -> None:
        self._links += [Link(whole, id, frame, "division") for id in parts]
        self.end(whole, "divided")

    def _link_merging(self, parts: Sequence[int], union: int, frame: int) -> None:
        self._links += [Link(id, union, frame, "merging") for id in parts]
        for id in parts:
            self.end(id, "merged")

    def lineage(self) -> Lineage:
        """All tracks and links so far."""
        tracks = []
        for id, life in sorted(self._lives.items()):
            if life.seen:
                first, last = min(life.seen), max(life.seen)
                gaps = tuple(n for n in range(first, last) if n not in life.seen)
                tracks.append(Track(id, first, last, gaps, life.end))
        return Lineage(
            tuple(tracks), tuple(sorted(self._links, key=attrgetter("frame", "parent", "child")))
        )

    def state(self) -> dict[str, Any]:
        """State as a value, for `restore`."""
        lives = [[id, life.end, sorted(life.seen)] for id, life in sorted(self._lives.items())]
        return {"lives": lives, "links": [list(link) for link in self._links]}

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a `state`."""
        self._lives = {id: _Life(set(seen), end) for id, end, seen in state["lives"]}
        self._links = [Link(*link) for link in state["links"]]
