"""Uncertain places of a finished run, where to click next: those whose surface has the least evidence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from accelsurf.measure.evidence import doubtful_places, gather
from accelsurf.run.result import Result, SegmentedObject

#: Places that are offered, of all objects together.
COUNT = 5
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
    ranked = [(rank, doubt) for segmented in result.objects for rank, doubt in enumerate(_doubts(segmented))]
    return tuple(doubt for _, doubt in sorted(ranked, key=lambda entry: (entry[0], -entry[1].share))[:COUNT])


def _doubts(segmented: SegmentedObject) -> list[Doubt]:
    inside = segmented.psi < 0
    evidence = gather(inside, segmented.image, segmented.geometry.spacing, segmented.clicked)
    if evidence is None:
        return []
    volume = float(np.count_nonzero(inside)) * segmented.geometry.voxel_volume
    out = []
    for index, share in doubtful_places(evidence, segmented.geometry.spacing, volume, COUNT):
        x, y, z = (float(v) for v in segmented.geometry.index_to_world(np.array(index, float)))
        if share >= MIN_SHARE:
            out.append(Doubt((x, y, z), share, segmented.id))
    return out
