"""Evolve on a coarse grid first, and carry surface and momentum from level to level down to the image's own grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import Energy
from accelsurf.evolution import Evolution, Restart, Row, Step, Stop, StopReason, StopRule
from accelsurf.flows import Flow, Limits
from accelsurf.levelset import LevelSet, Workers
from accelsurf.pyramid import Level, carried, coarsened, refined

#: A coarse level only has to come near, the next one goes on anyway: its window, its motion as a multiple of the
#: finest level's, its kinetic energy.
COARSE_WINDOW, COARSE_MOTION, COARSE_KINETIC = 10, 2.0, 0.05
#: How a coarse level ends without a surface that the next one could go on from.
FAILED = ("vanished", "filled", "diverged")


class Passed(NamedTuple):
    """What happened on a level: the grid, the ``steps`` made there, and why they ended (None: not yet)."""

    level: Level
    steps: int
    reason: StopReason | None


class CoarseToFine:
    """Evolves a surface from the coarsest level to the finest; iterate over it to run, one `Step` at a time.

    With one level it is an `Evolution` and nothing else.

    Parameters
    ----------
    grids : sequence of Level
        Finest first, from `accelsurf.pyramid.levels`.
    image : ndarray (nz, ny, nx), float32
        On the finest level.
    start : ndarray (nz, ny, nx), float32
        psi of the first surface, on the finest level.
    energy : callable
        Makes the energy of an image and its spacing; called once for each level.
    flow : Flow
    limits : Limits
    max_steps : int
        Of all levels together.
    restart : Restart or None
    rule : StopRule or None
        Of the finest level. A coarser level is left at `COARSE_MOTION` times its motion. None runs the finest level to
        ``max_steps``.
    half_width : float
        Of the band, in voxels of each level.
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
        energy: Callable[[NDArray[np.float32], tuple[float, float, float]], Energy],
        flow: Flow,
        limits: Limits,
        max_steps: int,
        restart: Restart | None,
        rule: StopRule | None,
        half_width: float,
        workers: Workers,
    ) -> None:
        self.flow, self.limits, self.max_steps, self.restart, self.rule = flow, limits, max_steps, restart, rule
        motion = StopRule().motion if rule is None else rule.motion
        self._coarse_rule = StopRule(COARSE_WINDOW, COARSE_MOTION * motion, COARSE_KINETIC)
        self.warnings: list[str] = []
        self._make_energy, self._half_width, self._workers = energy, half_width, workers
        self._grids = list(grids)
        # Finest first, the present level last: what was used is let go.
        self._images, self._starts = [image], [start]
        for fine, coarse in zip(self._grids, self._grids[1:], strict=False):
            self._images.append(coarsened(self._images[-1], fine, coarse))
            self._starts.append(coarsened(self._starts[-1], fine, coarse))
        self._asked = False
        self._passed: list[Passed] = []
        self._now = self._first_level()

    @property
    def surface(self) -> LevelSet:
        """The surface on the present level."""
        return self._now.surface

    @property
    def ledger(self) -> list[Row]:
        """Every step so far, on all levels."""
        return self._now.ledger

    @property
    def stop(self) -> Stop | None:
        """Why the run ended, when it has: that of the finest level."""
        return self._now.stop if self._now.level == 0 else None

    @property
    def passed(self) -> list[Passed]:
        """The levels so far, coarsest first."""
        reason = None if self._now.stop is None else self._now.stop.reason
        return [*self._passed, Passed(self._grids[self._now.level], self._steps_here(), reason)]

    def ask_to_stop(self) -> None:
        """End the run after the present step, with the reason ``interrupted`` (safe from any thread)."""
        self._asked = True
        self._now.ask_to_stop()

    def __iter__(self) -> Iterator[Step]:
        """Run, yielding a Step after each step of the surface, on the grid of its level."""
        yield from self._now
        while self._now.level > 0:
            self._now = self._next_level(self._now)
            if self._asked:
                self._now.ask_to_stop()
            yield from self._now

    def _steps_here(self) -> int:
        return sum(row.level == self._now.level and row.dt > 0 for row in self.ledger)

    def _first_level(self) -> Evolution:
        """The evolution on the coarsest level whose grid has something of the start, inside and outside."""
        while len(self._starts) > 1:
            inside = self._starts[-1] < 0
            if inside.any() and not inside.all():
                break
            level = self._grids[len(self._starts) - 1]
            self._warn(level, "the start is not resolved there", "began")
            self._passed.append(Passed(level, 0, None))
            self._starts.pop()
            self._images.pop()
        return self._evolution(self._starts[-1], None, None)

    def _next_level(self, before: Evolution) -> Evolution:
        """The evolution on the next finer level, from where ``before`` ended, or from the start if that failed."""
        assert before.stop is not None
        coarse, fine = self._grids[before.level], self._grids[before.level - 1]
        self._passed.append(Passed(coarse, self._steps_here(), before.stop.reason))
        self._starts.pop()
        self._images.pop()
        if before.stop.reason in FAILED:
            self._warn(coarse, before.stop.message, "went on from the start")
            return self._evolution(self._starts[-1], before, None)
        # The start there is not needed any more; a whole volume on the finest level.
        self._starts[-1] = np.zeros((0, 0, 0), np.float32)
        psi = refined(before.surface.psi, coarse, fine)
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
            fields = carried(self.flow.fields, old, coarse, surface, fine)
        return Evolution(
            surface,
            self._make_energy(self._images[-1], spacing),
            self.flow,
            self.limits,
            self.max_steps,
            self.restart,
            self.rule if number == 0 else self._coarse_rule,
            number,
            before,
            fields,
        )

    def _warn(self, level: Level, what: str, then: str) -> None:
        size = " x ".join(str(n) for n in reversed(level.shape))
        self.warnings.append(f"level {level.number} ({size} voxels): {what}; the run {then} on the next finer level")
