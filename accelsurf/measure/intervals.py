"""Intervals that hold the true volume, area and diameter of an object in 95 of 100 cases, by its edge in the image.

A voxel that the surface passes holds a share f of the object, and the image there is I = f I_in + (1 - f) I_out, for
any blur and any thickness of the slices, as both keep sums. With I_in and I_out as they are nearby, in the object and
beside it, the volume is that of the voxels within plus the sum of f over a shell around the surface. The surface
f = 1/2 has the diameter; the area is that of the object's surface, scaled to this volume. White noise of deviation s in
I is s / |I_in - I_out| in f, so that of the volume is known. The rest has no formula: the levels nearby are those of
something else, the edge is doubtful, the surface is far off. It grows with the layer of voxels on the surface, with
how the contrast differs along it, and with how far the shell had to be moved; the weights come from phantoms
(`benchmarks/intervals.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box, bounding_box, corner_of, slabs
from accelsurf.grid.geometry import Geometry
from accelsurf.image.noise import noise_of
from accelsurf.image.smoothing import gaussian_weights
from accelsurf.kernels.smoothing import smooth_across_rows
from accelsurf.measure.diameters import longest_line
from accelsurf.measure.surface_mesh import crossings

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Half the shell's thickness, and where what is beside the object ends: voxels along the surface's normal.
SHELL, BESIDE = 1.5, 3.0
#: Levels nearby are means over a Gaussian of this sigma: voxels, of slices thicker than two pixels more pixels.
SIGMA = 1.5
#: Contrasts below this part of the object's count less and less.
MIN_CONTRAST = 0.05
#: The shell is moved to the edge that it finds, so often at most, or until it moves by less, in voxels.
PASSES, AT_REST = 3, 0.05
#: Beyond so much noise or variation, in parts of the contrast, there is no edge to measure by.
MAX_DOUBT = 2.0
#: Shares are smoothed for the surface f = 1/2 by a Gaussian of this sigma, pixels.
SMOOTH = 0.7


class Interval(NamedTuple):
    """An interval of a measure."""

    low: float
    high: float


class Intervals(NamedTuple):
    """Intervals that hold the true measures in 95 of 100 cases, as long as the object is the right one."""

    volume_mm3: Interval
    area_mm2: Interval
    diameter_mm: Interval


#: Those of `signs` that tell a mean error.
BIASED = (0, 1, 2, 5)


class _Weights(NamedTuple):
    """Weights of what tells the error of a measure.

    Attributes
    ----------
    bias : tuple of float
        Mean error: by 1, the variation, the noise, the thinness.
    spread : tuple of float
        Deviation, the root of the sum of squares: by all of `signs`.
    factor : float
        Deviations to either side of 95 of 100 cases.
    """

    bias: tuple[float, float, float, float]
    spread: tuple[float, float, float, float, float, float]
    factor: float


#: ``python -m benchmarks.intervals --fit``. Units: of the volume a layer of voxels; of the logarithm of the area, that
#: over the volume, by the root of its thickness in pixels; of the diameter, the root of pixel and voxel along it.
_VOLUME = _Weights((-0.002, 0.134, 0.023, 0.002), (0.0, 0.107, 0.047, 1.526, 0.036, 0.017), 2.29)
_AREA = _Weights((-0.079, -0.076, -0.426, 0.178), (0.095, 0.556, 0.238, 0.0, 0.304, 0.035), 1.83)
_DIAMETER = _Weights((0.693, 0.750, -2.359, -0.094), (0.741, 2.830, 1.865, 0.0, 2.923, 0.0), 1.95)


class EdgeMeasures(NamedTuple):
    """Measures of an object by its shares of voxels, and what tells how sure they are.

    Attributes
    ----------
    volume_mm3, area_mm2, diameter_mm : float
    noise_mm3 : float
        Standard deviation of the volume by the noise of the image.
    layer_mm3 : float
        Volume of a layer of one voxel on the surface.
    step_mm, pixel_mm : float
        Extent of a voxel along the diameter; the smallest spacing.
    variation : float
        Standard deviation of the contrast along the surface, in parts of its mean.
    noise : float
        Of the image, in parts of the contrast.
    moved : float
        How far outwards the shell was moved, in voxels.
    """

    volume_mm3: float
    area_mm2: float
    diameter_mm: float
    noise_mm3: float
    layer_mm3: float
    step_mm: float
    pixel_mm: float
    variation: float
    noise: float
    moved: float


def intervals(found: EdgeMeasures) -> Intervals:
    """Return the intervals of an object by the measures of its edge.

    Examples
    --------
    >>> found = EdgeMeasures(4189.0, 1257.0, 20.0, 9.0, 1257.0, 1.0, 1.0, variation=0.0, noise=0.1, moved=0.0)
    >>> [round(part) for part in intervals(found).volume_mm3], [round(part, 1) for part in intervals(found).diameter_mm]
    ([4161, 4219], [18.9, 21.9])
    """
    ends, (layer, relative, line) = [], units(found)
    for sign in (-1.0, 1.0):
        volume = found.volume_mm3 + layer * _end(_VOLUME, found, sign, found.noise_mm3 / layer)
        area = found.area_mm2 * math.exp(relative * _end(_AREA, found, sign))
        diameter = found.diameter_mm + line * _end(_DIAMETER, found, sign)
        ends.append((max(volume, 0.0), area, max(diameter, 0.0)))
    return Intervals(*(Interval(low, high) for low, high in zip(*ends, strict=True)))


def _end(weights: _Weights, found: EdgeMeasures, sign: float, known: float = 0.0) -> float:
    """Return an end of an interval in the unit of its measure; ``known`` is a deviation besides."""
    values = signs(found)
    middle = sum(weight * values[place] for weight, place in zip(weights.bias, BIASED, strict=True))
    squares = [(weight * value) ** 2 for weight, value in zip(weights.spread, values, strict=True)]
    return middle + sign * weights.factor * math.sqrt(known**2 + sum(squares))


def signs(found: EdgeMeasures) -> tuple[float, ...]:
    """Return what tells the error: 1, variation, noise, their product, how far the shell was moved, thinness."""
    thinness = found.layer_mm3 / found.volume_mm3
    return (
        1.0,
        found.variation,
        found.noise,
        found.variation * found.noise,
        abs(found.moved),
        thinness,
    )


def units(found: EdgeMeasures) -> tuple[float, float, float]:
    """Return the units of the errors of volume (mm3), logarithm of the area, and diameter (mm); see `_Weights`."""
    relative = found.layer_mm3 / found.volume_mm3
    thickness = found.layer_mm3 / found.area_mm2 / found.pixel_mm
    return (
        found.layer_mm3,
        relative / math.sqrt(thickness),
        math.sqrt(found.step_mm * found.pixel_mm),
    )


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
    psi: Image, image: Image, geometry: Geometry, volume_mm3: float, area_mm2: float
) -> EdgeMeasures | None:
    """Measure an object by the image around its surface; None where it has no edge at all, or is one slice.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        mm, negative inside.
    image : ndarray (nz, ny, nx)
        As it was evolved, in any unit.
    geometry : Geometry
    volume_mm3, area_mm2 : float
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
    shares, moved, found = np.empty_like(psi), 0.0, volume_mm3
    for _ in range(PASSES):
        sums = _measure_shell(shares, psi, image, moved, spacing, levels)
        if not sums.voxels or not sums.core or not sums.contrast:
            return None
        before, found = found, float(geometry.voxel_volume * (sums.core + sums.shares))
        layer = geometry.voxel_volume * sums.voxels / (2.0 * SHELL)
        shift = (found - before) / layer
        if abs(shift) < AT_REST:
            break
        moved += shift * sums.extents / sums.voxels
    mean, noise, contrast = (
        sums.contrast / sums.voxels,
        noise_of(image),
        abs(levels.inside - levels.beside),
    )
    deviation = float(np.sqrt(max(sums.squares / sums.voxels - mean**2, 0.0)))
    line = _diameter(shares, geometry, box)
    if (
        line is None
        or found <= 0
        or noise > MAX_DOUBT * contrast
        or deviation > MAX_DOUBT * abs(mean)
    ):
        return None
    return EdgeMeasures(
        found,
        area_mm2 * (found / volume_mm3) ** (2.0 / 3.0),
        line[0],
        geometry.voxel_volume * noise * float(np.sqrt(sums.weights)),
        layer,
        line[1],
        thin,
        deviation / abs(mean),
        noise / contrast,
        (found - volume_mm3) / layer,
    )


def _diameter(shares: Image, geometry: Geometry, box: Box) -> tuple[float, float] | None:
    """Return the diameter of the surface where shares are 1/2, and a voxel's extent along it, mm."""
    widths = [SMOOTH * (min(geometry.spacing) / h) ** 0.5 for h in geometry.spacing]
    half = np.float32(0.5) - ndimage.gaussian_filter(np.clip(shares, -1.0, 2.0), widths)
    parts, count = ndimage.label(half < 0)
    is_hollow = np.ones(count + 1, np.bool_)
    is_hollow[parts[shares >= 1.0]] = False
    half[(half < 0) & is_hollow[parts]] = 0.1
    if not (half < 0).any():
        return None
    part = Geometry(
        half.shape,
        geometry.spacing,
        tuple(geometry.index_to_world(corner_of(box))),
        geometry.direction,
    )
    first, last = longest_line(part.index_to_world(crossings(half, part)[0]))
    length = float(np.linalg.norm(last - first))
    along = geometry.direction.T @ (last - first) / length
    return length, float(np.linalg.norm(along * geometry.spacing_xyz))


def _measure_shell(
    shares: Image,
    psi: Image,
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


def _depth(psi: Image, spacing: tuple[float, float, float]) -> tuple[Image, Image]:
    """Return psi in voxels along its normal, and the extent of a voxel along that, mm.

    Where psi is constant, and where it is more than the shell and what is beside it take, the depth is infinite and the
    extent 0.
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
) -> Image:
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
