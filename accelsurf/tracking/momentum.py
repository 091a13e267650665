"""What an object has between two frames: its surface, and the velocity that takes it to the next frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Corner
from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import Workers
from accelsurf.tracking.records import SurfacePiece

Triple = tuple[float, float, float]


class Gains(NamedTuple):
    """Gains of the observer, each from 0 to 1.

    ``psi``: part of the way from the prediction to the measured surface that the surface goes; 1: it is the measured
    one. ``velocity``: part of the missing velocity that is added; 1: the velocity is that of the last interval.
    """

    psi: float = 1.0
    velocity: float = 1.0


class SurfaceMomentum(ABC):
    """A surface that coasts from frame to frame, and is corrected on each.

    Parameters
    ----------
    friction : float
        a, per unit of the sequence's time.
    workers : Workers, optional
        One thread by default.
    """

    def __init__(self, friction: float = 0.0, workers: Workers | None = None) -> None:
        self.friction, self.workers = float(friction), workers or Workers(1)

    @abstractmethod
    def start(
        self, psi: NDArray[np.float32], corner: Corner, geometry: Geometry, velocity: Triple | None = None
    ) -> SurfacePiece:
        """Begin on a surface.

        Parameters
        ----------
        psi : ndarray (nz, ny, nx)
            Signed distance, mm, on a box of the frame's grid that has the whole band of the surface; not modified.
        corner : (z, y, x)
            First voxel of the box.
        geometry : Geometry
            Grid of the frames.
        velocity : (x, y, z), optional
            Mean velocity, world mm per unit of time; at rest by default.
        """

    @abstractmethod
    def predict(self, duration: float) -> SurfacePiece:
        """Coast for a time, in the sequence's unit; below 0 it goes back in time. The surface moves, no force acts.

        Velocities are always those of rising time, also after a step back. Returns the surface on the frame's grid; a
        box of no voxels where it has left.
        """

    @abstractmethod
    def correct(self, piece: SurfacePiece, duration: float, gains: Gains) -> SurfacePiece:
        """Correct surface and velocity by the surface that the frame shows; to be called after `predict`.

        Parameters
        ----------
        piece : SurfacePiece
            The measured surface, a signed distance near it.
        duration : float
            As given to the last `predict`.
        gains : Gains
        """

    @property
    @abstractmethod
    def piece(self) -> SurfacePiece:
        """The surface now, on the frame's grid; a box of no voxels where it has left."""

    @abstractmethod
    def mean_velocity(self) -> Triple:
        """Mean velocity over the surface (x, y, z), world mm per unit of time."""

    @abstractmethod
    def volume(self) -> float:
        """Volume inside, mm3, to parts of a voxel."""

    @abstractmethod
    def area(self) -> float:
        """Area of the surface, mm2."""

    @abstractmethod
    def centroid(self) -> Triple:
        """Centroid of the volume (x, y, z), world mm."""

    @abstractmethod
    def attach_points(self, points: NDArray[np.float64]) -> None:
        """Attach material points (n, 3), world mm, near the surface: `predict` and `correct` move them with it."""

    @property
    @abstractmethod
    def points(self) -> NDArray[np.float64]:
        """The attached points (n, 3) where they are now, world mm; none by default."""

    @abstractmethod
    def split(self, pieces: Sequence[SurfacePiece]) -> list[SurfaceMomentum]:
        """One momentum for each piece that this surface divided into: velocities by the closest points, no points."""

    @abstractmethod
    def merged(self, others: Sequence[SurfaceMomentum]) -> SurfaceMomentum:
        """The momentum of the union with others, each with its own velocities; without attached points."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """State as a value: arrays and numbers by name, for `restore`."""

    @abstractmethod
    def restore(self, state: dict[str, Any], geometry: Geometry) -> None:
        """Go back to a `state` of a momentum of the same settings on the same grid; the same bytes follow."""
