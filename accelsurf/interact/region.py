"""The region in which a correction may move the surface: near the new clicks, less and less towards the rim.

Beyond the region nothing changes. Within the rim, of width L, the surface may leave its old place by
b(d) = L/4 u^2/(1 - u^2), u = d/L, at the depth d in the region: it leaves it at a tangent, so that there is no crease,
and its curvature along the seam differs by at most b''(0) = 1/(2 L).

Clicks of one side move the surface to that side alone: a person who says that something is missing has not said that
anything is too much.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks import depth_in_wrong, distances_within
from accelsurf.grid.arrays import Spacing
from accelsurf.grid.boxes import Box, box_at, corner_of, enclosing, widened
from accelsurf.grid.click_bounds import ClickBounds
from accelsurf.grid.clicks import SIDES, Click, Side
from accelsurf.grid.geometry import axis_steps

#: Width of the rim: least numbers of voxels of the smallest spacing, and of the largest.
_RIM_SMALLEST = 6.0
_RIM_LARGEST = 2.0
#: How far a correction goes unless it is known, in depths of the click in the wrong voxels, and at most, in voxels of
#: the smallest spacing, so that a correction does not take long; more is for another click, or ``near``.
_AUTO_TIMES = 1.5
_MAX_NEAR = 12.0
#: The smallest automatic region, voxels of the largest spacing.
_MIN_NEAR = 4.0
#: Distances are continued beyond the band by this number of the largest spacings: no surface that is bounded
#: by a number comes so far from it.
_BEYOND_BAND = 6.0


class NearRegion(NamedTuple):
    """The region of motion: ``mask`` on a ``box`` of the grid, with more voxels around it; ``rim`` in mm.

    ``reach``, mm: no voxel of the region is farther from the clicks.
    """

    box: Box
    mask: NDArray[np.bool_]
    rim: float
    reach: float = math.inf


def rim_width(shape: Sequence[int], spacing: Spacing) -> float:
    """Width of the rim, mm."""
    steps = axis_steps(shape, spacing)
    return max(_RIM_SMALLEST * min(steps), _RIM_LARGEST * max(steps))


def around_clicks(
    clicks: Sequence[Click],
    near: float,
    rim: float,
    shape: Sequence[int],
    spacing: Spacing,
    margin: float,
) -> NearRegion:
    """The region within a distance of the clicks.

    Parameters
    ----------
    clicks : sequence of Click
    near : float
        How far the surface may move, mm.
    rim : float
        Width of the rim, mm.
    shape : (nz, ny, nx)
        Of the grid.
    spacing : (hz, hy, hx)
        mm.
    margin : float
        How much of the grid beyond the region the energy and the surface see, mm.
    """
    low = np.min([corner_of(click.box) for click in clicks], axis=0)
    high = np.max([[s.stop for s in click.box] for click in clicks], axis=0)
    first = (int(low[0]), int(low[1]), int(low[2]))
    room = [math.ceil((near + margin) / h) + 1 for h in spacing]
    box = widened(box_at(first, (high - low).tolist()), shape, room)
    distance = distances_within(_voxels(clicks, box), spacing, float(near))
    return NearRegion(box, np.isfinite(distance), rim, near)


def within_reaches(
    region: NearRegion, clicks: Sequence[Click], reaches: Sequence[float], spacing: Spacing
) -> NearRegion:
    """Return the part of a region within the reach, mm, of a click; the clicks stay."""
    near = np.zeros(region.mask.shape, np.bool_)
    for click, reach in zip(clicks, reaches, strict=True):
        near |= np.isfinite(distances_within(_voxels([click], region.box), spacing, reach))
    return region._replace(mask=region.mask & near, reach=max(reaches))


def _voxels(clicks: Sequence[Click], box: Box) -> NDArray[np.bool_]:
    """The voxels of clicks that lie in a box."""
    mask = np.zeros(tuple(s.stop - s.start for s in box), np.bool_)
    for click in clicks:
        at = tuple(
            slice(c.start - b.start, c.stop - b.start) for c, b in zip(click.box, box, strict=True)
        )
        mask[at] |= click.mask
    return mask


def automatic_near(psi: NDArray[np.float32], clicks: Iterable[Click], spacing: Spacing) -> float:
    """Return the reach of a correction from its clicks, mm, without the rim: each lies amid the wrong voxels.

    Parameters
    ----------
    psi : ndarray (nz, ny, nx)
        The surface, on the clicks' grid. Read around the clicks only.
    clicks : sequence of Click
    spacing : (hz, hy, hx)
        mm.
    """
    steps = axis_steps(psi.shape, spacing)
    nz, ny, nx = psi.shape
    deepest = max(
        depth_in_wrong(click, lambda box: psi[box] < 0, (nz, ny, nx), spacing) for click in clicks
    )
    return max(_MIN_NEAR * max(steps), min(_AUTO_TIMES * deepest, _MAX_NEAR * min(steps)))


def signed_distance(
    psi: NDArray[np.float32], gamma: float, spacing: Spacing
) -> NDArray[np.float32]:
    """Psi with the distances beyond the band, where it is +-``gamma``, continued as far as `_BEYOND_BAND`; mm."""
    far = np.abs(psi) >= np.float32(gamma * (1.0 - 1e-6))
    if far.all():
        return np.where(psi < 0, np.float32(-1e6), np.float32(1e6))
    reach = _BEYOND_BAND * max(axis_steps(psi.shape, spacing))
    beyond = np.float32(gamma) + np.minimum(
        distances_within(~far, spacing, reach), np.float32(reach)
    )
    return np.where(far, np.copysign(beyond, psi), psi)


def near_bounds(
    before: NDArray[np.float32],
    region: NearRegion,
    spacing: Spacing,
    sides: Collection[Side] = SIDES,
) -> ClickBounds:
    """Bounds of psi that keep the surface beyond the region and let it move within it.

    Parameters
    ----------
    before : ndarray, shape of the region's box, float32
        The surface before, a signed distance, mm.
    region : NearRegion
    spacing : (hz, hy, hx)
        mm.
    sides : collection of {"inside", "outside"}
        The clicks' sides: with a single one the surface moves to that side alone.
    """
    depth = distances_within(~region.mask, spacing, region.rim)
    beside = _beside(before < 0)
    # The rim; and where the surface may move to one side, everything. Beyond the region it cannot arise anew.
    bounded = beside | (region.mask & (depth < region.rim) if len(set(sides)) > 1 else region.mask)
    u2 = np.minimum(depth[bounded].astype(np.float64) / region.rim, 1.0) ** 2
    with np.errstate(divide="ignore"):
        room = (0.25 * region.rim * u2 / (1.0 - u2)).astype(np.float32)
    values, shape = before[bounded], before.shape
    low, high = (
        (values - room if "inside" in sides else values),
        (values + room if "outside" in sides else values),
    )
    # Away from the surface before only the side is bounded, not the distance: new surface may arise nearby.
    half = np.float32(0.5 * min(axis_steps(shape, spacing)))
    away = ~beside[bounded]
    inside = values < 0
    low[away] = np.where(inside, -np.inf, np.minimum(low, half))[away]
    high[away] = np.where(inside, np.maximum(high, -half), np.inf)[away]
    cells, counts = np.flatnonzero(bounded), np.isfinite(low) | np.isfinite(high)
    return ClickBounds((shape[0], shape[1], shape[2]), cells[counts], low[counts], high[counts])


def _beside(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The voxels with a neighbour on the other side."""
    out = np.zeros(inside.shape, np.bool_)
    for axis in range(3):
        here, there = np.moveaxis(inside, axis, 0), np.moveaxis(out, axis, 0)
        changes = here[1:] != here[:-1]
        there[1:] |= changes
        there[:-1] |= changes
    return out


def united(near: ClickBounds, clicks: ClickBounds) -> ClickBounds:
    """Both bounds; where they contradict each other, the clicks'."""
    known = np.zeros(math.prod(near.shape), np.bool_)
    known[near.cells] = known[clicks.cells] = True
    cells = np.flatnonzero(known)
    place = np.cumsum(known) - 1
    low, high = np.full(cells.size, -np.inf, np.float32), np.full(cells.size, np.inf, np.float32)
    at = place[near.cells]
    low[at], high[at] = near.low, near.high
    at = place[clicks.cells]
    before_low, before_high = low[at], high[at]
    # A click where the surface is bounded moves the bounds along.
    low[at] = np.minimum(np.maximum(before_low, clicks.low), np.maximum(clicks.high, clicks.low))
    high[at] = np.maximum(np.minimum(before_high, clicks.high), np.minimum(clicks.low, clicks.high))
    return ClickBounds(near.shape, cells, low, high)


def box_around(clicks: Sequence[Click]) -> Box:
    """Return the box around clicks."""
    return functools.reduce(enclosing, (click.box for click in clicks))
