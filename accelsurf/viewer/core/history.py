"""Checkpoints of a run: as many as a memory budget holds, dense near the last step, sparse further back."""

from __future__ import annotations

from collections.abc import Iterator

from accelsurf.segmentation.run_checkpoint import RunCheckpoint


class CheckpointHistory:
    """Checkpoints by step, within a memory budget.

    When the budget is exceeded, the checkpoint goes whose neighbours lie closest together relative to its age; the
    first and the last stay. One can then go back approximately to any step, and one by one over the last steps.

    Parameters
    ----------
    budget_mb : float
        Memory for the checkpoints, MB (10^6 bytes); at least two are stored whatever they take.
    """

    def __init__(self, budget_mb: float) -> None:
        self.budget = budget_mb * 1e6
        self._checkpoints: dict[int, RunCheckpoint] = {}
        self._bytes = 0

    @property
    def steps(self) -> tuple[int, ...]:
        """The steps that have a checkpoint, in order."""
        return tuple(self._checkpoints)

    @property
    def nbytes(self) -> int:
        """Memory that the checkpoints take."""
        return self._bytes

    @property
    def last(self) -> RunCheckpoint | None:
        """The checkpoint of the last step; None without any."""
        return self._checkpoints[max(self._checkpoints)] if self._checkpoints else None

    def __len__(self) -> int:
        return len(self._checkpoints)

    def __iter__(self) -> Iterator[RunCheckpoint]:
        return iter(self._checkpoints.values())

    def add(self, checkpoint: RunCheckpoint) -> None:
        """Store a checkpoint, unless there is one of that step already, which is the same."""
        if checkpoint.step in self._checkpoints:
            return
        self._checkpoints[checkpoint.step] = checkpoint
        self._bytes += checkpoint.nbytes
        steps = list(self._checkpoints)
        if steps[-2:] != sorted(steps[-2:]):
            self._checkpoints = dict(sorted(self._checkpoints.items()))
        while self._bytes > self.budget and len(self._checkpoints) > 2:
            self._thin_out()

    def nearest(self, step: int, level: int) -> RunCheckpoint | None:
        """Return the last checkpoint at or before a step that is of this level."""
        found = [c for c in self if c.step <= step and c.level == level]
        return found[-1] if found else None

    def drop_after(self, step: int) -> None:
        """Forget the checkpoints after a step."""
        for later in [other for other in self._checkpoints if other > step]:
            self._bytes -= self._checkpoints.pop(later).nbytes

    def clear(self) -> None:
        """Forget all checkpoints."""
        self._checkpoints, self._bytes = {}, 0

    def _thin_out(self) -> None:
        steps = list(self._checkpoints)
        last = steps[-1]
        gaps = {
            at: (after - before) / (last - at + 2.0)
            for before, at, after in zip(steps, steps[1:], steps[2:], strict=False)
        }
        dropped = min(gaps, key=lambda at: gaps[at])
        self._bytes -= self._checkpoints.pop(dropped).nbytes
