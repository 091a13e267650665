"""Where the surface of a run may be: mask, box around the object."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.constraints.mask import mask_distance
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box
from accelsurf.grid.window import Window
from accelsurf.initialization import starts
from accelsurf.segmentation.region_of_interest import region_of_interest
from accelsurf.settings.run_config import RunConfig


def distance_of_mask(
    config: RunConfig, given: Mapping[str, NDArray[np.float32]], window: Window, box: Box
) -> NDArray[np.float32] | None:
    """Signed distance, mm, of mask and box on the region ``box`` of a window; None without both."""
    if "mask" in given:
        mask = np.asarray(given["mask"] < 0)
    elif config.mask is not None:
        mask = read_mask(config.mask, window)
    elif config.box is not None:
        mask = np.ones(window.shape, np.bool_)
    else:
        return None
    if config.box is not None:
        within = np.zeros(window.shape, np.bool_)
        part = window.local(region_of_interest(config.box, window.geometry, "box"))
        within[part] = mask[part]
        mask = within
    return mask_distance(np.ascontiguousarray(mask[box]), window.geometry.spacing)


def read_mask(file: str, window: Window) -> NDArray[np.bool_]:
    """Voxels above 0 of a label map on the image's grid, in a window of it.

    Raises
    ------
    InputError
        When there is none, or the file cannot be read; GeometryError when it lies on another grid.
    """
    mask = np.asarray(starts.label_box(file, window, f"mask {file}") > 0)
    if not mask.any():
        there = "" if window.is_whole else " there"
        raise InputError(f"mask {file}: it is empty{there}", "give one with voxels above 0, where the surface may be")
    return mask
