"""Filters of an image before a run: it is clipped, closed, smoothed; also box by box."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, with_halo
from accelsurf.image.kernels.smoothing import dilate
from accelsurf.image.smoothing import gaussian_mm, gaussian_on_box


class ImageFilters(NamedTuple):
    """The filters of an image, in the order in which they are applied.

    Attributes
    ----------
    bounds : tuple of 2 floats
        Values below the first and above the second become these.
    closing : float
        Radius, mm, of the ball that the image is closed by; 0 for none. See `closed_mm`.
    sigma : float
        Standard deviation, mm, of the Gaussian that it is smoothed by; 0 for none.
    """

    bounds: tuple[float, float] = (-math.inf, math.inf)
    closing: float = 0.0
    sigma: float = 0.0

    @property
    def change_nothing(self) -> bool:
        """True if the image stays as it is."""
        return self == NO_FILTERS

    def of_whole(self, image: NDArray[np.float32], spacing: Sequence[float]) -> NDArray[np.float32]:
        """The filtered image; the given one itself where nothing is to be done, else a new array.

        Parameters
        ----------
        image : ndarray (nz, ny, nx), float32
        spacing : sequence of 3 floats
            (hz, hy, hx), mm.
        """
        image = self._closed(image, spacing)
        return gaussian_mm(image, spacing, self.sigma) if self.sigma > 0 else image

    def on_box(
        self,
        read: Callable[[Box], NDArray[Any]],
        shape: Sequence[int],
        spacing: Sequence[float],
        box: Box,
    ) -> NDArray[np.float32]:
        """The bytes of a box of the whole image, filtered; only the box and its surroundings are read.

        Parameters
        ----------
        read : callable
            Returns the values of a box of the whole image.
        shape, spacing : sequence of 3
            Of the whole image; mm.
        box : tuple of slice

        Returns
        -------
        ndarray of the box's shape, float32
        """
        # A dilation at the faces of the halo lacks the voxels beyond it, and the erosion reads that far again.
        halo = [
            2 * int(self.closing / h) if n > 1 else 0 for n, h in zip(shape, spacing, strict=True)
        ]

        def closed(around: Box) -> NDArray[np.float32]:
            return self._closed(read(around).astype(np.float32, copy=False), spacing)

        def read_closed(part: Box) -> NDArray[np.float32]:
            return with_halo(closed, part, shape, halo)

        return gaussian_on_box(read_closed, shape, spacing, self.sigma, box)

    def _closed(self, image: NDArray[np.float32], spacing: Sequence[float]) -> NDArray[np.float32]:
        """The image, clipped and closed."""
        if self.bounds != NO_FILTERS.bounds:
            low, high = self.bounds
            image = np.clip(image, np.float32(low), np.float32(high))
        return closed_mm(image, spacing, self.closing) if self.closing > 0 else image


#: An image as it is.
NO_FILTERS = ImageFilters()


def closed_mm(
    image: NDArray[np.float32], spacing: Sequence[float], radius: float
) -> NDArray[np.float32]:
    """Close an image by a ball: dark places that no ball of this radius fits into are filled up.

    The smallest, over all balls that a voxel lies in, of their largest value (Serra, Image Analysis and Mathematical
    Morphology, 1982). No voxel becomes darker. Beyond the border there is nothing that would count.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    radius : float
        mm.

    Returns
    -------
    ndarray (nz, ny, nx), float32
        A new array.

    Examples
    --------
    >>> image = np.array([[[9, 9, 1, 9, 1, 1, 1, 1]]], np.float32)
    >>> closed_mm(image, (1.0, 1.0, 2.0), 2.0)
    array([[[9., 9., 9., 9., 1., 1., 1., 1.]]], dtype=float32)
    """
    image, lines = np.ascontiguousarray(image, np.float32), lines_of_ball(spacing, radius)
    wide, out = np.empty_like(image), np.empty_like(image)
    dilate(image, lines, wide)
    np.negative(wide, out=wide)
    dilate(wide, lines, out)
    return np.negative(out, out=out)


def lines_of_ball(spacing: Sequence[float], radius: float) -> NDArray[np.int64]:
    """The voxels of a ball as lines along x: steps (z, y) to their middles, and half their lengths, longest first.

    Parameters
    ----------
    spacing : sequence of 3 floats
        (hz, hy, hx), mm.
    radius : float
        mm; the voxels are those whose centres lie in the ball around one of them.

    Examples
    --------
    >>> lines_of_ball((3.0, 1.0, 1.0), 1.0).tolist()
    [[0, 0, 1], [0, -1, 0], [0, 1, 0]]
    """
    hz, hy, hx = spacing
    reach_z, reach_y = int(radius / hz), int(radius / hy)
    lines = []
    for z in range(-reach_z, reach_z + 1):
        for y in range(-reach_y, reach_y + 1):
            left = radius * radius - (z * hz) ** 2 - (y * hy) ** 2
            if left >= 0:
                lines.append((z, y, int(math.sqrt(left) / hx)))
    return np.array(sorted(lines, key=lambda line: -line[2]), np.int64)
