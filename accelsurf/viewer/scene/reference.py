"""The reference: a label map that the surface is compared with."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.shapes import label_surface
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import SpaceTile


class Reference:
    """The true object or objects, as one.

    Parameters
    ----------
    labels : Volume
        Above 0 is the object.
    geometry : Geometry
        Of the image.

    Attributes
    ----------
    inside : ndarray (nz, ny, nx), bool
    contour_function : ndarray (nz, ny, nx), float32
        Negative inside; 0 halfway between voxels inside and outside.

    Raises
    ------
    InputError
        When the labels are on another grid than the image.
    """

    def __init__(self, labels: Volume, geometry: Geometry) -> None:
        if not geometry.matches(labels.geometry):
            raise InputError(
                f"the reference is not on the image's grid: {geometry.difference(labels.geometry)}",
                "resample it to the image's grid",
            )
        self._geometry = geometry
        self.inside: NDArray[np.bool_] = np.asarray(labels.array > 0)
        self.contour_function: NDArray[np.float32] = np.asarray(np.float32(0.5) - self.inside)
        self._voxels = int(self.inside.sum())

    def draw(self, space: SpaceTile | None, tiles: Iterable[SliceTile]) -> None:
        """Draw the surface in 3D, and the contours in the slices."""
        if space is not None:
            space.show_reference(label_surface(self.inside, self._geometry))
        for tile in tiles:
            tile.draw_reference(self.contour_function)

    def dice(self, frame: Frame) -> float:
        """Dice of the reference and all objects of a frame; coarse frames count their voxels."""
        return frame.dice(self.inside, self._voxels)
