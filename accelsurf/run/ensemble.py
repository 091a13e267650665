"""Objects that move beside each other and never overlap.

They move in rounds, one step each. Those that are near each other take turns, in the order of their ids, and each uses
the present surfaces of the others; all others move at the same time in threads. So the result does not depend on the
number of threads.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.evolution import LevelSummary, Step, Stop, StopReason
from accelsurf.grid.boxes import Corner, bounding_box, box_at, meeting
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.pyramid import Level
from accelsurf.grid.window import Window
from accelsurf.levelset import Workers
from accelsurf.run.evolving_object import EvolvingObject
from accelsurf.run.preprocessing import PreprocessedInput
from accelsurf.starts import ObjectStart

#: Objects can touch in a step where the boxes around them, larger by this number of voxels on each side, overlap:
#: contact sets in over one voxel, and none moves by more than one.
NEAR = 2
#: A converged object moves again when a neighbour is this deep inside it, in voxels of the smallest spacing, and each
#: further time when it is so much deeper than the last time: two that converge where they overlap would set each other
#: going for ever.
REACTIVATION_DEPTH = 0.5
#: Reasons that hold for the whole run if they hold for any object, the worst first.
_WORST: tuple[StopReason, ...] = (
    "interrupted",
    "diverged",
    "leaked",
    "stalled",
    "max-steps",
    "filled",
)
T = TypeVar("T")


class Ensemble:
    """Steps all objects of a run.

    Parameters
    ----------
    objects : sequence of EvolvingObject
        In order of their ids.
    workers : Workers
        The threads to use.
    steps : sequence of float
        Spacings of the axes that count, mm.
    meet : bool
        Whether they can touch; False for a single object.
    window : Window, optional
        The part of a larger grid that theirs is.
    """

    def __init__(
        self,
        objects: Sequence[EvolvingObject],
        workers: Workers,
        steps: Sequence[float],
        meet: bool,
        window: Window | None = None,
    ) -> None:
        self._objects = tuple(objects)
        self._workers = workers
        self._meets = meet
        self._window = window
        self._smallest = min(steps)
        several = meet and workers.threads > 1
        self._pool = ThreadPoolExecutor(workers.threads) if several else None

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def step(self, steps_left: int, reactivate: bool = True) -> tuple[Step, ...]:
        """One step of each object that moves; none when all have ended on their level.

        Parameters
        ----------
        steps_left : int
            How many steps may follow, this one included, whatever an object has made itself.
        reactivate : bool
            Whether objects that have converged move again when others push into them.

        Raises
        ------
        LeavesWindow
            When a surface, or the part that its energy sees, comes near an open face of the window.
        """
        steps = self._steps(steps_left, reactivate)
        if self._window is not None:
            for evolving in self._objects:
                if evolving.surface.size:
                    self._window.check_box(evolving.seen(), evolving.grid.factors)
        return steps

    def _steps(self, steps_left: int, reactivate: bool) -> tuple[Step, ...]:
        if not self._meets:
            alone = [evolving.step() for evolving in self._objects]
            return tuple(step for step in alone if step is not None)
        moving = [evolving for evolving in self._objects if evolving.moves]
        if not moving:
            return ()
        for evolving in moving:
            evolving.set_max_steps(steps_left + len(evolving.evolution.history))
        meets = self._meet()
        steps = [
            step
            for batch in self._batches(meets)
            for step in self._each(EvolvingObject.step, batch)
        ]
        # Vanished objects need no room.
        self._each(
            EvolvingObject.grow_grid,
            [evolving for evolving in moving if evolving.moves and evolving.surface.size],
        )
        if reactivate and steps_left > 1:
            self.reactivate_touched(meets)
        return tuple(step for step in steps if step is not None)

    def _each(self, work: Callable[[EvolvingObject], T], batch: list[EvolvingObject]) -> list[T]:
        """Call ``work`` for objects that are not neighbours; a single one gets all threads."""
        if self._pool is None or len(batch) > 1:
            return list(map(work, batch) if self._pool is None else self._pool.map(work, batch))
        with ExitStack() as stack:
            for evolving in batch:
                stack.enter_context(evolving.workers.borrowing_threads(self._workers))
            return [work(evolving) for evolving in batch]

    def _meet(self) -> list[list[int]]:
        """Set the neighbours of each object; return their positions in the list of objects."""
        ends = [
            np.array(moving.corner) + moving.surface.extent(inside_only=True)
            for moving in self._objects
        ]
        low, high = np.array([end[0] for end in ends]), np.array([end[1] for end in ends])
        there = np.all(low < high, axis=1).tolist()
        boxes = meeting(low - NEAR, high + NEAR)
        meets = [[j for j in near if there[i] and there[j]] for i, near in enumerate(boxes)]
        for evolving, near in zip(self._objects, meets, strict=True):
            others = (self._objects[j] for j in near)
            evolving.contact.set_neighbours([other.as_neighbour for other in others])
        return meets

    def _batches(self, meets: list[list[int]]) -> list[list[EvolvingObject]]:
        """The moving objects in batches without neighbours among them; lower ids come first."""
        batch: dict[int, int] = {}
        for i, evolving in enumerate(self._objects):
            if evolving.moves:
                taken = {batch[j] for j in meets[i] if j in batch}
                batch[i] = next(k for k in range(len(taken) + 1) if k not in taken)
        out: list[list[EvolvingObject]] = [[] for _ in range(max(batch.values()) + 1)]
        for i, k in batch.items():
            out[k].append(self._objects[i])
        return out

    def reactivate_touched(self, meets: list[list[int]]) -> None:
        """Continue converged objects that a neighbour has moved into."""
        for i, evolving in enumerate(self._objects):
            stop = evolving.evolution.stop
            if (
                stop is None
                or stop.reason != "converged"
                or stop.steps >= evolving.evolution.max_steps
            ):
                continue
            moving = [self._objects[j] for j in meets[i] if self._objects[j].moves]
            evolving.contact.set_neighbours([other.as_neighbour for other in moving])
            depth = REACTIVATION_DEPTH * (evolving.reactivations + 1) * self._smallest
            if evolving.contact.overlap(evolving.surface) > depth:
                evolving.reactivate()

    def summary(self, grid: Level) -> LevelSummary:
        """Return the summary of the present level, ``grid``, so far."""
        stops = [evolving.evolution.stop for evolving in self._objects]
        ended = [stop for stop in stops if stop is not None]
        reason = overall_stop(ended).reason if len(ended) == len(stops) else None
        return LevelSummary(
            grid, max(evolving.steps_on_level() for evolving in self._objects), reason
        )

    def separated(
        self, mask_distance: NDArray[np.float32] | None
    ) -> list[tuple[Corner, NDArray[np.float32]]]:
        """First voxel and psi of each object on the finest grid, cut where it meets another: none overlap."""
        parts = [evolving.psi_on_finest() for evolving in self._objects]
        # One cuts another only where it is deeper inside than the other is outside.
        deepest = max(-float(psi.min()) for _, psi in parts)
        low, high = (
            np.array(ends)
            for ends in zip(*(_ends(at, psi < deepest) for at, psi in parts), strict=True)
        )
        out = []
        for i, near in enumerate(meeting(low, high)):
            corner, uncut = parts[i]
            psi = uncut.copy()
            for j in near:
                at, theirs_psi = parts[j]
                first, end = np.maximum(low[i], low[j]), np.minimum(high[i], high[j])
                mine, theirs = (box_at(tuple(first - c), tuple(end - first)) for c in (corner, at))
                a, b = uncut[mine], theirs_psi[theirs]
                cut = np.float32(0.5) * (a - b)
                # Where both are equally deep the lower id has the voxel, unless a third is deeper.
                cut[(a == b) & (a < 0)] = np.float32(-1e-6 if i < j else 1e-6) * np.float32(
                    self._smallest
                )
                np.maximum(psi[mine], cut, out=psi[mine])
            if mask_distance is not None:
                psi = np.maximum(psi, mask_distance[box_at(corner, psi.shape)])
            out.append((corner, psi))
        return out


def _ends(corner: Corner, near: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first voxel of a mask on a box of the grid, and the one after its last; equal where it is empty."""
    box = bounding_box(near) or box_at((0, 0, 0), (0, 0, 0))
    return np.add(corner, [part.start for part in box]), np.add(corner, [part.stop for part in box])


def union_of(starts: Sequence[ObjectStart], geometry: Geometry) -> NDArray[np.float32]:
    """Psi of the union of first surfaces on the whole grid."""
    union = np.full(geometry.shape, np.float32(0.5 * min(geometry.steps)), np.float32)
    for start in starts:
        box = box_at(start.corner, start.psi.shape)
        np.minimum(union[box], start.psi, out=union[box])
    return union


def within(start: ObjectStart, prepared: PreprocessedInput) -> ObjectStart:
    """A start on the grid of the region of interest, within the mask.

    Raises
    ------
    InputError
        When nothing of it lies there.
    """
    box, roi = box_at(start.corner, start.psi.shape), prepared.box
    a, b, c = (
        slice(max(s.start, r.start), min(s.stop, r.stop)) for s, r in zip(box, roi, strict=True)
    )
    if all(s.start < s.stop for s in (a, b, c)):
        psi = start.psi[
            tuple(
                slice(s.start - k, s.stop - k) for s, k in zip((a, b, c), start.corner, strict=True)
            )
        ]
        at = (a.start - roi[0].start, b.start - roi[1].start, c.start - roi[2].start)
        distance = prepared.mask_distance
        inside = psi
        if distance is not None:
            inside = np.maximum(
                psi, distance[tuple(slice(k, k + n) for k, n in zip(at, psi.shape, strict=True))]
            )
        if (inside < 0).any():
            return ObjectStart(start.id, at, psi)
    raise InputError(
        f"object {start.id}: its start lies outside of the mask and the region of interest",
        "start within them",
    )


def overall_stop(stops: Sequence[Stop]) -> Stop:
    """Why several ended: ``converged`` if all that moved did, ``vanished`` if none remains, else the worst."""
    counts: Counter[StopReason] = Counter(stop.reason for stop in stops)
    worst = next((reason for reason in _WORST if counts[reason]), None)
    good: tuple[StopReason, ...] = ("converged", "given", "vanished")
    left = next((reason for reason in good if counts[reason]), good[-1])
    message = ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items()))
    steps, longest = max(stop.steps for stop in stops), max(stop.time for stop in stops)
    said = f"of {len(stops)} objects {message}" if len(stops) > 1 else f"1 object {stops[0].reason}"
    return Stop(worst or left, steps, longest, said)
