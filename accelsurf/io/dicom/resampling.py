"""Slices that lie on no regular grid, put on one: linear interpolation, within each slice and between neighbours.

The grid has the axes and the pixels of the slices. Along the normal its step is the (lower) median of their distances,
changed so that the first and the last slice lie on it. Where slices are tilted or shifted it is made wider, so that no
part of a slice is lost; voxels beyond a slice have the smallest value of all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.errors import GeometryError
from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.slices import TOLERANCE_MM, Slices


@dataclass(frozen=True, eq=False)
class RegularGrid:
    """The grid that slices are put on.

    Attributes
    ----------
    geometry : Geometry
    along : ndarray, shape (n,)
        Place of each slice along the normal, in steps of the grid.
    aside : ndarray, shape (n, 2)
        Place of its first pixel on the grid: (row, column), in pixels.
    text : str
        Note on the resampling for the user.
    """

    geometry: Geometry
    along: NDArray[np.float64]
    aside: NDArray[np.float64]
    text: str


def regular_grid(slices: Slices) -> RegularGrid:
    """Return the grid for slices.

    Raises
    ------
    GeometryError
        When a fault cannot be mended by interpolation.
    """
    lasting = [fault.text for fault in slices.faults if not fault.can_resample]
    if lasting:
        raise GeometryError(
            "; ".join(lasting),
            "no grid follows from that: take the files that do not belong to the volume out",
        )
    along = slices.along
    steps = np.sort(np.diff(along))
    count = int(np.rint(along[-1] / steps[(len(steps) - 1) // 2])) + 1
    step = float(along[-1]) / (count - 1)
    _, rows_mm, columns_mm = slices.spacing
    shift = slices.aside
    straight = np.abs(shift).max() <= TOLERANCE_MM
    shift = np.zeros_like(shift) if straight else shift
    low, wide = shift.min(axis=0), np.ptp(shift, axis=0)
    first = slices.frames[0]
    shape = (
        count,
        first.rows + math.ceil(wide[1] / rows_mm - 1e-9),
        first.columns + math.ceil(wide[0] / columns_mm - 1e-9),
    )
    origin = slices.positions[0] + slices.axes[:, :2] @ low
    aside = np.stack(
        [(shift[:, 1] - low[1]) / rows_mm, (shift[:, 0] - low[0]) / columns_mm], axis=1
    )
    text = (
        f"{len(along)} slices were put on a regular grid of {count}, {step:.4g} mm apart, by linear interpolation "
        f"({'; '.join(fault.text for fault in slices.faults)})"
    )
    geometry = Geometry(shape, (step, rows_mm, columns_mm), tuple(origin.tolist()), slices.axes)
    return RegularGrid(geometry, along / step, aside, text)


def resampled(values: NDArray[Any], grid: RegularGrid) -> NDArray[np.float32]:
    """Return the values on the grid.

    Parameters
    ----------
    values : ndarray, shape (n, rows, columns)
        Of the slices, in their order.
    grid : RegularGrid
    """
    fill = float(values.min())
    out = np.empty(grid.geometry.shape, np.float32)
    placed: dict[int, NDArray[np.float32]] = {}

    def slice_at(n: int) -> NDArray[np.float32]:
        if n not in placed:
            for old in [place for place in placed if place < n - 1]:
                del placed[old]
            placed[n] = ndimage.affine_transform(
                values[n].astype(np.float32),
                np.ones(2),
                -grid.aside[n],
                out.shape[1:],
                order=1,
                mode="constant",
                cval=fill,
            )
        return placed[n]

    for place in range(out.shape[0]):
        before = int(np.clip(np.searchsorted(grid.along, place + 1e-9) - 1, 0, len(grid.along) - 2))
        width = grid.along[before + 1] - grid.along[before]
        weight = np.float32(np.clip((place - grid.along[before]) / width, 0.0, 1.0))
        out[place] = (1 - weight) * slice_at(before) + weight * slice_at(before + 1)
    return out
