"""Kept states of a run: as many as a budget of memory holds, close together where the run is, sparse further back."""

from __future__ import annotations

from collections.abc import Iterator

from accelsurf.segmentation.run import RunCheckpoint


class CheckpointHistory:
    """States by step, within a budget.

    When it is spent the state goes whose neighbours lie closest together for how long ago it was; the first and the
    last stay. Any time can then be gone back to roughly, and the last steps one by one.

    Parameters
    ----------
    budget_mb : float
        Memory for the states, MB (10^6 bytes); two are kept whatever they take.
    """

    def __init__(self, budget_mb: float) -> None:
        self.budget = budget_mb * 1e6
        self._states: dict[int, RunCheckpoint] = {}
        self._bytes = 0

    @property
    def steps(self) -> tuple[int, ...]:
        """The steps that there are states of, in order."""
        return tuple(self._states)

    @property
    def nbytes(self) -> int:
        """Memory that the states take."""
        return self._bytes

    def __len__(self) -> int:
        return len(self._states)

    def __iter__(self) -> Iterator[RunCheckpoint]:
        return iter(self._states.values())

    def add(self, state: RunCheckpoint) -> None:
        """Keep a state; one of that step which is there already is the same."""
        if state.step in self._states:
            return
        self._states[state.step] = state
        self._bytes += state.nbytes
        steps = list(self._states)
        if steps[-2:] != sorted(steps[-2:]):
            self._states = dict(sorted(self._states.items()))
        while self._bytes > self.budget and len(self._states) > 2:
            self._thin()

    def nearest(self, step: int, level: int) -> RunCheckpoint | None:
        """Return the last state at or before a step that is of this level."""
        found = [s for s in self if s.step <= step and s.level == level]
        return found[-1] if found else None

    def drop_after(self, step: int) -> None:
        """Forget the states after a step: the run goes another way from there."""
        for later in [other for other in self._states if other > step]:
            self._bytes -= self._states.pop(later).nbytes

    def clear(self) -> None:
        """Forget all."""
        self._states, self._bytes = {}, 0

    def _thin(self) -> None:
        steps = list(self._states)
        last = steps[-1]
        gaps = {
            at: (after - before) / (last - at + 2.0)
            for before, at, after in zip(steps, steps[1:], steps[2:], strict=False)
        }
        gone = min(gaps, key=lambda at: gaps[at])
        self._bytes -= self._states.pop(gone).nbytes
