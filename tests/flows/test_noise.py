"""Stochastic acceleration: variance, correlation, seeds, and the saddle that it is for."""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.api.segment import segment
from accelsurf.energies import RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.records import StepRecord
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, Noise, StepLimits
from accelsurf.levelset import LevelSet

FLAT = (12, 40, 40)


def plane() -> LevelSet:
    z, _, _ = np.indices(FLAT)
    return LevelSet(z - 5.5, (1.0, 1.0, 1.0))


@pytest.mark.slow
def test_the_noise_has_its_variance_and_its_length() -> None:
    """Over many draws: variance tau^2 dt, correlation exp(-|d|^2/(2 length^2))."""
    surface = plane()
    front = surface.front(0.6)
    noise = Noise(0.3, 5.0, seed=1)
    z, y, x = np.unravel_index(surface.band.cells, FLAT)
    near = np.flatnonzero(front & (z == 5))
    draws = np.stack([noise.kicks(surface, front, 0.04, 1)[near, 0] for _ in range(400)])
    assert draws.mean() == pytest.approx(0.0, abs=0.005)
    assert draws.std() == pytest.approx(0.3 * 0.2, rel=0.03)
    grid = draws.reshape(400, 40, 40) / draws.std()
    for apart in (2, 5, 10):
        got = float((grid[:, :, apart:] * grid[:, :, :-apart]).mean())
        assert got == pytest.approx(np.exp(-(apart**2) / 50.0), abs=0.04)


def spread(dt: float, seed: int, t_end: float = 1.0) -> float:
    """RMS speed of a plane under noise alone after ``t_end``, almost without friction."""
    surface = plane()
    flow = ConstantDensity(friction=1e-6, diffusion=0.0, noise=Noise(0.2, 3.0, seed, until=99.0))
    for step in Evolution(
        surface,
        RegionField(np.full(FLAT, 1e-9)),
        SolverSetup(flow, StepLimits(0.5, 100.0, dt)),
        10_000,
    ):
        if step.record.t + step.record.dt > t_end:
            break
    area = surface.fraction_and_area()[1]
    return float((area * flow.beta.astype(float) ** 2).sum() / area.sum())


@pytest.mark.slow
def test_results_do_not_depend_on_the_step() -> None:
    """The variance of the speed is tau^2 t, for steps of 0.1 and of 0.025: mean of 12 runs each, within 20 %."""
    for dt in (0.1, 0.025):
        variance = float(np.mean([spread(dt, seed) for seed in range(12)]))
        assert variance == pytest.approx(0.2**2, rel=0.2)


@pytest.mark.threads
def test_same_seed_same_bytes_and_threads_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    z, y, x = np.indices((28, 28, 28)) - 13.5
    image = ((z**2 + y**2 + x**2 < 8**2) + rng.normal(0, 0.3, z.shape)).astype(np.float32)

    def labels(**options: object) -> np.ndarray:
        return segment(image, start="ball:11,13,14,4vox", noise=0.5, max_steps=25, **options).psi

    one = labels(seed=4)
    np.testing.assert_array_equal(labels(seed=4, threads=2), one)
    assert (labels(seed=5) != one).any()
    drawn = segment(image, start="ball:11,13,14,4vox", noise=0.5, max_steps=25)
    assert drawn.config.seed is not None
    np.testing.assert_array_equal(labels(seed=drawn.config.seed), drawn.psi)


def test_none_costs_nothing() -> None:
    def run(noise: Noise | None) -> list[StepRecord]:
        z, y, x = np.indices((24, 24, 24)) - 11.5
        surface = LevelSet(np.sqrt(z**2 + y**2 + x**2) - 8.0, (1.0, 1.0, 1.0))
        flow = ConstantDensity(noise=noise)
        field = np.sqrt(z**2 + y**2 + x**2) / 6.0 - 1.0
        return [
            step.record for step in Evolution(surface, RegionField(field), SolverSetup(flow), 12)
        ]

    without, zero = run(None), run(Noise(0.0))
    assert [row._replace(seconds=0.0) for row in without] == [
        row._replace(seconds=0.0) for row in zero
    ]


@pytest.mark.parametrize("model", [ConstantDensity, FlowableMass])
def test_nothing_acts_along_a_missing_axis(model: type) -> None:
    y, x = np.indices((30, 30)) - 14.5
    surface = LevelSet((np.hypot(y, x) - 8.0)[None], (2.0, 1.0, 1.0), 4.0)
    flow = model(noise=Noise(0.3, 4.0, seed=2, until=9.0))
    for _ in Evolution(surface, RegionField(np.zeros((1, 30, 30)), 0.1), SolverSetup(flow), 10):
        pass
    if model is FlowableMass:
        assert not flow.velocity[:, 0].any() and np.abs(flow.velocity[:, 1:]).max() > 0
    assert not surface.band.to_closest[:, 0].any()


def test_noise_leaves_a_saddle() -> None:
    """A plane on the ridge of a potential: without noise no force acts and it stays; with noise it rolls off."""
    z, _, _ = np.indices((40, 14, 14))
    ridge = -np.sin(
        (z - 19.5) / 19.5 * np.pi
    )  # zero force at 19.5, growing away from it on both sides
    moved = {}
    for tau in (0.0, 0.05):
        surface = LevelSet(z - 19.5, (1.0, 1.0, 1.0))
        flow = ConstantDensity(noise=Noise(tau, 6.0, seed=1, until=5.0) if tau else None)
        evolution = Evolution(
            surface,
            RegionField(ridge.astype(np.float32)),
            SolverSetup(flow, StepLimits(dt_max=0.5)),
            150,
        )
        history = [step.record for step in evolution]
        moved[tau] = abs(history[-1].volume_mm3 - history[0].volume_mm3) / 14**2
    assert moved[0.0] < 0.05 and moved[0.05] > 5.0
