"""A run never ends above the lowest potential that it has seen."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.energies import ChanVese, Energy, LocalRegion, RegionField
from accelsurf.evolution import lowest
from accelsurf.evolution.convergence import Restart, StopRule
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, Gradient, HeavyBall, StepLimits
from accelsurf.levelset import LevelSet
from tests.support.level_set_checks import check_level_set

N = 20


def radius(spacing=(1.0, 1.0, 1.0), shape=(N, N, N)):
    z, y, x = (
        (np.indices(shape)[axis] - 0.5 * (shape[axis] - 1)) * spacing[axis] for axis in range(3)
    )
    return np.sqrt(z**2 + y**2 + x**2)


def noisy(level=1.0):
    return (radius() < 6) + np.random.default_rng(2).normal(0, level, (N, N, N))


def run(evolution):
    for _ in evolution:
        pass
    return np.array([record.potential for record in evolution.history])


ENERGIES = {
    "chan-vese": lambda: ChanVese(noisy()),
    "chan-vese, area": lambda: ChanVese(noisy(), alpha=0.1),
    "local-region": lambda: LocalRegion(noisy(), 4.0),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("max_steps", [23, 90])
@pytest.mark.parametrize("flow", [ConstantDensity, FlowableMass, Gradient, HeavyBall])
@pytest.mark.parametrize("energy", ENERGIES)
def test_a_run_never_ends_above_the_lowest_energy(energy, flow, max_steps):
    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
        ENERGIES[energy](),
        SolverSetup(flow(), restart=Restart(), rule=StopRule()),
        max_steps,
    )
    potential = run(evolution)
    assert potential[-1] <= potential.min() + 1e-9 * abs(potential.min())
    assert check_level_set(evolution.surface, 6) == []
    # The last record is that of the surface, evaluated anew.
    fraction, area = evolution.surface.fraction_and_area()
    fresh = ENERGIES[energy]()
    fresh.start(evolution.surface)
    assert fresh.value(evolution.surface, fraction, area) == pytest.approx(potential[-1], rel=1e-9)


class Misled(RegionField):
    """An energy whose force is not its derivative: the surface is driven outwards, past its minimum."""

    def force(self, surface, front, curvature):
        return np.where(front, np.float32(-1.0), np.float32(0.0))


def misled():
    """U falls up to radius 6 and rises from there."""
    return Misled(radius() - 6.0)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flow", [ConstantDensity, FlowableMass, Gradient])
def test_a_surface_that_is_driven_up_goes_back_and_ends_at_the_lowest_state(flow):
    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
        misled(),
        SolverSetup(flow(), rule=StopRule()),
        400,
    )
    potential = run(evolution)
    back = [record for record in evolution.history if record.returned]
    assert evolution.stop.reason in ("stalled", "converged", "filled") and len(back) >= 1
    assert all(record.kinetic == 0 for record in back)
    if evolution.stop.reason != "filled":
        assert potential[-1] <= potential.min() + 1e-9 * abs(potential.min())
        assert evolution.history[-1].volume_mm3 == pytest.approx(4 / 3 * np.pi * 6**3, rel=0.15)
    # What it went back from is in the account, and the steps became shorter.
    assert back[0].smoothing_work > 0 or flow is Gradient


def test_a_run_that_begins_near_its_end_and_finds_nothing_lower_ends_where_it_began():
    surface, limits, rule = (
        LevelSet(radius() - 6.0, (1.0, 1.0, 1.0)),
        StepLimits(0.1, 100.0),
        StopRule(patience=3),
    )
    evolution = Evolution(surface, misled(), SolverSetup(Gradient(), limits, rule=rule), 400)
    potential = run(evolution)
    assert (
        evolution.stop.reason == "stalled"
        and str(lowest.PATIENCE_AT_START) in evolution.stop.message
    )
    assert evolution.stop.steps == lowest.PATIENCE_AT_START and evolution.history[-1].returned
    assert (
        potential[-1] == pytest.approx(potential[0], rel=1e-9) and potential[-1] == potential.min()
    )


def test_motion_without_a_stop_rule_is_left_alone():
    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)), misled(), SolverSetup(Gradient()), 12
    )
    potential = run(evolution)
    assert potential[-1] > potential.min() and not any(
        record.returned for record in evolution.history
    )


def test_an_interrupted_run_stays_where_it_was():
    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
        misled(),
        SolverSetup(Gradient(), rule=StopRule()),
        40,
    )
    for step in evolution:
        if step.record.step == 11:
            evolution.request_stop()
    potential = [record.potential for record in evolution.history]
    assert evolution.stop.reason == "interrupted" and potential[-1] > min(potential)


def test_objects_beside_it_make_a_rise_no_error():
    class Accelerated(Misled):
        is_disturbed = True

    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
        Accelerated(radius() - 6.0),
        SolverSetup(Gradient(), rule=StopRule()),
        12,
    )
    run(evolution)
    assert evolution.state.lowest is None and not any(
        record.returned for record in evolution.history
    )
    assert not Energy.is_disturbed.fget(misled())


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (6.0, 0.5, 0.5)])
@pytest.mark.parametrize("flow", [ConstantDensity, FlowableMass])
def test_the_lowest_state_is_kept_by_reference_and_completed_a_step_later(flow, spacing):
    """As a full copy would have it, bit for bit."""
    from accelsurf.levelset import checkpoint_surface

    shape = (N, N, N) if spacing[0] == 1 else (8, 30, 30)
    image = (radius(spacing, shape) < 6).astype(np.float32)
    surface = LevelSet(radius(spacing, shape) - 4.5, spacing)
    evolution = Evolution(surface, ChanVese(image), SolverSetup(flow()), 60)
    evolution.initialize()
    for _ in range(8):
        want = checkpoint_surface(surface)
        kept = lowest.lowest_of(None, 1.0, 0, surface, evolution.flow, evolution.energy)
        evolution.step()
        done = lowest.lowest_of(kept, 2.0, 1, surface, evolution.flow, evolution.energy)
        assert done.complete and done.potential == 1.0
        for one, other in zip(done.surface, want, strict=True):
            assert np.array_equal(one, other)


def test_a_checkpoint_has_the_lowest_state():
    def made():
        return Evolution(
            LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
            ChanVese(noisy()),
            SolverSetup(ConstantDensity(), rule=StopRule()),
            60,
        )

    one, other = made(), made()
    for _ in range(31):
        one.step()
    kept = one.checkpoint()
    assert (
        kept.loop.lowest is not None and kept.nbytes > kept.surface.nbytes + kept.loop.lowest.nbytes
    )
    want = run(one)
    other.restore(kept)
    assert np.array_equal(run(other), want) and np.array_equal(one.surface.psi, other.surface.psi)


def test_the_last_record_has_the_mass_of_the_surface_that_it_went_back_to():
    """A ball that grows out of the volume: its mass changes, and what the record shows is that of its surface."""
    z, y, x = np.indices((N, N, N)) - 9.5
    psi = np.sqrt(z**2 + y**2 + (x + 7.0) ** 2)
    evolution = Evolution(
        LevelSet(psi - 4.0, (1.0, 1.0, 1.0)),
        Misled(psi - 6.0),
        SolverSetup(FlowableMass(), rule=StopRule()),
        45,
    )
    run(evolution)
    last, steps = evolution.history[-1], evolution.history[:-1]
    then = steps[int(np.argmin([record.potential for record in steps]))]
    assert last.returned and then.step < steps[-1].step
    assert (last.mass, last.mass_correction) == (then.mass, then.mass_correction)
    assert abs(steps[-1].mass - then.mass) > 0.01 * then.mass


def test_the_memory_of_a_checkpoint_counts_both_snapshots_of_the_stop_rule():
    evolution = Evolution(
        LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
        misled(),
        SolverSetup(Gradient(), rule=StopRule(window=4)),
        60,
    )
    for _ in range(10):
        evolution.step()
    kept = evolution.checkpoint()
    assert kept.loop.earlier is not None
    without = kept._replace(loop=kept.loop.copy())
    without.loop.earlier = None
    assert kept.nbytes - without.nbytes == 12 * kept.loop.earlier.psi.size


def near_its_end(rule):
    """A ball that is a little too small, with momentum."""
    image = 0.5 * (1 - np.tanh((radius() - 6.0) / 2))
    return Evolution(
        LevelSet(radius() - 5.5, (1.0, 1.0, 1.0)),
        ChanVese(image, means=(1.0, 0.0)),
        SolverSetup(ConstantDensity(), rule=rule),
        80,
    )


def test_with_patience_a_run_ends_when_it_has_passed_its_lowest_energy():
    plain, patient = near_its_end(StopRule(6)), near_its_end(StopRule(6, patience=3))
    potential = run(patient)
    run(plain)
    assert patient.stop.reason == "converged" and "for 3 steps" in patient.stop.message
    low = int(np.argmin(potential[:-1]))
    assert patient.stop.steps == low + 3 and low > 0
    assert potential[-1] == pytest.approx(potential[low], rel=1e-9)
    # It is the state that the run without patience passes, too, and the end is the same to a fraction of a voxel.
    assert patient.stop.steps < plain.stop.steps
    assert plain.history[low].volume_mm3 == patient.history[low].volume_mm3
    assert patient.history[-1].volume_mm3 == pytest.approx(plain.history[-1].volume_mm3, rel=0.01)


def test_patience_does_not_end_what_creeps_or_is_elsewhere():
    class Creeping(Gradient):
        def move(self, now, limits):
            speed = np.full(now.surface.size, 0.002, np.float32)
            return super().move(now, limits)._replace(dt=1.0, cfl_dt=1.0, speed=speed)

    creeping = Evolution(
        LevelSet(radius() - 6.0, (1.0, 1.0, 1.0)),
        RegionField(np.full((N, N, N), 0.5)),
        SolverSetup(Creeping(), rule=StopRule(patience=1)),
        60,
    )
    run(creeping)
    assert creeping.stop.reason == "max-steps"
    # Driven away from its lowest state faster than a tolerance in so many steps: back to it, as without patience.
    plain, patient = (
        Evolution(
            LevelSet(radius() - 4.0, (1.0, 1.0, 1.0)),
            misled(),
            SolverSetup(Gradient(), rule=StopRule(patience=patience)),
            400,
        )
        for patience in (None, 3)
    )
    assert run(patient).tolist() == run(plain).tolist() and patient.stop == plain.stop
