"""A run between two steps, as a value."""

from __future__ import annotations

from typing import NamedTuple

from accelsurf.evolution.multilevel import LevelSummary
from accelsurf.segmentation.object_records import ObjectCheckpoint
from accelsurf.settings.run_config import RunConfig


class RunCheckpoint(NamedTuple):
    """A run between two steps, before the edits of the coming one.

    Attributes
    ----------
    step : int
        Number of the coming step.
    settings : RunConfig
        In force.
    edits_done : int
        How many edits were applied.
    level : int
    objects : tuple of ObjectCheckpoint
    summaries : tuple of LevelSummary
        Of the levels before.
    warnings : tuple of str
    """

    step: int
    settings: RunConfig
    edits_done: int
    level: int
    objects: tuple[ObjectCheckpoint, ...]
    summaries: tuple[LevelSummary, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        """Memory that it takes at most."""
        return sum(one.nbytes for one in self.objects)
