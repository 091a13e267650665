"""Evidence for a surface, place by place: an edge, different values outside, and a click nearby.

At places on the surface the image is sampled along the normal: one step outside (I_o), one inside (I_i) and three
inside (I_d). A step is `STEP` voxels. The noise is the median of |I_i - I_d|: the difference within the object over
the same distance as across its surface. So contrasts have no unit and need no range of the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.arrays import Floats, Image, Mask
from accelsurf.grid.boxes import (
    Box,
    Corner,
    as_corner,
    bounding_box,
    box_at,
    corner_of,
    counted_from,
    whole_box,
    widened,
)

#: Voxels of a step; approximate number of sampled places on the surface; sigma, voxels, that normals are smoothed with.
STEP = 1.5
SAMPLES = 20_000
NORMAL_SIGMA = 1.0
#: HALF_EDGE: an edge of this many times the noise counts as half. HALF_MODEL: the outside counts half as another
#: region where its values are farther from the object's median than the inside, by this many deviations of the object.
#: LIKE: the outside counts as the same region within this many deviations.
HALF_EDGE = 3.0
HALF_MODEL = 1.5
LIKE = 2.5
#: A patch of the surface is a Gaussian of this part of the object's radius (that of the ball of its volume).
PATCH = 0.3
#: Distance between patches that are looked at one after another, in radii of a patch.
APART = 3.0
#: Least noise, as a part of the deviation of the object's values and of those beside it.
MIN_NOISE = 0.05


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence at places on a surface.

    Attributes
    ----------
    index : ndarray (n, 3)
        Voxels (z, y, x) next to the surface, on its inside.
    edge, model : ndarray (n,)
        0 to 1: of an edge; of an outside that is less like the object than the inside there.
    click : ndarray (n,)
        0 to 1: of a click near by.
    contrast : float
        Median difference across the surface in units of the noise.
    inside_like : float
        Share of the surface where the outside has values of the object.
    drift : float
        Difference of the object's values far from its middle and near it, in units of their deviation.
    """

    index: NDArray[np.int64]
    edge: Floats
    model: Floats
    click: Floats
    contrast: float
    inside_like: float
    drift: float

    @property
    def of_image(self) -> Floats:
        """Evidence of each place (n,) by the image alone."""
        return self.edge * self.model

    @property
    def total(self) -> Floats:
        """Evidence of each place (n,), 0 to 1: that at least one of the three holds."""
        uncertainty: Floats = (1.0 - self.of_image) * (1.0 - self.click)
        return 1.0 - uncertainty


def gather_evidence(
    inside: Mask, image: Image, spacing: tuple[float, float, float], clicked: Mask | None = None
) -> Evidence | None:
    """The evidence for the surface of a mask; None where nothing of it lies within the image.

    Parameters
    ----------
    inside : ndarray (nz, ny, nx) of bool
    image : ndarray (nz, ny, nx), float32
        As it was evolved, in any unit.
    spacing : (hz, hy, hx)
        mm.
    clicked : ndarray (nz, ny, nx) of bool, optional
        Voxels that a person clicked, on either side.
    """
    box = bounding_box(inside, 6)
    if box is None:
        return None
    part, values = inside[box], image[box]
    deeper = eroded(part)
    index, normal = _places(part, part & ~deeper, spacing)
    if not len(index):
        return None
    near, deep, out = (_sampled(values, index, normal, k * STEP) for k in (-1.0, -3.0, 1.0))
    core = values[deeper]
    core = core if core.size > 20 else values[part]
    middle, deviation = median_and_deviation(core)
    beside = median_and_deviation(out)[1]
    floor = MIN_NOISE * max(deviation, beside, 1e-12)
    noise = max(float(np.median(np.abs(near - deep))), floor)
    across = np.abs(near - out) / noise
    unlike = np.abs(out - middle) / max(deviation, floor)
    gain = np.maximum(unlike - np.abs(near - middle) / max(deviation, floor), 0.0)
    corner = np.array(corner_of(box))
    places = index + corner
    return Evidence(
        places,
        _rising(across, HALF_EDGE),
        _rising(gain, HALF_MODEL),
        _near_click(places, clicked, inside, spacing),
        float(np.median(across)),
        float((unlike < LIKE).mean()),
        _drift(part, deeper, values, spacing, deviation, floor),
    )


def uncertain_places(
    evidence: Evidence, spacing: tuple[float, float, float], volume_mm3: float, count: int = 1
) -> list[tuple[tuple[int, int, int], float]]:
    """Return the patches with the least evidence, most uncertain first: a voxel (z, y, x), and its uncertainty, 0 to 1.

    The voxel lies next to the surface, and the patch around it. Uncertainty is summed over the patch: a large
    uncertain piece counts for more than a small one. Ties go to the first. There is at least one; a further one lies at
    least three patches' radii from those before it.
    """
    uncertainty = 1.0 - evidence.total
    # Counted from the object's own first voxel: the blocks do not depend on where its grid begins.
    places = (evidence.index - evidence.index.min(axis=0)) * np.asarray(spacing)
    radius = max(PATCH * (0.75 * max(volume_mm3, 1e-30) / np.pi) ** (1.0 / 3.0), 2.0 * max(spacing))
    # Blocks of half a patch stand for the places in them.
    blocks = (places / (0.5 * radius)).astype(np.int64).T
    _, member = np.unique(
        np.ravel_multi_index(tuple(blocks), blocks.max(axis=1) + 1), return_inverse=True
    )
    counts = np.bincount(member).astype(np.float64)
    sums = np.bincount(member, uncertainty)
    middles = (
        np.stack([np.bincount(member, places[:, a]) for a in range(3)], axis=1) / counts[:, None]
    )
    totals, shares = np.zeros((2, len(counts)))
    for i, middle in enumerate(middles):
        weight = np.exp(-0.5 * ((middles - middle) ** 2).sum(axis=1) / radius**2)
        totals[i] = float((weight * sums).sum())
        shares[i] = totals[i] / float((weight * counts).sum())
    out: list[tuple[tuple[int, int, int], float]] = []
    far = np.ones(len(counts), np.bool_)
    while len(out) < count and far.any():
        best = _first_largest(totals, far)
        members = np.flatnonzero(member == best)
        voxel = evidence.index[members[int(np.argmax(uncertainty[members]))]]
        out.append((as_corner(voxel), float(shares[best])))
        far &= ((middles - middles[best]) ** 2).sum(axis=1) > (APART * radius) ** 2
    return out


def _first_largest(totals: Floats, among: Mask) -> int:
    """The largest of some numbers; of those that are equal but for rounding the first."""
    best, most = 0, -1.0
    for i in np.flatnonzero(among):
        if totals[i] > most * (1.0 + 1e-9):
            best, most = int(i), float(totals[i])
    return best


def eroded(mask: Mask, voxels: int = 1) -> Mask:
    """Voxels of a mask with no other voxel within a number of voxels; beyond the array the mask continues."""
    reach = [voxels if n > 1 else 0 for n in mask.shape]
    deep = mask.copy()
    offsets = np.indices([2 * r + 1 for r in reach]).reshape(3, -1).T - reach
    for offset in offsets[(offsets**2).sum(axis=1) <= voxels**2]:
        here = tuple(
            slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, mask.shape, strict=True)
        )
        there = tuple(
            slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, mask.shape, strict=True)
        )
        deep[here] &= mask[there]
    return deep


def _places(inside: Mask, rim: Mask, spacing: Sequence[float]) -> tuple[NDArray[np.int64], Floats]:
    """Voxels of the rim, (n, 3), and the outward normal of the surface there: 1 voxel long along its axis."""
    cells = np.flatnonzero(rim)
    cells = cells[:: max(1, cells.size // SAMPLES)]
    index = np.stack(np.unravel_index(cells, inside.shape), axis=1)
    widths = [NORMAL_SIGMA if n > 1 else 0.0 for n in inside.shape]
    smooth = ndimage.gaussian_filter(inside.astype(np.float32), widths, mode="nearest")
    normal = np.zeros(index.shape)
    for axis, (n, h) in enumerate(zip(inside.shape, spacing, strict=True)):
        if n > 1:
            low, high = index.copy(), index.copy()
            low[:, axis], high[:, axis] = (
                np.maximum(index[:, axis] - 1, 0),
                np.minimum(index[:, axis] + 1, n - 1),
            )
            # In voxels: a gradient per mm, over the spacing once more.
            normal[:, axis] = (
                smooth[tuple(low.T)].astype(np.float64) - smooth[tuple(high.T)]
            ) / h**2
    longest = np.abs(normal).max(axis=1)
    known = longest > 0
    return index[known].astype(np.int64), normal[known] / longest[known, None]


def _sampled(values: Image, index: NDArray[np.int64], normal: Floats, voxels: float) -> Floats:
    """The image at places (n,) a number of voxels outward; linear, the border's values beyond the border."""
    at = (index + voxels * normal).T
    return np.asarray(ndimage.map_coordinates(values, at, order=1, mode="nearest"), np.float64)


def median_and_deviation(values: NDArray[np.floating]) -> tuple[float, float]:
    """Median, and the standard deviation by the median absolute deviation."""
    flat = np.asarray(values, np.float64).ravel()
    flat = flat[:: max(1, flat.size // (1 << 18))]
    middle = float(np.median(flat))
    return middle, 1.4826 * float(np.median(np.abs(flat - middle)))


def _rising(value: Floats, half: float) -> Floats:
    """0 at 0, a half at ``half``, towards 1 beyond."""
    square = (value / half) ** 2
    return square / (1.0 + square)


def _near_click(
    index: NDArray[np.int64], clicked: Mask | None, inside: Mask, spacing: Sequence[float]
) -> Floats:
    """1 beside a click, falling over a part of the object's radius."""
    if clicked is None or not clicked.any():
        return np.zeros(len(index))
    volume = float(inside.sum()) * float(np.prod(spacing))
    radius = PATCH * (0.75 * volume / np.pi) ** (1.0 / 3.0) + max(spacing)
    from scipy.spatial import cKDTree

    # From the object's own first voxel on: the last bits do not depend on where its grid begins.
    first, widths = index.min(axis=0), np.asarray(spacing)
    away, _ = cKDTree((np.argwhere(clicked) - first) * widths).query((index - first) * widths)
    return np.asarray(np.exp(-0.5 * (away / radius) ** 2))


def deepest_voxel(inside: Mask, spacing: Sequence[float]) -> Corner:
    """The voxel farthest from the surface, the first of several; the border is none."""
    if inside.all():
        return _deepest_within(inside, whole_box(inside.shape), 0.0, spacing)[1]
    # Distances between blocks of two voxels along each axis are those between their voxels but for a diagonal.
    blocks, diagonal = (
        np.pad(inside, [(0, n % 2) for n in inside.shape], mode="edge"),
        float(np.linalg.norm(spacing)),
    )
    blocks = blocks[::2] & blocks[1::2]
    blocks = blocks[:, ::2] & blocks[:, 1::2]
    depths = ndimage.distance_transform_edt(
        blocks[:, :, ::2] & blocks[:, :, 1::2], [2.0 * h for h in spacing]
    )
    reach, at = float(depths.max()) + diagonal, np.unravel_index(depths.argmax(), depths.shape)
    least, _ = _deepest_within(inside, box_at(as_corner(at), (1, 1, 1)), reach, spacing)
    may_be = bounding_box(depths >= least - 1.000001 * diagonal) or whole_box(depths.shape)
    return _deepest_within(inside, may_be, reach, spacing)[1]


def _deepest_within(
    inside: Mask, blocks: Box, reach: float, spacing: Sequence[float]
) -> tuple[float, Corner]:
    """The depth of the deepest voxel of a box of blocks, and which that is; none there is deeper than ``reach``."""
    z, y, x = (
        slice(2 * part.start, min(2 * part.stop, n))
        for part, n in zip(blocks, inside.shape, strict=True)
    )
    around = widened((z, y, x), inside.shape, [int(reach / h) + 2 for h in spacing])
    planes, lines, rows = counted_from((z, y, x), corner_of(around))
    # The nearest voxels outside, and the distances to them plane by plane: all distances at once take four times that.
    nearest = ndimage.distance_transform_edt(
        np.pad(inside[around], 1, mode="edge"),
        sampling=spacing,
        return_distances=False,
        return_indices=True,
    )[:, 1:-1, 1:-1, 1:-1]
    most, place = -1.0, (0, 0, 0)
    across, along = (np.arange(part.start + 1, part.stop + 1) for part in (lines, rows))
    for k in range(planes.start, planes.stop):
        at = nearest[:, k, lines, rows]
        offsets = (
            (at[0] - (k + 1)) * spacing[0],
            (at[1] - across[:, None]) * spacing[1],
            (at[2] - along) * spacing[2],
        )
        depth = np.sqrt(offsets[0] ** 2 + offsets[1] ** 2 + offsets[2] ** 2)
        found = int(np.argmax(depth))
        if depth.flat[found] > most:
            line, row = divmod(found, len(along))
            most, place = (
                float(depth.flat[found]),
                (k - planes.start + z.start, line + y.start, row + x.start),
            )
    return most, place


def _drift(
    inside: Mask,
    deeper: Mask,
    values: Image,
    spacing: Sequence[float],
    deviation: float,
    floor: float,
) -> float:
    """Largest difference of the medians of shells around the deepest point, in units of the object's deviation."""
    middle = deepest_voxel(inside, spacing)
    core = deeper if np.count_nonzero(deeper) > 20 else inside
    z, y, x = (
        ((np.arange(n) - m) * h) ** 2 for n, m, h in zip(inside.shape, middle, spacing, strict=True)
    )
    away = np.concatenate([(z[k] + y[:, None] + x)[plane] for k, plane in enumerate(core)])
    ordered = values[core][np.argsort(away, kind="stable")]
    shells = [float(np.median(shell)) for shell in np.array_split(ordered, 4) if shell.size]
    return float(np.ptp(shells)) / max(deviation, floor)
