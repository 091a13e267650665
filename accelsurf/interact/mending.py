"""An object brought to the edges of the image as a whole, within a band around it; its holes and islands by size.

Each voxel of the band is compared with the values on both sides of the border nearby: means and spreads in a window,
without the voxels at the border itself, which may be on the wrong side. Where the two sides look alike, the border
stays. Nothing but the object and the image nearby counts, so that any mask can be mended, whoever made it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies import Energy, MaskConstraint, RegionField, mask_distance
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.arrays import Mask, Spacing
from accelsurf.grid.boxes import (
    Box,
    bounding_box,
    box_at,
    counted_from,
    placed_at,
    tightened,
    widened,
)
from accelsurf.grid.click_bounds import ClickBounds, click_bounds
from accelsurf.grid.geometry import axis_steps
from accelsurf.grid.pyramid import Level
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.interact.corrected_surface import CorrectedSurface, count_inside, stop_of_whole
from accelsurf.interact.local_evolution import (
    LocalOutcome,
    LocalProblem,
    Stepping,
    evolve_bounded,
    measures_of,
    relabelled_psi,
)
from accelsurf.interact.models import ids_text
from accelsurf.interact.objects import CorrectedObjects
from accelsurf.interact.region import NearRegion
from accelsurf.run import BoxMask, correction_rule, half_width, setup_of
from accelsurf.settings.corrections import Correction
from accelsurf.settings.toml import volume_mm3

#: Sigma of the windows on both sides of the border, in multiples of its largest move; least sigma, in largest spacings;
#: half width of the windows, in sigmas.
WINDOW = 1.5
MIN_WINDOW = 2.0
ENDS = 2.5
#: Voxels nearer to the border than this, in smallest spacings, count little in them.
MIXED = 1.0
LITTLE = 0.1
#: Number of times that both sides are learned, each time from the object that the last time showed.
ROUNDS = 2
#: Pull to the old place at the rim of the band, of the pull of the clearest edge.
OLD_PLACE = 0.3
#: Squared difference of both sides, in their variances, at which an edge counts half.
CLEAR = 1.0
#: Largest log-ratio of both sides' likelihoods at a voxel; least variance of a side, of the image's range squared.
CLEAREST = 3.0
MIN_VARIANCE = 1e-4
#: Smoothing of the image before it is looked at, and weight of the area, both of the smallest spacing: stair steps go.
SMOOTHING = 0.5
AREA = 0.1
#: The border of the band is bounded on this number of largest spacings to either side.
SHELL = 4.0
#: Voxels of the largest spacing beyond the band that the surface and its stencils see.
MARGIN = 5.0


class Mended(NamedTuple):
    """The object after it was mended, the ``box`` of the grid that was looked at, and how many voxels changed."""

    surface: CorrectedSurface
    box: Box
    voxels: int


def mend(
    objects: CorrectedObjects, number: int, correction: Correction, stepping: Stepping
) -> Mended:
    """Remove islands, fill holes, and bring the border of an object to edges; voxels of others are not entered.

    Parameters
    ----------
    objects : CorrectedObjects
    number : int
        Of the correction.
    correction : Correction
        With ``to_edges``, ``holes`` or ``islands``.
    stepping : Stepping

    Raises
    ------
    UsageError
        When there are several objects and none is named.
    InputError
        When the object has no voxel, or nothing of it would be left.
    """
    id = _object_of(objects, correction)
    place = objects.place_of(id)
    inside = bounding_box(objects.surfaces[place].psi < 0)
    if inside is None:
        raise InputError(
            f"refine: object {id} has no voxel", "remove it, or begin it anew with new"
        )
    inside = placed_at(inside, objects.surfaces[place].corner)
    settings = objects.models.settings_of(id)
    sigma = _sigma(correction.to_edges or 0.0, objects.spacing)
    reach = 0.0 if correction.to_edges is None else correction.to_edges + ENDS * sigma
    steps = axis_steps(objects.shape, objects.spacing)
    margin = [math.ceil((reach + MARGIN * max(steps)) / h) for h in objects.spacing]
    box = widened(inside, objects.shape, margin)
    surface = objects.grown(place, box)
    here = counted_from(box, surface.corner)
    psi = surface.psi[here].copy()
    outcome = LocalOutcome(psi, surface.history, surface.stop)
    distance = objects.bounding(id, box, frozenset())
    is_open = np.ones(psi.shape, np.bool_) if distance is None else np.asarray(distance < 0)
    clicks = click_bounds(
        objects.models.clicks.of(id).on_box(box), Level(0, (1, 1, 1), psi.shape, objects.spacing)
    )
    outcome = _tidied(outcome, correction, is_open, clicks, objects, stepping)
    if correction.to_edges is not None:
        before = mask_distance(outcome.psi < 0, objects.spacing)
        images = [image[box] for image in objects.images]
        field = edge_field(images, before, objects.spacing, correction.to_edges, is_open)
        energy: Energy = RegionField(field, settings.smoothness or AREA * min(objects.spacing))
        if distance is not None:
            energy = MaskConstraint(energy, distance)
        setup = setup_of(settings, 0, 1, objects.prepared.geometry)._replace(
            rule=correction_rule(settings)
        )
        region = NearRegion(box, np.abs(before) <= correction.to_edges, 0.0)
        bounds = _band(before, correction.to_edges, clicks, max(steps))
        problem = LocalProblem(
            outcome.psi,
            objects.spacing,
            region,
            bounds,
            [],
            frozenset(),
            energy,
            setup,
            outcome.history,
        )
        outcome = evolve_bounded(problem, id, stepping, outcome.psi, bounds)
        outcome = _tidied(outcome, correction, is_open, clicks, objects, stepping)
    count = surface.inside + count_inside(outcome.psi) - count_inside(psi)
    if count == 0:
        raise InputError(
            f"refine: nothing of object {id} would be left",
            "give smaller islands, or a smaller to_edges",
        )
    stop = stop_of_whole(outcome.stop, count, math.prod(objects.shape))
    objects.put(
        place, here, outcome.psi, surface._replace(inside=count, history=outcome.history, stop=stop)
    )
    objects.models.begin_given(number, id, _mask_of(objects.surfaces[place]))
    return Mended(
        objects.surfaces[place], box, int(np.count_nonzero((outcome.psi < 0) != (psi < 0)))
    )


def _object_of(objects: CorrectedObjects, correction: Correction) -> int:
    """Return the object that is mended."""
    if correction.object is not None:
        return correction.object
    if len(objects.ids) > 1:
        raise UsageError(
            "refine: to_edges, holes or islands were given without object, expected an object's id",
            ids_text(objects.ids),
        )
    return objects.ids[0]


def _sigma(most: float, spacing: Spacing) -> float:
    """Sigma of the windows, mm."""
    return max(WINDOW * most, MIN_WINDOW * max(spacing))


def edge_field(
    images: Sequence[NDArray[np.float32]],
    before: NDArray[np.float32],
    spacing: Spacing,
    most: float,
    is_open: Mask | None = None,
) -> NDArray[np.float32]:
    """Return a field that is below 0 where a voxel near a border looks like the object, -1 to 1 but for the rim.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels.
    before : ndarray (nz, ny, nx), float32
        Signed distance to the border, mm, negative inside.
    spacing : (hz, hy, hx)
        mm.
    most : float
        How far the border may move, mm.
    is_open : ndarray (nz, ny, nx) of bool, optional
        The object is in no other voxel.

    Examples
    --------
    >>> image = np.zeros((1, 1, 16), np.float32)
    >>> image[..., :9] = 1.0
    >>> distance = np.arange(16, dtype=np.float32).reshape(1, 1, 16) - 6.5
    >>> (edge_field([image], distance, (1.0, 1.0, 1.0), 3.0) < 0).sum()
    np.int64(9)
    """
    sigma = [
        _sigma(most, spacing) / h if n > 1 else 0.0
        for h, n in zip(spacing, before.shape, strict=True)
    ]
    smooth = [gaussian_mm(image, spacing, SMOOTHING * min(spacing)) for image in images]
    band, old = (
        np.abs(before) <= most,
        np.float32(OLD_PLACE) * np.clip(before / np.float32(most), -1.0, 1.0),
    )
    distance, field = before, old
    for number in range(ROUNDS):
        if number:
            inside = np.where(band, field < 0, before < 0) & (True if is_open is None else is_open)
            if not inside.any() or inside.all():
                break
            distance = mask_distance(inside, spacing)
        mixed = MIXED * min(spacing)
        pulls = [
            _pull(image, homogeneous, distance, sigma, mixed)
            for image, homogeneous in zip(images, smooth, strict=True)
        ]
        field = np.asarray(np.mean(pulls, axis=0) + old, np.float32)
    return field


def _pull(
    image: NDArray[np.float32],
    smooth: NDArray[np.float32],
    distance: NDArray[np.float32],
    sigma: Sequence[float],
    mixed: float,
) -> NDArray[np.float32]:
    """Return how much likelier a value is beyond the border than inside, -1 to 1; near 0 where both look alike."""
    weight = np.where(np.abs(distance) > mixed, np.float32(1.0), np.float32(LITTLE))

    def around(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(ndimage.gaussian_filter(values, sigma, truncate=ENDS, mode="constant"))

    means, variances = [], []
    for side in (distance < 0, distance >= 0):
        here = weight * side
        total = np.maximum(around(here), np.float32(1e-6))
        mean = around(here * image) / total
        means.append(mean)
        variances.append(np.maximum(around(here * image * image) / total - mean * mean, 0.0))
    variance = 0.5 * (variances[0] + variances[1]) + np.float32(MIN_VARIANCE)
    likelier = ((smooth - means[0]) ** 2 - (smooth - means[1]) ** 2) / (2.0 * variance)
    contrast = (means[0] - means[1]) ** 2 / variance
    pull = (
        contrast
        / (contrast + np.float32(CLEAR))
        * np.clip(likelier, -CLEAREST, CLEAREST)
        / CLEAREST
    )
    return np.asarray(pull, np.float32)


def _mask_of(surface: CorrectedSurface) -> BoxMask:
    """Return the voxels of an object."""
    tight = tightened(box_at(surface.corner, surface.psi.shape), surface.psi < 0)
    assert tight is not None  # it has voxels
    return BoxMask(*tight)


def _band(
    before: NDArray[np.float32], most: float, clicks: ClickBounds, spacing: float
) -> ClickBounds:
    """Return bounds of psi that keep the surface within a distance, mm, of where it was, and of clicks."""
    low, high = (
        np.full(before.shape, -np.inf, np.float32),
        np.full(before.shape, np.inf, np.float32),
    )
    shell = np.abs(np.abs(before) - np.float32(most)) <= SHELL * spacing
    low[shell], high[shell] = before[shell] - np.float32(most), before[shell] + np.float32(most)
    flat_low, flat_high = low.reshape(-1), high.reshape(-1)
    # A click holds; a band around a surface on its side does not contradict it.
    flat_low[clicks.cells] = np.where(
        clicks.high < 0, -np.inf, np.maximum(flat_low[clicks.cells], clicks.low)
    )
    flat_high[clicks.cells] = np.where(
        clicks.low > 0, np.inf, np.minimum(flat_high[clicks.cells], clicks.high)
    )
    cells = np.flatnonzero(np.isfinite(flat_low) | np.isfinite(flat_high))
    return ClickBounds(clicks.shape, cells, flat_low[cells], flat_high[cells])


def _tidied(
    outcome: LocalOutcome,
    correction: Correction,
    is_open: Mask,
    clicks: ClickBounds,
    objects: CorrectedObjects,
    stepping: Stepping,
) -> LocalOutcome:
    """Return an object without its islands, and with its holes filled, as far as their sizes are given."""
    sizes = [
        None if text is None else volume_mm3(text) / math.prod(objects.spacing)
        for text in (correction.islands, correction.holes)
    ]
    inside = outcome.psi < 0
    held, beyond = (np.zeros(inside.size, np.bool_) for _ in range(2))
    held[clicks.cells[clicks.high < 0]], beyond[clicks.cells[clicks.low > 0]] = True, True
    after = inside
    if sizes[0] is not None:
        after = after & ~islands_of(after, sizes[0], held.reshape(inside.shape))
    if sizes[1] is not None:
        after = after | (holes_of(after, sizes[1], beyond.reshape(inside.shape)) & is_open)
    if np.array_equal(after, inside):
        return outcome
    width = half_width(objects.models.settings_of(objects.ids[0]))
    psi = relabelled_psi(outcome.psi, after, objects.spacing, width, stepping.workers)
    (volume, area), (volume_now, area_now) = (
        measures_of(part, objects.spacing, width, stepping.workers) for part in (outcome.psi, psi)
    )
    last = outcome.history[-1]
    last = last._replace(
        volume_mm3=last.volume_mm3 + volume_now - volume, area_mm2=last.area_mm2 + area_now - area
    )
    return outcome._replace(psi=psi, history=[*outcome.history[:-1], last])


def islands_of(inside: Mask, most: float, held: Mask | None = None) -> Mask:
    """Return the parts of an object of less than ``most`` voxels, but for the largest and parts with ``held`` voxels.

    Examples
    --------
    >>> row = np.array([[[1, 1, 1, 0, 1, 0, 1, 1]]], bool)
    >>> islands_of(row, 2).astype(int)
    array([[[0, 0, 0, 0, 1, 0, 0, 0]]])
    """
    parts, count = ndimage.label(inside)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    sizes[0] = 0
    small = sizes < most
    small[int(np.argmax(sizes))] = small[0] = False
    if held is not None:
        small[np.unique(parts[held])] = False
    return np.asarray(small[parts])


def holes_of(inside: Mask, most: float, beyond: Mask | None = None) -> Mask:
    """Return the parts of less than ``most`` voxels that an object encloses, but for parts with ``beyond`` voxels.

    A part that reaches a face of the array is not enclosed; of one slice the faces within it count.

    Examples
    --------
    >>> ring = np.array([[[1, 1, 1, 1], [1, 0, 1, 0], [1, 1, 1, 1]]], bool)
    >>> holes_of(ring, 2).astype(int)
    array([[[0, 0, 0, 0],
            [0, 1, 0, 0],
            [0, 0, 0, 0]]])
    """
    parts, count = ndimage.label(~inside)
    small = np.bincount(parts.ravel(), minlength=count + 1) < most
    small[0] = False
    for axis in (axis for axis, n in enumerate(inside.shape) if n > 1):
        for end in (0, -1):
            small[np.unique(np.take(parts, end, axis=axis))] = False
    if beyond is not None:
        small[np.unique(parts[beyond])] = False
    return np.asarray(small[parts])
