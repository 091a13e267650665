"""Records of a tracking: the objects of one frame, and the links between parents and children."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, Corner, bounding_box, box_at, corner_of, widened
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io.images import label_type

#: Voxels around what is inside that a surface has on its box.
BAND = 5


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
        """The same on the box of what is inside, of which there is something, with `BAND` voxels around."""
        inner = bounding_box(self.psi < 0)
        assert inner is not None  # something is inside
        part = widened(inner, self.psi.shape, (BAND, BAND, BAND))
        z, y, x = (a + b for a, b in zip(corner_of(part), self.corner, strict=True))
        return SurfacePiece((z, y, x), np.ascontiguousarray(self.psi[part]))

    @property
    def box(self) -> Box:
        """The box as slices of the frame's grid."""
        return box_at(self.corner, self.psi.shape)


class CarriedMesh(NamedTuple):
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
    mesh : CarriedMesh or None
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
    mesh: CarriedMesh | None = None


@dataclass(frozen=True, eq=False)
class FrameResult:
    """The objects of one frame; what `accelsurf.tracking.track` yields, one frame at a time.

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
        labels = np.zeros(self.geometry.shape, label_type(max((tracked.id for tracked in shown), default=0)))
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

    ``end`` says why it ends there: "end of sequence", "divided", "merged", "vanished" or "left".
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
