"""The columns of the trace: one entry each, in the order in which they are written.

The entries without a ``value`` are the fields of `accelsurf.evolution.records.StepRecord`. An entry with one is
measured in each step, and the record has it under ``extra``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from accelsurf.settings.registry import by_name


@dataclass(frozen=True)
class TraceColumn:
    """The entry of a column of the trace.

    Attributes
    ----------
    name : str
    unit : str
        Empty for a number without one.
    help : str
        Description.
    value : callable, optional
        Of (surface, energy, flow), at the beginning of each step: the number. It must not change any of them.
    """

    name: str
    unit: str
    help: str
    value: Callable[[Any, Any, Any], float] | None = None


_ENERGY = "mm3"
TRACE_COLUMNS: dict[str, TraceColumn] = by_name(
    TraceColumn("step", "", "number of the step; the last row is the final state"),
    TraceColumn("level", "", "grid of the step: 0 is the image's own, 1 the next coarser one"),
    TraceColumn("t", "flow time", "time at the beginning of the step"),
    TraceColumn("dt", "flow time", "length of the step; 0 in the last row"),
    TraceColumn(
        "cfl_dt",
        "flow time",
        "length that the CFL limit alone would allow; where dt is less, waves, diffusion, noise or density limit it",
    ),
    TraceColumn(
        "potential",
        _ENERGY,
        "energy U that is minimised; values of different levels do not compare",
    ),
    TraceColumn("kinetic", "", "kinetic energy T of the paper; T/w is in mm3, as the potential"),
    TraceColumn("mass_potential", _ENERGY, "mass potential U_mass; 0 without gravity"),
    TraceColumn(
        "weight", "", "factor w of the potentials: U + U_mass + T/w never rises; 1 for descent"
    ),
    TraceColumn(
        "friction_work",
        _ENERGY,
        "energy that friction has taken so far, or in a descent its motion",
    ),
    TraceColumn(
        "smoothing_work",
        _ENERGY,
        "energy that diffusion, the speed limiter, restarts, changes of level, clicks and edits have taken so far",
    ),
    TraceColumn("noise_work", _ENERGY, "energy that noise has added so far"),
    TraceColumn("mass", "relative", "mass of the surface; 0 without momentum"),
    TraceColumn(
        "mass_correction", "relative", "fraction of the mass that was added so far to conserve it"
    ),
    TraceColumn("volume_mm3", "mm3", "volume of the object"),
    TraceColumn("area_mm2", "mm2", "area of the surface"),
    TraceColumn(
        "speed",
        "mm per unit of flow time",
        "the speed limiter's percentile of the absolute speed on the surface",
    ),
    TraceColumn(
        "motion_voxels", "voxels", "mean motion of the surface in the step, along the normal"
    ),
    TraceColumn(
        "limited_fraction", "", "share of front cells whose speed was clipped to the CFL limit"
    ),
    TraceColumn(
        "clamped_fraction",
        "",
        "share of the surface where a negative tension of gravity was clamped",
    ),
    TraceColumn("diffusion", "mm2 per unit of flow time", "velocity diffusion used in the step"),
    TraceColumn("band_cells", "", "cells of the narrow band"),
    TraceColumn(
        "cells_visited",
        "",
        "cells that all passes of the step visited: its cost, the same on any machine; 0 as the seconds",
    ),
    TraceColumn("restarted", "", "1 when momentum was set to zero before the step"),
    TraceColumn(
        "removed_components",
        "",
        "components removed because they are smaller than the grid resolves",
    ),
    TraceColumn(
        "seconds", "s", "wall time of the step; 0 of steps before a resumed run or a correction"
    ),
    TraceColumn("edits", "", "edits applied right before the step"),
    TraceColumn(
        "returned",
        "",
        "1 when the surface went back to that of the lowest energy before the step, at rest; in the last row, when the "
        "run ended there",
    ),
)


def added_measures() -> dict[str, Callable[[Any, Any, Any], float]]:
    """Return the functions of the columns that are measured in each step, by name, for `SolverSetup.measures`."""
    return {
        name: column.value for name, column in TRACE_COLUMNS.items() if column.value is not None
    }


def row_values(record: Any) -> dict[str, Any]:
    """Return the values of a StepRecord by column; None for a column that was not there when the step was made.

    Parameters
    ----------
    record : StepRecord
    """
    extra = dict(record.extra)
    return {
        name: getattr(record, name) if column.value is None else extra.get(name)
        for name, column in TRACE_COLUMNS.items()
    }
