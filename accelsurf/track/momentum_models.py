"""Models of momentum between frames: flowable mass, and two baselines; and how a surface coasts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.flows import FlowableMass, StepInput, StepLimits
from accelsurf.grid.arrays import Floats
from accelsurf.levelset import Motion, Workers
from accelsurf.track.boxed_surface import BoxedSurface, sample_fields, transferred
from accelsurf.track.image_motion import ImageMotion
from accelsurf.track.momentum import Gains, SurfaceMomentum
from accelsurf.track.observer import Displacement, in_frame, missing_velocity, smoothed_by
from accelsurf.track.records import SurfacePiece

#: Voxels that a surface may move in a step, and that one may whose motion the image has shown: less certain than that.
CFL = 0.5
STEERED_CFL = 1.5
#: Steps of a motion at most: speeds that run away, as where paths cross, end it.
MAX_STEPS = 200
#: A motion has ended when less than this part of its time is left: that is rounding.
END = 1e-9
#: Least variance of a displacement, voxels squared: no frame is known better.
MIN_SPREAD = 1e-4
#: Density of new surface.
RHO = 1.0
#: Voxels that a place may move relative to the whole in one prediction.
MAX_RELATIVE = 32.0


def coast(
    boxed: BoxedSurface, fields: list[np.ndarray], duration: float, points: Floats, cfl: float = CFL
) -> tuple[BoxedSurface, list[np.ndarray], Floats]:
    """Move a surface for ``duration`` > 0 as flowable mass, without any force or friction.

    Parameters
    ----------
    boxed : BoxedSurface
        Moved in place where its box has room enough.
    fields : list of ndarray (n,)
        Velocity and density, now.
    duration : float
    points : ndarray (m, 3)
        Material points near the surface, mm along the grid's axes.
    cfl : float
        Voxels that it may move in a step, at most 1.5.

    Returns
    -------
    BoxedSurface, list of ndarray, ndarray
        The surface, its fields and the points, all of the same moment.
    """
    flow = FlowableMass(rho=RHO, friction=0.0, diffusion=0.0)
    flow.start_moving(boxed.surface, fields)
    left, points = duration, points.copy()
    for _ in range(MAX_STEPS):
        if left <= END * duration or not boxed.surface.size:
            break
        if boxed.is_tight():
            boxed = _relaid(boxed, flow)
        now = _now(boxed, flow)
        # The step follows the speed now; its curvature may speed a surface up, which must not be clipped.
        step = min(left, cfl / max(_fastest(now, flow), cfl / duration))
        plan = flow.move(now, StepLimits(2.0 * cfl, 100.0, step))
        if not plan.dt > 0 or plan.velocity is None:
            break
        if len(points):
            columns = [np.ascontiguousarray(plan.velocity[:, c]) for c in range(3)]
            points += plan.dt * sample_fields(boxed, columns, points)[0]
        surface = boxed.surface
        surface.advect(plan.velocity, plan.dt)
        flow.set_fields(surface.redistance(flow.fields, Motion(plan.velocity, plan.dt)).fields)
        left -= plan.dt
    if boxed.surface.size:
        flow.synchronize(_now(boxed, flow))
    return boxed, flow.fields, points


def _now(boxed: BoxedSurface, flow: FlowableMass) -> StepInput:
    """The surface without any force."""
    surface = boxed.surface
    front = surface.front(flow.stencil_width(surface))
    none = np.zeros(surface.size, np.float32)
    return StepInput(surface, front, none, none, surface.fraction_and_area()[1], 0.0)


def _fastest(now: StepInput, flow: FlowableMass) -> float:
    """The largest speed of the front, voxels per unit of time."""
    grid = now.surface.grid
    squares = (
        (field / h) ** 2
        for field, h in zip(flow.fields[:3], (grid.hz, grid.hy, grid.hx), strict=True)
    )
    rates = np.sqrt(sum(squares))
    return float(rates[now.front].max(initial=0.0))


def _relaid(boxed: BoxedSurface, flow: FlowableMass) -> BoxedSurface:
    """The surface on a box with more room, and the fields of the flow there."""
    larger = boxed.with_room([max(8, n // 4) for n in boxed.surface.shape])
    flow.set_fields(transferred(boxed, flow.fields, larger))
    return larger


class Steered(NamedTuple):
    """Mean squares over a surface, mm2: ``innovation``, the difference between the image's motion and the momentum's
    beyond the image's own variance, and ``variance`` of the displacement by both.
    """

    innovation: float
    variance: float


class FlowableMomentum(SurfaceMomentum):
    """Flowable mass: V_t + (V . grad) V = -a (V - c(t)), psi_t = -V . grad psi; the mass flows with V.

    c is the mean of V over the mass, which nothing changes while the surface coasts. The motion is made in a frame
    that moves by whole voxels along with c: the grid has to resolve only V - c and less than a voxel, so a surface
    that only travels is as good after any distance. Friction is exact: V - c shrinks by exp(-a t).

    The fields are V (z, y, x, mm per unit of time) and the density rho.
    """

    _steered = False

    def _fields_at_start(self, velocity: Floats) -> list[np.ndarray]:
        size = self.boxed.surface.size
        return [np.full(size, value, np.float32) for value in (*velocity, RHO)]

    def _mean_velocity(self) -> Floats:
        mass = self.boxed.surface.fraction_and_area()[1] * self.fields[3]
        total = max(float(mass.sum()), 1e-300)
        return np.array([float((mass * field).sum()) / total for field in self.fields[:3]])

    def steer(self, seen: ImageMotion, duration: float, variance: float) -> Steered:
        """Set the velocities to an interval's: the momentum's, drawn to the image's by their certainties.

        The next `predict` has no friction: the image's motion includes its effect.

        Parameters
        ----------
        seen : ImageMotion
            From the frame in which the surface lies to the next one.
        duration : float
        variance : float
            Of a component of the displacement by the momentum alone, mm2; inf: nothing is known of it.
        """
        boxed = self.boxed
        points, wide = boxed.closest_points(), boxed.wide
        mean, free = self._mean_velocity(), self._free(duration)
        field = np.stack(self.fields[:3], axis=1).astype(np.float64)
        by_momentum = mean * duration + (field - mean) * math.copysign(free, duration)
        found, spread = seen.at(points if boxed.halving is None else points + boxed.halving.offset)
        least = MIN_SPREAD * boxed.surface.smallest_spacing**2
        certainty = np.where(in_frame(boxed, points), 1.0 / np.maximum(spread, least), 0.0)
        found, certainty = smoothed_by(boxed, np.where(wide, found, 0.0), certainty)
        # Where the image shows no motion at all nothing is known but the momentum.
        known = 0.0 if math.isinf(variance) else 1.0 / max(variance, least)
        total = np.maximum(certainty + known, 1e-30)
        moved = by_momentum + (certainty / total)[:, None] * (found - by_momentum)
        self.fields = [
            *(np.asarray(moved[:, c] / duration, np.float32) for c in range(3)),
            self.fields[3],
        ]
        self._steered = True
        area = boxed.surface.fraction_and_area()[1]
        share = area * (certainty > 0) / max(float((area * (certainty > 0)).sum()), 1e-300)
        off = ((found - by_momentum) ** 2)[:, wide].mean(axis=1) - 1.0 / np.maximum(
            certainty, 1e-30
        )
        return Steered(max(float((share * off).sum()), least), float((share / total).sum()))

    def _free(self, duration: float) -> float:
        """Time in which V - c moves freely as far as with friction over the duration."""
        if self.friction == 0 or self._steered:
            return abs(duration)
        return -math.expm1(-self.friction * abs(duration)) / self.friction

    def _coast(self, duration: float) -> None:
        mean = self._mean_velocity()
        h = self.boxed.spacing
        sign = math.copysign(1.0, duration)
        voxels = np.rint(mean * duration / h)
        free = self._free(duration)
        slowed, cfl = (
            (1.0, STEERED_CFL) if self._steered else (math.exp(-self.friction * abs(duration)), CFL)
        )
        self._steered = False
        left = (mean * duration - voxels * h) / free
        relative = [
            sign * (field - m) + v for field, m, v in zip(self.fields[:3], mean, left, strict=True)
        ]
        voxel = min(self.boxed.surface.spacings)
        relative = list(_clipped(np.stack(relative, axis=1), MAX_RELATIVE * voxel / free).T)
        fields = [np.asarray(field, np.float32) for field in (*relative, self.fields[3])]
        boxed = self._with_room(fields[:3], free)
        fields = transferred(self.boxed, fields, boxed)
        boxed, fields, points = coast(boxed, fields, free, self._points, cfl)
        shift = [int(n) for n in voxels]
        self.boxed, self._points = boxed.shifted(shift), points + voxels * h
        moving = [
            sign * slowed * (field - v) + m
            for field, m, v in zip(fields[:3], mean, left, strict=True)
        ]
        self.fields = [np.asarray(field, np.float32) for field in (*moving, fields[3])]

    def _with_room(self, velocity: list[np.ndarray], duration: float) -> BoxedSurface:
        """The surface on a box in which it can move for ``duration``, at most by the extent of the frames."""
        h, frame = self.boxed.spacing, np.array(self.boxed.geometry.shape)
        fastest = np.array([float(np.abs(field).max(initial=0.0)) for field in velocity])
        room = np.minimum(np.ceil(fastest * duration / h), frame).astype(np.int64)
        return self.boxed.with_room(np.where(self.boxed.wide, room, 0).astype(np.int64))

    def _corrected_fields(
        self, found: Displacement, duration: float, gain: float
    ) -> list[np.ndarray]:
        missing = gain * missing_velocity(self.boxed, found, duration)
        moving = [field + missing[:, c] for c, field in enumerate(self.fields[:3])]
        return [*(np.asarray(field, np.float32) for field in moving), self.fields[3]]

    def _fields_on(
        self, new: BoxedSurface, values: Floats, known: NDArray[np.bool_]
    ) -> list[np.ndarray]:
        fields = super()._fields_on(new, values, known)
        fields[3] = np.where(known, np.maximum(fields[3], 0.0), np.float32(RHO)).astype(np.float32)
        return fields


def _clipped(velocity: Floats, most: float) -> Floats:
    """Velocities (n, 3) of at most ``most``, in their directions."""
    speed = np.linalg.norm(velocity, axis=1)
    return np.asarray(velocity * np.minimum(1.0, most / np.maximum(speed, 1e-300))[:, None])


class LastDisplacement(SurfaceMomentum):
    """Restart with the last displacement added: the surface moves rigidly as its centroid moved last. A baseline."""

    def _fields_at_start(self, velocity: Floats) -> list[np.ndarray]:
        size = self.boxed.surface.size
        return [np.full(size, value, np.float32) for value in velocity]

    def _mean_velocity(self) -> Floats:
        return np.array([float(field[0]) for field in self.fields])

    def _coast(self, duration: float) -> None:
        way = self._mean_velocity() * duration
        voxels = np.rint(way / self.boxed.spacing)
        left = np.asarray(way - voxels * self.boxed.spacing, np.float32)
        mean = self._mean_velocity()
        boxed = self.boxed.with_room((0, 0, 0))
        size = boxed.surface.size
        fields = [np.full(size, value, np.float32) for value in (*left, RHO)]
        boxed, _, points = coast(boxed, fields, 1.0, self._points)
        self.boxed, self._points = (
            boxed.shifted([int(n) for n in voxels]),
            points + voxels * self.boxed.spacing,
        )
        self.fields = self._fields_at_start(mean)

    def correct(self, piece: SurfacePiece, duration: float, gains: Gains) -> SurfacePiece:
        """Correct the surface; the velocity is the displacement of the centroid since the last correction."""
        seen_before = self.boxed.surface.size > 0
        before, mean = (
            self.boxed.centroid(),
            self._mean_velocity() if seen_before and self.moves else np.zeros(3),
        )
        super().correct(piece, duration, gains)
        if seen_before:
            velocity = mean + gains.velocity / duration * (self.boxed.centroid() - before)
            self.fields = self._fields_at_start(np.where(self.boxed.wide, velocity, 0.0))
        return self.piece

    def _corrected_fields(
        self, found: Displacement, duration: float, gain: float
    ) -> list[np.ndarray]:
        return self.fields


class NoMomentum(LastDisplacement):
    """Static restart: each frame begins where the last one ended. The way of other programs; a baseline.

    The velocity that it reports is that of its centroid; it moves nothing.
    """

    moves = False

    def _coast(self, duration: float) -> None:
        """The surface stays."""


MODELS: dict[str, type[SurfaceMomentum]] = {
    "flowable-mass": FlowableMomentum,
    "last-displacement": LastDisplacement,
    "none": NoMomentum,
}


def make_momentum(
    model: str, friction: float = 0.0, workers: Workers | None = None
) -> SurfaceMomentum:
    """A momentum without a surface yet.

    Parameters
    ----------
    model : {"flowable-mass", "last-displacement", "none"}
    friction : float
        a, per unit of the sequence's time; of no meaning to the two baselines.
    workers : Workers, optional
        One thread by default.

    Raises
    ------
    KeyError
        When no model has this name.
    """
    return MODELS[model](friction, workers)
