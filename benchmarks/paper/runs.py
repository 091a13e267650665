"""A surface from its start to rest: the flows, one step control for all, and figures of the run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from accelsurf.energies import ChanVese
from accelsurf.evolution.convergence import Restart
from accelsurf.evolution.loop import Evolution
from accelsurf.flows import (
    ConstantDensity,
    Flow,
    Gradient,
    HeavyBall,
    Noise,
    Sobolev,
    StepInput,
    StepLimits,
    StepPlan,
)
from accelsurf.flows.descent import LENGTH, descent_plan, h1_gradient
from accelsurf.flows.protocol import voxel_rates
from accelsurf.levelset import LevelSet
from accelsurf.measure.metrics import dice
from accelsurf.run.setup import stop_rule
from accelsurf.settings.run_config import RunConfig
from benchmarks.figures.common import corner_dice
from benchmarks.paper.landscapes import LANDSCAPES

#: So many steps are never reached: what ends there is named.
MAX_STEPS = 20_000
#: The step control, the same for every flow: the program's own, where the fastest twentieth is held back; and one where
#: the fastest place moves by a quarter of a voxel, so that nothing is hopped over.
LIMITS = {"default": StepLimits(), "short": StepLimits(0.25, 100.0)}


def vector_gradient(
    surface: LevelSet, force: np.ndarray, length: float, guess: np.ndarray
) -> np.ndarray:
    """Normal part (n,) of g, (1 - length^2 Lap_S) g = f N for each component.

    On a sphere of radius r the wave of degree 1, a translation, comes out times 1/3 + 2/3/(1 + 6 q), q = (length/r)^2;
    in the scalar form times 1/(1 + 2 q).
    """
    normal = surface.normals()
    out = np.zeros(surface.size, np.float32)
    for axis in range(3):
        along = np.ascontiguousarray(normal[:, axis])
        out += along * h1_gradient(surface, force * along, length, guess * along)
    return out


class VectorSobolev(Sobolev):
    """Sobolev descent in the paper's form, (f N) * K: the components of the vector are smoothed."""

    name = "sobolev-vector"

    def move(self, now: StepInput, limits: StepLimits) -> StepPlan:
        """Step with beta = N . g, in all else as Sobolev descent."""
        surface = now.surface
        length = LENGTH * surface.smallest_spacing if self.length is None else self.length
        speed = vector_gradient(surface, now.force, length, self._last)
        inner = surface.front(1.0)
        surface.extend_outwards(speed, inner)
        cfl_dt = self.cfl_dt(voxel_rates(surface, inner, speed)[inner], surface, limits)
        dt = self.resting_dt(now, speed, min(cfl_dt, limits.dt_max))
        if not np.isfinite(dt):
            return StepPlan.none(surface)
        return self.remember(descent_plan(now, speed, dt, limits, cfl_dt))


class Method(NamedTuple):
    """A flow: its maker, the flow whose stop rule it has, and the area weight."""

    make: Callable[[], Flow]
    rule: str
    alpha: float = 0.0


DESCENT, MOMENTUM, SOBOLEV, AREA_WEIGHT = (
    "descent",
    "constant density",
    "Sobolev",
    "descent, area weight 0.3",
)
METHODS = {
    DESCENT: Method(Gradient, "gradient"),
    AREA_WEIGHT: Method(Gradient, "gradient", 0.3),
    "heavy ball": Method(HeavyBall, "momentum"),
    SOBOLEV: Method(Sobolev, "sobolev"),
    "Sobolev, vector": Method(VectorSobolev, "sobolev"),
    MOMENTUM: Method(ConstantDensity, "constant-density"),
}


class Task(NamedTuple):
    """A run. ``noise`` is the tau of the stochastic acceleration."""

    experiment: str
    landscape: str
    start: str
    method: str
    seed: int
    limits: str = "default"
    noise: float = 0.0


def run(task: Task) -> dict[str, Any]:
    """Run to rest; descent and momentum then for as many steps again, up to 100, without a stop rule: do they stay?

    Returns
    -------
    dict
        What the task says; Dice, Dice at the corners, energy, steps, reason to stop and processor seconds;
        ``later_dice`` and ``later_energy`` after the further steps; ``labels`` at rest.
    """
    landscape = LANDSCAPES[task.landscape]
    image, truth = landscape.make(task.seed)
    ball = landscape.starts[task.start]
    method = METHODS[task.method]
    flow = method.make()
    if task.noise:
        flow = ConstantDensity(noise=Noise(task.noise, seed=1000 + task.seed))
    surface = LevelSet(ball.distance(), (1.0, 1.0, 1.0))
    rule = stop_rule(RunConfig(flow=method.rule), 1)
    energy = ChanVese(image, method.alpha + landscape.alpha)
    true = energy_of(energy, 0.5 - truth)
    began = time.process_time()
    evolution = Evolution(surface, energy, flow, LIMITS[task.limits], MAX_STEPS, Restart(), rule)
    for _ in evolution:
        pass
    seconds = time.process_time() - began
    assert evolution.stop is not None
    labels = surface.labels.astype(bool)
    figures = {
        **task._asdict(),
        "dice": dice(labels, truth),
        "corner_dice": corner_dice(labels, truth),
        "energy": evolution.history[-1].potential,
        "first_energy": evolution.history[0].potential,
        "true_energy": true,
        "steps": evolution.stop.steps,
        "stop": evolution.stop.reason,
        "seconds": seconds,
        "labels": labels,
    }
    if task.experiment == task.landscape and task.method in (DESCENT, MOMENTUM):
        further = Evolution(
            surface,
            energy,
            method.make(),
            LIMITS[task.limits],
            min(evolution.stop.steps, 100),
            Restart(),
        )
        for _ in further:
            pass
        later = surface.labels.astype(bool)
        figures |= {"later_dice": dice(later, truth), "later_energy": further.history[-1].potential}
    return figures


def energy_of(energy: ChanVese, psi: np.ndarray) -> float:
    """Energy of the zero level of ``psi``."""
    surface = LevelSet(psi, (1.0, 1.0, 1.0))
    energy.start(surface)
    return energy.value(surface, *surface.fraction_and_area())
