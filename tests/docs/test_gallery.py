"""The systems as the gallery writes them, in twenty lines, against the package's flows.

Both sides step by the same dt. The examples are of first order in dt (implicit friction, and the transport term of the
step's beginning), the flows of second: surfaces differ by c dt, and by half of it at half the step. The example of
flowable mass has neither the flow's exact stretch nor its balance of mass: this adds a part of a voxel.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from accelsurf.energies import RegionField
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
from accelsurf.flows import ConstantDensity, FlowableMass, StepLimits

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"
WIDTH, N = 2.6, 32


class System(NamedTuple):
    """How an example is compared: its function, the flow, the end, and the tolerance: parts of dt, mm, and of h."""

    function: str
    flow: type[ConstantDensity] | type[FlowableMass]
    t_end: float
    of_dt: float
    of_h: float

    def tolerance(self, dt: float) -> float:
        """Tolerance, mm."""
        return self.of_dt * dt + self.of_h * WIDTH / N


SYSTEMS = {
    "plot_constant_density.py": System("constant_density", ConstantDensity, 1.2, 0.15, 0.0),
    "plot_flowable_mass.py": System("flowable_mass", FlowableMass, 0.8, 0.5, 0.06),
}
#: What a slip would be: a text of the example, and a wrong one.
SLIPS = {
    "plot_constant_density.py": [
        ("+ 0.5 * beta**2 * H", "- 0.5 * beta**2 * H"),
        ("+ 0.5 * beta**2 * H", "+ beta**2 * H"),
        ("kick * (k + 1) / t", "kick * k / t"),
        ("(w * f / rho", "(-w * f / rho"),
    ],
    "plot_flowable_mass.py": [
        ("1 + dt * divergence", "1 - dt * divergence"),
        ("surface.advect(V, dt)", "surface.advect(-V, dt)"),
        ("kick * (k + 1) / t", "kick * k / t"),
        ("kick * w * (f / rho)", "kick * w * (-f / rho)"),
    ],
}


def functions_of(example: str, right: str = "", wrong: str = "") -> dict[str, Any]:
    """Imports and functions of an example, with a text of it replaced."""
    source = (GALLERY / example).read_text(encoding="utf-8")
    assert not right or source.count(right) == 1
    tree = ast.parse(source.replace(right, wrong) if right else source)
    tree.body = [
        node
        for node in tree.body
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.FunctionDef))
    ]
    names: dict[str, Any] = {}
    exec(compile(tree, example, "exec"), names)
    return names


def by_example(example: str, names: dict[str, Any], dt: float) -> Iterator[np.ndarray]:
    """psi after each step of the example."""
    system, surface = SYSTEMS[example], names["ball"](N)
    for _ in names[system.function](surface, names["force"], dt, round(system.t_end / dt)):
        yield surface.psi.copy()


@cache
def by_flow(example: str, dt: float) -> list[np.ndarray]:
    """psi after each step of the flow, under the same force."""
    system, names = SYSTEMS[example], functions_of(example)
    surface, steps = names["ball"](N), round(system.t_end / dt)
    points = (np.indices(surface.shape) - 0.5 * (N - 1)) * WIDTH / N
    energy, limits = RegionField(names["force"](*points)), StepLimits(2.0, 100.0, dt)
    moved = []
    for step in Evolution(
        surface, energy, SolverSetup(system.flow(diffusion=0.0), limits), steps + 1
    ):
        if len(moved) < steps:
            assert step.record.dt == pytest.approx(dt)
            moved.append(surface.psi.copy())
    return moved


def misfit(example: str, names: dict[str, Any], dt: float) -> float:
    """Largest distance of the surfaces at any point and step, mm; infinite where the example breaks."""
    h, worst = WIDTH / N, 0.0
    with np.errstate(all="ignore"):
        for found, wanted in zip(by_example(example, names, dt), by_flow(example, dt), strict=True):
            near = (np.abs(found) < h) | (np.abs(wanted) < h)
            off = np.abs(found - wanted)[near].max(initial=0.0)
            worst = max(worst, float(off) if np.isfinite(off) else np.inf)
    return worst


@pytest.mark.parametrize("example", SYSTEMS)
def test_the_system_as_the_gallery_writes_it_is_the_flow(example: str) -> None:
    """Constant density: .12 dt, and half of it at half the step. Flowable mass: .15 and .10 voxel, of .18 and .12."""
    names, system = functions_of(example), SYSTEMS[example]
    coarse, fine = misfit(example, names, 0.02), misfit(example, names, 0.01)
    print(
        f"\n{example}: {coarse:.5f} mm at dt = .02, {fine:.5f} mm at .01; a voxel is {WIDTH / N:.3f} mm"
    )
    assert coarse < system.tolerance(0.02) and fine < system.tolerance(0.01)
    assert fine < (0.55 if system.of_h == 0.0 else 0.75) * coarse


@pytest.mark.parametrize(
    ("example", "right", "wrong"), [(name, *slip) for name in SLIPS for slip in SLIPS[name]]
)
def test_a_slip_in_the_system_is_not_the_flow(example: str, right: str, wrong: str) -> None:
    """Each is off by more than five times the tolerance, or breaks."""
    found = misfit(example, functions_of(example, right, wrong), 0.02)
    print(f"\n{wrong}: {found * N / WIDTH:.2f} voxels")
    assert found > 5.0 * SYSTEMS[example].tolerance(0.02)
