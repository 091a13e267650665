"""The whole pipeline against the Lagrangian reference: a curve or surface of revolution evolved on a grid, compared.

The reference lives in its own coordinates, (x, y) of a plane or (r, z) about an axis; a `Frame` says where they lie in
the grid, turned and shifted by any amount.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from accelsurf.energies import RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, Flow, FlowableMass, Gradient, StepLimits
from accelsurf.levelset import LevelSet
from tests.support.follow import Lattice, surface_points
from tests.support.lagrangian import Curve, Force, Law, solve


@dataclass(frozen=True)
class Frame:
    """Where the reference lies in the grid: its coordinates are ``turn`` (3, 3) @ (point - ``shift``), points x y z."""

    turn: np.ndarray
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def inwards(self, points: np.ndarray, revolved: bool) -> np.ndarray:
        """Grid points (n, 3), z y x, in the reference's coordinates (n, 2)."""
        own = (points[:, ::-1] - self.shift) @ self.turn.T
        return (
            np.stack([np.hypot(own[:, 0], own[:, 1]), own[:, 2]], axis=1)
            if revolved
            else own[:, :2]
        )

    def outwards(self, points: np.ndarray, revolved: bool, around: int = 16) -> np.ndarray:
        """Reference points (n, 2) as grid points (m, 3), z y x; a surface of revolution at ``around`` angles."""
        own = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
        if revolved:
            angle = 2.0 * np.pi * (np.arange(around) + 0.3) / around
            r, z = points[points[:, 0] > 0].T
            own = np.stack(
                [np.outer(np.cos(angle), r), np.outer(np.sin(angle), r), np.tile(z, (around, 1))],
                axis=-1,
            )
            own = own.reshape(-1, 3)
        return np.asarray((own @ self.turn + self.shift)[:, ::-1])


def turned(angle: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Frame:
    """The plane's axes turned by ``angle`` (radians)."""
    c, s = math.cos(angle), math.sin(angle)
    return Frame(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), shift)


def about(axis: Sequence[float], shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Frame:
    """The axis of revolution along ``axis``, x y z."""
    along = np.asarray(axis, float) / np.linalg.norm(axis)
    first = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    first /= np.linalg.norm(first)
    return Frame(np.stack([first, np.cross(along, first), along]), shift)


UPRIGHT = Frame(np.eye(3))


class Nearest(NamedTuple):
    """For each point: signed distance from a curve (outside > 0), and the curve's density at its closest point."""

    distance: np.ndarray
    density: np.ndarray


def nearest(curve: Curve, points: np.ndarray, count: int = 4096) -> Nearest:
    """Distance of points (m, 2) from a curve, from its osculating circle at the nearest of ``count`` points."""
    fine = curve.resampled(count)
    at = fine.geometry()
    index = cKDTree(fine.points).query(points)[1]
    away = points - fine.points[index]
    out = -(away * at.normal[index]).sum(axis=1)
    along = (away * at.tangent[index]).sum(axis=1)
    bend = at.bend[index]
    distance = out + 0.5 * bend * along**2 / np.maximum(1.0 + bend * out, 0.1)
    density = np.ones(count) if fine.density is None else fine.density
    slope = (
        (np.roll(density, -1) - np.roll(density, 1))[index]
        * count
        / (4.0 * np.pi)
        / at.stretch[index]
    )
    return Nearest(distance, density[index] + slope * along)


def flow_of(law: Law) -> Flow:
    """The program's flow for a law; without the free diffusion."""
    if law.model == "descent":
        return Gradient()
    made = FlowableMass if law.model == "flowable-mass" else ConstantDensity
    return made(
        k=law.k,
        lambda_=law.lambda_,
        rho=law.rho,
        friction=law.friction,
        diffusion=law.diffusion,
        t0=law.t0 or None,
    )


class Misfit(NamedTuple):
    """Difference from the reference at one time, mm: ``point`` the largest of any point of the reference from the
    surface and of the surface from the reference, ``mean`` of all points; ``density`` the largest relative one."""

    mean: float
    point: float
    density: float


def psi_at(surface: LevelSet, on: Lattice, frame: Frame, curve: Curve) -> np.ndarray:
    """psi (m,), mm, at the points of a reference: how far inside the surface they lie, or outside (> 0)."""
    axes = [np.unique(on.points[axis]) for axis in range(3)]
    wide = [axis for axis in range(3) if len(axes[axis]) > 1]
    psi = RegularGridInterpolator(
        [axes[axis] for axis in wide], np.squeeze(surface.psi).astype(float), "cubic"
    )
    return np.asarray(psi(frame.outwards(curve.points, curve.revolved)[:, wide]))


def compare(
    surface: LevelSet, on: Lattice, frame: Frame, curve: Curve, density: np.ndarray | None = None
) -> Misfit:
    """Compare the zero level of psi with the reference, both ways."""
    found = frame.inwards(surface_points(surface, on), curve.revolved)
    here = nearest(curve, found)
    there = psi_at(surface, on, frame, curve)
    off = 0.0
    if density is not None:
        near = surface.front(1.0)
        off = float(np.abs(density[near] / here.density - 1.0).max())
    both = np.concatenate([np.abs(here.distance), np.abs(there)])
    return Misfit(float(np.abs(there).mean()), float(both.max()), off)


class Setup(NamedTuple):
    """A start and a force on a grid: psi and the region energy's field (nz, ny, nx), spacing z y x mm."""

    psi: np.ndarray
    field: np.ndarray
    spacing: tuple[float, float, float]


def set_up(start: Curve, force: Force, on: Lattice, frame: Frame = UPRIGHT) -> Setup:
    """Sample the start's distance and the force at the voxels' centres."""
    own = frame.inwards(on.points.reshape(3, -1).T, start.revolved)
    shape = on.points.shape[1:]
    return Setup(nearest(start, own).distance.reshape(shape), force(own).reshape(shape), on.spacing)


class Run:
    """The program on a setup, step by step."""

    def __init__(self, setup: Setup, law: Law, flow: Flow | None = None) -> None:
        self.surface = LevelSet(
            setup.psi, setup.spacing, 4.0 if law.model == "flowable-mass" else 3.0
        )
        self.flow = flow or flow_of(law)
        energy = RegionField(setup.field, law.alpha)
        self.evolution = Evolution(
            self.surface, energy, SolverSetup(self.flow, StepLimits(0.5, 100.0)), 100_000
        )
        self.time = 0.0

    def until(self, end: float, dt: float) -> None:
        """Evolve to the time ``end`` in equal steps of at most ``dt``."""
        while self.time < end - 1e-9:
            left = math.ceil((end - self.time) / dt - 1e-6)
            setup = self.evolution.setup
            limits = setup.limits._replace(dt_max=(end - self.time) / left)
            self.evolution.use(setup._replace(limits=limits))
            step = self.evolution.step()
            assert step is not None and step.record.dt > 0, self.evolution.stop
            self.time = step.record.t + step.record.dt

    @property
    def density(self) -> np.ndarray | None:
        """Of the flow, if it has one."""
        return self.flow.density if isinstance(self.flow, FlowableMass) else None


def evolve(
    start: Curve,
    force: Force,
    law: Law,
    on: Lattice,
    times: Sequence[float],
    dt: float,
    frame: Frame = UPRIGHT,
) -> list[Misfit]:
    """Evolve a start by the program with steps of about ``dt``; its misfits at ``times``."""
    run, misfits = Run(set_up(start, force, on, frame), law), []
    for end, curve in zip(times, solve(start, force, law, times), strict=True):
        run.until(end, dt)
        misfits.append(compare(run.surface, on, frame, curve, run.density))
    return misfits


def in_voxels(misfits: Sequence[Misfit], h: float) -> Misfit:
    """The largest of misfits, in voxels of ``h`` mm (the density's stays relative)."""
    mean, point, density = (max(values) for values in zip(*misfits, strict=True))
    return Misfit(mean / h, point / h, density)
