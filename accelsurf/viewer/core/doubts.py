"""Where to click next: the places of a finished run whose surface has the least evidence."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from accelsurf.analysis.evidence import doubtful_places, gather
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.segmentation.run import Run
from accelsurf.segmentation.run_result import result_of

#: Places that are offered, of all objects together.
COUNT = 5
#: Seconds without a command after which they are looked for.
QUIET = 0.4
#: Below this share of doubt there is nothing to click.
MIN_SHARE = 0.1


class Doubt(NamedTuple):
    """A doubtful place: ``world`` (x, y, z), mm LPS, ``share`` of doubt there, 0 to 1, and whose surface it is on."""

    world: tuple[float, float, float]
    share: float
    object_id: int


def doubts_of(result: Result) -> tuple[Doubt, ...]:
    """Return the most doubtful places of a result, the first of each object as `Quality.next_click` has it.

    Parameters
    ----------
    result : Result
        Of a run that has ended.
    """
    ranked = [(rank, doubt) for one in result.objects for rank, doubt in enumerate(_doubts(one))]
    return tuple(doubt for _, doubt in sorted(ranked, key=lambda one: (one[0], -one[1].share))[:COUNT])


def _doubts(one: SegmentedObject) -> list[Doubt]:
    inside = one.psi < 0
    evidence = gather(inside, one.image, one.geometry.spacing, one.clicked)
    if evidence is None:
        return []
    volume = float(np.count_nonzero(inside)) * one.geometry.voxel_volume
    out = []
    for index, share in doubtful_places(evidence, one.geometry.spacing, volume, COUNT):
        x, y, z = (float(v) for v in one.geometry.index_to_world(np.array(index, float)))
        if share >= MIN_SHARE:
            out.append(Doubt((x, y, z), share, one.id))
    return out


class DoubtWatch:
    """When the doubts of a session are looked for: once for each state after the run's end, when nothing else is asked.

    Looking takes tenths of a second on a large object, which the next command must not wait for.
    """

    def __init__(self) -> None:
        self._looked_at, self._busy_until = -1, 0.0

    def is_wanted(self, version: int, has_ended: bool) -> bool:
        """Whether this version of the state has not been looked at."""
        return has_ended and self._looked_at != version

    def postpone(self) -> None:
        """Something was done: wait again until it has been quiet for some time."""
        self._busy_until = time.perf_counter() + QUIET

    def find(self, version: int, run: Run, corrected: Result | None) -> tuple[Doubt, ...] | None:
        """The doubts of a version of the state; None while it is not quiet yet."""
        if time.perf_counter() < self._busy_until:
            return None
        self._looked_at = version
        return doubts_of(corrected if corrected is not None else result_of(run))
