"""When a run has converged, stalled, or has no surface left; and when momentum is set to zero."""

from __future__ import annotations

import math
from typing import NamedTuple

from accelsurf.evolution.records import StepRecord, StopReason
from accelsurf.evolution.state import LoopState
from accelsurf.flows import Flow
from accelsurf.levelset import LevelSet

#: Mean motion in a step, voxels, below which a surface does not move: details finer than the grid let it oscillate.
STILL = 0.05
#: A run has stalled when the last `STALL_STEPS` steps are all shorter than the share `STALLED` of the CFL step, or than
#: the share `COLLAPSED` of the longest step; steps down to the share `SHORT` are long enough to judge by.
STALLED, COLLAPSED, STALL_STEPS, SHORT = 1e-3, 1e-6, 10, 0.1

Reason = tuple[StopReason, str]


class StopRule(NamedTuple):
    """When a run has converged, in physical terms.

    Checked every ``window`` steps: the surface lies on average within ``motion`` voxels of where it lay a window
    before (oscillation within the window does not count), and no more than the share ``far`` of it lies further away
    than `levelset.FAR`: a small part may still move while the rest does not. The kinetic energy is below ``kinetic``
    of w times the decrease of the potential so far, or the last step moved the surface by less than `STILL` voxels: a
    start at the minimum decreases nothing. Where steps are shorter than the share `SHORT` of `StepRecord.cfl_dt`, the
    window is longer in proportion.
    """

    window: int = 20
    motion: float = 0.1
    kinetic: float = 0.01
    far: float = 0.01

    def judge(self, surface: LevelSet, flow: Flow, state: LoopState) -> Reason | None:
        """Whether the surface has converged; ``state`` records the check."""
        if (len(state.history) - state.first) % self.window:
            return None
        records = state.history[state.judged_at :]
        asked = sum(record.cfl_dt for record in records) / max(len(records), 1)
        if sum(record.dt for record in records) < SHORT * self.window * asked:
            return None
        before, state.snapshot, state.judged_at = state.snapshot, surface.snapshot(), len(state.history)
        if before is None:
            return None
        moved, last = surface.distance_from(before), state.history[-1]
        swings = last.kinetic > self.kinetic * flow.weight * state.gained and last.motion_voxels > STILL
        if moved.mean > self.motion or moved.far > self.far or swings:
            return None
        return "converged", f"the surface moved {moved.mean:.3f} voxels in {len(records)} steps"


class Restart(NamedTuple):
    """When momentum is set to zero: the potential rises, ``travel`` voxels after the start or the last restart,
    and not within ``steps`` steps of it.
    """

    travel: float = 3.0
    steps: int = 5

    def is_due(self, potential: float, records: list[StepRecord]) -> bool:
        """Whether the potential has risen, far and long enough after the last restart."""
        if len(records) < 2:
            return False
        travelled, steps = 0.0, 0
        for record in reversed(records):
            travelled += record.motion_voxels
            steps += 1
            if record.restarted or travelled >= self.travel:
                break
        rising = potential > records[-1].potential
        return rising and steps >= self.steps and travelled >= self.travel


def surface_is_gone(surface: LevelSet, potential: float) -> Reason | None:
    """Why no surface is left that could move; None if one is."""
    if surface.size == 0:
        if surface.is_filled:
            return "filled", "the surface filled the whole volume"
        return "vanished", "the surface shrank to nothing"
    if not math.isfinite(potential):
        return "diverged", f"the potential became {potential}"
    return None


def stalled(records: list[StepRecord]) -> Reason | None:
    """Whether the last `STALL_STEPS` steps were too short to get anywhere, and why."""
    if len(records) < STALL_STEPS:
        return None
    longest = max(record.dt for record in records)
    last = records[-1]
    if any(r.dt >= max(STALLED * r.cfl_dt, COLLAPSED * longest) for r in records[-STALL_STEPS:]):
        return None
    if last.dt < STALLED * last.cfl_dt:
        return "stalled", (
            f"the steps are {last.cfl_dt / last.dt:.0e} times shorter than the forces allow: diffusion, "
            "noise, smoothness or gravity limit them; use less of it, or --diffusion free"
        )
    return "stalled", "the time step has collapsed: the surface can no longer move"
