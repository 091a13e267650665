import math

import numpy as np
import pytest

from accelsurf.energies import ChanVese, RegionField
from accelsurf.evolution.convergence import Restart, StopRule, forecast
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.records import StepRecord
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, Gradient, HeavyBall, Sobolev, StepLimits
from accelsurf.levelset import LevelSet
from tests.support.level_set_checks import check_level_set

N = 24


def radius(center=(0, 0, 0)):
    z, y, x = np.indices((N, N, N)) - 0.5 * (N - 1)
    return np.sqrt((z - center[0]) ** 2 + (y - center[1]) ** 2 + (x - center[2]) ** 2)


def ball(r, center=(0, 0, 0)):
    return LevelSet(radius(center) - r, (1.0, 1.0, 1.0))


def smooth_image():
    return 0.5 * (1 - np.tanh((radius() - 7) / 2))


def run(evolution):
    for _ in evolution:
        pass
    return evolution.stop


@pytest.mark.parametrize("flow", [ConstantDensity(), Gradient()])
def test_converged(flow):
    energy = ChanVese(smooth_image(), means=(1.0, 0.0))
    evolution = Evolution(ball(4, (1, 2, 0)), energy, SolverSetup(flow, rule=StopRule()), 400)
    stop = run(evolution)
    assert stop.reason == "converged" and "voxels in 20 steps" in stop.message
    assert stop.steps == len(evolution.history) - 1 == evolution.history[-1].step
    assert evolution.history[-1].volume_mm3 == pytest.approx(4 / 3 * np.pi * 7**3, rel=0.05)
    assert check_level_set(evolution.surface) == []


def test_max_steps_and_the_energy_budget():
    evolution = Evolution(
        ball(4), ChanVese(smooth_image()), SolverSetup(ConstantDensity(), rule=StopRule()), 7
    )
    stop = run(evolution)
    assert stop.reason == "max-steps" and stop.steps == 7
    rows = evolution.history
    assert [row.step for row in rows] == list(range(8))
    assert all(isinstance(row, StepRecord) for row in rows)
    # Times add up; the last row only records the final state.
    for before, after in zip(rows, rows[1:], strict=False):
        assert after.t == pytest.approx(before.t + before.dt)
    assert rows[-1].dt == 0 and rows[-1].t == stop.time
    assert rows[0].kinetic == 0 and rows[3].kinetic > 0
    assert rows[-1].potential < rows[0].potential
    assert all(0 < row.motion_voxels <= 0.5 + 1e-6 for row in rows[:-1])
    assert all(row.band_cells > 0 and row.seconds > 0 for row in rows)


def test_vanished():
    evolution = Evolution(
        ball(4), RegionField(np.ones((N, N, N))), SolverSetup(ConstantDensity()), 200
    )
    assert run(evolution).reason == "vanished"
    assert not evolution.surface.labels.any()
    assert evolution.history[-1].volume_mm3 == 0
    # The last voxels were removed, not chased with ever smaller steps.
    assert sum(row.removed_components for row in evolution.history) == 1
    assert min(row.dt for row in evolution.history[:-1]) > 1e-2 * max(
        row.dt for row in evolution.history
    )


def test_filled():
    evolution = Evolution(
        ball(9), RegionField(-np.ones((N, N, N))), SolverSetup(ConstantDensity()), 200
    )
    assert run(evolution).reason == "filled"
    assert evolution.surface.labels.all()
    assert evolution.history[-1].volume_mm3 == N**3


def test_no_force_at_all_has_converged():
    assert (
        run(Evolution(ball(6), RegionField(np.zeros((N, N, N))), SolverSetup(Gradient()))).reason
        == "converged"
    )


def test_interrupted_leaves_a_valid_surface():
    evolution = Evolution(ball(4), ChanVese(smooth_image()), SolverSetup(ConstantDensity()))
    for step in evolution:
        if step.record.step == 5:
            evolution.request_stop()
    assert evolution.stop.reason == "interrupted" and evolution.stop.steps == 6
    assert check_level_set(evolution.surface) == []


def test_the_iteration_may_be_abandoned():
    evolution = Evolution(ball(4), ChanVese(smooth_image()), SolverSetup(ConstantDensity()))
    with pytest.raises(KeyboardInterrupt):
        for step in evolution:
            if step.record.step == 5:
                raise KeyboardInterrupt
    assert evolution.stop is None and len(evolution.history) == 6
    assert check_level_set(evolution.surface) == []


class Broken(RegionField):
    """An energy that becomes NaN."""

    def value(self, surface, part, area):
        value = super().value(surface, part, area)
        return value if value > -100 else math.nan


def test_diverged():
    assert (
        run(Evolution(ball(4), Broken(-np.ones((N, N, N))), SolverSetup(Gradient()))).reason
        == "diverged"
    )


class Freezing(Gradient):
    """A flow whose time step collapses."""

    def move(self, now, limits):
        self.factor = getattr(self, "factor", 1.0) * 0.2
        move = super().move(now, limits)
        return move._replace(dt=move.dt * self.factor)


def test_stalled():
    stop = run(Evolution(ball(6), ChanVese(smooth_image()), SolverSetup(Freezing()), 100))
    assert stop.reason == "stalled" and stop.steps < 40


@pytest.mark.parametrize("flow", [Gradient, ConstantDensity, FlowableMass])
def test_short_steps_are_no_plateau(flow):
    """A diffusion that makes the steps a thousand and more times too short: the surface has not moved, nor arrived."""
    stop = run(
        Evolution(
            ball(6),
            ChanVese(smooth_image()),
            SolverSetup(flow(diffusion=1e5), rule=StopRule()),
            100,
        )
    )
    assert (
        stop.reason == "stalled"
        and stop.steps < 40
        and "times shorter than the forces allow" in stop.message
    )
    # Some hundred times too short: 20 of them move it by less than the tolerance, and prove nothing.
    evolution = Evolution(
        ball(4), ChanVese(smooth_image()), SolverSetup(flow(diffusion=1000.0), rule=StopRule()), 60
    )
    assert run(evolution).reason == "max-steps"
    assert sum(row.motion_voxels for row in evolution.history) < 0.5
    assert all(20 < row.cfl_dt / row.dt < 200 for row in evolution.history[:-1])


def test_a_small_part_on_its_way_is_no_plateau():
    """A ball at rest, and a rod of a fiftieth of its area that grows out of it to voxel 45."""
    z, y, x = np.indices((40, 40, 50)) - np.array([19.5, 19.5, 18.5])[:, None, None, None]
    r = np.sqrt(z**2 + y**2 + x**2)
    rod = (z**2 + y**2 < 3.5**2) & (x > 0) & (x < 26)
    evolution = Evolution(
        LevelSet(r - 14, (1.0, 1.0, 1.0)),
        RegionField(np.where(rod, -1.0, np.clip(r - 14, -1, 1))),
        SolverSetup(Gradient(), rule=StopRule(6)),
        200,
    )
    assert run(evolution).reason == "converged"
    assert np.flatnonzero(evolution.surface.labels.any(axis=(0, 1)))[-1] >= 43


def test_restart_when_the_potential_rises_after_travel():
    def restarts(restart):
        evolution = Evolution(
            ball(4),
            ChanVese(smooth_image()),
            SolverSetup(ConstantDensity(diffusion=0), restart=restart),
            80,
        )
        run(evolution)
        return evolution.history

    rows = restarts(Restart())
    at = [row.step for row in rows if row.restarted]
    assert at, "the surface overshoots the object, so the potential must rise"
    first = at[0]
    assert rows[first].potential > rows[first - 1].potential
    assert sum(row.motion_voxels for row in rows[:first]) >= Restart().distance
    assert rows[first].kinetic == 0
    # Without travel enough it waits; without a rule it never comes.
    assert not any(row.restarted for row in restarts(None))
    later = [row.step for row in restarts(Restart(distance=1000.0)) if row.restarted]
    assert later == []


def test_restart_converges_where_plain_friction_oscillates():
    """A quadratic well: 3/t friction lets the energy decay like a power, restart makes it fall faster."""
    energies = []
    for restart in (None, Restart(distance=1.0, steps=5)):
        evolution = Evolution(
            ball(5),
            ChanVese(smooth_image(), means=(1.0, 0.0)),
            SolverSetup(ConstantDensity(diffusion=0.0), restart=restart),
            120,
        )
        run(evolution)
        energies.append(np.array([row.kinetic for row in evolution.history[-30:]]).max())
    assert energies[1] < 0.5 * energies[0]


def test_the_limits_are_the_same_for_every_flow():
    for flow in (ConstantDensity(), Gradient()):
        evolution = Evolution(
            ball(4),
            ChanVese(smooth_image()),
            SolverSetup(flow, StepLimits(cfl=0.25, dt_max=0.3)),
            10,
        )
        run(evolution)
        assert all(row.dt <= 0.3 and row.motion_voxels <= 0.25 + 1e-6 for row in evolution.history)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("flow", "steps"), [(ConstantDensity, 120), (FlowableMass, 58)])
@pytest.mark.parametrize("epsilon", [0.0, 1.5])
def test_a_surface_at_a_sharp_edge_does_not_flicker(flow, steps, epsilon):
    """Wells there are steeper than the forces on the way say: the step must become shorter, or flicker grows.

    With the step of the forces alone the kinetic energy stays below 0 and the potential rises above its minimum.
    """
    image = (radius() < 7.3).astype(np.float64)
    energy = ChanVese(image, means=(1.0, 0.0), epsilon=epsilon)
    evolution = Evolution(ball(7.5, (0.5, 0, 0)), energy, SolverSetup(flow()), steps)
    run(evolution)
    rows = evolution.history
    least = min(row.potential for row in rows)
    first = rows[0].potential - least
    assert all(row.kinetic >= 0 for row in rows[-18:])
    assert all(row.potential - least < 0.15 * first for row in rows[-18:])


@pytest.mark.parametrize("flow", [ConstantDensity, FlowableMass, Gradient, HeavyBall, Sobolev])
def test_the_strongest_force_is_stored_in_mm_when_the_grid_changes(flow):
    coarse = LevelSet(np.asarray(2.0 * radius() - 14), (2.0, 2.0, 2.0))
    made = flow()
    made.start(coarse)
    made.peak_force_so_far(3.0, coarse)
    assert made.peak_force_so_far(0.5, ball(7)) == pytest.approx(6.0)


def test_the_step_becomes_shorter_where_the_surface_turns_around_twice_running():
    flow = ConstantDensity()
    flow.start(ball(7))
    for kinetic, steeper in (
        (1.0, 1),
        (-1.0, 1),
        (1.0, 1),
        (-1.0, 1),
        (-1.0, 1.5),
        (-1.0, 2.25),
        (2.0, 2.25),
    ):
        flow.detect_oscillation(kinetic)
        assert flow.force_stiffness(2.0, ball(7)) == pytest.approx(2.0 * steeper)
    for _ in range(30):
        flow.detect_oscillation(-1.0)
    assert flow.force_stiffness(2.0, ball(7)) == pytest.approx(32.0)


@pytest.mark.parametrize("flow", [ConstantDensity, FlowableMass])
def test_a_start_that_is_the_end_has_converged(flow):
    """Nothing is won there that the kinetic energy of what trembles could be compared with."""
    image = (radius() < 7.3).astype(np.float64)
    energy = ChanVese(image, means=(1.0, 0.0), epsilon=1.5)
    evolution = Evolution(ball(7.28), energy, SolverSetup(flow(), rule=StopRule()), 100)
    assert run(evolution).reason == "converged"


@pytest.mark.parametrize(
    ("moved", "before", "twice", "low", "high"),
    [
        (0.03, 0.5, 0.52, 0.0, 0.015),  # falls fast
        (0.04, 0.04, 0.042, 0.03, 0.05),  # oscillates about one place
        (
            0.017,
            0.017,
            0.034,
            0.16,
            0.18,
        ),  # creeps: the stop rule took 0.017 voxels in 20 steps for rest
        (0.02, 0.025, 0.03, 0.05, 0.1),  # creeps, ever more slowly
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (0.02, math.nan, math.nan, 0.2, 0.2),  # nothing is known: as fast as now
    ],
)
def test_the_trend_tells_creep_from_oscillation(moved, before, twice, low, high):
    assert low <= forecast(moved, before, twice, 10.0) <= high + 1e-12


class Creeping(Gradient):
    """A flow that moves the surface by the same small amount in each step."""

    def move(self, now, limits):
        speed = np.full(now.surface.size, 0.002, np.float32)
        return super().move(now, limits)._replace(dt=1.0, cfl_dt=1.0, speed=speed)


def test_slow_creep_does_not_pass_the_stop_rule():
    """0.04 voxels in a window of 20 steps, 0.4 in 200."""
    energy = RegionField(np.full((N, N, N), 0.5))
    evolution = Evolution(ball(7), energy, SolverSetup(Creeping(), rule=StopRule()), 100)
    assert run(evolution).reason == "max-steps"
    lenient = Evolution(ball(7), energy, SolverSetup(Creeping(), rule=StopRule(further=1.0)), 100)
    assert run(lenient).reason == "converged"


class Level(Gradient):
    """A flow whose kinetic energy stays what it is after a long way, while the surface hardly moves any more."""

    kinetic = 50.0

    def move(self, now, limits):
        plan = super().move(now, limits)
        return plan._replace(energy_rates=plan.energy_rates._replace(kinetic=self.kinetic))


def test_a_level_kinetic_energy_is_no_plateau():
    reasons = []
    for kinetic in (0.0, 50.0):
        flow = Level()
        flow.kinetic = kinetic
        energy = ChanVese(smooth_image(), means=(1.0, 0.0))
        reasons.append(
            run(Evolution(ball(3), energy, SolverSetup(flow, rule=StopRule()), 120)).reason
        )
    assert reasons == ["converged", "max-steps"]
