"""State of a finished run besides its result, from which it can be refined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.clicks import Clicks
from accelsurf.segmentation.image_context import ImageContext
from accelsurf.segmentation.preprocessing import PreprocessedInput
from accelsurf.segmentation.run_setup import EnergyLike
from accelsurf.settings.run_config import RunConfig


class BoxMask(NamedTuple):
    """Voxels: a ``mask`` of bool on a ``box`` of the grid."""

    box: Box
    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RunState:
    """Inputs of a correction besides the surfaces and settings of a `Result`.

    Attributes
    ----------
    prepared : PreprocessedInput
        Image and mask of the run.
    contexts : mapping of int to ImageContext
        Of each object.
    energy : Energy or callable or None
        One of the user's own; None for one with a name.
    clicks : Clicks or None
        All clicks so far, on the grid of the region of interest; None for none.
    models : mapping of int to LocalState
        Of each object whose model refinements have needed, after all of them.
    totals : mapping of str to ndarray (2, m)
        Of `accelsurf.segmentation.region_totals.RegionTotals`; empty before the first refinement.
    settings : mapping of int to RunConfig
        Of objects whose settings are not those of the run: those that refinements have begun.
    masks : mapping of int to BoxMask
        By the number of a refinement, on the grid of the region of interest: voxels that its new object may not have,
        or that were split off.
    """

    prepared: PreprocessedInput
    contexts: Mapping[int, ImageContext] = field(default_factory=dict)
    energy: EnergyLike | None = None
    clicks: Clicks | None = None
    models: Mapping[int, Any] = field(default_factory=dict)
    totals: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    settings: Mapping[int, RunConfig] = field(default_factory=dict)
    masks: Mapping[int, BoxMask] = field(default_factory=dict)
