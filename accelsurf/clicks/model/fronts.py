"""Fronts that march through an image from clicks: faster where it looks like the clicks, slower across edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.kernels.arrival import Appearance, Medium, Sources, march
from accelsurf.grid.arrays import Mask, Singles, Spacing
from accelsurf.grid.boxes import widened
from accelsurf.grid.clicks import Click
from accelsurf.kernels.grid import Grid

CROSS = ndimage.generate_binary_structure(3, 1)
#: Cost per mm, see `accelsurf.clicks.kernels.arrival.cost_at`; unit of gradients, in median gradients.
COST = (0.02, 0.1, 50.0, 0.15, 2.0, 16.0)
EDGE = 6.0
#: A click of fewer voxels learns from its neighbours too. Least spread: a number of median gradients per voxel, and
#: a part of the range of the values.
MIN_VOXELS = 20
MIN_SPREAD = 3.0
MIN_RANGE = 1e-3


def times_from(
    seeds: Mask,
    image: Singles,
    spacing: Sequence[float],
    appearance: Appearance,
    open: Mask | None = None,
    sooner_than: Singles | None = None,
    sources: Sources | None = None,
) -> Singles:
    """Return arrival times (nz, ny, nx) of a front from ``seeds``; inf where it does not come.

    It does not come where nothing is ``open``, nor where its time would not be ``sooner_than``.
    With ``sources`` their ``origin`` is filled in.
    """
    times = np.where(seeds, np.float32(0.0), np.float32(np.inf))
    passes = np.zeros(0, np.bool_) if open is None else np.ascontiguousarray(open).ravel()
    cap = np.zeros(0, np.float32) if sooner_than is None else sooner_than.ravel()
    grid = Grid(*times.shape, *(float(h) for h in spacing))
    march(
        times.reshape(-1),
        Medium(np.ravel(image)[None], passes),
        appearance,
        grid,
        np.flatnonzero(seeds),
        cap,
        sources or Sources(np.zeros(0, np.int32), np.zeros(0, np.int32)),
    )
    return times


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


def gradient(values: Singles, spacing: Sequence[float]) -> NDArray[np.floating]:
    """Length of the gradient by central differences, per unit of the spacing."""
    parts = (np.gradient(values, h, axis=i) for i, h in enumerate(spacing) if values.shape[i] > 1)
    return np.asarray(np.sqrt(sum((part**2 for part in parts), np.zeros(values.shape))))


def enough(mask: Mask) -> Mask:
    """A mask, with its neighbours where it has few voxels."""
    return (
        mask
        if np.count_nonzero(mask) >= MIN_VOXELS
        else np.asarray(ndimage.binary_dilation(mask, CROSS))
    )


def learned(images: Sequence[Singles], spacing: Spacing, click: Click) -> Appearance:
    """Appearance of the image under a click, for fronts."""
    box = widened(click.box, images[0].shape, (3, 3, 3))
    sample, smallest = enough(click.mask_on(box)), min(spacing)
    around = ndimage.binary_dilation(sample, CROSS, iterations=2)
    found = []
    for image in images:
        part = image[box]
        middle, spread = robust(part[sample])
        noise = float(np.median(gradient(part, spacing)[around]))
        least = max(MIN_RANGE * float(np.ptp(part)), 1e-6)
        found.append(
            (
                middle,
                max(spread, MIN_SPREAD * noise * smallest, least),
                EDGE * max(noise, least / smallest),
            )
        )
    median, deviation, edge = (np.array(column, np.float64) for column in zip(*found, strict=True))
    return Appearance(median, deviation, edge, np.array(COST))
