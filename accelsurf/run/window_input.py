"""The part of an image that a run is made on, where the whole is not in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from accelsurf.run.image_context import WholeChannel
from accelsurf.run.region_of_interest import region_of_run
from accelsurf.settings.run_config import RunConfig
from accelsurf.starts import ObjectStart


@dataclass(frozen=True, eq=False)
class WindowInput:
    """Inputs of a run in a window beside the volumes there.

    Attributes
    ----------
    window : Window
    filtered : tuple of ndarray, shape of the window, float32
        Each channel, filtered with its surroundings; the run uses their memory.
    whole : tuple of WholeChannel
        Statistics of each whole channel; empty with a region of interest, which is scaled by its own values.
    starts : tuple of ObjectStart or None
        First surfaces of several objects, counted from the window's first voxel; None for a single object.
    """

    window: Window
    filtered: tuple[NDArray[np.float32], ...]
    whole: tuple[WholeChannel, ...] = ()
    starts: tuple[ObjectStart, ...] | None = None

    @property
    def open_window(self) -> Window | None:
        """The window, where the object may lie beyond it; None where a region of interest ends it."""
        return self.window if self.whole else None


def has_region(config: RunConfig) -> bool:
    """Return True if a run is made on a part of the image that the person gave."""
    return config.roi is not None or config.box is not None


def region_in(config: RunConfig, geometry: Geometry, part: WindowInput | None) -> Box:
    """Voxels that a run is made on, of a volume or of a window on it."""
    if part is None:
        return region_of_run(config, geometry)
    if not has_region(config):
        return whole_box(geometry.shape)
    return part.window.local(region_of_run(config, part.window.geometry))


def window_of(geometry: Geometry, part: WindowInput | None) -> Window:
    """The window that a run's volumes are."""
    return Window(geometry, whole_box(geometry.shape)) if part is None else part.window


def whole_of(part: WindowInput | None) -> Sequence[WholeChannel]:
    """Return the numbers of whole channels; none where the channels are at hand."""
    return () if part is None else part.whole
