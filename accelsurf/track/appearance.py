"""Appearance of an object near its given surface, on both sides, and the odds that it gives voxels of another frame.

Features of a voxel are the mean and the standard deviation of the image in Gaussian windows of several widths. A
quadratic function of them, Fisher's discriminant, tells the voxels that lie inside near the surface from those outside
near it: the logarithm of the odds for inside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import Box, Corner, box_at, corner_of, nearest_places, shared, widened
from accelsurf.image.volume import Volume
from accelsurf.track.records import SurfacePiece

#: Widths (sigma) of the windows, voxels, and their half width in sigmas.
SCALES = (1.0, 2.0, 4.0, 6.0)
END = 3.0
#: Voxels to either side of the surface that are learned from, and those in which the evidence has its slope.
NEAR = 8.0
SLOPE_NEAR = 2.5
#: Part of the mean variance of a feature that is added to each: few voxels tell little.
RIDGE = 1e-2
#: Largest logarithm of odds: nothing is surer.
MAX_SCORE = 4.0
#: Fewest voxels on a side that can be learned from.
MIN_VOXELS = 8


class Appearance(NamedTuple):
    """Appearance on both sides of a surface.

    Attributes
    ----------
    center, spread : ndarray (k,)
        Mean and standard deviation of the features near the surface.
    weights : ndarray (m,)
        Of the features and their products.
    offset : float
    slope : float
        How the evidence rises from the surface inward, 1/mm.
    variance : float
        Mean square distance from the given surface to where a run by the evidence ends in the given frame, mm2.
    """

    center: Floats
    spread: Floats
    weights: Floats
    offset: float
    slope: float
    variance: float = 0.0

    def evidence(self, image: Volume, corner: Corner, shape: tuple[int, ...]) -> Floats:
        """Logarithm of the odds for inside on a box, which may go beyond the frame: there it is that of its edge.

        Parameters
        ----------
        image : Volume
            The frame.
        corner : (z, y, x)
            First voxel of the box; ``shape``: its size.
        """
        index = nearest_places(box_at(corner, shape), image.geometry.shape)
        box = tuple(slice(int(places[0]), int(places[-1]) + 1) for places in index)
        found = self._odds(_features(image, (box[0], box[1], box[2])))
        return found[np.ix_(*(places - places[0] for places in index))]

    def _odds(self, features: Floats) -> Floats:
        """The odds at places whose features (k, ...) are given."""
        count = len(self.center)
        center, spread = (
            np.asarray(values[:, None], np.float32) for values in (self.center, self.spread)
        )
        near = (features.reshape(count, -1) - center) / spread
        squares = np.zeros((count, count), np.float32)
        squares[np.triu_indices(count)] = self.weights[count:]
        found = ((squares @ near + self.weights[:count, None].astype(np.float32)) * near).sum(
            axis=0
        ) + self.offset
        return np.asarray(np.clip(found, -MAX_SCORE, MAX_SCORE)).reshape(features.shape[1:])


def appearance_of(image: Volume, surface: SurfacePiece) -> Appearance | None:
    """Learn the appearance on both sides of a surface; None where a side has too few voxels.

    Parameters
    ----------
    image : Volume
        The frame.
    surface : SurfacePiece
        In it.
    """
    geometry = image.geometry
    step = min(geometry.steps)
    box = widened(
        surface.box, geometry.shape, [int(np.ceil(NEAR * step / h)) for h in geometry.spacing]
    )
    inside = np.zeros([side.stop - side.start for side in box], np.bool_)
    there, mine = shared(corner_of(box), inside.shape, surface.corner, surface.psi.shape)
    inside[there] = surface.psi[mine] < 0
    sampling = [h if n > 1 else 1.0 for h, n in zip(geometry.spacing, geometry.shape, strict=True)]
    if min(np.count_nonzero(inside), np.count_nonzero(~inside)) < MIN_VOXELS:
        return None
    depth = ndimage.distance_transform_edt(inside, sampling) - ndimage.distance_transform_edt(
        ~inside, sampling
    )
    near = np.abs(depth) <= NEAR * step
    if min(np.count_nonzero(inside[near]), np.count_nonzero(~inside[near])) < MIN_VOXELS:
        return None
    features = _features(image, box)[:, near]
    label = inside[near]
    depth = depth[near]
    spread = features.std(axis=1, dtype=np.float64)
    if not spread.max() > 0.0:
        return None
    center = features.mean(axis=1, dtype=np.float64)
    learned = Appearance(center, np.maximum(spread, 1e-6 * spread.max()), np.zeros(0), 0.0, 0.0)
    relative = (features.T - learned.center) / learned.spread
    first, second = np.triu_indices(relative.shape[1])
    values = np.concatenate([relative, relative[:, first] * relative[:, second]], axis=1)
    sides = values[label], values[~label]
    covariance = 0.5 * (np.cov(sides[0].T) + np.cov(sides[1].T))
    covariance += RIDGE * float(np.trace(covariance)) / len(covariance) * np.eye(len(covariance))
    weights = np.linalg.solve(covariance, sides[0].mean(axis=0) - sides[1].mean(axis=0))
    offset = -0.5 * float(weights @ (sides[0].mean(axis=0) + sides[1].mean(axis=0)))
    learned = learned._replace(weights=weights, offset=offset)
    at = np.abs(depth) <= SLOPE_NEAR * step
    slope = float((depth[at] * learned._odds(features[:, at])).sum() / (depth[at] ** 2).sum())
    return learned._replace(slope=slope) if slope > 0.0 else None


def _features(image: Volume, box: Box) -> Floats:
    """Means and standard deviations (k, nz, ny, nx) around the voxels of a box of a frame."""
    geometry = image.geometry
    step = min(geometry.steps)
    sides = list(zip(geometry.spacing, geometry.shape, strict=True))
    sigmas = [[scale * step / h if n > 1 else 0.0 for h, n in sides] for scale in SCALES]
    room = widened(box, geometry.shape, [int(np.ceil(END * sigma)) for sigma in sigmas[-1]])
    inner = tuple(
        slice(a.start - b.start, a.stop - b.start) for a, b in zip(box, room, strict=True)
    )
    values = image.array[room]
    middle = np.float32(values.mean(dtype=np.float64))  # squares of the rest have digits enough
    values = values.astype(np.float32) - middle
    found = []
    for sigma in sigmas:
        mean, square = (
            ndimage.gaussian_filter(power, sigma, truncate=END)[inner]
            for power in (values, values**2)
        )
        found += [mean + middle, np.sqrt(np.maximum(square - mean**2, 0.0))]
    return np.stack(found)
