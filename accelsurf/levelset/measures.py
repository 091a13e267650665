"""What is measured on the band: shares of voxels, area, curvature, and what a redistancing did to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Measures(NamedTuple):
    """What was measured on the band, see `LevelSet.fraction_and_area` and `LevelSet.curvature`.

    ``fraction`` and ``area`` (n,); ``curvature`` and ``variation`` (n,), where they could be measured, as ``resolved``
    (n,) says.
    """

    fraction: np.ndarray
    area: np.ndarray
    curvature: np.ndarray
    variation: np.ndarray
    resolved: np.ndarray


class BandChange(NamedTuple):
    """What a redistancing did to the band.

    ``entered_inside`` and ``left_inside`` are the raveled cells with psi < 0 that came into the band and
    that left it; ``fields`` are the extended fields on the new band.
    """

    entered_inside: np.ndarray
    left_inside: np.ndarray
    fields: list[np.ndarray]
