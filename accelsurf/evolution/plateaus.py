"""Plateaus of the front: where a growing front nearly stops, before it breaks through to something else.

The speed of the front is its rate of volume per area, dV/dt / A, over the last `WINDOW` steps. It rests where that
falls below `SLOW` of its peak, at its least, and breaks through where it rises again: above `BURST` of the peak and
twice the least, once the volume has grown by `GROWTH`. The growth after that is mostly a leak.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from accelsurf.energies import Energy
from accelsurf.evolution.records import StepFields, StepRecord
from accelsurf.evolution.state import FoundPlateau, LoopState, PlateauWatch, Slowest
from accelsurf.flows import Flow
from accelsurf.grid.boxes import Corner
from accelsurf.levelset import LevelSet, band_state, complete_state, psi_of

# The numbers come from leaks of organs in CT: benchmarks/notes/quality.md, "When it rests, when it breaks through".
#: Steps that the speed is a mean over.
WINDOW = 5
#: Part of the peak below which a front may be on a plateau; a liver that fills falls to 0.53 of its peak.
SLOW = 0.5
#: Part of the peak above which it breaks through: creep in an aorta has 0.01 of it.
BURST = 0.04
#: Part of the volume that it has grown by then; selected with `BURST`.
GROWTH = 0.05
#: Below this part of the peak it is as good as still: an aorta falls to 0.01 of 2.35 mm.
STILL = 0.01
#: A front without momentum is slow for this many steps: no plateau.
AFTER_RESTART = 10
#: No more plateaus of a run are kept: a run that breaks through this often has leaked at the first.
MAX_FOUND = 3
#: Why a run ends at one.
WHY = "it rested at step {}, before it broke through to something else"


class Moment(NamedTuple):
    """A surface at the beginning of a step: its number, the level, volume, area, and the box that it lies in."""

    step: int
    level: int
    volume_mm3: float
    area_mm2: float
    corner: Corner


def front_speed(records: Sequence[StepRecord], now: Moment) -> float | None:
    """Mean speed of the front over the last `WINDOW` steps, mm per unit of flow time; None with fewer steps.

    Growing is above 0.
    """
    last = records[-WINDOW:]
    if len(last) < WINDOW or not now.volume_mm3 > 0:
        return None
    swept = sum(record.dt * record.area_mm2 for record in last)
    return (now.volume_mm3 - last[0].volume_mm3) / swept if swept > 0 else None


def completed(watch: PlateauWatch, level: int, surface: LevelSet) -> PlateauWatch:
    """Return the watch with the sides of the voxels beyond the band of its state; without a state of another level."""
    slowest = watch.slowest
    if slowest is not None and slowest.level != level:
        slowest = None
    if slowest is not None and not slowest.complete:
        slowest = slowest._replace(surface=complete_state(slowest.surface, surface), complete=True)
    return watch._replace(slowest=slowest)


def watched(
    watch: PlateauWatch,
    records: Sequence[StepRecord],
    now: Moment,
    surface: LevelSet,
    fields: StepFields | None,
) -> PlateauWatch:
    """Return the watch after one more step; to be called at every step, after `completed`.

    Parameters
    ----------
    watch : PlateauWatch
    records : sequence of StepRecord
        The steps before on this grid.
    now : Moment
    surface : LevelSet
        Now.
    fields : StepFields or None
        The fields that moved the surface last.
    """
    slowest, speed = watch.slowest, front_speed(records, now)
    if speed is None or surface.size == 0:
        return watch
    if (
        slowest is not None
        and fields is not None
        and _breaks_through(slowest, watch.peak, speed, now)
    ):
        plateau = FoundPlateau(
            slowest.step,
            slowest.level,
            slowest.volume_mm3,
            now.step,
            fastest_place(fields, surface.shape, now.corner),
        )
        return PlateauWatch(speed, None, (*watch.found, plateau)[:MAX_FOUND])
    watch = watch._replace(peak=max(watch.peak, speed))
    calm = not any(
        record.restarted or record.returned or record.edits for record in records[-AFTER_RESTART:]
    )
    if calm and _is_slowest(watch, speed, now):
        band = band_state(surface)
        slowest = Slowest(
            now.step, now.level, max(speed, 0.0), now.volume_mm3, now.corner, surface.shape, band
        )
        return watch._replace(slowest=slowest)
    return watch


def _breaks_through(slowest: Slowest, peak: float, speed: float, now: Moment) -> bool:
    grown = now.volume_mm3 > (1.0 + GROWTH) * slowest.volume_mm3
    return grown and speed > max(BURST * peak, 2.0 * slowest.speed)


def _is_slowest(watch: PlateauWatch, speed: float, now: Moment) -> bool:
    """Test if it grows slower than at any time since it fell below `SLOW`; after an overshoot where it is smallest."""
    if watch.slowest is None:
        return speed < SLOW * watch.peak
    # A front that creeps on from a plateau is on no other plateau later.
    slower = STILL * watch.peak < watch.slowest.speed and 0.0 < speed < watch.slowest.speed
    return slower or (speed <= 0.0 and now.volume_mm3 < watch.slowest.volume_mm3)


def go_back(
    plateau: Slowest,
    state: LoopState,
    area: np.ndarray,
    surface: LevelSet,
    energy: Energy,
    flow: Flow,
    corner: Corner,
) -> tuple[np.ndarray, np.ndarray]:
    """Go back to a plateau on this level, in a box from voxel ``corner`` on that has grown since at most.

    Energy and flow start anew on it, without momentum. Returns the volume fractions and areas there.
    """
    before = state.potential + flow.energy(area)
    psi = surface.dense.psi.reshape(surface.shape)
    psi.fill(surface.gamma)
    z, y, x = (
        slice(c - k, c - k + n)
        for c, k, n in zip(plateau.corner, corner, plateau.shape, strict=True)
    )
    psi[z, y, x] = psi_of(plateau.surface, plateau.shape, float(surface.gamma))
    surface.reinitialize(surface.requested_half_width)
    energy.start(surface)
    flow.start(surface)
    fraction, area = surface.fraction_and_area()
    state.record_plateau(energy.value(surface, fraction, area))
    state.budget.record_loss(before - state.potential - flow.energy(area))
    return fraction, area


def fastest_place(fields: StepFields, shape: tuple[int, int, int], corner: Corner) -> Corner:
    """Voxel of the level's grid in the middle of the part of a front that grows fastest: half as fast or faster.

    Of the cells of that part it is the one nearest to the middle of the largest cluster's mean; ties go to the first.
    """
    growing = np.maximum(-fields.speed, 0.0)
    fast = growing >= 0.5 * growing.max() if growing.size else growing > 0
    cells = np.stack(np.unravel_index(fields.cells[fast], shape), axis=1).astype(np.float64)
    weight = growing[fast].astype(np.float64)
    # Blocks of 8 voxels stand for clusters; counted from the part's own first voxel, wherever its grid begins.
    blocks, member = np.unique(
        (cells - cells.min(axis=0, initial=np.inf)) // 8, axis=0, return_inverse=True
    )
    member = member.reshape(-1)
    largest = int(np.argmax(np.bincount(member, weight, len(blocks))))
    cluster = cells[member == largest]
    middle = np.average(cluster, axis=0, weights=np.maximum(weight[member == largest], 1e-30))
    z, y, x = cluster[int(np.argmin(((cluster - middle) ** 2).sum(axis=1)))]
    return int(z) + corner[0], int(y) + corner[1], int(x) + corner[2]
