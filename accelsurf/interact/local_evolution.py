"""Evolution of a part of a surface on a box of the grid; bounds keep the surface elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import distances_within
from accelsurf.energies import ClickConstraint, Energy
from accelsurf.evolution import Evolution, LoopState, SolverSetup, StepRecord, Stop
from accelsurf.grid.arrays import Spacing
from accelsurf.grid.boxes import bounding_box, widened
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.grid.clicks import Side
from accelsurf.grid.geometry import axis_steps
from accelsurf.interact.finished import OnObjectStep
from accelsurf.interact.region import NearRegion, near_bounds, signed_distance, united
from accelsurf.kernels.grid import Band
from accelsurf.levelset import LevelSet, Workers
from accelsurf.run import leaked_stop

#: Callback for each record; a true value ends the evolution.
OnStep = Callable[[StepRecord], bool | None]
#: Distances around relabelled voxels are computed as far as this number of the largest spacings.
RELABEL_REACH = 6.0


class Stepping(NamedTuple):
    """Threads of the evolutions of a correction, largest number of their steps, and the callback for each record."""

    workers: Workers
    max_steps: int
    on_step: OnObjectStep | None

    def watch_of(self, id: int) -> OnStep | None:
        """Return the callback for the records of an object."""
        on_step = self.on_step
        return None if on_step is None else lambda record: on_step(record, id)


class LocalProblem(NamedTuple):
    """The moving part of a surface, and the bounds of all else; arrays on the box of the region.

    ``psi`` (nz, ny, nx) of the surface before, mm; ``spacing``; ``region`` in which it may move; ``clicks``, the bounds
    of all clicks there; ``relabelled``, voxels (nz, ny, nx) that new clicks relabel, each with its side; ``sides`` of
    the new clicks; ``energy`` of the box; ``setup`` of the solver; the ``history`` so far.
    """

    psi: NDArray[np.float32]
    spacing: Spacing
    region: NearRegion
    clicks: ClickBounds
    relabelled: list[tuple[Side, NDArray[np.bool_]]]
    sides: frozenset[Side]
    energy: Energy
    setup: SolverSetup
    history: list[StepRecord]


class LocalOutcome(NamedTuple):
    """``psi`` on the box, the same bytes beyond the region; the whole ``history``; why it ended."""

    psi: NDArray[np.float32]
    history: list[StepRecord]
    stop: Stop


def evolve_near(problem: LocalProblem, id: int, stepping: Stepping) -> LocalOutcome:
    """Evolve the surface in the region until it has converged, from its old place with the new clicks on their sides.

    Parameters
    ----------
    problem : LocalProblem
    id : int
        Of the object.
    stepping : Stepping

    Returns
    -------
    LocalOutcome
        Its history has the volume and area of the whole object; the potential is that of the box.
    """
    spacing, surface = problem.spacing, _surface_before(problem, stepping)
    before = signed_distance(problem.psi, float(surface.gamma), spacing)
    bounds = united(near_bounds(before, problem.region, spacing, problem.sides), problem.clicks)
    for side, basin in problem.relabelled:
        relabel(before, basin & problem.region.mask, side, spacing)
    return evolve_bounded(problem, id, stepping, before, bounds, surface)


def evolve_bounded(
    problem: LocalProblem,
    id: int,
    stepping: Stepping,
    begin: NDArray[np.float32],
    bounds: ClickBounds,
    surface: LevelSet | None = None,
) -> LocalOutcome:
    """Evolve the surface in the region from another one, within bounds; the other parameters are of `evolve_near`.

    Parameters
    ----------
    problem, id, stepping
        As of `evolve_near`.
    begin : ndarray (nz, ny, nx), float32
        Psi of the first surface, mm.
    bounds : ClickBounds
        Of psi.
    surface : LevelSet, optional
        That of ``problem.psi``, which moves.
    """
    psi, setup = problem.psi, problem.setup
    surface = surface or _surface_before(problem, stepping)
    volume, area = _measures(surface)
    dense = surface.dense.psi.reshape(surface.shape)
    dense[...] = begin
    bounds.apply(dense)
    surface.reinitialize(setup.half_width)
    past = problem.history
    volume_offset, area_offset = past[-1].volume_mm3 - volume, past[-1].area_mm2 - area
    # The last record of the run before has the final state, which is not final any more.
    now = len(past) - 1
    state = LoopState(past[:-1], past[-1].t, edits=1, first=now, judged_at=now, returned_at=now)
    setup = setup._replace(stop_at_rest=False, end="lowest")
    energy = ClickConstraint(problem.energy, bounds)
    evolution = Evolution(surface, energy, setup, now + stepping.max_steps, 0, state)
    stop = evolve_to_end(evolution, setup, stepping.watch_of(id), volume_offset, area_offset)
    psi_after = np.where(problem.region.mask, surface.psi, psi)
    return LocalOutcome(psi_after, list(evolution.history), stop)


def _surface_before(problem: LocalProblem, stepping: Stepping) -> LevelSet:
    """The surface before, with the band of the solver."""
    setup, nothing = problem.setup, np.ones(problem.psi.shape, np.float32)
    surface = LevelSet(
        nothing,
        problem.spacing,
        setup.half_width,
        stepping.workers,
        overwrite=True,
        extension=setup.extension,
    )
    restore_psi(surface, problem.psi)
    return surface


def evolve_to_end(
    evolution: Evolution,
    setup: SolverSetup,
    on_step: OnStep | None,
    volume: float = 0.0,
    area: float = 0.0,
) -> Stop:
    """Run an evolution to its end; ``volume`` and ``area``, mm3 and mm2, of the object beyond its box are added."""
    leaked = False
    for step in evolution:
        record = step.record
        if volume or area:
            record = record._replace(
                volume_mm3=record.volume_mm3 + volume, area_mm2=record.area_mm2 + area
            )
            evolution.history[-1] = record
        leaked = setup.max_volume is not None and record.volume_mm3 > setup.max_volume
        if leaked or (on_step is not None and on_step(record)):
            evolution.request_stop()
    assert evolution.stop is not None
    return leaked_stop(evolution.stop, setup) if leaked else evolution.stop


def restore_psi(surface: LevelSet, psi: NDArray[np.float32]) -> None:
    """Make a surface that of ``psi``, a signed distance in the band: nothing is solved again."""
    flat, grid = psi.reshape(-1), surface.grid
    cells = np.flatnonzero(np.abs(flat) < surface.gamma * np.float32(1.0 - 1e-6))
    slopes = np.zeros((cells.size, 3), np.float32)
    for axis, h in enumerate((grid.hz, grid.hy, grid.hx)):
        if psi.shape[axis] > 1:
            slopes[:, axis] = np.gradient(psi, h, axis=axis).reshape(-1)[cells]
    length = np.maximum(np.sqrt((slopes**2).sum(axis=1, keepdims=True)), np.float32(1e-6))
    band = Band(cells, flat[cells], -flat[cells, None] * slopes / length)
    inside = psi < 0
    beyond = int(np.count_nonzero(inside)) - int(np.count_nonzero(band.psi < 0))
    surface.restore(band, inside.reshape(-1), beyond, surface.requested_half_width)


def relabel(
    psi: NDArray[np.float32], basin: NDArray[np.bool_], side: Side, spacing: Spacing
) -> None:
    """Bring voxels of a basin to their side, in place, with distances around them as far as a band may go."""
    margin = [math.ceil(RELABEL_REACH * max(axis_steps(psi.shape, spacing)) / h) for h in spacing]
    box = bounding_box(basin)
    if box is None:
        return
    box = widened(box, psi.shape, margin)
    part, distance = psi[box], _distance_to(basin[box], spacing)
    np.copyto(part, np.minimum(part, distance) if side == "inside" else np.maximum(part, -distance))


def relabelled_psi(
    psi: NDArray[np.float32],
    inside: NDArray[np.bool_],
    spacing: Spacing,
    half_width: float,
    workers: Workers,
) -> NDArray[np.float32]:
    """Return psi of a surface with other voxels inside; away from those that change it has the same bytes.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx), float32
        Of the surface before, mm.
    inside : ndarray (nz, ny, nx) of bool
    spacing : (hz, hy, hx)
        mm.
    half_width : float
        Of its band, voxels.
    workers : Workers
    """
    out, changed = psi.copy(), (psi < 0) != inside
    relabel(out, changed & inside, "inside", spacing)
    relabel(out, changed & ~inside, "outside", spacing)
    surface = LevelSet(out, spacing, half_width, workers)
    reach = float(surface.gamma) + max(axis_steps(psi.shape, spacing))
    near = np.isfinite(distances_within(changed, spacing, reach))
    out = np.where(near, surface.psi, psi)
    half = np.float32(0.5 * min(axis_steps(psi.shape, spacing)))
    return np.where((out < 0) == inside, out, np.where(inside, -half, half))


def _distance_to(mask: NDArray[np.bool_], spacing: Spacing) -> NDArray[np.float32]:
    """Signed distance, mm, to some voxels, negative in them; no number is larger than that of `RELABEL_REACH`."""
    steps = axis_steps(mask.shape, spacing)
    reach, half = np.float32(RELABEL_REACH * max(steps)), np.float32(0.5 * min(steps))
    to_mask, to_others = (
        distances_within(side, spacing, float(reach)) for side in (np.array(mask), ~mask)
    )
    return np.where(mask, half - np.minimum(to_others, reach), np.minimum(to_mask, reach) - half)


def _measures(surface: LevelSet) -> tuple[float, float]:
    """Volume and area of a surface on its box, mm3 and mm2."""
    fraction, area = surface.fraction_and_area()
    return surface.volume(fraction), math.fsum(area)


def measures_of(
    psi: NDArray[np.float32], spacing: Spacing, half_width: float, workers: Workers
) -> tuple[float, float]:
    """Volume and area of a surface on a box, mm3 and mm2."""
    return _measures(LevelSet(psi, spacing, half_width, workers))
