"""A surface from its start to rest: the flows, one step control for all, and figures of the run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.energies import ChanVese
from accelsurf.evolution.convergence import Restart
from accelsurf.evolution.loop import Evolution
from accelsurf.evolution.setup import SolverSetup
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
from benchmarks.paper.landscapes import ALL, Ball, Landscape, about_core

#: So many steps are never reached: what ends there is named.
MAX_STEPS = 20_000
#: Half width of the interface in the energy of every run of the program that does not ask for another, voxels.
SMEARED = RunConfig().epsilon
#: What may free descent: voxels over which the image is smoothed first, and by which the surface at rest is grown
#: before it goes on; and how many balls, drawn in the object, are started from, of which the lowest energy counts.
SMOOTHED, GROWN, STARTS = 1.0, 1.0, 6
#: Radii of the balls about the core whose energies show the ridge, voxels.
RADII = np.arange(5.0, 12.01, 0.25)
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
        dt = self.stiffness_dt(now, speed, min(cfl_dt, limits.dt_max))
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
    """A run. ``noise`` is the tau of the stochastic acceleration, ``epsilon`` the half width of the interface in the
    energy, voxels; ``remedy`` is "none", "smoothed", "grown" or "starts", see `SMOOTHED`.
    """

    experiment: str
    landscape: str
    start: str
    method: str
    seed: int
    limits: str = "default"
    noise: float = 0.0
    epsilon: float = 0.0
    remedy: str = "none"


def run(task: Task) -> dict[str, Any]:
    """Run to rest; descent and momentum then for as many steps again, up to 100, without a stop rule: do they stay?

    Returns
    -------
    dict
        What the task says; Dice, Dice at the corners, energy, steps, reason to stop and processor seconds;
        ``later_dice`` and ``later_energy`` after the further steps; ``labels`` at rest.
    """
    landscape = ALL[task.landscape]
    image, truth = landscape.make(task.seed)
    ball = landscape.starts[task.start]
    if task.remedy == "smoothed":
        image = ndimage.gaussian_filter(image, SMOOTHED, mode="nearest")
    balls = drawn_balls(task.seed) if task.remedy == "starts" else [ball]
    began = time.process_time()
    tries = [to_convergence(task, landscape, image, ball) for ball in balls]
    if task.remedy == "grown":
        grown = LevelSet(tries[0].surface.psi - GROWN, (1.0, 1.0, 1.0))
        tries = [to_convergence(task, landscape, image, grown)]
    seconds = time.process_time() - began
    evolution = min(tries, key=lambda done: done.history[-1].potential)
    assert evolution.stop is not None
    labels = evolution.surface.labels.astype(bool)
    figures = {
        **task._asdict(),
        "dice": dice(labels, truth),
        "corner_dice": corner_dice(labels, truth),
        "energy": evolution.history[-1].potential,
        "first_energy": evolution.history[0].potential,
        "true_energy": energy_of(energy_on(task, landscape, image), 0.5 - truth),
        "steps": evolution.stop.steps,
        "stop": evolution.stop.reason,
        "seconds": seconds,
        "dice_of_starts": [dice(done.surface.labels.astype(bool), truth) for done in tries],
        "labels": labels,
    }
    if task.experiment in (task.landscape, "smeared") and task.method in (DESCENT, MOMENTUM):
        further = Evolution(
            evolution.surface,
            energy_on(task, landscape, image),
            SolverSetup(METHODS[task.method].make(), LIMITS[task.limits], restart=Restart()),
            min(evolution.stop.steps, 100),
        )
        for _ in further:
            pass
        later = evolution.surface.labels.astype(bool)
        figures |= {"later_dice": dice(later, truth), "later_energy": further.history[-1].potential}
    return figures


def to_convergence(
    task: Task, landscape: Landscape, image: np.ndarray, start: Ball | LevelSet
) -> Evolution:
    """Run a surface to rest; returns the run, which has the surface."""
    method = METHODS[task.method]
    flow = method.make()
    if task.noise:
        flow = ConstantDensity(noise=Noise(task.noise, seed=1000 + task.seed))
    surface = LevelSet(start.distance(), (1.0, 1.0, 1.0)) if isinstance(start, Ball) else start
    evolution = Evolution(
        surface,
        energy_on(task, landscape, image),
        SolverSetup(
            flow,
            LIMITS[task.limits],
            restart=Restart(),
            rule=stop_rule(RunConfig(flow=method.rule), 1),
        ),
        MAX_STEPS,
    )
    for _ in evolution:
        pass
    return evolution


def energy_on(task: Task, landscape: Landscape, image: np.ndarray) -> ChanVese:
    """Make the energy of a run."""
    return ChanVese(image, METHODS[task.method].alpha + landscape.alpha, epsilon=task.epsilon)


def drawn_balls(seed: int) -> list[Ball]:
    """Draw the balls of the remedy "starts": radius 6, each wholly within the box."""
    random = np.random.default_rng(500 + seed)
    return [
        Ball(*(float(random.uniform(-side, side)) for side in (6.0, 8.0, 7.0)), 6.0)
        for _ in range(STARTS)
    ]


def ridge(task: Task) -> dict[str, Any]:
    """Energies of balls about the core, in the energy that a run minimises.

    Returns
    -------
    dict
        What the task says; energy of the start; ``least``, ``least_radius`` where a ball rests at the core and
        ``crest``, ``crest_radius`` of the highest ball beyond it, before the energy falls to that of the box. Without
        a ridge both are of the smallest ball.
    """
    landscape = ALL[task.landscape]
    image, truth = landscape.make(task.seed)
    energy = energy_on(task, landscape, image)
    balls = [energy_of(energy, about_core(task.seed, float(radius)).distance()) for radius in RADII]
    rising = np.flatnonzero(np.diff(balls) > 0)
    least = int(rising[0]) if rising.size else 0
    crest = least + int(np.argmax(balls[least:])) if rising.size else 0
    return {
        **task._asdict(),
        "first_energy": energy_of(energy, landscape.starts[task.start].distance()),
        "true_energy": energy_of(energy, 0.5 - truth),
        "least": balls[least],
        "least_radius": float(RADII[least]),
        "crest": balls[crest],
        "crest_radius": float(RADII[crest]),
    }


def energy_of(energy: ChanVese, psi: np.ndarray) -> float:
    """Energy of the zero level of ``psi``."""
    surface = LevelSet(psi, (1.0, 1.0, 1.0))
    energy.start(surface)
    return energy.value(surface, *surface.fraction_and_area())
