"""Momentum of an object between two frames: its surface, and the velocity that takes it to the next frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from accelsurf.grid.boxes import Corner
from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet, SurfaceState, Workers, checkpoint_surface, restore_surface
from accelsurf.track.boxed_surface import (
    BoxedSurface,
    Floats,
    Halving,
    boxed_piece,
    boxed_surface,
    halving_of,
    on_larger_box,
    sample_fields,
)
from accelsurf.track.observer import Displacement, between, displacement, measured_surface
from accelsurf.track.records import SurfacePiece

Triple = tuple[float, float, float]


class Gains(NamedTuple):
    """Gains of the observer, each from 0 to 1.

    ``psi``: part of the way from the prediction to the measured surface that the surface goes; 1: it is the measured
    one. ``velocity``: part of the missing velocity that is added; 1: the velocity is that of the last interval.
    """

    psi: float = 1.0
    velocity: float = 1.0


class MovedSurface(NamedTuple):
    """A surface, and its ``speed`` (n,) along N on the band, mm in the time between two frames."""

    boxed: BoxedSurface
    speed: NDArray[np.float32]


class SurfaceMomentum(ABC):
    """A surface that coasts from frame to frame, and is corrected on each.

    A subclass gives the fields that it carries on the surface, and how they move it.

    Parameters
    ----------
    friction : float
        a, per unit of the sequence's time.
    workers : Workers, optional
        One thread by default.

    Attributes
    ----------
    half_width : float
        Of the narrow band, voxels.
    moves : bool
        Whether it coasts at all.
    """

    half_width: ClassVar[float] = 4.0
    moves: ClassVar[bool] = True

    def __init__(self, friction: float = 0.0, workers: Workers | None = None) -> None:
        self.friction, self.workers = float(friction), workers or Workers(1)
        self.boxed: BoxedSurface
        self.fields: list[np.ndarray] = []
        #: Material points (m, 3), mm along the grid's axes from its first voxel.
        self._points: Floats = np.zeros((0, 3))

    # -- methods of a model --------------------------------------------------------------------------------

    @abstractmethod
    def _fields_at_start(self, velocity: Floats) -> list[np.ndarray]:
        """The fields (n,) on the band of a surface that moves with ``velocity`` (3,), z y x mm per unit of time."""

    @abstractmethod
    def _coast(self, duration: float) -> None:
        """Move surface, fields and points."""

    @abstractmethod
    def _corrected_fields(
        self, found: Displacement, duration: float, gain: float
    ) -> list[np.ndarray]:
        """The fields (n,) on the predicted band with the velocity that was missing."""

    @abstractmethod
    def _mean_velocity(self) -> Floats:
        """Mean velocity (3,), z y x mm per unit of time."""

    def _fields_on(
        self, new: BoxedSurface, values: Floats, known: NDArray[np.bool_]
    ) -> list[np.ndarray]:
        """Fields on a corrected surface from sampled ``values`` (n, k); ``known`` (n,): False on new surface."""
        return [np.ascontiguousarray(values[:, c], np.float32) for c in range(values.shape[1])]

    # -- the life of a surface -----------------------------------------------------------------------------

    def start(
        self,
        psi: NDArray[np.float32],
        corner: Corner,
        geometry: Geometry,
        velocity: Triple | None = None,
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
        self.boxed = boxed_surface(psi, corner, geometry, self.half_width, self.workers)
        moving = np.zeros(3) if velocity is None else self._to_grid(np.array([velocity]))[0]
        self.fields = self._fields_at_start(np.where(self.boxed.wide, moving, 0.0))
        self._points = np.zeros((0, 3))
        return self.piece

    def halve(self) -> None:
        """Go on with voxels twice as large, if the frames' grid has a coarser one."""
        self._put_on_grid(
            halving_of(self.boxed.geometry) if self.boxed.halving is None else self.boxed.halving
        )

    def _put_on_grid(self, halving: Halving | None) -> None:
        """Go on on the frames' grid, or on a coarser one."""
        old, piece = self.boxed, self.piece
        if halving is old.halving or not piece.has_inside:
            return
        frame = old.geometry if old.halving is None else old.halving.frame
        self.boxed = boxed_piece(piece, frame, self.half_width, self.workers, halving)
        shift = sum(
            (sign * at.offset for sign, at in ((1.0, halving), (-1.0, old.halving)) if at),
            np.zeros(3),
        )
        values, known = sample_fields(old, self.fields, self.boxed.closest_points() + shift)
        self.fields = self._fields_on(self.boxed, values, known)
        self._points = self._points - shift

    def predict(self, duration: float) -> SurfacePiece:
        """Coast for a time, in the sequence's unit; below 0 it goes back in time. The surface moves, no force acts.

        Velocities are always in rising time, also after a step back; friction takes from them in both directions.
        Returns the surface on the frame's grid: see `piece`.
        """
        if duration != 0.0 and self.boxed.surface.size:
            self._coast(duration)
        return self.piece

    def correct(self, piece: SurfacePiece, duration: float, gains: Gains) -> SurfacePiece:
        """Correct surface and velocity by the surface that the frame shows; to be called after `predict`.

        Surface that was not there before gets the mean velocity of the surface nearest to it; lost surface takes its
        mass along.

        Parameters
        ----------
        piece : SurfacePiece
            The measured surface, a signed distance near it, with something inside.
        duration : float
            As given to the last `predict`.
        gains : Gains
        """
        predicted, measured = self.boxed, measured_surface(piece, self.boxed)
        if not predicted.surface.size:
            self.fields = []
            self.boxed = measured
            self.fields = self._fields_at_start(np.zeros(3))
            return self.piece
        found = displacement(predicted, measured)
        fields = self._corrected_fields(found, duration, gains.velocity)
        new = between(predicted, measured, found, gains.psi)
        way = gains.psi * found.shift
        values, known = sample_fields(predicted, fields, new.closest_points() - way)
        self.boxed = new
        self.fields = self._fields_on(new, values, known)
        if len(self._points):
            self._points = _onto(new, self._points + way)
        return self.piece

    # -- present state -------------------------------------------------------------------------------------

    @property
    def piece(self) -> SurfacePiece:
        """The surface now, on the frame's grid; a box of no voxels (shape 0, 0, 0) where it has left."""
        return self.boxed.on_frame()

    def mean_velocity(self) -> Triple:
        """Mean velocity over the surface (x, y, z), world mm per unit of time; 0 without a surface."""
        if not self.boxed.surface.size:
            return 0.0, 0.0, 0.0
        index = self._mean_velocity() / self.boxed.spacing
        x, y, z = self.boxed.geometry.index_to_world(index) - self.boxed.geometry.index_to_world(
            np.zeros(3)
        )
        return float(x), float(y), float(z)

    def way(self, duration: float) -> Floats:
        """Way (3,) of the whole in a time as its momentum has it, mm along the grid's axes z, y, x."""
        return self._mean_velocity() * duration if self.boxed.surface.size else np.zeros(3)

    def moved_surface(self, duration: float) -> MovedSurface:
        """Copy the surface, with room to move, and the speed that its momentum has there, per ``duration``."""
        boxed = self.boxed.widened(self.half_width)
        velocity, _ = sample_fields(self.boxed, self.fields[:3], boxed.closest_points())
        speed = (velocity * boxed.surface.normals()).sum(axis=1) * (duration if self.moves else 0.0)
        return MovedSurface(boxed, np.asarray(speed, np.float32))

    def volume(self) -> float:
        """Volume inside, mm3, to parts of a voxel."""
        return self.boxed.surface.volume(self.boxed.surface.fraction_and_area()[0])

    def area(self) -> float:
        """Area of the surface, mm2."""
        return float(self.boxed.surface.fraction_and_area()[1].sum())

    def centroid(self) -> Triple:
        """Centroid of the volume (x, y, z), world mm; of an empty surface, of no meaning."""
        x, y, z = self._to_world(self.boxed.centroid()[None])[0]
        return float(x), float(y), float(z)

    def attach_points(self, points: NDArray[np.float64]) -> None:
        """Attach material points (n, 3), world mm, near the surface: `predict` and `correct` move them with it."""
        geometry = self.boxed.geometry
        self._points = geometry.world_to_index(np.reshape(points, (-1, 3))) * self.boxed.spacing

    @property
    def points(self) -> NDArray[np.float64]:
        """The attached points (n, 3) where they are now, world mm; none by default."""
        return self._to_world(self._points)

    def _to_world(self, points: Floats) -> Floats:
        """Points (n, 3), mm along the grid's axes, in the world."""
        return self.boxed.geometry.index_to_world(points / self.boxed.spacing)

    def _to_grid(self, vectors: Floats) -> Floats:
        """World vectors (n, 3), x y z, along the grid's axes, z y x."""
        geometry = self.boxed.geometry
        return np.asarray(
            geometry.world_to_index(vectors + np.asarray(geometry.origin)) * self.boxed.spacing
        )

    # -- several -------------------------------------------------------------------------------------------

    def split(self, pieces: Sequence[SurfacePiece]) -> list[SurfaceMomentum]:
        """One momentum for each piece that this surface divided into: velocities by the closest points, no points."""
        return [self._on_surface(measured_surface(piece, self.boxed), [self]) for piece in pieces]

    def merged(self, others: Sequence[SurfaceMomentum]) -> SurfaceMomentum:
        """The momentum of the union with others of the same model, each with its own velocities; without points."""
        sources = [momentum for momentum in (self, *others) if momentum.boxed.surface.size]
        if len({momentum.boxed.geometry.shape for momentum in sources}) > 1:
            for momentum in sources:
                momentum._put_on_grid(None)
        if not sources:
            return self._on_surface(self.boxed, [self])
        return self._on_surface(_union([momentum.boxed for momentum in sources]), sources)

    def _on_surface(self, new: BoxedSurface, sources: Sequence[SurfaceMomentum]) -> SurfaceMomentum:
        """A momentum like this on another surface, with the fields of the source that is nearest to each place."""
        points, nearest = new.closest_points(), np.full(new.surface.size, np.inf)
        values = np.zeros((new.surface.size, len(self.fields)))
        for source in sources:
            if not source.boxed.surface.size:
                continue
            front = source.boxed.surface.front()
            distance, _ = cKDTree(source.boxed.closest_points()[front]).query(points)
            found, _ = sample_fields(source.boxed, source.fields, points)
            nearer = distance < nearest
            values[nearer], nearest[nearer] = found[nearer], distance[nearer]
        momentum = type(self)(self.friction, self.workers)
        return momentum._put_on(
            new, momentum._fields_on(new, values, np.ones(len(values), np.bool_))
        )

    def _put_on(self, boxed: BoxedSurface, fields: list[np.ndarray]) -> SurfaceMomentum:
        """Put this momentum on a surface with its fields."""
        self.boxed, self.fields = boxed, fields
        return self

    # -- checkpoints ---------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """State as a value: arrays and numbers by name, for `restore`."""
        surface = checkpoint_surface(self.boxed.surface)
        return {
            "halved": self.boxed.halving is not None,
            "corner": self.boxed.corner,
            "shape": self.boxed.surface.shape,
            "points": self._points,
            "fields": np.array(self.fields, np.float32).reshape(len(self.fields), -1),
            **{f"surface_{name}": value for name, value in surface._asdict().items()},
        }

    def restore(self, state: dict[str, Any], geometry: Geometry) -> None:
        """Go back to a `state` of a momentum of the same settings on the same grid; the same bytes follow."""
        names = SurfaceState._fields
        saved = SurfaceState(**{name: state[f"surface_{name}"] for name in names})
        halving = halving_of(geometry) if state["halved"] else None
        geometry = geometry if halving is None else halving.geometry
        shape = tuple(int(n) for n in state["shape"])
        surface = LevelSet(
            np.ones(shape, np.float32), geometry.spacing, self.half_width, self.workers
        )
        restore_surface(surface, saved._replace(inside_beyond=int(saved.inside_beyond)))
        z, y, x = (int(c) for c in state["corner"])
        self.boxed = BoxedSurface(surface, (z, y, x), geometry, halving)
        self.fields = [np.array(field, np.float32) for field in state["fields"]]
        self._points = np.array(state["points"], np.float64).reshape(-1, 3)


def _onto(boxed: BoxedSurface, points: Floats) -> Floats:
    """Points (m, 3) near a surface put on it; one that is not near stays where it is."""
    band = [np.ascontiguousarray(boxed.surface.band.to_closest[:, c]) for c in range(3)]
    steps, known = sample_fields(boxed, band, points)
    return points + np.where(known[:, None], steps, 0.0)


def _union(surfaces: Sequence[BoxedSurface]) -> BoxedSurface:
    """The surface around all that is inside of one of several."""
    first = np.min([surface.corner for surface in surfaces], axis=0)
    last = np.max(
        [np.array(surface.corner) + surface.surface.shape for surface in surfaces], axis=0
    )
    psi = np.full(tuple(int(n) for n in last - first), np.inf, np.float32)
    for surface in surfaces:
        psi = np.minimum(
            psi, on_larger_box(surface.surface.psi, np.array(surface.corner), first, last)
        )
    like = surfaces[0]
    corner = int(first[0]), int(first[1]), int(first[2])
    width, workers = like.surface.requested_half_width, like.surface.workers
    return boxed_surface(psi, corner, like.geometry, width, workers, like.halving)
