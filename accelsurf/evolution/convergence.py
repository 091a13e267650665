"""When a run has converged, stalled, or has no surface left; and when momentum is set to zero."""

from __future__ import annotations

import math
from typing import NamedTuple

from accelsurf.evolution.records import Reason, StepRecord
from accelsurf.evolution.state import LoopState
from accelsurf.flows import Flow
from accelsurf.levelset import LevelSet

#: Mean motion in a step, voxels, below which a surface does not move: details finer than the grid let it oscillate.
STILL = 0.05
#: A kinetic energy above this share of w times the decrease of the potential must fall: in the second half of the
#: window it is at most the share `LEVEL` of that in the first. From the same 27 runs.
LEVEL_KINETIC = 0.05
LEVEL = 0.7
#: Number of further windows that would move a converged surface by little: 200 steps, 60 to 100 after coarser levels;
#: 27 runs of benchmarks/notes/steps-and-stop.md.
HORIZON = 10
#: A run has stalled when the last `STALL_STEPS` steps are all shorter than the share `STALLED` of the CFL step, or than
#: the share `COLLAPSED` of the longest step; steps down to the share `SHORT` are long enough to judge by.
STALLED = 1e-3
COLLAPSED = 1e-6
STALL_STEPS = 10
SHORT = 0.1


class StopRule(NamedTuple):
    """When a run has converged, in physical terms.

    Checked every ``window`` steps: the surface lies on average within ``motion`` voxels of where it lay a window
    before (oscillation within the window does not count), and no more than the share ``far`` of it lies further away
    than `levelset.FAR`: a small part may still move while the rest does not. By the trend of the last windows
    `HORIZON` more of them would move it by at most ``further`` voxels more than one: slow creep goes on, oscillation
    stays in place. The kinetic energy is below ``kinetic`` of w times the decrease of the potential so far, or the
    last step moved the surface by less than `STILL` voxels (a start at the minimum decreases nothing) and a kinetic
    energy above `LEVEL_KINETIC` of it falls. Where steps are shorter than the share `SHORT` of `StepRecord.cfl_dt`,
    the window is longer in proportion.

    With ``patience`` a run has also converged when this number of steps has found no lower potential than one of the
    run, and the surface still lies there, by ``motion`` and ``far``. A creeping surface finds a lower one in each step.
    """

    window: int = 20
    motion: float = 0.1
    kinetic: float = 0.01
    far: float = 0.01
    further: float = 0.07
    patience: int | None = None

    def judge(self, surface: LevelSet, flow: Flow, state: LoopState) -> Reason | None:
        """Test if the surface has converged; ``state`` records the check."""
        if self._is_past_lowest(surface, state):
            message = f"the energy has not fallen for {self.patience} steps, and the surface has not moved"
            return Reason("converged", message)
        if (len(state.history) - state.first) % self.window:
            return None
        records = state.history[state.judged_at :]
        asked = sum(record.cfl_dt for record in records) / max(len(records), 1)
        if sum(record.dt for record in records) < SHORT * self.window * asked:
            return None
        earlier = state.earlier
        before = state.snapshot
        moved_before = state.moved
        moved = None if before is None else surface.distance_from(before)
        state.record_check(surface.snapshot(), math.nan if moved is None else moved.mean)
        if moved is None:
            return None
        if moved.mean > self.motion or moved.far > self.far or self._swings(flow, state, records):
            return None
        if math.isfinite(self.further):
            twice = math.nan if earlier is None else surface.distance_from(earlier).mean
            # An oscillation in one window is one in ten: only the motion that would be added counts.
            if forecast(moved.mean, moved_before, twice, HORIZON) - moved.mean > self.further:
                return None
        return Reason(
            "converged", f"the surface moved {moved.mean:.3f} voxels in {len(records)} steps"
        )

    def _is_past_lowest(self, surface: LevelSet, state: LoopState) -> bool:
        """Test if the lowest potential lies ``patience`` steps back, and the surface is still there."""
        lowest = state.lowest
        if self.patience is None or lowest is None or not lowest.is_below(state.potential):
            return False
        since = len(state.history) - max(lowest.step, state.returned_at)
        if since < self.patience or lowest.step <= state.first:
            return False
        moved = surface.distance_from(lowest.snapshot)
        return moved.mean <= self.motion and moved.far <= self.far

    def _swings(self, flow: Flow, state: LoopState, records: list[StepRecord]) -> bool:
        """Test if momentum moves the surface: much kinetic energy while it is not still, or more that does not fall."""
        last, half = records[-1], len(records) // 2
        gained = flow.weight * state.gained
        if last.kinetic <= self.kinetic * gained:
            return False
        if last.motion_voxels > STILL:
            return True
        early, late = (
            sum(record.kinetic for record in part) for part in (records[:half], records[-half:])
        )
        # At the minimum itself some speed may stay that redistancing undoes: a run that has hardly moved may end.
        travelled = (
            sum(record.motion_voxels for record in state.history[state.first :])
            > Restart().distance
        )
        return travelled and last.kinetic > LEVEL_KINETIC * gained and late > LEVEL * early


def forecast(moved: float, moved_before: float, moved_twice: float, windows: float) -> float:
    """Distance (voxels) of a surface from the present one after a number of windows more.

    Parameters
    ----------
    moved, moved_before : float
        Distance of the surface from where it lay a window before, and the same a window earlier; NaN if there is none.
    moved_twice : float
        Its distance from where it lay two windows before.
    windows : float

    Notes
    -----
    The lower of two bounds. Motion that falls by q from window to window goes on for sum q^(i/2): half as fast, as the
    slow parts remain. Motion that went to 2^p of itself in two windows is windows^p of it after more: p = 1 for steady
    creep, 0 for oscillation about one place.

    Examples
    --------
    >>> forecast(0.01, 0.5, 0.5, 10) < 0.003, forecast(0.03, 0.03, 0.06, 10), forecast(0.04, 0.04, 0.04, 10)
    (True, 0.3, 0.04)
    """
    if moved <= 0.0:
        return 0.0
    ratio = 1.0 if math.isnan(moved_before) else min(moved / max(moved_before, 1e-9), 1.0) ** 0.5
    falling = windows if ratio > 0.999 else ratio * (1.0 - ratio**windows) / (1.0 - ratio)
    growth = (
        1.0
        if math.isnan(moved_twice)
        else min(max(math.log2(max(moved_twice, 1e-9) / moved), 0.0), 1.0)
    )
    return moved * min(falling, windows**growth)


class Restart(NamedTuple):
    """When momentum is set to zero: the potential rises, ``distance`` voxels after the start or the last restart,
    and not within ``steps`` steps of it.
    """

    distance: float = 3.0
    steps: int = 5

    def is_due(self, potential: float, records: list[StepRecord]) -> bool:
        """Test if the potential has risen, far and long enough after the last restart."""
        if len(records) < 2:
            return False
        travelled, steps = 0.0, 0
        for record in reversed(records):
            travelled += record.motion_voxels
            steps += 1
            if record.restarted or travelled >= self.distance:
                break
        rising = potential > records[-1].potential
        return rising and steps >= self.steps and travelled >= self.distance


def surface_is_gone(surface: LevelSet, potential: float) -> Reason | None:
    """Why no surface is left that could move; None if one is."""
    if surface.size == 0:
        if surface.is_filled:
            return Reason("filled", "the surface filled the whole volume")
        return Reason("vanished", "the surface shrank to nothing")
    if not math.isfinite(potential):
        return Reason("diverged", f"the potential became {potential}")
    return None


def stalled(records: list[StepRecord]) -> Reason | None:
    """Return why the last `STALL_STEPS` steps were too short to get anywhere; None if they were not."""
    if len(records) < STALL_STEPS:
        return None
    longest = max(record.dt for record in records)
    last = records[-1]
    if any(r.dt >= max(STALLED * r.cfl_dt, COLLAPSED * longest) for r in records[-STALL_STEPS:]):
        return None
    if last.dt < STALLED * last.cfl_dt:
        return Reason(
            "stalled",
            f"the steps are {last.cfl_dt / last.dt:.0e} times shorter than the forces allow: diffusion, "
            "noise, smoothness or gravity limit them; reduce it, or use --diffusion free",
        )
    return Reason(
        "stalled",
        "the time step has become too small to move the surface; "
        "use a larger --presmooth, or --flow constant-density",
    )
