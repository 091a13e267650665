"""Records of the loop: of a step, why a run stopped, the forces and speeds that acted."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from accelsurf.levelset import LevelSet

StopReason = Literal[
    "converged",
    "max-steps",
    "vanished",
    "filled",
    "stalled",
    "interrupted",
    "diverged",
    "leaked",
    "rested",
    "given",
]


class StepRecord(NamedTuple):
    """One line of the trace: the state at the beginning of a step and the move that followed.

    Attributes
    ----------
    step : int
    level : int
        Grid that the step was made on: 0 is the image's own, 1 the next coarser one; see `accelsurf.grid.pyramid`.
    t, dt, cfl_dt : float
        Flow time, the step's length, and the length that the CFL condition alone would allow: where dt is less, waves,
        diffusion, noise or density limit it. Both are 0 in the last record, which has the final state.
    potential, kinetic, mass_potential, weight : float
        U, the paper's T, U_mass, and the factor w of the potentials, at time t: E = U + U_mass + T/w never rises.
    friction_work, smoothing_work, noise_work : float
        Taken from E so far by friction, or by the motion of a descent; by diffusion, the limiter, restarts, changes of
        level and edits; added to E by noise: E + friction_work + smoothing_work - noise_work is constant.
    mass, mass_correction : float
        Mass of the surface, and the fraction of it that the flow has added so far to conserve it.
    clamped_fraction : float
        Share of the surface where a negative tension of the mass potential was clamped.
    volume_mm3, area_mm2 : float
    speed : float
        The limiter's percentile of the absolute speed on the front, mm per unit time.
    motion_voxels : float
        Mean motion of the surface in the step, voxels along the normal.
    limited_fraction : float
        Share of front cells whose speed was clipped to the CFL limit.
    diffusion : float
        Velocity diffusion used, mm2 per unit time.
    band_cells, cells_visited : int
        Size of the band, and the number of cells that all passes of the step visited: its cost on any machine; 0 as
        ``seconds``.
    restarted : bool
        True when momentum was set to zero before this step.
    removed_components : int
        Components removed as smaller than the grid resolves.
    seconds : float
        Wall time of the step; 0 for one that was read from the file of a state, which has no times.
    edits : int
        Edits applied right before this step; see `accelsurf.settings.corrections`.
    returned : bool
        True when the surface went back to that of the lowest potential before this step, at rest; in the last record,
        when that is where the run ended.
    extra : tuple of (str, float)
        Name and value of each of the solver's ``measures``.
    """

    step: int
    level: int
    t: float
    dt: float
    cfl_dt: float
    potential: float
    kinetic: float
    mass_potential: float
    weight: float
    friction_work: float
    smoothing_work: float
    noise_work: float
    mass: float
    mass_correction: float
    volume_mm3: float
    area_mm2: float
    speed: float
    motion_voxels: float
    limited_fraction: float
    clamped_fraction: float
    diffusion: float
    band_cells: int
    cells_visited: int
    restarted: bool
    removed_components: int
    seconds: float
    edits: int = 0
    returned: bool = False
    extra: tuple[tuple[str, float], ...] = ()


def without_costs(history: Iterable[StepRecord]) -> list[StepRecord]:
    """The records as a file of a state has them: the same steps have the same bytes, whatever they took.

    Of the cells that a step visited, the first one after a restored state has more.
    """
    return [record._replace(seconds=0.0, cells_visited=0) for record in history]


class Reason(NamedTuple):
    """Reason to stop: its ``name``, and a ``message`` in words."""

    name: StopReason
    message: str


class Stop(NamedTuple):
    """Why a run ended: ``reason``, after how many ``steps``, at flow time ``time``, in words (``message``)."""

    reason: StopReason
    steps: int
    time: float
    message: str


class StepFields(NamedTuple):
    """Fields of a step, per cell of the band at its beginning: raveled ``cells`` (n,) in raster order; ``force``
    (n,), valid at the front; ``speed`` (n,), mm per unit time. Both are along N: above 0 shrinks.
    """

    cells: np.ndarray
    force: np.ndarray
    speed: np.ndarray


class Step(NamedTuple):
    """Step of the loop: the ``record`` of the step, the present ``surface``, the ``fields`` that moved it last on
    this grid (read only; None before the first step on the grid), and the ``object_id``.
    """

    record: StepRecord
    surface: LevelSet
    fields: StepFields | None = None
    object_id: int = 1
