"""Whether to trust a result: what can be told from the surface and the image without a reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.smoothing import gaussian_smoothed
from accelsurf.grid.spacing import largest_spacing

if TYPE_CHECKING:
    from accelsurf.evolution.loop import StepRecord, Stop

#: What makes a warning: more of the surface than this on the border or without an edge; less contrast than this, in
#: parts of the image's range; more growth than this in the last steps.
MAX_ON_BORDER, MAX_WITHOUT_EDGE, MIN_CONTRAST, MAX_GROWTH, LAST_STEPS = 0.2, 0.4, 0.05, 0.02, 20
#: More of the object unlike what it was learned from. A Gaussian has 1.2 % beyond the bounds; of the good results of
#: docs/real-scans.md at most 3 % was, of those that leaked 19 % and more.
MAX_UNLIKE = 0.1
#: A gradient is no edge unless it is above this percentile of those in the object's own depth, so many voxels from its
#: surface, and above this part of the image's range over the scale that gradients are seen at.
USUAL_PERCENTILE, DEEP, FLAT = 75.0, 3, 0.005
#: Parts of the object with this share of its volume that hang together by less than two voxels to either side.
LARGE_PART, NECK, MAX_PARTS = 0.05, 2, 200
#: So many of the object's own voxels are enough to know their gradients.
ENOUGH = 1 << 18
#: Voxels of a slab that is worked on at once, and slices of it for each of those around it that it needs besides.
SLAB, HALOS = 1 << 20, 4


class Quality(NamedTuple):
    """How a result looks without a reference.

    Attributes
    ----------
    border_fraction : float
        Share of the object's surface that lies on the volume's border.
    contrast : float
        Mean difference of the image across the surface, inside less outside, a voxel off it to either side; in parts
        of the image's range.
    no_edge_fraction : float
        Share of the surface where the image has no edge: no larger gradient than three quarters of the object's own
        inside have.
    parts_beyond_necks : int
        Large parts that the object falls into without its necks of less than four voxels; 1 for a compact object.
    growth : float
        Volume at the end over that of the start.
    late_growth : float
        Relative change of the volume over the last 20 steps.
    unlike_learned : float or None
        Share of the object, a voxel off its surface, whose values lie further than 2.5 standard deviations from the
        mean of those that it was learned from; None where no model was learned once.
    leaked : bool
        Whether it grew beyond ``max_volume``.
    warnings : tuple of str
        What of this is doubtful, in words.
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
    """Look at a result.

    Parameters
    ----------
    labels : ndarray (nz, ny, nx)
        Above 0 inside.
    image : ndarray (nz, ny, nx)
        As energies saw it, 0 and 1 at its percentiles.
    spacing : (hz, hy, hx)
        mm.
    history : sequence of Row
    stop : Stop
    learned : (float, float), optional
        Values between which those of the object should lie, as models learned from the start have it.
    """
    inside = labels > 0
    border, contrast = _faces(inside, image, spacing)
    own = [row for row in history if row.level == 0]
    first, last = (history[0].volume_mm3, history[-1].volume_mm3) if history else (0.0, 0.0)
    before = own[-LAST_STEPS - 1].volume_mm3 if len(own) > LAST_STEPS else (own[0].volume_mm3 if own else 0.0)
    found = Quality(
        border_fraction=border,
        contrast=contrast,
        no_edge_fraction=_without_edge(inside, image, spacing),
        parts_beyond_necks=_parts(inside),
        growth=last / first if first > 0 else 0.0,
        late_growth=(last - before) / last if last > 0 else 0.0,
        unlike_learned=None if learned is None else _unlike(inside, image, learned),
        leaked=stop.reason == "leaked",
        warnings=(),
    )
    return found._replace(warnings=tuple(_doubts(found, stop)))


def _doubts(found: Quality, stop: Stop) -> list[str]:
    doubts = []
    if found.leaked:
        doubts.append(f"leak: {stop.message}")
    if found.unlike_learned is not None and found.unlike_learned > MAX_UNLIKE:
        doubts.append(
            f"values: {found.unlike_learned:.0%} of the object is unlike what it was learned from: it may have leaked, "
            "or what it was learned from is not typical"
        )
    if found.border_fraction > MAX_ON_BORDER:
        doubts.append(f"border: {found.border_fraction:.0%} of the surface lies on the volume's border")
    # An object may be brighter than one neighbour and darker than another: then there are edges.
    if abs(found.contrast) < MIN_CONTRAST and found.no_edge_fraction > MAX_WITHOUT_EDGE:
        doubts.append(
            f"contrast: inside and outside hardly differ at the surface ({found.contrast:.3f} of the image's range)"
        )
    if found.no_edge_fraction > MAX_WITHOUT_EDGE:
        doubts.append(f"edge: under {found.no_edge_fraction:.0%} of the surface the image has no edge")
    if found.parts_beyond_necks > 1:
        doubts.append(
            f"necks: {found.parts_beyond_necks} large parts hang together by less than four voxels only; has it leaked?"
        )
    if abs(found.late_growth) > MAX_GROWTH and stop.reason != "converged":
        doubts.append(f"growth: the volume changed by {found.late_growth:+.0%} in the last {LAST_STEPS} steps")
    return doubts


def _around(inside: NDArray[np.bool_], margin: int) -> tuple[slice, ...]:
    """The object's box with so many voxels around it."""
    box = []
    for axis, n in enumerate(inside.shape):
        on = np.flatnonzero(inside.any(axis=tuple(other for other in range(3) if other != axis)))
        box.append(slice(max(int(on[0]) - margin, 0), min(int(on[-1]) + 1 + margin, n)) if on.size else slice(0, 0))
    return tuple(box)


def _faces(
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


def _unlike(inside: NDArray[np.bool_], image: NDArray[np.float32], learned: tuple[float, float]) -> float:
    """Share of the object, without the voxels next to its surface, with values outside of an interval."""
    box = _around(inside, 1)
    part = ndimage.binary_erosion(inside[box], border_value=1)
    values = image[box][part if part.any() else inside[box]]
    return float(((values < learned[0]) | (values > learned[1])).mean()) if values.size else 0.0


def _without_edge(
    inside: NDArray[np.bool_], image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> float:
    """Share of the voxels next to the surface, on its inside, where the smoothed image has no edge."""
    scale = largest_spacing(inside.shape, spacing)
    halo = DEEP + 5 * int(np.ceil(scale / spacing[0])) + 1
    box = _around(inside, DEEP + 5 * int(np.ceil(scale / min(spacing))) + 1)
    inside, image = inside[box], image[box]
    if not inside.size:
        return 0.0
    step = max(HALOS * halo, SLAB // (inside.shape[1] * inside.shape[2]))
    on_surface: list[NDArray[np.float32]] = []
    within: list[NDArray[np.float32]] = []
    every = max(1, inside.size // ENOUGH)
    for first in range(0, inside.shape[0], step):
        low, high = max(first - halo, 0), min(first + step + halo, inside.shape[0])
        smooth = gaussian_smoothed(image[low:high], spacing, scale)
        before, after = first - low, min(first + step, inside.shape[0]) - low
        part = inside[low:high]
        within_rim = ndimage.binary_erosion(part, border_value=1)
        deep = ndimage.binary_erosion(within_rim, iterations=DEEP - 1, border_value=1)
        for mask, found, each in ((part & ~within_rim, on_surface, 1), (deep, within, every)):
            own = mask[before:after]
            found.append(_gradients(smooth, spacing, np.flatnonzero(own)[::each] + before * own[0].size))
    surface, own = np.concatenate(on_surface), np.concatenate(within)
    if surface.size == 0:
        return 0.0
    # A thin object has no inside to compare with.
    usual = float(np.percentile(own, USUAL_PERCENTILE)) if own.size else 0.0
    return float((surface <= max(usual, FLAT / scale)).mean())


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


def _parts(inside: NDArray[np.bool_]) -> int:
    """Large parts of the largest component that are left of it without its necks."""
    box = _around(inside, 1)
    parts, count = ndimage.label(inside[box])
    if count == 0:
        return 0
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    body = parts == sizes.argmax()
    # What is cut by the border goes on beyond it, and a single slice has no depth across.
    padded = np.pad(body, [(NECK, NECK) if n > 1 else (0, 0) for n in inside.shape], mode="edge")
    del parts, body
    cores, count = ndimage.label(_deeper_than_neck(padded))
    if count < 2:
        return 1
    # So many parts at most are large; as bytes they need a quarter of the memory.
    sizes = np.bincount(cores.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")[: min(count, MAX_PARTS)]
    name = np.zeros(count + 1, np.uint8)
    name[order] = np.arange(1, len(order) + 1)
    reach = name[cores]
    del cores
    # A core stands for what is within its reach, not for the little that is left of it.
    for _ in range(NECK + 1):
        grown = ndimage.maximum_filter(reach, 3)
        np.copyto(reach, grown, where=(reach == 0) & padded)
    volumes = np.bincount(reach.ravel())[1:]
    return max(1, int((volumes >= LARGE_PART * padded.sum()).sum()))


def _deeper_than_neck(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels of a mask with nothing else within `NECK` voxels; beyond the array the mask goes on."""
    reach = [NECK if n > 1 else 0 for n in mask.shape]
    deep = mask.copy()
    offsets = np.indices([2 * r + 1 for r in reach]).reshape(3, -1).T - reach
    for offset in offsets[(offsets**2).sum(axis=1) <= NECK**2]:
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, mask.shape, strict=True))
        there = tuple(slice(max(0, o), n - max(0, -o)) for o, n in zip(offset, mask.shape, strict=True))
        deep[here] &= mask[there]
    return deep
