"""The object's boundary within a block: voxels near it go to the side that their values, and those around them, suit.

A window's blocks may be several voxels wide. Near the boundary that they give, the mean values of the object and of
its surroundings are known block by block; a small network weighs the place of a voxel's value between these means
against the blocks' F and the distance from their boundary.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.clicks.kernels.distance import distances_within
from accelsurf.clicks.model.fronts import MIN_RANGE
from accelsurf.clicks.model.network import Network
from accelsurf.grid.arrays import Mask, Singles
from accelsurf.grid.boxes import bounding_box, widened
from accelsurf.image.blocks import block_means, on_voxels
from accelsurf.image.smoothing import gaussian_mm

#: Largest distance from the boundary of the voxels looked at: this part of a block, plus this number of voxels.
REACH = 0.75
MORE = 1.0
#: Blocks along each axis in a mean; distance from the boundary, in voxels, up to which voxels count little in it; their
#: weight.
AROUND = 3
MIXED = 1.0
LITTLE = 0.02
#: Contrast of both sides, in spreads, at which the image counts half; at a larger one it counts fully.
CLEAR = 1.0
#: Smoothing of the values that are looked at beside the voxel's own, in voxels.
SMOOTHING = 1.0
#: Features are cut at these: the place of a value, and logarithms of the contrast.
MAX_BALANCE = 3.0
MAX_CONTRAST = 30.0


def features_near(
    image: Singles,
    spacing: Sequence[float],
    field: Singles,
    inside: Mask,
    steps: Sequence[int],
    near: Mask | None = None,
) -> tuple[dict[str, NDArray[np.floating]], NDArray[np.int64]]:
    """Features of the voxels near a boundary, and which voxels those are, as flat indices.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
        The channel.
    spacing : (hz, hy, hx)
        mm.
    field : ndarray (nz, ny, nx), float32
        F by blocks, at voxels.
    inside : ndarray (nz, ny, nx) of bool
        Where it is below 0.
    steps : (int, int, int)
        Voxels of a block along each axis.
    near : ndarray (nz, ny, nx) of bool, optional
        Other voxels are left out.
    """
    mm = np.asarray(spacing)
    width, finest = float(np.max(mm * steps)), float(mm[[n > 1 for n in image.shape]].min())
    reach = REACH * width + MORE * finest
    distance = np.full(inside.shape, np.float32(np.inf))
    if (found := bounding_box(inside)) is not None:  # farther away no distance is looked at
        box = widened(found, inside.shape, [math.ceil(reach / h) + 1 for h in mm])
        hz, hy, hx = (float(h) for h in spacing)
        here = np.ascontiguousarray(inside[box])
        within, beyond = (distances_within(part, (hz, hy, hx), reach) for part in (~here, here))
        # From voxel to voxel: half a step off on either side.
        distance[box] = np.where(here, -within, beyond)
    band = np.abs(distance) <= reach
    where = np.flatnonzero(band if near is None else band & near)
    counted = np.where(np.abs(distance) <= MIXED * finest, np.float32(LITTLE), np.float32(1.0))
    blocks, sides = [int(n) for n in steps], []
    for part in (counted * inside, counted * ~inside):
        sums = [
            _around(block_means(values, blocks))
            for values in (part, part * image, part * image * image)
        ]
        weight = np.maximum(sums[0], 1e-6)
        means = (np.asarray(part_sum / weight, np.float32) for part_sum in sums[1:])
        sides.append([on_voxels(mean, blocks, image.shape).ravel()[where] for mean in means])
    (mean_in, square_in), (mean_out, square_out) = sides
    variance = 0.5 * (
        np.maximum(square_in - mean_in**2, 0.0) + np.maximum(square_out - mean_out**2, 0.0)
    )
    spread = np.sqrt(variance) + max(MIN_RANGE * float(np.ptp(image)), 1e-9)
    half = 0.5 * (mean_out - mean_in)
    least = np.maximum(np.abs(half), 0.05 * spread) * np.where(half < 0, -1.0, 1.0)
    middle, smooth = 0.5 * (mean_in + mean_out), gaussian_mm(image, spacing, SMOOTHING * finest)
    contrast = np.log(np.clip(2.0 * np.abs(half) / spread, 1.0 / MAX_CONTRAST, MAX_CONTRAST))
    features: dict[str, NDArray[np.floating]] = {
        "contrast": contrast,
        "blocks": np.array(np.log2(width / finest)),
    }
    for name, values in (("value", image), ("smooth value", smooth)):
        features[name] = np.clip(
            (values.ravel()[where] - middle) / least, -MAX_BALANCE, MAX_BALANCE
        )
        features[f"{name} by contrast"] = features[name] * np.minimum(np.exp(contrast), 8.0)
    features["field"] = field.ravel()[where]
    features["distance"] = distance.ravel()[where] / width
    return features, where


def at_boundary(
    network: Network,
    image: Singles,
    spacing: Sequence[float],
    field: Singles,
    inside: Mask,
    steps: Sequence[int],
    near: Mask | None = None,
) -> Singles:
    """Return 1 - 2 p of the probability p that a voxel is inside near a boundary with contrast, the field elsewhere.

    For the parameters see `features_near`.
    """
    features, where = features_near(image, spacing, field, inside, steps, near)
    out, contrast = field.copy(), np.exp(features["contrast"])
    clear = (contrast**4 / (contrast**4 + CLEAR**4)).astype(np.float32)
    fitted = 1.0 - 2.0 * network.probability(features, where.shape)
    out.ravel()[where] = clear * fitted + (1.0 - clear) * field.ravel()[where]
    return out


def _around(blocks: Singles) -> Singles:
    return np.asarray(ndimage.uniform_filter(blocks, AROUND, mode="constant"))
