"""Meshes whose vertices are the same material points from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.analysis import surface_mesh
from accelsurf.grid.geometry import Geometry
from accelsurf.segmentation.region_of_interest import cropped
from accelsurf.tracking.momentum import SurfaceMomentum
from accelsurf.tracking.records import CarriedMesh, SurfacePiece

#: A new mesh is made where the volume of a carried one differs from that of its surface by more than this part, or
#: where more than this part of its triangles has turned over.
MAX_DIFFERENCE = 0.05


class MeshCarrier:
    """The mesh of one object, carried along with the points that are attached to its momentum.

    A new mesh begins, and with it a new generation, where the topology changes, triangles turn over, or the carried
    mesh does not describe the surface any more.
    """

    def __init__(self) -> None:
        self._faces = np.zeros((0, 3), np.int64)
        self._topology, self._generation = (0, 0), 0

    def in_frame(self, momentum: SurfaceMomentum, geometry: Geometry) -> CarriedMesh | None:
        """The mesh now, in an image of more than one slice; None where nothing of the object lies in the grid."""
        piece = momentum.piece
        if geometry.slice_axis is not None or not piece.has_inside or (piece.psi < 0).all():
            return None
        topology = _topology_of(piece)
        points = momentum.points
        if topology != self._topology or not len(points) or not self._describes(points, momentum.volume()):
            made = surface_mesh.extract(piece.psi, cropped(geometry, piece.box))
            momentum.attach_points(made.vertices)
            self._faces, self._topology = made.faces.astype(np.int64), topology
            self._generation += 1
            points = momentum.points
        return CarriedMesh(points, self._faces, self._generation)

    def _describes(self, points: NDArray[np.float64], volume: float) -> bool:
        """Whether the carried points are still a mesh of the surface."""
        mesh = surface_mesh.Surface(points, self._faces.astype(np.int32))
        return abs(mesh.volume - volume) <= MAX_DIFFERENCE * abs(volume)

    def state(self) -> dict[str, Any]:
        """State as a value, for `restored`; the points are of the momentum's."""
        return {"faces": self._faces, "topology": self._topology, "generation": self._generation}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> MeshCarrier:
        """A mesh as it was."""
        made = cls()
        made._faces, made._generation = np.array(state["faces"], np.int64), int(state["generation"])
        made._topology = tuple(state["topology"])
        return made


def _topology_of(piece: SurfacePiece) -> tuple[int, int]:
    """Parts inside, and parts of what is outside: they change where an object divides, merges or encloses something."""
    inside = np.pad(piece.psi < 0, 1, mode="edge")
    outside = np.pad(piece.psi >= 0, 1, constant_values=True)
    return int(ndimage.label(inside)[1]), int(ndimage.label(outside)[1])
