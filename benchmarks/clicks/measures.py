"""How well a result agrees with the reference: surface distances and surface Dice, in mm and in voxels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from accelsurf.measure.metrics import surface_dice, surface_distances

Mask = NDArray[np.bool_]


def voxel_of(spacing: tuple[float, float, float]) -> float:
    """Length of a voxel (mm): the cube root of its volume.

    Examples
    --------
    >>> voxel_of((4.0, 2.0, 1.0))
    2.0
    """
    return round(math.prod(spacing) ** (1 / 3), 12)


def surfaces(
    labels: Mask, truth: Mask, spacing: tuple[float, float, float]
) -> dict[str, float | None]:
    """Mean and 95 % surface distance (mm, voxels), and normalised surface Dice at one voxel.

    Distances are None where one of the two is empty. All is computed on the boxes of the two objects.
    """
    voxel = voxel_of(spacing)
    there, back = surface_distances(labels, truth, spacing)
    near = surface_dice(labels, truth, spacing, [voxel])[0] if labels.any() else 0.0
    if not there.size:
        return {
            "mean_mm": None,
            "p95_mm": None,
            "mean_voxels": None,
            "p95_voxels": None,
            "nsd": near,
        }
    mean = float((there.sum() + back.sum()) / (there.size + back.size))
    far = max(float(np.percentile(there, 95)), float(np.percentile(back, 95)))
    return {
        "mean_mm": mean,
        "p95_mm": far,
        "mean_voxels": mean / voxel,
        "p95_voxels": far / voxel,
        "nsd": near,
    }
