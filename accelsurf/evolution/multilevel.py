"""Evolve on a coarse grid first, and carry surface and momentum from level to level down to the image's own grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.evolution.loop import Evolution, Kept, Restart, Step, StepFields, StepRecord, Stop, StopReason, StopRule
from accelsurf.flows import Flow, StepLimits
from accelsurf.grid.pyramid import Level, prolong, restrict
from accelsurf.levelset import LevelSet, Workers
from accelsurf.levelset.transfer import transfer_fields

#: A coarse level only has to come near, the next one goes on anyway: its window, its motion as a multiple of the
#: finest level's, its kinetic energy, and the share of it that may be further off.
COARSE_WINDOW, COARSE_MOTION, COARSE_KINETIC, COARSE_FAR = 10, 2.0, 0.05, 0.01
#: How a coarse level ends without a surface that the next one could go on from.
FAILED = ("vanished", "filled", "diverged")


class LevelSummary(NamedTuple):
    """What happened on a level: the grid, the ``steps`` made there, and why they ended (None: not yet)."""

    level: Level
    steps: int
    reason: StopReason | None


class SolverSetup(NamedTuple):
    """What moves a surface.

    ``energy`` makes the energy of an image and its spacing, for each level; ``flow``; ``limits``; ``restart`` or None;
    ``half_width`` of the band, in voxels of each level; ``rule`` of stop of the finest level, None to run to the last
    step: a coarser level is left at `COARSE_MOTION` times its motion.
    """

    energy: Callable[[NDArray[np.float32], tuple[float, float, float]], Energy]
    flow: Flow
    limits: StepLimits
    restart: Restart | None
    half_width: float
    rule: StopRule | None


class Multilevel:
    """Evolves a surface from the coarsest level to the finest; iterate over it to run, one `Step` at a time.

    With one level it is an `Evolution` and nothing else.

    Parameters
    ----------
    grids : sequence of Level
        Finest first, from `accelsurf.grid.pyramid.levels`.
    image : ndarray (nz, ny, nx), float32
        On the finest level.
    start : ndarray (nz, ny, nx), float32
        psi of the first surface, on the finest level.
    parts : Parts
    max_steps : int
        Of all levels together.
    workers : Workers

    Attributes
    ----------
    surface : LevelSet
        The surface now, on the grid of the present level.
    warnings : list of str
        What went wrong on coarse levels.
    """

    def __init__(
        self,
        grids: Sequence[Level],
        image: NDArray[np.float32],
        start: NDArray[np.float32],
        parts: SolverSetup,
        max_steps: int,
        workers: Workers,
    ) -> None:
        self._make_energy, self.flow, self.limits, self.restart, self._half_width, self.rule = parts
        self.max_steps = max_steps
        self.warnings: list[str] = []
        self._workers = workers
        self._grids = list(grids)
        # Finest first, the present level last: what was used is let go.
        self._images, self._starts = [image], [start]
        for fine, coarse in zip(self._grids, self._grids[1:], strict=False):
            self._images.append(restrict(self._images[-1], fine, coarse))
            self._starts.append(restrict(self._starts[-1], fine, coarse))
        self._asked = False
        self._level_summaries: list[LevelSummary] = []
        self._now = self._first_level()

    @property
    def surface(self) -> LevelSet:
        """The surface on the present level."""
        return self._now.surface

    @property
    def history(self) -> list[StepRecord]:
        """Every step so far, on all levels."""
        return self._now.history

    @property
    def stop(self) -> Stop | None:
        """Why the run ended, when it has: that of the finest level."""
        return self._now.stop if self._now.level == 0 else None

    @property
    def level_summaries(self) -> list[LevelSummary]:
        """The levels so far, coarsest first."""
        reason = None if self._now.stop is None else self._now.stop.reason
        return [*self._level_summaries, LevelSummary(self._grids[self._now.level], self._steps_here(), reason)]

    def ask_to_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._asked = True
        self._now.ask_to_stop()

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface, on the grid of its level."""
        while (step := self.step()) is not None:
            yield step

    def step(self) -> Step | None:
        """Make one step, on the next level where this one has ended; None when the run has."""
        step = self._now.step()
        while step is None and self._now.level > 0:
            self._now = self._next_level(self._now)
            if self._asked:
                self._now.ask_to_stop()
            step = self._now.step()
        return step

    # -- changed by hand -----------------------------------------------------------------------------------

    @property
    def level(self) -> Level:
        """The grid of the present level."""
        return self._grids[self._now.level]

    def edit(self, parts: SolverSetup, new_energy: bool, push: Callable[[LevelSet], None] | None = None) -> None:
        """Go on with other parts, or from a surface changed by ``push``; between two steps, see `Evolution.edited`.

        Parameters
        ----------
        parts : Parts
            The coming levels have them too.
        new_energy : bool
            Whether the energy is another one; it is made of this level's image.
        push : callable, optional
            Changes the dense psi of the surface, which is then made a distance again.
        """
        energy = self._take(parts, new_energy)
        rule = self._rule_of(self._now.level)
        self._now = self._now.edited(energy, self.flow, self.limits, self.restart, rule, self._half_width, push)

    def extend(self, max_steps: int) -> None:
        """Have another limit of the steps of all levels together."""
        self.max_steps = self._now.max_steps = max_steps

    @property
    def step_fields(self) -> StepFields | None:
        """What moved the surface last on this grid."""
        return self._now.step_fields

    def look(self) -> Step:
        """Return the state between two steps, as the row of a step that moves nothing."""
        return self._now.look()

    def checkpoint(self) -> Kept:
        """Put aside the state between two steps."""
        return self._now.checkpoint()

    def restore(self, kept: Kept, parts: SolverSetup, new_energy: bool) -> None:
        """Go back to a state of this level, with the parts that were at work then.

        Raises
        ------
        ValueError
            When the state is of another level.
        """
        if kept.scalars["level"] != self._now.level:
            raise ValueError(f"kept on level {kept.scalars['level']}, and the run is on {self._now.level}")
        energy = self._take(parts, new_energy)
        now, self._asked = self._now, False
        now.energy, now.flow, now.limits, now.restart = energy or now.energy, self.flow, self.limits, self.restart
        now.rule = self._rule_of(now.level)
        now.restore(kept)

    def _rule_of(self, number: int) -> StopRule | None:
        """The rule of stop on a level."""
        if number == 0:
            return self.rule
        motion = StopRule().motion if self.rule is None else self.rule.motion
        return StopRule(COARSE_WINDOW, COARSE_MOTION * motion, COARSE_KINETIC, COARSE_FAR)

    def _take(self, parts: SolverSetup, new_energy: bool) -> Energy | None:
        self._make_energy, self.flow, self.limits, self.restart, self._half_width, self.rule = parts
        return self._make_energy(self._images[-1], self.level.spacing) if new_energy else None

    # -- levels --------------------------------------------------------------------------------------------

    def _steps_here(self) -> int:
        return sum(row.level == self._now.level and row.dt > 0 for row in self.history)

    def _first_level(self) -> Evolution:
        """The evolution on the coarsest level whose grid has something of the start, inside and outside."""
        while len(self._starts) > 1:
            inside = self._starts[-1] < 0
            if inside.any() and not inside.all():
                break
            level = self._grids[len(self._starts) - 1]
            self._warn(level, "the start is not resolved there", "began")
            self._level_summaries.append(LevelSummary(level, 0, None))
            self._starts.pop()
            self._images.pop()
        return self._evolution(self._starts[-1], None, None)

    def _next_level(self, before: Evolution) -> Evolution:
        """The evolution on the next finer level, from where ``before`` ended, or from the start if that failed."""
        assert before.stop is not None
        coarse, fine = self._grids[before.level], self._grids[before.level - 1]
        self._level_summaries.append(LevelSummary(coarse, self._steps_here(), before.stop.reason))
        self._starts.pop()
        self._images.pop()
        if before.stop.reason in FAILED:
            self._warn(coarse, before.stop.message, "went on from the start")
            return self._evolution(self._starts[-1], before, None)
        # The start there is not needed any more; a whole volume on the finest level.
        self._starts[-1] = np.zeros((0, 0, 0), np.float32)
        psi = prolong(before.surface.psi, coarse, fine)
        return self._evolution(psi, before, (before.surface, coarse, fine))

    def _evolution(
        self, psi: NDArray[np.float32], before: Evolution | None, way: tuple[LevelSet, Level, Level] | None
    ) -> Evolution:
        number = len(self._starts) - 1
        spacing = self._grids[number].spacing
        if number == 0:
            # The last to need it: a whole volume less while the finest level runs.
            self._starts = [np.zeros((0, 0, 0), np.float32)]
        # Each start is taken up once: the next level has its own.
        surface = LevelSet(psi, spacing, self._half_width, self._workers, overwrite=True)
        fields = None
        if way is not None:
            old, coarse, fine = way
            fields = transfer_fields(self.flow.fields, self.flow.fill_values, old.dense.slot, coarse, surface, fine)
        return Evolution(
            surface,
            self._make_energy(self._images[-1], spacing),
            self.flow,
            self.limits,
            self.max_steps,
            self.restart,
            self._rule_of(number),
            number,
            before,
            fields,
        )

    def _warn(self, level: Level, what: str, then: str) -> None:
        size = " x ".join(str(n) for n in reversed(level.shape))
        self.warnings.append(f"level {level.number} ({size} voxels): {what}; the run {then} on the next finer level")
