"""The filters of a run's image, from its settings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.image_filters import ImageFilters
from accelsurf.grid.volume import Volume
from accelsurf.settings import budgets
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.written_values import bounds_of


def in_mm(length: float | str, geometry: Geometry) -> float:
    """A length of `RunConfig` in mm: as it is, or ``Nvox`` in voxels of the smallest spacing.

    Examples
    --------
    >>> in_mm("1.5vox", Geometry((8, 6, 4), (3.0, 2.0, 2.0)))
    3.0
    """
    if not isinstance(length, str):
        return length
    return float(length.removesuffix("vox")) * min(geometry.steps)


def filters_of(config: RunConfig, geometry: Geometry) -> ImageFilters:
    """What a run filters its image by: ``clip``, ``closing`` and ``presmooth``.

    Raises
    ------
    UsageError
        When one of them would take too long.
    """
    filters = ImageFilters(bounds_of(config.clip), in_mm(config.closing, geometry), in_mm(config.presmooth, geometry))
    check_filters(filters, geometry)
    return filters


def check_filters(filters: ImageFilters, geometry: Geometry) -> None:
    """Refuse a Gaussian or a closing that takes too long."""
    smallest = min(geometry.steps)
    budgets.SMOOTHING.check(
        math.ceil(filters.sigma / smallest), f"presmooth: a sigma of {filters.sigma:g} mm", kind=UsageError
    )
    budgets.CLOSING.check(
        math.floor(filters.closing / smallest), f"closing: a radius of {filters.closing:g} mm", kind=UsageError
    )


def filtered_volume(volume: Volume, filters: ImageFilters) -> NDArray[np.float32]:
    """The image as float32, filtered."""
    return filters.of_whole(volume.as_float32(), volume.geometry.spacing)
