"""Fronts that march through an image from clicks: faster where it looks like the clicks, slower across edges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.model.windows import Floats, Mask, Spacing
from accelsurf.grid.boxes import Box, widened
from accelsurf.grid.clicks import Click
from accelsurf.kernels.arrival import Medium, Tissue, march
from accelsurf.kernels.grid import Grid

CROSS = ndimage.generate_binary_structure(3, 1)
#: Cost per mm, see `accelsurf.kernels.arrival.cost_at`; gradients count in so many median ones.
COST, EDGE = (0.02, 0.1, 50.0, 0.15, 2.0, 16.0), 6.0
#: A click of fewer voxels learns from its neighbours too. A spread is at least so many median gradients per voxel, and
#: at least this part of the range of the values.
MIN_VOXELS, MIN_SPREAD, MIN_RANGE = 20, 3.0, 1e-3
_ALL_OPEN, _NO_CAP = np.zeros(0, np.bool_), np.zeros(0, np.float32)


class Field(NamedTuple):
    """Channels that fronts march through, where they may go, and their grid."""

    medium: Medium
    grid: Grid

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return self.grid.nz, self.grid.ny, self.grid.nx

    def images_on(self, box: Box) -> list[Floats]:
        """The channels on a box."""
        return [image.reshape(self.shape)[box] for image in self.medium.values]

    def times(self, tissue: Tissue, times: Floats, seeds: NDArray[np.int64], cap: Floats = _NO_CAP) -> Floats:
        """Times (nz, ny, nx) also where they are inf, from flat ``seeds``, where they are not; ``times`` is used up.

        A front does not come where its time would not be below ``cap`` (n,).
        """
        flat = np.ravel(times)
        march(flat, self.medium, tissue, self.grid, seeds, cap)
        return flat.reshape(self.shape)


    def times_from(self, tissue: Tissue, seeds: Mask, cap: Floats = _NO_CAP) -> Floats:
        """Times (nz, ny, nx) from ``seeds``, where they are 0; ``cap`` as of `times`."""
        begin = np.where(seeds, np.float32(0.0), np.float32(np.inf))
        return self.times(tissue, begin, np.flatnonzero(seeds), cap)


def field_of(images: Sequence[Floats], spacing: Sequence[float], open: Mask | None = None) -> Field:
    """The channels for fronts on their grid; a single one is not copied."""
    nz, ny, nx = images[0].shape
    channels = [np.ravel(image) for image in images]
    values = channels[0][None] if len(channels) == 1 else np.stack(channels)
    passes = _ALL_OPEN if open is None else np.ascontiguousarray(open).ravel()
    return Field(Medium(values, passes), Grid(nz, ny, nx, *(float(h) for h in spacing)))


def robust(values: NDArray[np.floating]) -> tuple[float, float]:
    """Median, and spread from the median absolute deviation: the standard deviation of a normal distribution.

    Examples
    --------
    >>> middle, spread = robust(np.array([1.0, 2.0, 3.0, 1000.0, 2.0]))
    >>> middle, round(spread, 2)
    (2.0, 1.48)
    """
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))


def gradient(values: Floats, spacing: Sequence[float]) -> NDArray[np.floating]:
    """Length of the gradient by central differences, per unit of the spacing."""
    parts = (np.gradient(values, h, axis=i) for i, h in enumerate(spacing) if values.shape[i] > 1)
    return np.asarray(np.sqrt(sum((part**2 for part in parts), np.zeros(values.shape))))


def enough(mask: Mask) -> Mask:
    """A mask, with its neighbours where it has few voxels."""
    return mask if np.count_nonzero(mask) >= MIN_VOXELS else np.asarray(ndimage.binary_dilation(mask, CROSS))


def learned(images: Sequence[Floats], spacing: Spacing, click: Click) -> Tissue:
    """The tissue under a click, for fronts."""
    box = widened(click.box, images[0].shape, (3, 3, 3))
    sample, smallest = enough(click.mask_on(box)), min(spacing)
    around = ndimage.binary_dilation(sample, CROSS, iterations=2)
    found = []
    for image in images:
        part = image[box]
        middle, spread = robust(part[sample])
        noise = float(np.median(gradient(part, spacing)[around]))
        least = max(MIN_RANGE * float(np.ptp(part)), 1e-6)
        found.append((middle, max(spread, MIN_SPREAD * noise * smallest, least), EDGE * max(noise, least / smallest)))
    median, deviation, edge = (np.array(column, np.float64) for column in zip(*found, strict=True))
    return Tissue(median, deviation, edge, np.array(COST))


def balance(inside: Floats, outside: Floats) -> Floats:
    """(T_in - T_out)/(T_in + T_out): -1 at the inside clicks, 1 outside; 1 where T_in is inf, 0 where both are 0.

    Examples
    --------
    >>> balance(np.array([0, 1, 3, 0, np.inf], np.float32), np.array([1, 3, 1, 0, 2], np.float32)).tolist()
    [-1.0, -0.5, 0.5, 0.0, 1.0]
    """
    with np.errstate(invalid="ignore"):
        out = (inside - outside) / (inside + outside)
    out[np.isinf(outside)] = -1.0
    out[np.isinf(inside)] = 1.0
    out[inside + outside == 0.0] = 0.0
    return out
