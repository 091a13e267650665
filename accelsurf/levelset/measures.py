"""What is measured on the band: shares of voxels, area, curvature."""

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
