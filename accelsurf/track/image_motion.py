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

from accelsurf.grid.boxes import Box, bounding_box, box_at, placed_at, widened
from accelsurf.image.volume import Volume
from accelsurf.track.boxed_surface import Floats
from accelsurf.track.records import SurfacePiece

#: Voxels around an object that are matched; sigma of the blur before, voxels.
AROUND, BLUR = 12, 1.5
#: Radius of the window of a match in voxels of the grid that is matched, and rounds of warping on each scale.
RADIUS, ROUNDS = 3, 3
#: In volumes every so many voxels are matched: an eighth of the cost, and the blur leaves no more.
STRIDE = 2
#: Correlation of the neighbourhood with the next frame below which nothing is known of its motion.
LIKE = 0.65
#: The neighbourhood whose likeness counts: so many voxels to either side of the surface.
NEAR = 4.0


class ImageMotion(NamedTuple):
    """Motion of the image on a box of the frame before.

    Attributes
    ----------
    box : tuple of slice
    displacement : ndarray (3, nz, ny, nx)
        To the next frame, mm along the grid's axes z, y, x.
    variance : ndarray (nz, ny, nx)
        Of each component, mm2; inf where the image has no structure.
    likeness : float
        Correlation of the neighbourhood of the surface, moved, with the next frame; 1: the same but for gray scale.
    """

    box: Box
    displacement: Floats
    variance: Floats
    likeness: float

    def at(self, points: Floats, spacing: Floats) -> tuple[Floats, Floats]:
        """Displacement (m, 3) and variance (m,) at points (m, 3), mm along the grid's axes z, y, x."""
        corner = np.array([side.start for side in self.box])
        index = (points / spacing - corner).T
        moved = [ndimage.map_coordinates(part, index, order=1, mode="nearest") for part in self.displacement]
        return np.stack(moved, axis=1), ndimage.map_coordinates(self.variance, index, order=0, mode="nearest")


def image_motion(before: Volume, now: Volume, surface: SurfacePiece, expected: Floats) -> ImageMotion | None:
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
    stride = [STRIDE if n > 1 and wide.all() else 1 for n in wide]
    first, second = (_blurred(volume, box, offset) for volume, offset in ((before, np.zeros(3)), (now, shift)))
    every = tuple(slice(None, None, n) for n in stride)
    matched = first[every], second[every]
    scale = float(matched[0].std())
    if scale == 0.0 or not np.isfinite(scale) or min(n for n, w in zip(matched[0].shape, wide, strict=True) if w) < 4:
        return None
    reference, moving = (np.squeeze(image, tuple(np.flatnonzero(~wide))) / scale for image in matched)
    flow = optical_flow_ilk(reference, moving, radius=RADIUS, num_warp=ROUNDS, gaussian=True, dtype=np.float64)
    warped = ndimage.map_coordinates(moving, np.indices(flow.shape[1:]) + flow, order=1, mode="nearest")
    variance = _variance(reference, warped)
    steps = (h * stride)[wide]
    dense = np.zeros((3, *matched[0].shape))
    dense[wide] = (flow * steps.reshape(-1, *[1] * flow[0].ndim)).reshape(-1, *matched[0].shape)
    to_full = np.indices(first.shape) / np.array(stride).reshape(3, 1, 1, 1)
    moved = np.stack([ndimage.map_coordinates(part, to_full, order=1, mode="nearest") for part in dense])
    spread = ndimage.map_coordinates(variance.reshape(matched[0].shape), to_full, order=0, mode="nearest")
    near = _near(surface, box)[every]
    likeness = _correlation(reference[near.reshape(reference.shape)], warped[near.reshape(reference.shape)])
    moved += (shift * h).reshape(3, 1, 1, 1)
    return ImageMotion(box, moved, spread * float(steps.min()) ** 2, likeness)


def _blurred(volume: Volume, box: Box, offset: Floats) -> Floats:
    """The blurred image on a box that is moved by whole voxels; beyond the frame it is that of its edge."""
    index = [
        np.clip(np.arange(side.start, side.stop) + int(n), 0, last - 1)
        for side, n, last in zip(box, offset, volume.geometry.shape, strict=True)
    ]
    values = volume.array[np.ix_(*index)].astype(np.float64)
    finest = min(volume.geometry.steps)
    sigma = [BLUR * finest / h if n > 1 else 0.0 for h, n in zip(volume.geometry.spacing, values.shape, strict=True)]
    return np.asarray(ndimage.gaussian_filter(values, sigma, mode="nearest"))


def _variance(reference: Floats, warped: Floats) -> Floats:
    """Variance of a component of the flow, voxels of the matched grid squared: the mean over the axes."""
    dim = reference.ndim
    sigma = 0.25 * (2 * RADIUS + 1)
    blur = BLUR / (STRIDE if dim == 3 else 1)
    independent = max(1.0, (sigma / blur) ** dim)  # values of a window, which the blur has made alike
    gradient = np.gradient(warped)
    normal = np.empty((*reference.shape, dim, dim))
    for a in range(dim):
        for b in range(a, dim):
            normal[..., a, b] = normal[..., b, a] = ndimage.gaussian_filter(gradient[a] * gradient[b], sigma)
    error = ndimage.gaussian_filter((reference - warped) ** 2, sigma)
    least = 1e-6 * max(float(np.trace(normal, axis1=-2, axis2=-1).mean()), 1e-12)
    inverse = np.linalg.inv(normal + least * np.eye(dim))
    return np.asarray(error * np.trace(inverse, axis1=-2, axis2=-1) / dim / independent)


def _near(surface: SurfacePiece, box: Box) -> NDArray[np.bool_]:
    """Voxels of a box near the surface."""
    inside = np.zeros([side.stop - side.start for side in box], np.bool_)
    low = [side.start for side in box]
    extent = box_at(surface.corner, surface.psi.shape)
    cut = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(extent, box, strict=True))
    mine = tuple(slice(a.start - c, a.stop - c) for a, c in zip(cut, surface.corner, strict=True))
    inside[tuple(slice(a.start - c, a.stop - c) for a, c in zip(cut, low, strict=True))] = surface.psi[mine] < 0
    distance = ndimage.distance_transform_edt(inside) + ndimage.distance_transform_edt(~inside)
    return np.asarray(distance <= NEAR)


def _correlation(a: Floats, b: Floats) -> float:
    if a.size < 2:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / power if power > 0 else 0.0
