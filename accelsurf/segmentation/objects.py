"""Several surfaces that never overlap, each on its own part of the grid: cost goes with their areas, not n volumes.

Objects are moved in rounds, one step each. Those that are near each other take turns, in the order of their ids, and
see each other as they are; the others move side by side in threads. So the result does not depend on their number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from types import TracebackType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.constraints.contact import Corner, Neighbour, NonOverlap
from accelsurf.energies.constraints.mask import MaskConstraint
from accelsurf.energies.geodesic import largest_spacing
from accelsurf.energies.local_region import TENT
from accelsurf.errors import InputError
from accelsurf.evolution.loop import Evolution, Restart, StepRecord, Stop
from accelsurf.flows import StepLimits
from accelsurf.grid.geometry import Box
from accelsurf.initialization.object_starts import ObjectStart, corner_of, meeting, shared, widened
from accelsurf.levelset import LevelSet, Workers
from accelsurf.segmentation.energy_assembly import make_energy
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.solver_setup import half_width, make_flow, stop_rule
from accelsurf.segmentation.term_makers import WINDOW_VOXELS
from accelsurf.settings import energy_expression
from accelsurf.settings.run_config import RunConfig

#: Voxels around an object's band at least, and as part of its extent; nearer than this the grid is made larger.
ROOM, ROOM_PART, GUARD = 10, 0.5, 3
#: Voxels by which a band may grow in a round, and stencils reach.
REACH = 3
#: A neighbour that is this deep inside, voxels of the smallest spacing, wakes an object that had converged.
PUSHED = 0.5
T = TypeVar("T")


class Moving:
    """One of the objects: its surface on its own grid, and how it moves.

    Attributes
    ----------
    id : int
    corner : (z, y, x)
        First voxel of its grid in the grid that all share.
    leaked : bool
        Whether it grew beyond the largest volume that it may have.
    context : ImageContext
        What its energy needs of the image.
    terms : list of dict
        The terms of its energy with their resolved settings.
    """

    def __init__(self, one: ObjectStart, place: int, prepared: PreprocessedInput, config: RunConfig) -> None:
        self.id, self.leaked = one.id, False
        self._prepared, self._config = prepared, config
        seed = None if config.seed is None else config.seed + place
        self.flow = make_flow(config.replace(seed=seed))
        self.workers = Workers(1)
        self.context = prepared.context.of_object(one.corner, one.psi < 0)
        self._least = _least_room(config, prepared)
        inside = np.argwhere(one.psi < 0)
        low, high = inside.min(axis=0) + one.corner, inside.max(axis=0) + 1 + one.corner
        self._begin(self._boxed(low, high), one.psi, one.corner, None)

    def _boxed(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> Box:
        """The box of the grid for an object between two voxels."""
        a, b, c = (slice(int(i), int(j)) for i, j in zip(low, high, strict=True))
        room = [max(m, math.ceil(ROOM_PART * (j - i))) for m, i, j in zip(self._least, low, high, strict=True)]
        return widened((a, b, c), self._prepared.geometry.shape, (room[0], room[1], room[2]))

    def _begin(self, box: Box, known: NDArray[np.float32], at: Corner, before: Evolution | None) -> None:
        """Lay the surface, known from voxel ``at`` on, out on a box and go on from ``before``."""
        prepared, config = self._prepared, self._config
        self.corner = corner_of(box)
        # Beyond what is known all is outside.
        psi = np.full(tuple(s.stop - s.start for s in box), np.abs(known[np.isfinite(known)]).max(), np.float32)
        mine, theirs = shared(self.corner, psi.shape, at, known.shape)
        psi[mine] = np.minimum(known[theirs], psi[mine])
        fence = prepared.fence(box)
        if fence is not None:
            np.maximum(psi, fence, out=psi)
        spacing = prepared.geometry.spacing
        surface = LevelSet(psi, spacing, half_width(config), self.workers, overwrite=True)
        fields = None if before is None else moved(self.flow.fields, before.surface, at, surface, self.corner)
        image = np.ascontiguousarray(prepared.image[box])
        energy, self.terms = make_energy(config, image, spacing, self.context.on(box))
        if fence is not None:
            energy = MaskConstraint(energy, fence)
        self.energy = NonOverlap(energy, self.corner)
        self._go_on(surface, before, fields)

    def _go_on(self, surface: LevelSet, before: Evolution | None, fields: list[NDArray[np.float32]] | None) -> None:
        config = self._config
        self.evolution = Evolution(
            surface,
            self.energy,
            self.flow,
            StepLimits(config.cfl, config.percentile),
            config.max_steps,
            Restart() if config.restart == "auto" else None,
            stop_rule(config, 1),
            before=before,
            fields=fields,
        )
        # Others see it before its first step.
        self.evolution.begin()

    @property
    def surface(self) -> LevelSet:
        """The surface now."""
        return self.evolution.surface

    @property
    def as_neighbour(self) -> Neighbour:
        """What others see of it."""
        return Neighbour(self.surface, self.corner, self.energy, self.flow)

    @property
    def moves(self) -> bool:
        """Whether it has not stopped."""
        return self.evolution.stop is None

    @property
    def history(self) -> list[StepRecord]:
        """Its steps so far."""
        return self.evolution.history

    @property
    def stop(self) -> Stop:
        """Why it stopped, when it has."""
        stop = self.evolution.stop
        assert stop is not None
        if self.leaked and stop.reason == "interrupted":
            message = f"the object grew beyond {self._config.max_volume:g} mm3, the largest volume it may have"
            return stop._replace(reason="leaked", message=message)
        return stop

    def extent(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First voxel of the band and the one after its last, in the common grid; of no band an empty box."""
        if self.surface.size == 0:
            return np.array(self.corner), np.array(self.corner)
        index = np.unravel_index(self.surface.band.cells, self.surface.shape)
        low, high = ([int(f(i)) + c for i, c in zip(index, self.corner, strict=True)] for f in (np.min, np.max))
        return np.array(low), np.array(high) + 1

    def fence(self) -> NDArray[np.float32] | None:
        """The mask's fence on its grid, if there is one."""
        z, y, x = (slice(c, c + n) for c, n in zip(self.corner, self.surface.shape, strict=True))
        return self._prepared.fence((z, y, x))

    def step(self) -> StepRecord:
        """Make a step."""
        step = self.evolution.step()
        assert step is not None
        row = step.row
        self.energy.react_to_contact(self.surface, self.flow)
        if self.evolution.stop is not None and self.surface.size:
            # Neighbours would follow what is left of its speed, into a surface that stands still.
            self.evolution.zero_momentum()
        most = self._config.max_volume
        if most is not None and row.volume_mm3 > most:
            self.leaked = True
            self.evolution.ask_to_stop()
        return row

    def grow(self) -> None:
        """Go over to a larger grid when the band comes near the edge of this one."""
        low, high = self.extent()
        corner, shape = np.array(self.corner), np.array(self.surface.shape)
        ends = np.array(self._prepared.geometry.shape)
        near = ((low - corner < GUARD) & (corner > 0)) | ((corner + shape - high < GUARD) & (corner + shape < ends))
        if near.any():
            box = self._boxed(np.minimum(low, corner + GUARD), np.maximum(high, corner + shape - GUARD))
            self.evolution.hand_over()
            self._begin(box, self.surface.psi, self.corner, self.evolution)

    def wake(self) -> None:
        """Move again after it had converged: a neighbour ran into it."""
        # The row of the final state: it was not.
        self.history.pop()
        self._go_on(self.surface, self.evolution, self.flow.fields)


def _least_room(config: RunConfig, prepared: PreprocessedInput) -> tuple[int, int, int]:
    """Voxels that an object needs around itself for its energy to see what it would see on the whole grid."""
    shape, spacing = prepared.geometry.shape, prepared.geometry.spacing
    usual = WINDOW_VOXELS * largest_spacing(shape, spacing)
    local = [t for t in energy_expression.parse(config.energy) if t.name == "local-region"]
    # Windows half their width off the surface are cut by it, and reach as far again.
    reach = max((2.0 * TENT * float(term.settings.get("R", usual)) for term in local), default=0.0)
    z, y, x = (max(ROOM, math.ceil(reach / h) + GUARD) for h in spacing)
    return z, y, x


def moved(
    fields: Sequence[NDArray[np.float32]], old: LevelSet, at: Corner, new: LevelSet, corner: Corner
) -> list[NDArray[np.float32]]:
    """Fields (n,) of a band on the band of the same surface on another grid, whose first voxels are ``at``, ``corner``.

    What is new there gets the value of the front along the normal.
    """
    index = np.unravel_index(new.band.cells, new.shape)
    place = np.stack([i + (c - a) for i, a, c in zip(index, at, corner, strict=True)])
    there = ((place >= 0) & (place < np.array(old.shape)[:, None])).all(axis=0)
    cells = np.ravel_multi_index(tuple(np.where(there, place, 0)), old.shape)
    slot = np.minimum(np.searchsorted(old.band.cells, cells), max(old.size - 1, 0))
    there &= old.band.cells[slot] == cells
    out = []
    for field in fields:
        values = np.where(there, field[slot], np.float32(0.0))
        known = np.where(there, np.float32(1.0), np.float32(0.0))
        spread = values.copy()
        new.extend_outwards(spread, new.front())
        out.append(np.where(known > 0, values, spread).astype(np.float32))
    return out


class Objects:
    """Moves several surfaces until all have stopped; iterate to run: (id, row) for each step of each.

    Parameters
    ----------
    starts : sequence of ObjectStart
        In order of their ids, on the grid of ``prepared``.
    prepared : Prepared
    config : RunConfig
    threads : int

    Raises
    ------
    InputError
        When nothing of a start lies within region of interest and mask.
    """

    def __init__(
        self, starts: Sequence[ObjectStart], prepared: PreprocessedInput, config: RunConfig, threads: int
    ) -> None:
        self._config, self._steps = config, prepared.geometry.steps
        self._asked = False
        self._stack = ExitStack()
        self._together = self._stack.enter_context(Workers(threads))
        self._pool = self._stack.enter_context(ThreadPoolExecutor(threads)) if threads > 1 else None
        self.objects = [
            Moving(_within(one, prepared), place, prepared, config) for place, one in enumerate(starts)
        ]

    def __enter__(self) -> Objects:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def ask_to_stop(self) -> None:
        """End the run after the present steps, with the reason ``interrupted``."""
        self._asked = True

    @property
    def kernels(self) -> dict[str, float]:
        """Seconds in each kernel, over all objects and threads."""
        total: dict[str, float] = {}
        for one in self.objects:
            for name, seconds in one.workers.seconds.items():
                total[name] = total.get(name, 0.0) + seconds
        return total

    def __iter__(self) -> Iterator[tuple[int, StepRecord]]:
        """Run in rounds."""
        while moving := [one for one in self.objects if one.moves]:
            if self._asked:
                for one in moving:
                    one.evolution.ask_to_stop()
            meets = self._meet()
            for batch in self._batches(meets):
                for one, row in zip(batch, self._each(Moving.step, batch), strict=True):
                    yield one.id, row
            self._each(Moving.grow, [one for one in moving if one.moves])
            if not self._asked:
                self._wake(meets)

    def _each(self, do: Callable[[Moving], T], batch: list[Moving]) -> list[T]:
        """Do something with objects that do not see each other; one alone gets all threads."""
        if self._pool is None or len(batch) > 1:
            return list(map(do, batch) if self._pool is None else self._pool.map(do, batch))
        with ExitStack() as stack:
            for one in batch:
                stack.enter_context(one.workers.helped_by(self._together))
            return [do(one) for one in batch]

    def _meet(self) -> list[list[int]]:
        """Tell each object its neighbours; those of each by their places."""
        bands = [one.extent() for one in self.objects]
        low, high = np.array([band[0] for band in bands]), np.array([band[1] for band in bands])
        there = np.array([one.surface.size > 0 for one in self.objects])
        boxes = meeting(low - REACH, high + REACH)
        meets = [[j for j in near if there[i] and there[j]] for i, near in enumerate(boxes)]
        for one, near in zip(self.objects, meets, strict=True):
            others = (self.objects[j] for j in near)
            one.energy.neighbours = [other.as_neighbour for other in others]
        return meets

    def _batches(self, meets: list[list[int]]) -> list[list[Moving]]:
        """Objects that move, shared out so that none in a batch sees another there; lower ids come first."""
        batch: dict[int, int] = {}
        for i, one in enumerate(self.objects):
            if one.moves:
                taken = {batch[j] for j in meets[i] if j in batch}
                batch[i] = next(k for k in range(len(taken) + 1) if k not in taken)
        out: list[list[Moving]] = [[] for _ in range(max(batch.values()) + 1)]
        for i, k in batch.items():
            out[k].append(self.objects[i])
        return out

    def _wake(self, meets: list[list[int]]) -> None:
        """Wake what has converged and was run into."""
        most = PUSHED * min(self._steps)
        for i, one in enumerate(self.objects):
            stop = one.evolution.stop
            if stop is None or stop.reason != "converged" or stop.steps >= self._config.max_steps:
                continue
            moving = [self.objects[j] for j in meets[i] if self.objects[j].moves]
            one.energy.neighbours = [other.as_neighbour for other in moving]
            if one.energy.overlap(one.surface) > most:
                one.wake()

    def apart(self) -> list[NDArray[np.float32]]:
        """Psi of each object on its grid, cut where it meets another: none overlap."""
        low = np.array([one.corner for one in self.objects])
        high = low + np.array([one.surface.shape for one in self.objects])
        out = []
        for i, near in enumerate(meeting(low, high)):
            one = self.objects[i]
            psi, own = one.surface.psi.copy(), one.surface.psi
            for j in near:
                other = self.objects[j]
                mine, theirs = shared(one.corner, own.shape, other.corner, other.surface.shape)
                a, b = own[mine], other.surface.psi[theirs]
                np.maximum(psi[mine], np.float32(0.5) * (a - b), out=psi[mine])
                # Where both are equally deep the lower id has the voxel.
                tie = (a == b) & (a < 0)
                psi[mine][tie] = np.float32(-1e-6 if i < j else 1e-6) * np.float32(min(self._steps))
            fence = one.fence()
            out.append(psi if fence is None else np.maximum(psi, fence))
        return out


def _within(one: ObjectStart, prepared: PreprocessedInput) -> ObjectStart:
    """A start on the grid of the region of interest, behind the fence."""
    box, roi = tuple(slice(c, c + n) for c, n in zip(one.corner, one.psi.shape, strict=True)), prepared.box
    a, b, c = (slice(max(s.start, r.start), min(s.stop, r.stop)) for s, r in zip(box, roi, strict=True))
    if all(s.start < s.stop for s in (a, b, c)):
        psi = one.psi[tuple(slice(s.start - k, s.stop - k) for s, k in zip((a, b, c), one.corner, strict=True))]
        at = (a.start - roi[0].start, b.start - roi[1].start, c.start - roi[2].start)
        fence = prepared.fence(tuple(slice(k, k + n) for k, n in zip(at, psi.shape, strict=True)))  # type: ignore[arg-type]
        if ((psi if fence is None else np.maximum(psi, fence)) < 0).any():
            return ObjectStart(one.id, at, psi)
    raise InputError(
        f"object {one.id}: nothing of its start lies in the mask and the region of interest", "start within them"
    )
