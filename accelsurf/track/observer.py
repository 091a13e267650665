"""The observer: how a predicted surface must move to be the measured one, and the surface part of the way there.

A surface shows only how far it has moved along its normal (the aperture problem). The shift b of the whole is therefore
fitted first: the predicted surface, shifted by b, lies on the measured one. Only the rest, delta, goes along the
normal.

The surfaces of two frames differ by noise, too, which has no momentum. Noise is rough, motion is smooth: the rest
becomes velocity as far as it is smooth over the surface and more than the noise that its roughness lets expect.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.boxes import as_corner
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.kernels import point_sampling
from accelsurf.track.boxed_surface import BoxedSurface, boxed_piece, boxed_surface
from accelsurf.track.records import SurfacePiece

#: Damping of a round of the fit, in parts of a surface that looks all ways: along a plane no shift is determined.
DAMPING = 1e-4
#: Rounds of the fit; it ends when a round moves by no more than this part of a voxel.
MAX_ROUNDS = 30
FITTED = 1e-3
#: Half width, voxels, of the band in which distances are known for the fit; further off nothing is fitted.
FIT_WIDTH = 12.0
#: Points farther off than this, voxels, count by 1/distance: a place that is really different does not draw the whole.
ROBUST = 1.0
#: Standard deviation, voxels, of the Gaussian over the surface that separates smooth from rough parts of a motion.
SMOOTH = 2.5
#: Mean square of the smooth part of noise, as a fraction of that of its rough part.
SMOOTH_NOISE = 0.2


class Displacement(NamedTuple):
    """From the predicted surface to the measured one: ``shift`` (3,) of the whole, mm along the grid's axes z, y, x,
    and ``remainder`` (n,), mm, the outward distance that is then left for each cell of the predicted band.
    """

    shift: Floats
    remainder: NDArray[np.float64]


def displacement(predicted: BoxedSurface, measured: BoxedSurface) -> Displacement:
    """Find how the ``predicted`` surface must move to be the ``measured`` one.

    Parameters
    ----------
    predicted, measured : BoxedSurface
        On the same frames' grid; neither empty.
    """
    wide = measured.widened(FIT_WIDTH)
    points = predicted.closest_points()
    shift = _fitted_shift(predicted, points, wide)
    # Further off than the band nothing is known but that it is far.
    return Displacement(shift, -_psi_at(wide, points + shift)[:, 0])


def _fitted_shift(predicted: BoxedSurface, points: Floats, measured: BoxedSurface) -> Floats:
    """The shift of the whole: robust least squares of the distances that it leaves, by Gauss and Newton."""
    h, area = predicted.spacing, predicted.surface.fraction_and_area()[1]
    seen = (area > 0) & in_frame(predicted, points)
    shift = np.zeros(3)
    if not predicted.is_cut and not measured.is_cut:
        shift = measured.centroid() - predicted.centroid()
    for _ in range(MAX_ROUNDS):
        change = _round(points[seen] + shift, area[seen], measured)
        shift = shift + change
        if float((np.abs(change) / h).max()) < FITTED:
            break
    return shift


def in_frame(boxed: BoxedSurface, points: Floats) -> NDArray[np.bool_]:
    """Mask of the points (m, 3), mm along the grid's axes, that lie in a voxel of the frames."""
    h, frame = boxed.spacing, np.array(boxed.geometry.shape)
    return np.asarray(((points >= -0.5 * h) & (points <= (frame - 0.5) * h)).all(axis=1))


def _round(points: Floats, area: Floats, measured: BoxedSurface) -> Floats:
    """One round: the small shift of ``points`` (m, 3) that brings them nearest to the measured surface."""
    found = _psi_at(measured, points)
    left, slope = found[:, 0], found[:, 1:]
    h, far = measured.surface.smallest_spacing, 0.95 * float(measured.surface.gamma)
    weight = np.where(np.abs(left) < far, area / np.maximum(1.0, np.abs(left) / (ROBUST * h)), 0.0)
    total = float(weight.sum())
    if total <= 0.0:
        return np.zeros(3)
    weighted = slope * (weight / total)[:, None]
    # Sums in order, not by a library's threads: the same bytes on any machine.
    normal = np.array(
        [[float((weighted[:, a] * slope[:, b]).sum()) for b in range(3)] for a in range(3)]
    )
    pull = np.array([float((weighted[:, a] * left).sum()) for a in range(3)])
    return np.asarray(-np.linalg.solve(normal + DAMPING * np.eye(3), pull))


def _psi_at(boxed: BoxedSurface, points: Floats) -> Floats:
    """Distance (mm) and its slopes at points (m, 3), mm along the grid's axes: (m, 4)."""
    surface, out = boxed.surface, np.empty((len(points), 4))
    surface.workers.parallel(
        point_sampling.value_and_gradient_at_points,
        len(points),
        surface.dense.psi,
        surface.grid,
        boxed.index_on_box(points),
        out,
    )
    return out


def between(
    predicted: BoxedSurface, measured: BoxedSurface, found: Displacement, gain: float
) -> BoxedSurface:
    """The surface that is ``gain`` K of the way from the predicted to the measured one.

    psi(y) = (1 - K) psi_predicted(y - K b) + K psi_measured(y + (1 - K) b).
    """
    if gain >= 1.0:
        return measured
    h, width = predicted.spacing, predicted.surface.requested_half_width
    farthest = float(np.abs(found.remainder).max(initial=0.0)) / predicted.surface.smallest_spacing
    wide = width + min(farthest, FIT_WIDTH)
    first, second = predicted.widened(wide), measured.widened(wide)
    ahead = predicted.closest_points() + gain * found.shift
    places = np.concatenate([ahead, measured.closest_points() - (1.0 - gain) * found.shift]) / h
    room = np.where(first.wide, int(np.ceil(width)) + 2, 0)
    low = np.maximum(np.floor(places.min(axis=0)) - room, 0).astype(np.int64)
    high = np.minimum(np.ceil(places.max(axis=0)) + room + 1, predicted.geometry.shape).astype(
        np.int64
    )
    shape = tuple(int(n) for n in np.maximum(high - low, 1))
    psi = (1.0 - gain) * _resampled(first, -gain * found.shift, low, shape)
    psi += gain * _resampled(second, (1.0 - gain) * found.shift, low, shape)
    like, corner = predicted, as_corner(low)
    return boxed_surface(
        psi.astype(np.float32), corner, like.geometry, width, like.surface.workers, like.halving
    )


def _resampled(
    boxed: BoxedSurface, shift: Floats, low: NDArray[np.int64], shape: tuple[int, ...]
) -> Floats:
    """Psi at the voxels of the box at ``low``, each shifted by ``shift`` mm."""
    surface, out = boxed.surface, np.empty(int(np.prod(shape)))
    target = surface.grid._replace(nz=shape[0], ny=shape[1], nx=shape[2])
    first = shift / boxed.spacing + low - np.array(boxed.corner)
    surface.workers.parallel(
        point_sampling.resample_shifted,
        out.size,
        surface.dense.psi,
        surface.grid,
        first,
        target,
        out,
    )
    return out.reshape(shape)


def missing_velocity(
    predicted: BoxedSurface, found: Displacement, duration: float
) -> NDArray[np.float64]:
    """Velocity (n, 3) that the predicted band lacked: (b + K_delta delta n)/duration, delta as far as it is smooth."""
    far = 0.95 * FIT_WIDTH * predicted.surface.largest_spacing
    outward = certain_part(predicted, np.where(np.abs(found.remainder) < far, found.remainder, 0.0))
    return np.asarray((found.shift - outward[:, None] * predicted.surface.normals()) / duration)


def certain_part(predicted: BoxedSurface, outward: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth distances over a surface, and weaken them by as much as may be noise (Wiener's filter).

    Parameters
    ----------
    predicted : BoxedSurface
    outward : ndarray (n,)
        Of each cell of its band, mm.

    Returns
    -------
    ndarray (n,)
        K_delta E outward: E is the mean over the surface with a Gaussian weight, plus that of the remainder; K_delta
        = 1 - `SMOOTH_NOISE` <(1 - E)^2>/<E^2>, at least 0, <> the mean over the surface of outward's squared parts.
    """
    surface, points = predicted.surface, predicted.closest_points()
    area = np.where(
        in_frame(predicted, points), surface.fraction_and_area()[1], 0.0
    )  # beyond nothing is measured
    total = float(area.sum())
    if total <= 0.0:
        return np.zeros_like(outward)
    smoothed_at = _smoother(predicted)
    weight = np.maximum(smoothed_at(area), 1e-6 * float(area.max()))
    smooth = smoothed_at(area * outward) / weight
    smooth += smoothed_at(area * (outward - smooth)) / weight
    clear, rough = (
        float((area * values**2).sum()) / total for values in (smooth, outward - smooth)
    )
    return smooth * max(0.0, 1.0 - SMOOTH_NOISE * rough / clear) if clear > 0.0 else smooth


def smoothed_by(boxed: BoxedSurface, values: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Smooth values (n, k) over a surface by their weights (n,), and return the mean weights (n,) too."""
    area, smoothed_at = boxed.surface.fraction_and_area()[1], _smoother(boxed)
    there = np.maximum(smoothed_at(area), 1e-6 * float(area.max(initial=1e-30)))
    total = smoothed_at(area * weight)
    least = 1e-9 * max(float(total.max(initial=0.0)), 1e-30)
    columns = [
        smoothed_at(area * weight * column) / np.maximum(total, least) for column in values.T
    ]
    return np.stack(columns, axis=1), total / there


def _smoother(boxed: BoxedSurface) -> Callable[[Floats], Floats]:
    """A function that takes values (n,) of a band to their Gaussian sums at the closest points of its cells."""
    surface, spacing = boxed.surface, boxed.spacing
    index = np.rint(boxed.index_on_box(boxed.closest_points())).astype(np.int64)
    at = tuple(np.clip(index, 0, np.array(surface.shape) - 1).T)

    def smoothed_at(values: Floats) -> Floats:
        dense = np.zeros(surface.shape, np.float32)
        dense.ravel()[surface.band.cells] = values
        return gaussian_mm(dense, tuple(spacing), SMOOTH * surface.smallest_spacing)[at].astype(
            np.float64
        )

    return smoothed_at


def measured_surface(piece: SurfacePiece, predicted: BoxedSurface) -> BoxedSurface:
    """The piece that a frame shows, as a surface with a band like the predicted one's."""
    surface, halving = predicted.surface, predicted.halving
    frame = predicted.geometry if halving is None else halving.frame
    return boxed_piece(piece, frame, surface.requested_half_width, surface.workers, halving)
