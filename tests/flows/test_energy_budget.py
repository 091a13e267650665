"""The energy budget of the history: what the potentials and the kinetic energy lose is what friction and the rest take.

d(U + U_mass + T/w) = -(3k/t) T/w dt - (diffusion, limiter, restart) + noise; with a constant friction a, -2 a T/w.
"""

from __future__ import annotations

import numpy as np
import pytest

from accelsurf.energies import ChanVese, RegionField
from accelsurf.evolution.convergence import Restart
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.records import StepRecord
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import (
    ConstantDensity,
    Flow,
    FlowableMass,
    Gradient,
    HeavyBall,
    Noise,
    Sobolev,
    StepLimits,
)
from accelsurf.levelset import LevelSet
from tests.support.follow import lattice
from tests.support.shapes import spheroid
from tests.support.wrong_flows import BentWrongly


def run(
    flow: Flow, alpha: float = 0.0, t_end: float = 2.0, n: int = 48, restart: Restart | None = None
) -> list[StepRecord]:
    on = lattice(n)
    surface = LevelSet(spheroid(on).psi, on.spacing, 4.0)
    energy = RegionField(0.5 * (on.radius**2 - 0.36) / on.radius, alpha)
    rows = []
    for step in Evolution(
        surface,
        energy,
        SolverSetup(flow, StepLimits(0.5, 100.0, 0.5 * on.spacing[0]), restart=restart),
        10_000,
    ):
        if step.record.t > t_end or step.record.dt == 0:
            break
        rows.append(step.record)
    return rows


def residue(rows: list[StepRecord]) -> float:
    """Largest part of the energy lost so far that the account does not explain."""
    total = [
        r.potential
        + r.mass_potential
        + r.kinetic / r.weight
        + r.friction_work
        + r.smoothing_work
        - r.noise_work
        for r in rows
    ]
    return float(
        np.abs(np.array(total) - total[0]).max()
        / (rows[-1].friction_work + rows[-1].smoothing_work)
    )


FLOWS: dict[str, ConstantDensity | FlowableMass] = {
    "constant density": ConstantDensity(diffusion=0.0),
    "constant density, k = 3": ConstantDensity(k=3.0, diffusion=0.0),
    "constant density, k = 1 from t0": ConstantDensity(k=1.0, diffusion=0.0, t0=0.3),
    "constant density, constant friction": ConstantDensity(friction=2.0, diffusion=0.0),
    "constant density, diffusion": ConstantDensity(diffusion=0.1),
    "constant density, noise": ConstantDensity(
        diffusion=0.0, noise=Noise(0.02, 0.8, seed=3, until=9.0)
    ),
    "flowable mass": FlowableMass(diffusion=0.0),
    "flowable mass, k = 3": FlowableMass(k=3.0, diffusion=0.0),
    "flowable mass, gravity": FlowableMass(0.02, diffusion=0.0, support=None),
    "flowable mass, diffusion": FlowableMass(diffusion=0.1),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", FLOWS)
def test_the_energy_lost_is_accounted_for(name: str) -> None:
    """Within 2 % of what was lost on a smooth problem (noise: 4 %)."""
    k = FLOWS[name].clock.k
    rows = run(FLOWS[name], alpha=0.05, t_end=2.0 ** (2.0 / max(k, 2.0)))
    assert len(rows) > 30 and rows[-1].friction_work > 0.1
    print(f"\n{name}: {residue(rows):.4f}")
    assert residue(rows) < (0.04 if "noise" in name else 0.02)
    if "diffusion" in name:
        assert rows[-1].smoothing_work > 0.005 * rows[-1].friction_work
    if "noise" in name:
        assert rows[-1].noise_work != 0.0
    if "gravity" in name:
        assert np.ptp([row.mass_potential for row in rows]) > 0


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("flow", "most"), [(ConstantDensity(), 0.035), (FlowableMass(), 0.045)])
def test_default_limiter_and_diffusion_are_accounted_for_at_a_sharp_edge(
    flow: ConstantDensity | FlowableMass, most: float
) -> None:
    """Chan-Vese of one ellipsoid at 32^3, 100 steps; half the step does not help.

    Booked as the difference of the energies of single stages, which leaves out that the force works on the mean of the
    velocities before and after a kick, 5.0 % and 9.6 % were missing.
    """
    z, y, x = np.indices((32, 32, 32)) - 15.5
    image = 0.5 * (1.0 - np.tanh((np.sqrt(z**2 + 1.3 * y**2 + 0.8 * x**2) - 9.6) / 0.2))
    surface = LevelSet(np.sqrt((z - 2) ** 2 + y**2 + (x - 3) ** 2) - 4.8, (1.0, 1.0, 1.0))
    evolution = Evolution(surface, ChanVese(image), SolverSetup(flow), 100)
    rows = [step.record for step in evolution if step.record.dt > 0]
    assert rows[-1].smoothing_work > 0.1 * rows[-1].friction_work
    assert residue(rows) < most


def sharp(kind: str, n: int, seed: int) -> np.ndarray:
    """Distance (voxels), or a bound of it, from a body with corners, off the grid and 1/3 to 2/3 of ``n`` wide."""
    off = np.random.default_rng(seed).uniform(-0.03, 0.03, 3)
    z, y, x = (np.indices((n, n, n)) - 0.5 * (n - 1)) / n - off.reshape(3, 1, 1, 1)

    def bar(
        half: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> np.ndarray:
        sides = (np.abs(p - c) - d for p, c, d in zip((z, y, x), at, half, strict=True))
        return np.asarray(np.maximum.reduce(list(sides)))

    bodies = {
        "ball": np.sqrt(z**2 + 1.3 * y**2 + 0.8 * x**2) - 0.3,
        "box": bar((0.25, 0.28, 0.22)),
        "torus": np.hypot(np.hypot(y, x) - 0.25, z) - 0.11,
        "cross": np.minimum.reduce(
            [bar((0.33, 0.11, 0.11)), bar((0.11, 0.33, 0.11)), bar((0.11, 0.11, 0.33))]
        ),
        "L": np.minimum(
            bar((0.12, 0.12, 0.33), (0.0, -0.2, 0.0)), bar((0.12, 0.3, 0.13), (0.0, 0.05, -0.2))
        ),
    }
    return n * bodies[kind]


#: Where balls start that lie within the bodies, in parts of the volume.
STARTS = {"torus": (0.0, 0.0, 0.25), "L": (0.0, -0.1, -0.15)}


def unexplained(kind: str, n: int, seed: int, flow: Flow) -> float:
    """Largest share of the energy lost that the account does not explain: Chan-Vese of a sharp body, 100 steps."""
    centre = np.reshape(STARTS.get(kind, (0.03, 0.0, 0.05)), (3, 1, 1, 1))
    z, y, x = (np.indices((n, n, n)) - 0.5 * (n - 1)) / n - centre
    surface = LevelSet(n * (np.sqrt(z**2 + y**2 + x**2) - 0.12), (1.0, 1.0, 1.0), 4.0)
    image = 0.5 * (1.0 - np.tanh(sharp(kind, n, seed) / 0.2))
    evolution = Evolution(surface, ChanVese(image), SolverSetup(flow), 100)
    return residue([step.record for step in evolution if step.record.dt > 0])


#: Largest shares at 32 and 48 voxels, of seeds 1 and 2: the table of docs/explanation/theory.md.
SHARES = {
    ("constant density", 32): {
        "ball": 0.028,
        "box": 0.047,
        "torus": 0.022,
        "cross": 0.045,
        "L": 0.053,
    },
    ("constant density", 48): {
        "ball": 0.022,
        "box": 0.025,
        "torus": 0.009,
        "cross": 0.017,
        "L": 0.040,
    },
    ("flowable mass", 32): {
        "ball": 0.056,
        "box": 0.067,
        "torus": 0.083,
        "cross": 0.083,
        "L": 0.044,
    },
    ("flowable mass", 48): {
        "ball": 0.038,
        "box": 0.031,
        "torus": 0.088,
        "cross": 0.035,
        "L": 0.030,
    },
    ("descent", 32): {"ball": 0.010, "box": 0.044, "torus": 0.027, "cross": 0.044, "L": 0.041},
    ("heavy ball", 32): {"ball": 0.014, "box": 0.051, "torus": 0.026, "cross": 0.072, "L": 0.068},
    ("sobolev", 32): {"ball": 0.008, "box": 0.040, "torus": 0.021, "cross": 0.041, "L": 0.045},
}
MODELS: dict[str, type[Flow]] = {
    "constant density": ConstantDensity,
    "flowable mass": FlowableMass,
    "descent": Gradient,
    "heavy ball": HeavyBall,
    "sobolev": Sobolev,
}


def test_diffusion_that_takes_most_is_accounted_for() -> None:
    """In the ring diffusion takes three quarters of what is lost.

    With friction booked by the speeds before diffusion, and the transport term by those after it, 12.7 % were
    missing.
    """
    assert unexplained("torus", 32, 1, ConstantDensity()) < 0.03


@pytest.mark.parametrize("flow", [Gradient(), HeavyBall(), Sobolev()])
def test_a_descent_loses_what_its_force_works(flow: Flow) -> None:
    rows = run(flow, n=32, t_end=1.0)
    assert residue(rows) < 0.01 and rows[-1].friction_work > 0.1
    assert all(
        (row.kinetic, row.weight, row.smoothing_work, row.mass) == (0.0, 1.0, 0.0, 0.0)
        for row in rows
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "n"),
    [
        key if key == ("constant density", 32) else pytest.param(*key, marks=pytest.mark.slow)
        for key in SHARES
    ],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_sharp_bodies_with_default_settings_are_accounted_for(
    model: str, n: int, seed: int
) -> None:
    """The table of the documentation; ``pytest -s tests/flows/test_energy_budget.py -k sharp_bodies`` prints it.

    What is missing is the work of the force where it changes within a step: at the sharp edge itself.
    """
    found = {kind: unexplained(kind, n, seed, MODELS[model]()) for kind in SHARES[model, n]}
    print(
        f"\n{model}, {n}, seed {seed}:",
        {kind: f"{100 * share:.1f} %" for kind, share in found.items()},
    )
    for kind, share in found.items():
        assert share < 1.15 * SHARES[model, n][kind] + 0.01, kind


def test_a_wrong_sign_is_not_accounted_for() -> None:
    assert residue(run(BentWrongly(diffusion=0.0), alpha=0.05)) > 0.05


def test_what_a_restart_takes_is_accounted_for() -> None:
    rows = run(ConstantDensity(diffusion=0.0), t_end=8.0, n=32, restart=Restart(1.0, 5))
    assert sum(row.restarted for row in rows) >= 1
    assert residue(rows) < 0.015
    # At the restart itself nothing is missing: with half of the last kick's losses taken off, .3 % were.
    total = [
        row.potential + row.kinetic / row.weight + row.friction_work + row.smoothing_work
        for row in rows
    ]
    lost = rows[-1].friction_work + rows[-1].smoothing_work
    for row in rows:
        assert not row.restarted or abs(total[row.step] - total[row.step - 1]) < 0.001 * lost
    # Without what the restarts took it does not add up.
    bare = [row._replace(smoothing_work=0.0) for row in rows]
    assert residue(bare) > 2 * residue(rows)


def test_the_energy_never_rises_without_noise() -> None:
    rows = run(ConstantDensity(k=3.0), alpha=0.05, t_end=1.6)
    energy = np.array([row.potential + row.kinetic / row.weight for row in rows])
    assert np.diff(energy).max() < 1e-3 * np.ptp(energy)


def test_cost_is_counted_in_cells_visited() -> None:
    """A diffusion stage and a solve show; the same run costs the same."""
    plain, again = (
        run(ConstantDensity(diffusion=0.0), t_end=0.3),
        run(ConstantDensity(diffusion=0.0), t_end=0.3),
    )
    smooth = run(ConstantDensity(diffusion=0.1), t_end=0.3)
    assert [row.cells_visited for row in plain] == [row.cells_visited for row in again]
    per_cell = np.array([row.cells_visited / row.band_cells for row in plain])
    assert 5 < per_cell.min() and per_cell.max() < 30
    assert smooth[-1].cells_visited > plain[-1].cells_visited + 2 * plain[-1].band_cells
