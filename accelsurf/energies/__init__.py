"""Energies: each gives its value U and its force f = -dU along the inward normal per area.

The loop calls, in this order: `start` once with the first surface; at each step `value` and `force`; after each motion
`project`, and after redistancing `follow` with the change. See `Energy` for the protocol; `ImageEnergy`
and the ``..._at_front`` functions are for energies of your own.
"""

from accelsurf.energies.chan_vese import ChanVese, LocalRegion
from accelsurf.energies.energy import Energy
from accelsurf.energies.front_samples import (
    normals_at_front,
    points_at_front,
    sample_at_front,
    slope_at_front,
)
from accelsurf.energies.geodesic import Geodesic, edge_contrast, edge_indicator
from accelsurf.energies.image_energy import AreaTerm, ImageEnergy, RegionField
from accelsurf.energies.likelihood import (
    Gaussian,
    GaussianLikelihood,
    HistogramLikelihood,
    Parzen,
    gaussian_of,
)
from accelsurf.energies.region_sums import MomentTracker, RegionMoments
from accelsurf.energies.threshold import Threshold
from accelsurf.energies.user_energy import CheckedEnergy
from accelsurf.energies.weighted_sum import Area, Balloon, BetweenFrames, WeightedSum

__all__ = [
    "Area",
    "AreaTerm",
    "Balloon",
    "BetweenFrames",
    "ChanVese",
    "CheckedEnergy",
    "Energy",
    "Gaussian",
    "GaussianLikelihood",
    "Geodesic",
    "HistogramLikelihood",
    "ImageEnergy",
    "LocalRegion",
    "Parzen",
    "RegionField",
    "MomentTracker",
    "RegionMoments",
    "Threshold",
    "WeightedSum",
    "edge_contrast",
    "edge_indicator",
    "gaussian_of",
    "normals_at_front",
    "points_at_front",
    "sample_at_front",
    "slope_at_front",
]
