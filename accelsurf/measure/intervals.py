"""Best estimates of an object's volume, area and diameter by its edge in the image, and 95 % intervals around them.

A voxel that the surface passes holds a share f of the object, and the image there is I = f I_in + (1 - f) I_out, for
any blur and any thickness of the slices, as both keep sums. With I_in and I_out as they are nearby, in the object and
beside it, the volume is that of the voxels within plus the sum of f over a shell around the surface. White noise of
deviation s in I is s / |I_in - I_out| in f, so the volume's is known. Area and diameter are measured on the surface
f = 1/2, smoothed the more, the more noise there is. Smoothing takes away edges and tips, as blur has before; twice the
width takes away more, and by how much tells edges from round sides, whose area and length it hardly changes.

The rest has no formula: the levels nearby belong to something else, the edge is doubtful, the surface is far off.
It grows with the layer of voxels on the surface, with the noise, with how the contrast differs along the surface, and
with how far the shell had to be moved. Mean errors, which the estimates are free of, and deviations come from phantoms
(`benchmarks/intervals.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.arrays import Image, Mask, Psi, Singles
from accelsurf.grid.boxes import bounding_box, corner_of, slabs
from accelsurf.grid.geometry import Geometry
from accelsurf.image.kernels.smoothing import smooth_across_rows
from accelsurf.image.noise import noise_of
from accelsurf.image.smoothing import gaussian_mm, gaussian_weights
from accelsurf.measure.diameters import longest_line
from accelsurf.measure.surface_mesh import Surface, crossings

#: Half the shell's thickness, and the end of the surroundings: voxels along the surface's normal.
SHELL = 1.5
BESIDE = 3.0
#: Levels nearby are means over a Gaussian of this sigma: voxels, of slices thicker than two pixels more pixels.
SIGMA = 1.5
#: Contrasts below this part of the object's count less and less.
MIN_CONTRAST = 0.05
#: The shell is moved to the edge that it finds, so often at most, or until it moves by less, in voxels.
PASSES = 3
STILL = 0.05
#: Beyond so much noise or variation, in parts of the contrast, there is no edge to measure by.
MAX_UNCERTAINTY = 2.0
#: Shares are smoothed for the surface f = 1/2 by a Gaussian of this sigma, pixels: in an image without noise, and so
#: much more where the noise is as strong as the contrast. Then again by twice that.
SMOOTH = 0.7
SMOOTH_IN_NOISE = 0.9


class Interval(NamedTuple):
    """An interval of a measure."""

    low: float
    high: float


class Intervals(NamedTuple):
    """Intervals that hold the true measures in 95 of 100 cases, as long as the object is the right one.

    None where nothing can be told.
    """

    volume_mm3: Interval | None
    area_mm2: Interval | None
    diameter_mm: Interval | None


class Estimates(NamedTuple):
    """Best estimates of the measures of an object; the diameter is None where its image has no edge to measure by."""

    volume_mm3: float
    area_mm2: float
    diameter_mm: float | None


class _Weights(NamedTuple):
    """Weights of the predictors of a measure's error, see `signs`.

    Attributes
    ----------
    bias : tuple of float
        Mean error: the sum.
    spread : tuple of float
        Deviation: the root of the sum of squares.
    factor, uneven : float
        Deviations to either side of 95 of 100 cases; the same where the contrast `is_uneven`.
    """

    bias: tuple[float, ...]
    spread: tuple[float, ...]
    factor: float
    uneven: float


#: ``python -m benchmarks.intervals --fit``; in the units of `units`.
WEIGHTS = {
    "volume_mm3": _Weights(
        (0.012, 0.083, -0.009, -0.055, -0.019, -0.009),
        (0.01, 0.094, 0.0, 0.27, 0.128, 0.0),
        2.37,
        3.63,
    ),
    "area_mm2": _Weights(
        (-0.029, -0.187, -0.124, 0.265, 0.081, 0.001, 0.758, -0.253),
        (0.02, 0.0, 0.115, 0.0, 0.0, 0.033, 0.265, 0.515),
        2.26,
        2.26,
    ),
    "diameter_mm": _Weights(
        (-0.839, -4.617, -1.831, 2.241, -0.372, -1.007, 3.042, -0.773),
        (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.646, 0.0),
        1.90,
        1.90,
    ),
}
#: Noise makes the contrast vary along the surface by up to this part of it: 9 of 10 phantoms of the fit with an even
#: contrast have less. More than the other part of the contrast beyond that is a contrast that fades, a neighbour, or a
#: part of the object that was missed: the volumes of these err by more than deviations in proportion tell.
VARIATION_OF_NOISE = 0.25
UNEVEN = 0.1
#: Largest ratio of an interval's high end to the low one: a wider interval tells nothing.
MAX_RATIO = 3.0
#: In more noise the intervals of the diameter held it in less than 9 of 10 phantoms of the fit: none is given.
MAX_NOISE_OF_DIAMETER = 0.5


class EdgeMeasures(NamedTuple):
    """Measures of an object by its shares of voxels, and predictors of their errors.

    Attributes
    ----------
    volume_mm3, area_mm2, diameter_mm : float
    area_lost, diameter_lost : float
        Logarithms of area and diameter over the values of the surface that is smoothed twice as much.
    noise_mm3 : float
        Standard deviation of the volume by the noise of the image.
    layer_mm3 : float
        Volume of a layer of one voxel on the surface.
    step_mm, pixel_mm : float
        Extent of a voxel along the diameter; the smallest spacing.
    variation : float
        Standard deviation of the contrast along the surface, in parts of its mean.
    noise : float
        Of the image, in parts of the contrast; times the fourth root of the thickness of the slices in pixels, as there
        are as many voxels fewer over which to smooth.
    moved : float
        How far outwards the shell was moved, in voxels.
    """

    volume_mm3: float
    area_mm2: float
    diameter_mm: float
    area_lost: float
    diameter_lost: float
    noise_mm3: float
    layer_mm3: float
    step_mm: float
    pixel_mm: float
    variation: float
    noise: float
    moved: float


def estimates(found: EdgeMeasures) -> tuple[Estimates, Intervals]:
    """Return the best estimates of an object by the measures of its edge, and the intervals around them."""
    best, around = [], []
    for key, weights in WEIGHTS.items():
        mean, deviation = error(found, key, weights)
        off = deviation * (weights.uneven if is_uneven(found) else weights.factor)
        ends = [measure_at(found, key, mean + step * off) for step in (-1, 0, 1)]
        best.append(ends[1])
        is_stated = ends[2] <= MAX_RATIO * ends[0] and (
            key != "diameter_mm" or found.noise <= MAX_NOISE_OF_DIAMETER
        )
        around.append(Interval(ends[0], ends[2]) if is_stated else None)
    return Estimates(*best), Intervals(*around)


def is_uneven(found: EdgeMeasures) -> bool:
    """Test if the contrast differs along the surface by more than its noise explains."""
    return found.variation > math.hypot(VARIATION_OF_NOISE * found.noise, UNEVEN)


def error(found: EdgeMeasures, key: str, weights: _Weights) -> tuple[float, float]:
    """Return the mean error of a measure and its deviation, in its unit."""
    values, known = (
        signs(found, key),
        found.noise_mm3 / found.layer_mm3 if key == "volume_mm3" else 0.0,
    )
    mean = sum(weight * value for weight, value in zip(weights.bias, values, strict=True))
    squares = [(weight * value) ** 2 for weight, value in zip(weights.spread, values, strict=True)]
    return mean, math.sqrt(known**2 + sum(squares))


def measure_at(found: EdgeMeasures, key: str, off: float) -> float:
    """Return a measure changed by ``off`` of its units: of the logarithm's, but for the volume."""
    value = float(getattr(found, key))
    change = off * units(found)[key]
    return max(value + change, 0.0) if key == "volume_mm3" else value * math.exp(change)


def signs(found: EdgeMeasures, key: str) -> tuple[float, ...]:
    """Return the predictors of a measure's error.

    1, variation, noise, their product, how far the shell was moved, how thin the object is; of area and diameter also
    the root of the loss by smoothing, in its unit, and the product of that and the noise.
    """
    common = (
        1.0,
        found.variation,
        found.noise,
        found.variation * found.noise,
        abs(found.moved),
        found.layer_mm3 / found.volume_mm3,
    )
    if key == "volume_mm3":
        return common
    lost = found.area_lost if key == "area_mm2" else found.diameter_lost
    root = math.sqrt(max(lost, 0.0) / units(found)[key])
    return (*common, root, root * found.noise)


def units(found: EdgeMeasures) -> dict[str, float]:
    """Return the units of the errors: of the volume in mm3, of the logarithms of area and diameter.

    A layer of voxels; of the area this over the volume, by the root of its thickness in pixels; of the diameter the
    root of pixel and voxel along it.
    """
    thickness = found.layer_mm3 / found.area_mm2 / found.pixel_mm
    return {
        "volume_mm3": found.layer_mm3,
        "area_mm2": found.layer_mm3 / found.volume_mm3 / math.sqrt(thickness),
        "diameter_mm": math.sqrt(found.step_mm * found.pixel_mm) / found.diameter_mm,
    }


class _Levels(NamedTuple):
    """Means of the image in the object and beside it, and sigmas (voxels) of the means nearby."""

    inside: float
    beside: float
    sigmas: tuple[float, ...]


class _Sums(NamedTuple):
    """Sums over the voxels of a shell: shares, 1, squares of weights, contrast, its squares, extents; and the core."""

    shares: float
    voxels: float
    weights: float
    contrast: float
    squares: float
    extents: float
    core: float


def edge_measures(
    psi: Psi, image: Image, geometry: Geometry, volume_mm3: float
) -> EdgeMeasures | None:
    """Measure an object by the image around its surface; None where it has no edge at all, or is one slice.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        mm, negative inside.
    image : ndarray (nz, ny, nx)
        As it was evolved, in any unit.
    geometry : Geometry
    volume_mm3 : float
        Of the surface.
    """
    spacing = geometry.spacing
    thin, thick = min(spacing), max(spacing)
    sigmas = tuple(SIGMA * max(1.0, thick / (2.0 * h)) for h in spacing)
    box = bounding_box(psi < 0, int(BESIDE) + 1 + int(np.ceil(3.0 * max(sigmas))))
    if box is None or min(geometry.shape) == 1:
        return None
    psi, image = np.ascontiguousarray(psi[box]), np.ascontiguousarray(image[box])
    deep = psi < min(-SHELL * thin, 0.5 * float(psi.min()))
    beside = (psi > SHELL * thin) & (psi < BESIDE * thick)
    if not deep.any() or not beside.any():
        return None
    levels = _Levels(
        float(image[deep].mean(dtype=float)), float(image[beside].mean(dtype=float)), sigmas
    )
    if levels.inside == levels.beside:
        return None
    shares = np.empty_like(psi)
    moved = 0.0
    found = volume_mm3
    for _ in range(PASSES):
        sums = _measure_shell(shares, psi, image, moved, spacing, levels)
        if not sums.voxels or not sums.core or not sums.contrast:
            return None
        before, found = found, float(geometry.voxel_volume * (sums.core + sums.shares))
        layer = geometry.voxel_volume * sums.voxels / (2.0 * SHELL)
        shift = (found - before) / layer
        if abs(shift) < STILL:
            break
        moved += shift * sums.extents / sums.voxels
    mean = sums.contrast / sums.voxels
    noise = noise_of(image)
    contrast = abs(levels.inside - levels.beside)
    deviation = float(np.sqrt(max(sums.squares / sums.voxels - mean**2, 0.0)))
    if found <= 0 or noise > MAX_UNCERTAINTY * contrast or deviation > MAX_UNCERTAINTY * abs(mean):
        return None
    at = Geometry(
        psi.shape, spacing, tuple(geometry.index_to_world(corner_of(box))), geometry.direction
    )
    noise_of_shares = noise / contrast * (thick / thin) ** 0.25
    sharp, blunt = (_half_surface(shares, at, noise_of_shares, times) for times in (1.0, 2.0))
    if sharp is None or blunt is None:
        return None
    area, blunt_area = (
        each.area_mm2 * (found / each.volume_mm3) ** (2 / 3) for each in (sharp, blunt)
    )
    return EdgeMeasures(
        found,
        area,
        sharp.diameter_mm,
        math.log(area / blunt_area),
        math.log(sharp.diameter_mm / blunt.diameter_mm),
        geometry.voxel_volume * noise * float(np.sqrt(sums.weights)),
        layer,
        sharp.step_mm,
        thin,
        deviation / abs(mean),
        noise_of_shares,
        (found - volume_mm3) / layer,
    )


class _HalfSurface(NamedTuple):
    """Measures of a surface f = 1/2, and a voxel's extent along its diameter."""

    volume_mm3: float
    area_mm2: float
    diameter_mm: float
    step_mm: float


def _half_surface(
    shares: Singles, geometry: Geometry, noise: float, times: float
) -> _HalfSurface | None:
    """Measure the surface where smoothed shares are 1/2; None where none is left.

    Parameters
    ----------
    shares : ndarray (nz, ny, nx)
    geometry : Geometry
        Of them.
    noise : float
        That of `EdgeMeasures`.
    times : float
        How many times the least smoothing.
    """
    sigma = times * (SMOOTH + SMOOTH_IN_NOISE * noise)
    widths = [(h / min(geometry.spacing)) ** 0.5 for h in geometry.spacing]
    half = np.float32(0.5) - gaussian_mm(np.clip(shares, -1.0, 2.0), widths, sigma)
    parts, count = ndimage.label(half < 0)
    is_hollow = np.ones(count + 1, np.bool_)
    is_hollow[parts[shares >= 1.0]] = False
    half[(half < 0) & is_hollow[parts]] = 0.1
    if not (half < 0).any():
        return None
    places, faces = crossings(half, geometry)
    surface = Surface(geometry.index_to_world(places), faces)
    first, last = longest_line(surface.vertices)
    length = float(np.linalg.norm(last - first))
    along = geometry.direction.T @ (last - first) / length
    step = float(np.linalg.norm(along * geometry.spacing_xyz))
    return _HalfSurface(abs(surface.volume), surface.area, length, step)


def _measure_shell(
    shares: Singles,
    psi: Psi,
    image: Image,
    moved: float,
    spacing: tuple[float, float, float],
    levels: _Levels,
) -> _Sums:
    """Write the share of each voxel, and return sums over the shell around psi = ``moved``; some planes at a time."""
    halo, sums = 1 + int(np.ceil(3.0 * levels.sigmas[0])), np.zeros(7)
    for planes in slabs(psi.shape, at_least=4 * halo):
        low, high = max(planes.start - halo, 0), min(planes.stop + halo, psi.shape[0])
        within = slice(planes.start - low, planes.stop - low)
        depth, extent = _depth(psi[low:high] - np.float32(moved), spacing)
        values, core = image[low:high], depth < -SHELL
        shell = np.flatnonzero(np.abs(depth[within]) <= SHELL)
        inside = _nearby(values, core, levels.inside, levels.sigmas, within, shell).astype(float)
        beside = (depth > SHELL) & (depth <= BESIDE)
        outside = _nearby(values, beside, levels.beside, levels.sigmas, within, shell)
        contrast, least = inside - outside, MIN_CONTRAST * (levels.inside - levels.beside)
        weights = contrast / (contrast**2 + least**2)
        found = (values[within].take(shell) - outside) * weights
        shares[planes] = core[within]
        shares[planes].reshape(-1)[shell] = found
        sums += [
            found.sum(),
            found.size,
            np.square(weights).sum(),
            contrast.sum(),
            np.square(contrast).sum(),
            extent[within].take(shell).sum(),
            np.count_nonzero(core[within]),
        ]
    return _Sums(*sums.tolist())


def _depth(psi: Psi, spacing: tuple[float, float, float]) -> tuple[Singles, Singles]:
    """Return psi in voxels along its normal, and the extent of a voxel along that, mm.

    Where psi is constant, and beyond the shell and the surroundings, the depth is infinite and the extent 0.
    """
    flat, near = psi.ravel(), np.flatnonzero(np.abs(psi) <= 1.01 * BESIDE * max(spacing))
    slopes = [
        np.gradient(psi, h, axis=axis).reshape(-1).take(near) for axis, h in enumerate(spacing)
    ]
    steep = np.sqrt(sum(np.square(slope) for slope in slopes))
    long = np.sqrt(
        sum(np.square(slope * np.float32(h)) for slope, h in zip(slopes, spacing, strict=True))
    )
    depth, extent = np.where(psi < 0, np.float32(-np.inf), np.float32(np.inf)), np.zeros_like(psi)
    with np.errstate(divide="ignore", invalid="ignore"):
        long = long / steep
        depth.reshape(-1)[near] = np.where(
            steep > 0.1, flat[near] / long, np.sign(flat[near]) * np.float32(np.inf)
        )
    extent.reshape(-1)[near] = long
    return depth, extent


def _nearby(
    image: Image,
    mask: Mask,
    level: float,
    sigmas: tuple[float, ...],
    within: slice,
    shell: NDArray[np.int64],
) -> Singles:
    """Return means of the image over the voxels of a mask nearby, at the shell; where none is near, the level.

    They are Gaussian filters, along the rows at the shell's voxels alone.
    """
    sums, (of_planes, of_lines, of_rows) = [], (gaussian_weights(sigma, 3.0) for sigma in sigmas)
    for values in (
        mask.astype(np.float32),
        np.where(mask, image - np.float32(level), np.float32(0)),
    ):
        smooth = np.empty_like(values)
        smooth_across_rows(values, of_planes, 0, smooth)
        smooth_across_rows(smooth[within], of_lines, 1, values[within])
        far, nx = len(of_rows) - 1, values.shape[2]
        row = np.pad(values[within].reshape(-1, nx), ((0, 0), (far, far)), "symmetric").ravel()
        at = shell // nx * (nx + 2 * far) + shell % nx + far
        total = of_rows[0] * row.take(at)
        for step in range(far, 0, -1):
            total += of_rows[step] * (row.take(at - step).astype(float) + row.take(at + step))
        sums.append(total.astype(np.float32))
    return np.asarray(np.float32(level) + sums[1] / (sums[0] + np.float32(1e-3)))
