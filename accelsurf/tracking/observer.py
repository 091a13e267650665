"""The observer: how a predicted surface must move to be the measured one, and the surface part of the way there.

A surface shows only how far it has moved along its normal (the aperture problem). The motion of the whole is therefore
fitted first: u(X) = A X + b - X, such that the predicted surface S, moved by u, lies on the measured one. Only what
is left, delta, goes along the normal.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from accelsurf.kernels import point_sampling
from accelsurf.tracking.boxed_surface import BoxedSurface, Floats, boxed
from accelsurf.tracking.records import SurfacePiece

#: What is fitted: nothing (all goes along the normal), or how many of the 12 parameters of A and b.
Fit = Literal["none", "translation", "rigid", "affine"]
PARAMETERS: dict[Fit, int] = {"none": 0, "translation": 3, "rigid": 6, "affine": 12}
#: Damping of a round of the fit, of translation, rotation and strain, in parts of a surface that looks all ways: what
#: the shape does not determine, such as the rotation of a ball, stays 0. Where rotation and strain explain a
#: displacement alike, as on an ellipsoid, it is the rotation.
DAMPING = np.repeat([1e-6, 1e-3, 1e-1], [3, 3, 6])
#: Rounds of the fit; it ends when no point moves by more than this part of a voxel.
ROUNDS, FITTED = 30, 1e-3
#: Half width, voxels, of the band in which distances are known for the fit; further off nothing is fitted.
FIT_WIDTH = 12.0
#: Points this many voxels off count by 1/distance: a place that is really different does not draw the whole.
ROBUST = 1.0


class Affine(NamedTuple):
    """x -> matrix x + offset; (3, 3) and (3,), mm along the grid's axes z, y, x."""

    matrix: Floats
    offset: Floats

    def at(self, points: Floats) -> Floats:
        """The points (n, 3) moved."""
        return np.asarray(points @ self.matrix.T + self.offset)

    def scaled(self, share: float) -> Affine:
        """The map that goes ``share`` of the way."""
        return Affine(np.eye(3) + share * (self.matrix - np.eye(3)), share * self.offset)

    def after(self, first: Affine) -> Affine:
        """The map of both, ``first`` first."""
        return Affine(self.matrix @ first.matrix, self.matrix @ first.offset + self.offset)

    def inverse(self) -> Affine:
        """The way back."""
        matrix = np.linalg.inv(self.matrix)
        return Affine(matrix, -matrix @ self.offset)


IDENTITY = Affine(np.eye(3), np.zeros(3))


class Displacement(NamedTuple):
    """From the predicted surface to the measured one: ``fitted`` motion of the whole, and ``rest`` (n,), mm, the
    outward distance that is left for each cell of the predicted band."""

    fitted: Affine
    rest: NDArray[np.float64]


def displacement(predicted: BoxedSurface, measured: BoxedSurface, fit: Fit = "affine") -> Displacement:
    """How the ``predicted`` surface must move to be the ``measured`` one.

    Parameters
    ----------
    predicted, measured : BoxedSurface
        On the same frames' grid; neither empty.
    fit : {"affine", "rigid", "translation", "none"}
    """
    wide = measured.widened(FIT_WIDTH)
    points = predicted.closest_points()
    fitted = _fitted(predicted, points, wide, PARAMETERS[fit])
    psi = _psi_at(wide, fitted.at(points))[:, 0]
    # Further off than the band nothing is known but that it is far.
    return Displacement(fitted, -psi)


def _fitted(predicted: BoxedSurface, points: Floats, measured: BoxedSurface, count: int) -> Affine:
    """The motion of the whole by ``count`` parameters: robust least squares of the distances that it leaves."""
    if count == 0:
        return IDENTITY
    surface = predicted.surface
    frame, h = np.array(predicted.geometry.shape), predicted.spacing
    _, area = surface.fraction_and_area()
    seen = (area > 0) & ((points >= -0.5 * h) & (points <= (frame - 0.5) * h)).all(axis=1)
    if not seen.any():
        return IDENTITY
    start, weight = points[seen], area[seen]
    fitted = _first_shift(predicted, measured)
    for _ in range(ROUNDS):
        here = fitted.at(start)
        change = _round(here, weight, measured, count)
        fitted = change.after(fitted)
        if float((np.abs(change.at(here) - here) / h).max()) < FITTED:
            break
    return fitted


def _first_shift(predicted: BoxedSurface, measured: BoxedSurface) -> Affine:
    """The shift of the centroids; none where the border of the frames cuts one of the two."""
    if predicted.is_cut or measured.is_cut:
        return IDENTITY
    return Affine(np.eye(3), measured.centroid() - predicted.centroid())


def _round(here: Floats, weight: Floats, measured: BoxedSurface, count: int) -> Affine:
    """One round: the small motion of the points ``here`` (m, 3) that brings them nearest to the measured surface."""
    found = _psi_at(measured, here)
    left, slope = found[:, 0], found[:, 1:]
    h, far = measured.surface.smallest_spacing, 0.95 * float(measured.surface.gamma)
    weight = np.where(np.abs(left) < far, weight / np.maximum(1.0, np.abs(left) / (ROBUST * h)), 0.0)
    total = float(weight.sum())
    if total <= 0.0:
        return IDENTITY
    centre = (weight[:, None] * here).sum(axis=0) / total
    arm = here - centre
    size = float(np.sqrt((weight * (arm**2).sum(axis=1)).sum() / total))
    columns = _columns(arm / size, slope)[:, :count]
    normal = (columns * weight[:, None]).T @ columns / total + np.diag(DAMPING[:count])
    step = np.zeros(12)
    step[:count] = np.linalg.solve(normal, -(columns * weight[:, None]).T @ left / total)
    shift, turn, strain = step[:3], step[3:6] / size, step[6:] / size
    matrix = expm(_skew(turn)) @ (np.eye(3) + _symmetric(strain))
    return Affine(matrix, centre + shift - matrix @ centre)


def _columns(arm: Floats, slope: Floats) -> Floats:
    """What each parameter changes in the distance of each point, (m, 12): shifts, rotations, strains."""
    turned = np.cross(arm, slope)
    stretched = arm * slope
    sheared = [arm[:, a] * slope[:, b] + arm[:, b] * slope[:, a] for a, b in ((0, 1), (0, 2), (1, 2))]
    return np.concatenate([slope, turned, stretched, np.stack(sheared, axis=1)], axis=1)


def _skew(turn: Floats) -> Floats:
    a, b, c = turn
    return np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def _symmetric(strain: Floats) -> Floats:
    a, b, c, ab, ac, bc = strain
    return np.array([[a, ab, ac], [ab, b, bc], [ac, bc, c]])


def _psi_at(on: BoxedSurface, points: Floats) -> Floats:
    """Distance (mm) and its slopes at points (m, 3), mm along the grid's axes: (m, 4)."""
    surface, out = on.surface, np.empty((len(points), 4))
    surface.workers.parallel(
        point_sampling.value_and_gradient_at_points, len(points), surface.dense.psi, surface.grid,
        on.index_on_box(points), out,
    )
    return out


def between(predicted: BoxedSurface, measured: BoxedSurface, found: Displacement, gain: float) -> BoxedSurface:
    """The surface that is ``gain`` of the way from the predicted to the measured one.

    psi(y) = (1 - K) psi_predicted(x) + K psi_measured(A x + b), y where x is after K of the fitted motion.
    """
    if gain >= 1.0:
        return measured
    there = found.fitted.scaled(gain)
    h = predicted.surface.smallest_spacing
    half_width = predicted.surface.requested_half_width
    wide = half_width + float(np.clip(np.abs(found.rest).max(initial=0.0) / h, 0.0, FIT_WIDTH))
    first, second = predicted.widened(wide), measured.widened(wide)
    ends = []
    for one, way in ((predicted, there), (measured, IDENTITY)):
        points = way.at(one.closest_points()) / one.spacing
        ends.append((np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))))
    room = np.where(first.wide, int(np.ceil(half_width)) + 2, 0)
    frame = np.array(predicted.geometry.shape)
    low = np.maximum(np.minimum(ends[0][0], ends[1][0]) - room, 0).astype(np.int64)
    high = np.minimum(np.maximum(ends[0][1], ends[1][1]) + room + 1, frame).astype(np.int64)
    shape = tuple(int(n) for n in np.maximum(high - low, 1))
    back = there.inverse()
    psi = (1.0 - gain) * _resampled(first, back, low, shape)
    psi += gain * _resampled(second, found.fitted.after(back), low, shape)
    corner = int(low[0]), int(low[1]), int(low[2])
    return boxed(psi.astype(np.float32), corner, predicted.geometry, half_width, predicted.surface.workers)


def _resampled(on: BoxedSurface, way: Affine, low: NDArray[np.int64], shape: tuple[int, ...]) -> Floats:
    """psi at where ``way`` takes the voxels of the box at ``low``."""
    h, surface = on.spacing, on.surface
    matrix = np.empty((3, 4))
    matrix[:, :3] = way.matrix * h[None, :] / h[:, None]
    matrix[:, 3] = (way.at((low * h)[None])[0] / h) - np.array(on.corner)
    out = np.empty(int(np.prod(shape)))
    target = surface.grid._replace(nz=shape[0], ny=shape[1], nx=shape[2])
    surface.workers.parallel(
        point_sampling.resample_affine, out.size, surface.dense.psi, surface.grid, matrix, target, out
    )
    return out.reshape(shape)


def corrected_velocity(
    predicted: BoxedSurface, velocity: NDArray[np.float32], found: Displacement, duration: float, gain: float
) -> NDArray[np.float32]:
    """Velocity (n, 3) of the predicted band with ``gain`` of what it lacked: V + K_V (u + delta n)/duration."""
    points = predicted.closest_points()
    far = 0.95 * FIT_WIDTH * predicted.surface.largest_spacing
    rest = np.where(np.abs(found.rest) < far, found.rest, 0.0)
    missing = found.fitted.at(points) - points - rest[:, None] * predicted.surface.normals()
    return np.asarray(velocity + gain / duration * missing, np.float32)


def measured_surface(piece: SurfacePiece, predicted: BoxedSurface) -> BoxedSurface:
    """The piece that a frame shows, as a surface with a band like the predicted one's."""
    surface = predicted.surface
    return boxed(piece.psi, piece.corner, predicted.geometry, surface.requested_half_width, surface.workers)
