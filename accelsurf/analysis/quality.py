"""Whether to trust a result: measures of the surface and the image that need no reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box, bounding_box
from accelsurf.grid.geometry import axis_steps
from accelsurf.grid.slabs import slabs
from accelsurf.grid.smoothing import gaussian_mm

if TYPE_CHECKING:
    from accelsurf.evolution.records import StepRecord, Stop

#: A warning is given beyond these: fraction of the surface on the border, and without an edge; contrast as a fraction
#: of the image's range; relative growth over the last steps.
MAX_ON_BORDER, MAX_WITHOUT_EDGE, MIN_CONTRAST, MAX_GROWTH, LAST_STEPS = 0.2, 0.4, 0.05, 0.02, 20
#: The same for the fraction of the object with values unlike those of the learned model. A Gaussian has 1.2 % beyond
#: the bounds; good results of docs/explanation/real-scans.md have at most 3 %, leaked ones 19 % and more.
MAX_UNLIKE = 0.1
#: A gradient is an edge if it is above this percentile of the gradients inside the object, at least so many voxels from
#: its surface, and above this fraction of the image's range over the scale that gradients are computed at.
INTERIOR_PERCENTILE, INTERIOR_DEPTH, MIN_EDGE = 75.0, 3, 0.005
#: A part counts from this fraction of the object's volume on; a neck is at most so many voxels to either side; so many
#: parts are examined.
LARGE_PART, NECK, MAX_PARTS = 0.05, 2, 200
#: Gradients inside the object are sampled at about so many voxels.
GRADIENT_SAMPLES = 1 << 18
#: A slab has at least so many planes for each plane around it that is needed besides.
MIN_SLAB_HALOS = 4


class Quality(NamedTuple):
    """Measures of a result that need no reference.

    Attributes
    ----------
    border_fraction : float
        Share of the object's surface that lies on the volume's border.
    contrast : float
        Mean difference of the image across the surface, inside less outside, one voxel from it on either side; as a
        fraction of the image's range.
    no_edge_fraction : float
        Share of the surface where the image has no edge: a gradient within the lower three quarters of those inside the
        object.
    parts_beyond_necks : int
        Large parts that remain when necks of less than four voxels are removed; 1 for a compact object.
    growth : float
        Volume at the end over that of the start.
    late_growth : float
        Relative change of the volume over the last 20 steps.
    unlike_learned : float or None
        Share of the object, without the voxels next to its surface, whose values lie further than 2.5 standard
        deviations from the mean of those that it was learned from; None where no model was learned once.
    leaked : bool
        Whether it grew beyond ``max_volume``.
    warnings : tuple of str
        One sentence for each doubtful measure.
    """

    border_fraction: float
    contrast: float
    no_edge_fraction: float
    parts_beyond_necks: int
    growth: float
    late_growth: float
    unlike_learned: float | None
    leaked: bool
    warnings: tuple[str, ...]


def assess(
    labels: NDArray[np.uint8],
    image: NDArray[np.float32],
    spacing: tuple[float, float, float],
    history: Sequence[StepRecord],
    stop: Stop,
    learned: tuple[float, float] | None = None,
) -> Quality:
    """Measure the quality of a result.

    Parameters
    ----------
    labels : ndarray (nz, ny, nx)
        Above 0 inside.
    image : ndarray (nz, ny, nx)
        As energies see it, 0 and 1 at its percentiles.
    spacing : (hz, hy, hx)
        mm.
    history : sequence of StepRecord
    stop : Stop
    learned : (float, float), optional
        Range of values that a model learned from the start gives the object.
    """
    inside = labels > 0
    border, contrast = _border_and_contrast(inside, image, spacing)
    own = [row for row in history if row.level == 0]
    first, last = (history[0].volume_mm3, history[-1].volume_mm3) if history else (0.0, 0.0)
    before = own[-LAST_STEPS - 1].volume_mm3 if len(own) > LAST_STEPS else (own[0].volume_mm3 if own else 0.0)
    found = Quality(
        border_fraction=border,
        contrast=contrast,
        no_edge_fraction=_no_edge_fraction(inside, image, spacing),
        parts_beyond_necks=_parts_beyond_necks(inside),
        growth=last / first if first > 0 else 0.0,
        late_growth=(last - before) / last if last > 0 else 0.0,
        unlike_learned=None if learned is None else _unlike_fraction(inside, image, learned),
        leaked=stop.reason == "leaked",
        warnings=(),
    )
    return found._replace(warnings=tuple(_warnings(found, stop)))


def _warnings(found: Quality, stop: Stop) -> list[str]:
    warnings = []
    if found.leaked:
        warnings.append(f"leak: {stop.message}")
    if found.unlike_learned is not None and found.unlike_learned > MAX_UNLIKE:
        warnings.append(
            f"values: {found.unlike_learned:.0%} of the object is unlike what it was learned from: it may have leaked, "
            "or what it was learned from is not typical"
        )
    if found.border_fraction > MAX_ON_BORDER:
        warnings.append(f"border: {found.border_fraction:.0%} of the surface lies on the volume's border")
    # An object may be brighter than one neighbour and darker than another: then there are edges.
    if abs(found.contrast) < MIN_CONTRAST and found.no_edge_fraction > MAX_WITHOUT_EDGE:
        warnings.append(
            f"contrast: inside and outside hardly differ at the surface ({found.contrast:.3f} of the image's range)"
        )
    if found.no_edge_fraction > MAX_WITHOUT_EDGE:
        warnings.append(f"edge: under {found.no_edge_fraction:.0%} of the surface the image has no edge")
    if found.parts_beyond_necks > 1:
        warnings.append(
            f"necks: {found.parts_beyond_necks} large parts are connected by less than four voxels only; has it leaked?"
        )
    if abs(found.late_growth) > MAX_GROWTH and stop.reason != "converged":
        warnings.append(f"growth: the volume changed by {found.late_growth:+.0%} in the last {LAST_STEPS} steps")
    return warnings


def _around(inside: NDArray[np.bool_], margin: int) -> Box:
    """The object's box with so many voxels around it; a box without voxels when there is no object."""
    return bounding_box(inside, margin) or (slice(0, 0), slice(0, 0), slice(0, 0))


def _border_and_contrast(
    inside: NDArray[np.bool_], image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> tuple[float, float]:
    """Share of the object's faces on the border, by their areas, and the mean difference across the others."""
    box = _around(inside, 2)
    within, values = inside[box], image[box]
    total = on_border = 0.0
    weights = differences = 0.0
    for axis in range(3):
        if inside.shape[axis] == 1:
            continue
        area = float(np.prod([h for other, h in enumerate(spacing) if other != axis]))
        m, v = np.moveaxis(within, axis, 0), np.moveaxis(values, axis, 0)
        on_border += area * sum(
            float(np.take(inside, end, axis=axis).sum()) for end in (0, inside.shape[axis] - 1)
        )
        at = np.argwhere(m[1:] != m[:-1])
        total += area * len(at)
        i, j, k = at.T
        # From a voxel below the face to one above it; towards inside it counts up.
        low, high = np.maximum(i - 1, 0), np.minimum(i + 2, len(m) - 1)
        sign = np.where(m[i, j, k], -1.0, 1.0)
        differences += area * float((sign * (v[high, j, k] - v[low, j, k])).sum())
        weights += area * len(at)
    total += on_border
    return (on_border / total if total > 0 else 0.0), (differences / weights if weights > 0 else 0.0)


def _unlike_fraction(inside: NDArray[np.bool_], image: NDArray[np.float32], learned: tuple[float, float]) -> float:
    """Share of the object, without the voxels next to its surface, with values outside of an interval."""
    box = _around(inside, 1)
    part = ndimage.binary_erosion(inside[box], border_value=1)
    values = image[box][part if part.any() else inside[box]]
    return float(((values < learned[0]) | (values > learned[1])).mean()) if values.size else 0.0


def _no_edge_fraction(
    inside: NDArray[np.bool_], image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> float:
    """Share of the voxels next to the surface, on its inside, where the smoothed image has no edge."""
    scale = max(axis_steps(inside.shape, spacing))
    halo = INTERIOR_DEPTH + 5 * int(np.ceil(scale / spacing[0])) + 1
    box = _around(inside, INTERIOR_DEPTH + 5 * int(np.ceil(scale / min(spacing))) + 1)
    inside, image = inside[box], image[box]
    if not inside.size:
        return 0.0
    on_surface: list[NDArray[np.float32]] = []
    within: list[NDArray[np.float32]] = []
    every = max(1, inside.size // GRADIENT_SAMPLES)
    for planes in slabs(inside.shape, at_least=MIN_SLAB_HALOS * halo):
        low, high = max(planes.start - halo, 0), min(planes.stop + halo, inside.shape[0])
        smooth = gaussian_mm(image[low:high], spacing, scale)
        before, after = planes.start - low, planes.stop - low
        part = inside[low:high]
        within_rim = ndimage.binary_erosion(part, border_value=1)
        deep = ndimage.binary_erosion(within_rim, iterations=INTERIOR_DEPTH - 1, border_value=1)
        for mask, found, each in ((part & ~within_rim, on_surface, 1), (deep, within, every)):
            own = mask[before:after]
            found.append(_gradients(smooth, spacing, np.flatnonzero(own)[::each] + before * own[0].size))
    surface, own = np.concatenate(on_surface), np.concatenate(within)
    if surface.size == 0:
        return 0.0
    # A thin object has no inside to compare with.
    usual = float(np.percentile(own, INTERIOR_PERCENTILE)) if own.size else 0.0
    return float((surface <= max(usual, MIN_EDGE / scale)).mean())


def _gradients(
    smooth: NDArray[np.float32], spacing: tuple[float, float, float], cells: NDArray[np.int64]
) -> NDArray[np.float32]:
    """|grad I| at raveled voxels (n,) of a smoothed image: centred differences, one-sided on the border."""
    flat, total, step = smooth.reshape(-1), np.zeros(cells.size, np.float32), smooth.size
    for n, h in zip(smooth.shape, spacing, strict=True):
        step //= n
        if n > 1:
            index = cells // step % n
            low, high = (index > 0).astype(np.int64), (index < n - 1).astype(np.int64)
            total += ((flat[cells + high * step] - flat[cells - low * step]) / (np.float32(h) * (low + high))) ** 2
    return np.sqrt(total)


def _parts_beyond_necks(inside: NDArray[np.bool_]) -> int:
    """Large parts that remain of the largest component without its necks."""
    box = _around(inside, 1)
    parts, count = ndimage.label(inside[box])
    if count == 0:
        return 0
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    body = parts == sizes.argmax()
    # An object that meets the border continues beyond it; a single slice has no depth across.
    padded = np.pad(body, [(NECK, NECK) if n > 1 else (0, 0) for n in inside.shape], mode="edge")
    del parts, body
    cores, count = ndimage.label(_deeper_than_neck(padded))
    if count < 2:
        return 1
    # Only so many parts can be large; numbered as bytes they need a quarter of the memory.
    sizes = np.bincount(cores.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")[: min(count, MAX_PARTS)]
    name = np.zeros(count + 1, np.uint8)
    name[order] = np.arange(1, len(order) + 1)
    reach = name[cores]
    del cores
    # Grow the cores back to the parts that they belong to.
    for _ in range(NECK + 1):
        grown = ndimage.maximum_filter(reach, 3)
        np.copyto(reach, grown, where=(reach == 0) & padded)
    volumes = np.bincount(reach.ravel())[1:]
    return max(1, int((volumes >= LARGE_PART * padded.sum()).sum()))


def _deeper_than_neck(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels of a mask with no other voxel within `NECK` voxels; beyond the array the mask continues."""
    reach = [NECK if n > 1 else 0 for n in mask.shape]
    deep = mask.copy()
    offsets = np.indices([2 * r + 1 for r in reach]).reshape(3, -1).T - reach
    for offset in offsets[(offsets**2).sum(axis=1) <= NECK**2]:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, mask.shape, strict=True))
        there = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, mask.shape, strict=True))
        deep[here] &= mask[there]
    return deep
