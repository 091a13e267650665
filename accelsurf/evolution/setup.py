"""Solver settings of a surface."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from accelsurf.energies import Energy
from accelsurf.evolution.convergence import Restart, StopRule
from accelsurf.flows import Flow, StepLimits
from accelsurf.levelset import CLOSEST_POINT, LevelSet

#: A number of (surface, energy, flow) at the beginning of a step, which changes none of them.
Measure = Callable[[LevelSet, Energy, Flow], float]


class SolverSetup(NamedTuple):
    """Settings of the motion of a surface besides its energy.

    ``flow``, not started yet; ``limits`` of the step; ``restart`` or None; ``half_width`` of the band, in voxels of
    each level; stop ``rule`` of the finest level, None to run to the last step; ``max_volume`` (mm3) of the leak guard
    or None; ``reach``, how far beyond the surface its energy sees the image, mm; ``stop_at_rest``, whether it ends
    where the front was on a plateau; ``extension`` of the level set; ``end``, "lowest" or "present", the state it ends
    with after its last step; ``measures``, numbers by name that each record has besides its own.
    """

    flow: Flow
    limits: StepLimits = StepLimits()
    restart: Restart | None = None
    half_width: float = 3.0
    rule: StopRule | None = None
    max_volume: float | None = None
    reach: float = 0.0
    stop_at_rest: bool = False
    extension: str = CLOSEST_POINT
    end: str = "lowest"
    measures: Mapping[str, Measure] = {}
