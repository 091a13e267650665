"""Several objects told as one: their histories summed, their terms with what differs between them."""

from __future__ import annotations

from collections import Counter
from typing import Any

from accelsurf.evolution.records import StepRecord

#: Columns of the history that are summed over objects, and those of which the largest counts.
SUMMED = (
    "potential", "kinetic", "mass_potential", "friction_work", "smoothing_work", "noise_work", "mass", "volume_mm3",
    "area_mm2", "band_cells", "cells_visited", "seconds",
)
LARGEST = ("mass_correction", "clamped_fraction", "motion_voxels", "limited_fraction")


def combined_history(histories: list[list[StepRecord]]) -> list[StepRecord]:
    """The history of several objects together, by step.

    Energies, mass, volume and area are summed; the columns of `LARGEST` have the largest value of any object; the other
    columns are those of the first. An object that has stopped counts with its last record.
    """
    records = []
    for step in range(max(map(len, histories))):
        now = [history[min(step, len(history) - 1)] for history in histories]
        sums = {key: sum(getattr(record, key) for record in now) for key in SUMMED}
        largest = {key: max((getattr(record, key) for record in now), key=abs) for key in LARGEST}
        records.append(now[0]._replace(step=step, restarted=False, **sums, **largest))
    return records


def before_corrections(history: list[StepRecord], edits: set[int]) -> list[StepRecord]:
    """The records of a run without those of corrections after it; ``edits`` are the steps of edits of the run itself.

    A correction counts as an edit before its first step, and replaces the record of the final state.
    """
    begun = [n for n, row in enumerate(history) if n and row.edits and row.step not in edits]
    return history[: begun[0]] if begun else history


def common_terms(terms: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """The terms of all objects; "by object" where a setting differs. Objects that began later may have other terms.

    Examples
    --------
    >>> common_terms([[{"term": "threshold", "LO": 3}], [{"term": "threshold", "LO": 4}]])
    [{'term': 'threshold', 'LO': 'by object'}]
    >>> common_terms([[{"term": "chan-vese"}], [{"term": "seeded"}]])
    [{'term': 'chan-vese'}, {'term': 'seeded'}]
    """
    same: dict[tuple[Any, int], list[dict[str, Any]]] = {}
    for own in terms:
        counts = Counter[Any]()
        for term in own:
            name = term.get("term")
            same.setdefault((name, counts[name]), []).append(term)
            counts[name] += 1
    return [
        {key: value if all(one.get(key) == value for one in alike) else "by object" for key, value in alike[0].items()}
        for alike in same.values()
    ]
