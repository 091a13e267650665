"""Flows that start in motion, under energies that stay, that travel, and that go from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from accelsurf.energies import BetweenFrames, Energy, RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.records import StepRecord
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, StepInput, StepLimits
from accelsurf.flows.accelerated import Accelerated
from accelsurf.levelset import BandChange, LevelSet
from tests.support.follow import Lattice, lattice, surface_points
from tests.support.follow_curve import UPRIGHT, compare, set_up
from tests.support.lagrangian import Curve, Law, MovingForce, ellipse, solve


class TravellingField(Energy):
    """A region field that is a function of place and time, sampled anew for each time."""

    def __init__(self, on: Lattice, force: MovingForce, alpha: float = 0.0) -> None:
        self.on, self.law, self.alpha = on, force, alpha
        self.now = RegionField(np.zeros(on.points.shape[1:]), alpha)

    def set_time(self, surface: LevelSet, time: float) -> None:
        places = np.stack([self.on.points[2], self.on.points[1]], axis=-1)
        self.now = RegionField(self.law(places, time), self.alpha)
        self.now.start(surface)

    def follow(self, surface: LevelSet, change: BandChange) -> None:
        self.now.follow(surface, change)

    def value(self, surface: LevelSet, fraction: np.ndarray, area: np.ndarray) -> float:
        return self.now.value(surface, fraction, area)

    def force(self, surface: LevelSet, front: np.ndarray, curvature: np.ndarray) -> np.ndarray:
        return self.now.force(surface, front, curvature)


def evolve_to(
    surface: LevelSet,
    energy: Energy,
    flow: Accelerated,
    end: float,
    dt: float,
    at_rest: bool = False,
) -> list[StepRecord]:
    """Evolve a surface in motion, by the flow's own fields, to a time, in equal steps."""
    count = math.ceil(end / dt - 1e-9)
    limits, fields = StepLimits(1.0, 100.0, end / count), None if at_rest else flow.fields
    evolution = Evolution(surface, energy, SolverSetup(flow, limits), count, fields=fields)
    return [step.record for step in evolution]


def well(places: np.ndarray) -> np.ndarray:
    """Without symmetry, and 0 on an egg."""
    x, y = places[..., 0], places[..., 1]
    return np.asarray(0.6 * (x**2 + 1.6 * y**2 - 0.3 * x * y + 0.5 * x**3 - 0.2))


def moving_pair(
    n: int, frames: int, speed: float, made: Callable[..., Accelerated] = FlowableMass
) -> float:
    """The largest distance, voxels, between a run in a travelling well and the same at rest, shifted by whole voxels.

    Per frame the well goes ``speed`` voxels along x.
    """
    on = lattice(n, flat=True)
    h = on.spacing[1]
    start = on.points - np.array([0.0, 0.0, -0.25])[:, None, None, None]
    psi = np.sqrt((start**2).sum(axis=0)) - 0.4
    whole = round(frames * speed)
    duration, c = 1.2, whole * h / 1.2

    def travelling(places: np.ndarray, t: float) -> np.ndarray:
        return well(places - np.array([c * t - 0.25, 0.0]))

    def static(places: np.ndarray, t: float) -> np.ndarray:
        return well(places + np.array([0.25, 0.0]))

    ends = []
    for law, first in ((static, 0.0), (travelling, c)):
        surface = LevelSet(psi, on.spacing, 4.0)
        flow = made(friction=0.0, diffusion=0.0)
        velocity = np.zeros((surface.size, 3), np.float32)
        velocity[:, 2] = first
        flow.start_moving(
            surface, [*(velocity[:, a].copy() for a in range(3)), np.ones(surface.size, np.float32)]
        )
        evolve_to(surface, TravellingField(on, law, 0.03), flow, duration, duration / frames)
        ends.append(surface)
    band = ends[0].front(1.0)
    cells = ends[0].band.cells[band]
    return float(np.abs(ends[1].dense.psi[cells + whole] - ends[0].band.psi[band]).max()) / h


def test_galilean_pair() -> None:
    """F(x - c t) from V = c is the static run shifted: within .02 h over 50 frames."""
    off = moving_pair(64, 50, 0.24)
    print(f"\nGalilean pair, 50 frames, 12 voxels: {off:.4f} h")
    assert off < 0.02


def accelerated_misfit(n: int) -> float:
    """A well that starts from rest and goes b/2 t^2: largest distance of the surface from the reference, voxels.

    In the frame of the well the points feel -b: X'' = f N/rho - b there, which is a force of no region energy. So the
    reference is solved with the time dependent force itself.
    """
    on, b, end = lattice(n, flat=True), np.array([0.25, 0.1]), 1.5
    h = on.spacing[1]

    def travelling(places: np.ndarray, t: float) -> np.ndarray:
        return well(places - 0.5 * b * t**2 + np.array([0.2, 0.0]))

    start = ellipse(0.55, 0.45, 128, (-0.2, 0.05))
    law = Law("flowable-mass", friction=0.0, alpha=0.03)
    curve = solve_in_time(start, travelling, law, end)
    setup = set_up(start, lambda points: np.zeros(len(points)), on)
    surface, flow = LevelSet(setup.psi, on.spacing, 4.0), FlowableMass(friction=0.0, diffusion=0.0)
    evolve_to(surface, TravellingField(on, travelling, 0.03), flow, end, 0.25 * h, at_rest=True)
    return compare(surface, on, UPRIGHT, curve).point / h


def solve_in_time(start: Curve, force: MovingForce, law: Law, end: float) -> Curve:
    """The reference under a force that depends on time."""
    return solve(start, lambda points: force(points, 0.0), law, (end,), moving=force)[0]


def test_a_well_that_accelerates() -> None:
    errors = [accelerated_misfit(n) for n in (32, 64)]
    order = math.log2(errors[0] * 63 / (errors[1] * 31)) / math.log2(63 / 31)
    print(f"\naccelerated well: {errors} h, order {order:.2f}")
    assert errors[1] < 0.02 and order > 1.5


@pytest.mark.parametrize("made", [ConstantDensity, FlowableMass])
def test_the_energy_of_a_static_well_is_conserved(made: Callable[..., Accelerated]) -> None:
    """T + U without friction, from a start in motion; half the step and half the voxel leave less than half.

    Orders 1.5 (constant density) and 1.1: what is left is of the grid; a quarter of the step leaves as much.
    """
    drifts = []
    for n in (24, 48):
        on = lattice(n, flat=True)
        h = on.spacing[1]
        surface = LevelSet(on.radius - 0.75, on.spacing, 4.0)
        flow = made(friction=0.0, diffusion=0.0)
        fields = [np.full(surface.size, 0.1)]
        if made is FlowableMass:
            fields = [*(0.1 * surface.normals().T), np.ones(surface.size)]
        flow.start_moving(surface, [np.asarray(f, np.float32) for f in fields])
        energy = RegionField(well(np.stack([on.points[2], on.points[1]], axis=-1)), 0.03)
        records = evolve_to(surface, energy, flow, 1.5, 0.4 * h)[:-1]
        total = np.array([one.potential + one.kinetic for one in records])
        kinetic = np.array([one.kinetic for one in records])
        drifts.append(float(np.abs(total - total[1]).max() / np.ptp(kinetic)))
    print(
        f"\n{made.__name__}: T + U drifts by {drifts} of T, order {math.log2(drifts[0] / drifts[1]):.2f}"
    )
    assert drifts[1] < (0.02 if made is ConstantDensity else 0.006) and drifts[1] < 0.5 * drifts[0]


def test_time_reversal() -> None:
    """Forth and, with V turned round, back: the first surface, within .02 h."""
    on = lattice(48, flat=True)
    h = on.spacing[1]
    surface = LevelSet(on.radius - 0.7, on.spacing, 4.0)
    first = surface.psi.copy()
    energy = RegionField(well(np.stack([on.points[2], on.points[1]], axis=-1)), 0.03)
    flow = FlowableMass(friction=0.0, diffusion=0.0)
    moving = [np.full(surface.size, v, np.float32) for v in (0.0, 0.1, 0.2, 1.0)]
    flow.start_moving(surface, moving)
    evolve_to(surface, energy, flow, 1.0, 0.4 * h)
    moved = np.abs(np.clip(surface.psi, -2 * h, 2 * h) - np.clip(first, -2 * h, 2 * h)).max() / h
    front = surface.front(flow.stencil_width(surface))
    curvature = surface.curvature(front)
    force = energy.force(surface, front, curvature)
    flow.synchronize(
        StepInput(surface, front, force, curvature, surface.fraction_and_area()[1], energy.alpha)
    )
    *velocity, density = flow.fields
    flow.start_moving(surface, [*(-v for v in velocity), density])
    evolve_to(surface, energy, flow, 1.0, 0.4 * h)
    radii = np.linalg.norm(surface_points(surface, on), axis=1)
    print(f"\nthere {moved:.2f} h, back {np.abs(radii - 0.7).max() / h:.4f} h")
    assert moved > 1.5 and np.abs(radii - 0.7).max() < 0.02 * h


def test_between_two_frames_the_energy_is_linear_in_time() -> None:
    """Force and value of a linear field are those of the image between the frames; frames come in as time goes on."""
    on = lattice(24, flat=True)
    surface = LevelSet(on.radius - 0.7, on.spacing)
    fields = [on.points[2] + 0.1 * k for k in (0, 1, 3)]
    energy = BetweenFrames([0.0, 1.0, 2.0], [RegionField(f, 0.1) for f in fields])
    energy.start(surface)
    front, (fraction, area) = surface.front(), surface.fraction_and_area()
    curvature = surface.curvature(front)
    for time, added in ((-1.0, 0.0), (0.25, 0.025), (1.5, 0.2), (0.5, 0.05), (7.0, 0.3)):
        energy.set_time(surface, time)
        same = RegionField(fields[0] + added, 0.1)
        same.start(surface)
        assert energy.value(surface, fraction, area) == pytest.approx(
            same.value(surface, fraction, area), rel=1e-5
        )
        both = energy.force(surface, front, curvature), same.force(surface, front, curvature)
        np.testing.assert_allclose(both[0][front], both[1][front], atol=1e-5)
    again = BetweenFrames([0.0, 1.0, 2.0], [RegionField(f, 0.1) for f in fields])
    again.restore(surface, energy.state())
    assert again.value(surface, fraction, area) == energy.value(surface, fraction, area)
    with pytest.raises(ValueError, match="rising"):
        BetweenFrames([0.0, 0.0], [same, same])
