"""Motion of the image near a surface from one frame to the next, with how far it can be trusted.

The neighbourhood of the surface in one frame is matched to the next by the optical flow of Lucas and Kanade, coarse to
fine (scikit-image). Where the image looks the same along a direction, or differs from frame to frame, the flow says
little: its variance follows from the least squares that it solves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.registration import optical_flow_ilk

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import (
    Box,
    as_corner,
    bounding_box,
    corner_of,
    nearest_places,
    placed_at,
    shared,
    widened,
)
from accelsurf.image.volume import Volume
from accelsurf.track.records import SurfacePiece

#: Voxels around an object that are matched; sigma of the blur before, voxels.
AROUND = 12
BLUR = 1.5
#: Radius of the window of a match in voxels of the grid that is matched, and rounds of warping on each scale.
RADIUS = 3
ROUNDS = 3
#: Stride of the matches in volumes, voxels, along axes that are as fine as the finest and have at least the second
#: number of voxels: an eighth of the cost, and the blur leaves no more. Least blur of the matched images, their voxels.
STRIDE = 2
MIN_STRIDDEN = 16
MIN_BLUR = 0.5
#: Independent windows along each direction in the surface over which the motion of a place of it is averaged: it is
#: smoothed over these.
WINDOWS = 2.8
#: Correlation of the neighbourhood with the next frame below which nothing is known of its motion.
LIKE = 0.65
#: Extent of the neighbourhood whose likeness counts, voxels to either side of the surface.
NEAR = 4.0


class ImageMotion(NamedTuple):
    """Motion of the image on a box of the frame before.

    Attributes
    ----------
    first : ndarray (3,)
        The first voxel, mm along the grid's axes z, y, x from that of the frame.
    step : ndarray (3,)
        From one that was matched to the next, mm.
    displacement : ndarray (3, mz, my, mx)
        To the next frame, mm along the grid's axes z, y, x.
    variance : ndarray (mz, my, mx)
        Of each component, mm2.
    likeness : float
        Correlation of the neighbourhood of the surface, moved, with the next frame; 1: the same but for gray scale.
    """

    first: Floats
    step: Floats
    displacement: Floats
    variance: Floats
    likeness: float

    def at(self, points: Floats) -> tuple[Floats, Floats]:
        """Displacement (m, 3) and variance (m,) at points (m, 3), mm along the grid's axes z, y, x."""
        index = ((points - self.first) / self.step).T
        moved = [
            ndimage.map_coordinates(part, index, order=1, mode="nearest")
            for part in self.displacement
        ]
        return np.stack(moved, axis=1), ndimage.map_coordinates(
            self.variance, index, order=0, mode="nearest"
        )


def image_motion(
    before: Volume, now: Volume, surface: SurfacePiece, expected: Floats
) -> ImageMotion | None:
    """Match the neighbourhood of a surface to the next frame.

    Parameters
    ----------
    before, now : Volume
        Two frames on one grid.
    surface : SurfacePiece
        In the frame before.
    expected : ndarray (3,)
        Way of the whole to the next frame as it is expected, mm along the grid's axes; the match begins there.

    Returns
    -------
    ImageMotion or None
        None where nothing of the surface lies in the frame, or the frame has no structure there.
    """
    inner = bounding_box(surface.psi < 0)
    if inner is None:
        return None
    shape = before.geometry.shape
    box = widened(placed_at(inner, surface.corner), shape, (AROUND,) * 3)
    wide = np.array([side.stop - side.start > 1 for side in box])
    h = np.array(before.geometry.spacing)
    shift = np.where(wide, np.rint(expected / h), 0.0)
    finest = min(before.geometry.steps)
    fine = (h < STRIDE * finest) & (
        np.array([side.stop - side.start for side in box]) >= MIN_STRIDDEN
    )
    stride = np.where(wide.all() & fine, STRIDE, 1)
    every = tuple(slice(None, None, n) for n in stride.tolist())
    matched = [
        _blurred(volume, box, offset)[every]
        for volume, offset in ((before, np.zeros(3)), (now, shift))
    ]
    scale, counts = float(matched[0].std()), matched[0].shape
    if scale == 0.0 or not np.isfinite(scale) or np.array(counts)[wide].min() < 4:
        return None
    reference, moving = (
        np.squeeze(image, tuple(np.flatnonzero(~wide))) / scale for image in matched
    )
    flow = optical_flow_ilk(
        reference, moving, radius=RADIUS, num_warp=ROUNDS, gaussian=True, dtype=np.float64
    )
    warped = ndimage.map_coordinates(
        moving, np.indices(flow.shape[1:]) + flow, order=1, mode="nearest"
    )
    steps = h * stride
    blur = np.maximum(BLUR * finest / steps, MIN_BLUR)[wide]
    variance = _variance(reference, warped, blur).reshape(counts) * float(steps[wide].min()) ** 2
    moved = np.zeros((3, *counts))
    moved[wide] = flow.reshape(-1, *counts)
    moved = moved * steps.reshape(3, 1, 1, 1) + (shift * h).reshape(3, 1, 1, 1)
    near = _near(surface, box, NEAR * finest)[every].reshape(reference.shape)
    likeness = _correlation(reference[near], warped[near])
    return ImageMotion(np.array(corner_of(box)) * h, steps, moved, variance, likeness)


def _blurred(volume: Volume, box: Box, offset: Floats) -> Floats:
    """The blurred image on a box that is moved by whole voxels; beyond the frame it is that of its edge."""
    index = nearest_places(placed_at(box, as_corner(offset)), volume.geometry.shape)
    values = volume.array[np.ix_(*index)].astype(np.float64)
    finest = min(volume.geometry.steps)
    sigma = [
        BLUR * finest / h if n > 1 else 0.0
        for h, n in zip(volume.geometry.spacing, values.shape, strict=True)
    ]
    return np.asarray(ndimage.gaussian_filter(values, sigma, mode="nearest"))


def _variance(reference: Floats, warped: Floats, blur: Floats) -> Floats:
    """Variance of a component of the flow, voxels of the matched grid squared: the mean over the axes.

    ``blur`` (d,) is that of the images, in these voxels.
    """
    dim = reference.ndim
    sigma = 0.25 * (2 * RADIUS + 1)
    independent = max(
        1.0, float(np.prod(sigma / blur))
    )  # values of a window, which the blur has made alike
    gradient = np.gradient(warped)
    normal = np.empty((*reference.shape, dim, dim))
    for a in range(dim):
        for b in range(a, dim):
            normal[..., a, b] = normal[..., b, a] = ndimage.gaussian_filter(
                gradient[a] * gradient[b], sigma
            )
    error = ndimage.gaussian_filter((reference - warped) ** 2, sigma)
    least = 1e-6 * max(float(np.trace(normal, axis1=-2, axis2=-1).mean()), 1e-12)
    inverse = np.linalg.inv(normal + least * np.eye(dim))
    return np.asarray(
        error * np.trace(inverse, axis1=-2, axis2=-1) / dim / independent / WINDOWS ** (dim - 1)
    )


def _near(surface: SurfacePiece, box: Box, width: float) -> NDArray[np.bool_]:
    """Voxels of a box less than ``width`` (mm) off the surface."""
    near = np.zeros([side.stop - side.start for side in box], np.bool_)
    there, mine = shared(corner_of(box), near.shape, surface.corner, surface.psi.shape)
    near[there] = np.abs(surface.psi[mine]) < width
    return near


def _correlation(a: Floats, b: Floats) -> float:
    if a.size < 2:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / power if power > 0 else 0.0
