"""Checks before step 1 of a start against the energy's bounds and the area weight; each line names a command to try."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.energies import NORMAL_MAD, without_clicks
from accelsurf.evolution import Evolution
from accelsurf.grid.boxes import Corner, bounding_box, box_at, corner_of, widened
from accelsurf.grid.clicks import Click
from accelsurf.grid.geometry import Geometry
from accelsurf.levelset import LevelSet
from accelsurf.run.evolving_object import EvolvingObject
from accelsurf.run.preprocessing import PreprocessedInput
from accelsurf.settings.wording import volume_text
from accelsurf.starts import ObjectStart
from accelsurf.text.coordinates import place_text

#: A start will shrink if less than this part of its values lies within the bounds; a window takes in the surroundings
#: if it has more than this part of the voxels in a shell around the start (bounds in its radii).
_MIN_WITHIN = 0.2
_MAX_AROUND = 0.5
SHELL = (3.0, 8.0)
#: A start has outliers if its standard deviation is over this multiple of the median-based one; they lie beyond
#: the second multiple.
_OUTLYING = 2.0
FAR = 4.0
#: Fewest voxels of a start that outliers are looked for in; number of samples of surroundings and image, about.
MIN_VOXELS = 20
SAMPLES = 1 << 18
#: The area cannot pull in a start whose curvature it weighs less than this part of the squared contrast.
_SAFE = 0.25
#: Voxels like the background are at least this part of the image; values within these spreads are like the click.
_COMMON = 0.05
_WITHIN = 4.0
#: A click is background where more than this part of it has the image's least or largest value.
_ONE_VALUE = 0.9
#: Values lie at an end of the image's range within this part of it.
_END = 0.15
#: A click of fewer voxels is looked at with a margin of this width, voxels.
_FEW = 20
_AROUND = 2
#: The part around the click has at least this part of the image's corners.
_CORNERS = 0.75
#: Voxels of one value are background where at least this part of the corners has it.
_HALF = 0.5


class Bounds(NamedTuple):
    """Values between which the energy takes an object's to be, in the file's unit; None for an open side."""

    low: float | None
    high: float | None


def start_checks(
    objects: Sequence[EvolvingObject],
    starts: Sequence[ObjectStart],
    prepared: PreprocessedInput,
    has_ids: bool,
) -> list[str]:
    """A line for each problem of a start, with a remedy to try; to be called before the first step.

    Parameters
    ----------
    objects : sequence of EvolvingObject
        On the level that they begin on.
    starts : sequence of ObjectStart
        Of each, on the grid of the region of interest.
    prepared : PreprocessedInput
    has_ids : bool
        Whether lines name the object.
    """
    lines = []
    for segmented, start in zip(objects, starts, strict=True):
        # The seeded model chooses start and weight to go together.
        seeded = any(term["term"] == "seeded" for term in segmented.made.terms)
        found = [*_of_values(segmented, start, prepared, has_ids)]
        found += (
            [*_of_size(segmented, prepared), *_of_clicks(segmented, prepared)]
            if seeded
            else _of_area(segmented, start, prepared)
        )
        lines += [f"object {segmented.id}: {line}" if has_ids else line for line in found]
    return lines


def _of_values(
    evolving: EvolvingObject, start: ObjectStart, prepared: PreprocessedInput, has_ids: bool
) -> list[str]:
    """The checks of the start's values, in the file's unit."""
    inside = start.psi < 0
    tight = bounding_box(inside)
    if tight is None:
        return []
    low, width = prepared.context.scales[0]
    image = prepared.images[0][box_at(start.corner, start.psi.shape)]
    values = low + width * image[tight][inside[tight]].astype(np.float64)
    lines = []
    if prepared.learns:
        clicked = evolving.context.clicks is not None and bool(evolving.context.clicks.ids())
        lines = _outlier_line(
            values, inside, start.corner, prepared.geometry, _option(evolving, clicked, has_ids)
        )
    for term in evolving.made.terms:
        if term["term"] != "threshold" or "LO" not in term:
            continue
        window = Bounds(term["LO"], term["HI"])
        if line := _bounds_line(values, window):
            lines.append(line)
        elif share := _surroundings_share(low + width * image, inside, prepared.geometry, window):
            ball = _deepest_ball(
                inside[tight], np.add(corner_of(tight), start.corner).tolist(), prepared.geometry
            )
            lines.append(
                f"window: {share:.0%} of the surroundings of the start lie within the bounds too: it will leak; try "
                f"{_option(evolving, True, has_ids).replace('*', ball)}, in place of "
                f"{'its start' if has_ids else '--start and --energy'}"
            )
    return lines


def _option(evolving: EvolvingObject, clicked: bool, has_ids: bool) -> str:
    """Return the option with a ball as the start or click of an object; the ball replaces the star."""
    if has_ids:
        return f"{evolving.id},*{',inside' if clicked else ''} as a row of --objects TABLE"
    return f"--{'inside' if clicked else 'start'} ball:*"


def _of_size(evolving: EvolvingObject, prepared: PreprocessedInput) -> list[str]:
    """Check that the stated size is not more than there is."""
    size, geometry = evolving.context.model_inputs.size_mm3, prepared.geometry
    whole = math.prod(geometry.shape) * geometry.voxel_volume
    if size is None or size < whole:
        return []
    return [
        f"size: {volume_text(size, geometry.unit)} is more than the whole image "
        f"({volume_text(whole, geometry.unit)}); try it without "
        "--size"
    ]


def _of_clicks(evolving: EvolvingObject, prepared: PreprocessedInput) -> list[str]:
    """Check that no click inside is like the background."""
    clicks = () if evolving.context.clicks is None else evolving.context.clicks.clicks
    lines = [
        _background_line(click, evolving, prepared) for click in clicks if click.side == "inside"
    ]
    return list(itertools.chain.from_iterable(lines))


def _background_line(
    click: Click, evolving: EvolvingObject, prepared: PreprocessedInput
) -> list[str]:
    """Check that a click inside does not look like the background of the image; of a part of one nothing is known."""
    if evolving.context.model_inputs.window is not None:
        return []
    share = _background_share(prepared.images[0], click)
    if not share > 0:
        return []
    index = ndimage.center_of_mass(click.mask)
    middle = [float(place) + side.start for place, side in zip(index, click.box, strict=True)]
    place = place_text(prepared.geometry.index_to_world(middle).tolist(), prepared.geometry)
    return [
        f"click: the click inside near {place} lies in what looks like background ({share:.0%} of the image); try "
        "--inside at the object, unless the background is what you want"
    ]


def _background_share(image: NDArray[np.float32], click: Click) -> float:
    """Return the share of an image that is background like a click; 0 where the click does not look like it.

    The values under the click are the image's least or largest one with no spread, and many voxels have it, half of
    the corners among them. Or they lie at an end of the range, and voxels like them and connected to the click reach
    most corners of the image.

    Parameters
    ----------
    image : ndarray (nz, ny, nx), float32
        Whole, 0 and 1 at its percentiles.
    click : Click
    """
    steps = _thinning(image.shape)
    thin = image[tuple(slice(None, None, step) for step in steps)]
    values = image[click.box][click.mask]
    if values.size < _FEW:
        around = [_AROUND if n > 1 else 0 for n in image.shape]
        values = image[widened(click.box, image.shape, (around[0], around[1], around[2]))]
    middle = float(np.median(values))
    same = thin == np.float32(middle)
    is_extreme = middle in (float(thin.min()), float(thin.max()))
    if (
        is_extreme
        and thin.min() < thin.max()
        and same.mean() >= _COMMON
        and (values == middle).mean() > _ONE_VALUE
    ):
        # An object may be of one value too, of a mask or where it is clipped: it has no corner of the image, or few.
        has_corners = np.mean([same[place] for place in _corner_voxels(same.shape)]) >= _HALF
        return float(same.mean()) if has_corners else 0.0
    if _END < middle < 1.0 - _END:
        return 0.0
    spread = max(NORMAL_MAD * float(np.median(np.abs(values - middle))), 0.01)
    parts, _ = ndimage.label(np.abs(thin - middle) <= _WITHIN * spread)
    voxels = (np.argwhere(click.mask) + [side.start for side in click.box]) // steps
    mine = np.unique(parts[tuple(voxels.T)])
    mine = mine[mine > 0]
    if not mine.size:
        return 0.0
    part = int(mine[np.argmax(np.bincount(parts.ravel())[mine])])
    share = float((parts == part).mean())
    at_corners = [parts[place] == part for place in _corner_voxels(parts.shape)]
    return share if share >= _COMMON and np.mean(at_corners) >= _CORNERS and share < 1.0 else 0.0


def _thinning(shape: Sequence[int]) -> list[int]:
    """Steps along each axis that leave about `SAMPLES` voxels."""
    every = max(
        1, int(np.ceil((math.prod(shape) / SAMPLES) ** (1.0 / max(sum(n > 1 for n in shape), 1))))
    )
    return [every if n > 1 else 1 for n in shape]


def _corner_voxels(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Voxels at the corners of an array, each once."""
    return list(itertools.product(*((0, n - 1) if n > 1 else (0,) for n in shape)))


def _deepest_ball(mask: NDArray[np.bool_], corner: Sequence[int], geometry: Geometry) -> str:
    """The largest ball in some voxels, as options take it."""
    steps = geometry.steps
    around = [(0, 0) if n == 1 else (1, 1) for n in geometry.shape]
    depth = ndimage.distance_transform_edt(np.pad(mask, around), sampling=geometry.spacing)
    deepest = np.array(np.unravel_index(int(np.argmax(depth)), depth.shape))
    index = deepest - [before for before, _ in around] + np.array(corner)
    radius = float(depth.max()) - 0.5 * min(steps)
    return place_text(geometry.index_to_world(index.tolist()).tolist(), geometry, radius)


def _bounds_line(values: NDArray[np.float64], window: Bounds) -> str:
    """Check that not nearly all of the start lies beyond the energy's bounds.

    Examples
    --------
    >>> _bounds_line(np.array([110.0, 112.0]), Bounds(226.0, None))
    'start: its median grey value 111 is beyond the bound 226: it will shrink to nothing; try --energy ...'
    """
    low, high = window
    within = _within(values, window)
    if within.mean() >= _MIN_WITHIN:
        return ""
    middle = float(np.median(values))
    bound = low if low is not None and middle < low else high
    return (
        f"start: its median grey value {middle:.4g} is beyond the bound {bound:.4g}: it will shrink to nothing; try "
        "--energy threshold:learned,learned"
    )


def _within(values: NDArray[Any], window: Bounds) -> NDArray[np.bool_]:
    low, high = window
    return np.asarray(
        (values >= (-np.inf if low is None else low))
        & (values <= (np.inf if high is None else high))
    )


def _surroundings_share(
    image: NDArray[Any], inside: NDArray[np.bool_], geometry: Geometry, window: Bounds
) -> float:
    """Return the share of a start's surroundings within the energy's window; 0 up to `_MAX_AROUND`."""
    tight, spacing = bounding_box(inside), geometry.spacing
    assert tight is not None
    radius = 0.5 * max(
        (s.stop - s.start) * h
        for s, h, n in zip(tight, spacing, inside.shape, strict=True)
        if n > 1
    )
    margins = [int(np.ceil(SHELL[1] * radius / h)) for h in spacing]
    box = widened(tight, inside.shape, (margins[0], margins[1], margins[2]))
    part = inside[box]
    steps = _thinning(part.shape)
    thin = tuple(slice(None, None, step) for step in steps)
    part, values = part[thin], image[box][thin]
    if not part.any():
        return 0.0
    away = ndimage.distance_transform_edt(
        ~part, sampling=[h * step for h, step in zip(spacing, steps, strict=True)]
    )
    shell = (away > (SHELL[0] - 1.0) * radius) & (away < SHELL[1] * radius)
    if not shell.any():
        return 0.0
    share = float(np.count_nonzero(shell & _within(values, window)) / np.count_nonzero(shell))
    return share if share > _MAX_AROUND else 0.0


def _outlier_line(
    values: NDArray[np.float64],
    inside: NDArray[np.bool_],
    corner: Corner,
    geometry: Geometry,
    option: str,
) -> list[str]:
    """Check that no values in the start are far from the others, and find the farthest.

    Parameters
    ----------
    values : ndarray (n,)
        Of the start's voxels.
    inside : ndarray of bool
        These, from voxel ``corner`` on.
    corner : (int, int, int)
    geometry : Geometry
    option : str
        The option to try, with a star in place of a ball.
    """
    middle = float(np.median(values))
    spread, robust = float(values.std()), NORMAL_MAD * float(np.median(np.abs(values - middle)))
    if values.size < MIN_VOXELS or not spread > _OUTLYING * robust > 0:
        return []
    unlike = np.abs(values - middle) > FAR * robust
    voxels = np.argwhere(inside)
    farthest = voxels[int(np.argmax(np.abs(values - middle)))] + np.array(corner)
    place = place_text(geometry.index_to_world(farthest.tolist()).tolist(), geometry)
    tight = bounding_box(inside)
    assert tight is not None
    rest = inside[tight].copy()
    rest[inside[tight]] = ~unlike
    ball = _deepest_ball(rest, np.add(corner_of(tight), corner).tolist(), geometry)
    return [
        f"start: {unlike.mean():.1%} of it has other grey values than the rest (standard deviation {spread:.3g}, "
        f"median-based {robust:.3g}), the farthest near {place}; the model leaves it out; try "
        f"{option.replace('*', ball)}"
    ]


def _of_area(
    evolving: EvolvingObject, start: ObjectStart, prepared: PreprocessedInput
) -> list[str]:
    """The check of the area weight; of a weight by noise alone only where the start is small, as it needs memory."""
    # The start's psi may be no distance any more: its memory is the surface's.
    of_terms, alpha = _area_of(evolving.made.terms), evolving.evolution.energy.alpha
    if 0 < alpha <= of_terms * (1.0 + 1e-9):
        inside, image = start.psi < 0, prepared.images[0]
        values = image[box_at(start.corner, start.psi.shape)][inside].astype(np.float64)
        outside = (float(image.sum(dtype=np.float64)) - values.sum()) / max(
            image.size - values.size, 1
        )
        steps = prepared.geometry.steps
        size = values.size * math.prod(steps)
        radius = (
            (0.75 * size / math.pi) ** (1 / 3) if len(steps) == 3 else math.sqrt(size / math.pi)
        )
        if 2.0 * alpha / radius < _SAFE * (values.mean() - outside) ** 2:
            return []
    return area_line(evolving.evolution, of_terms)


def _area_of(terms: Sequence[dict[str, Any]]) -> float:
    """Weight of the area that terms of chan-vese have of their own, mm."""
    found = [
        (term["weight"], term.get("channels", [term]))
        for term in terms
        if term["term"] == "chan-vese"
    ]
    return sum(
        weight * sum(channel["area"] for channel in seen) / len(seen) for weight, seen in found
    )


def area_line(evolution: Evolution, of_terms: float = 0.0) -> list[str]:
    """Check that the area weight, ``of_terms`` of it not of --smoothness, does not pull in a growing start."""
    alpha = evolution.energy.alpha
    surface = evolution.surface
    if not alpha > 0 or surface.size == 0:
        return []
    # On a copy: measures of the surface itself are counted with its first step. Where the surface touches a click no
    # force acts into it; the force without clicks tells whether all but the clicks vanishes.
    energy, front_surface = without_clicks(evolution.energy), surface
    spacing = (front_surface.grid.hz, front_surface.grid.hy, front_surface.grid.hx)
    surface = LevelSet(
        np.array(front_surface.psi),
        spacing,
        front_surface.requested_half_width,
        front_surface.workers,
        overwrite=True,
    )
    energy.start(surface)
    fraction, area = surface.fraction_and_area()
    energy.value(surface, fraction, area)
    front = surface.front()
    variation = surface.area_variation(front, surface.curvature(front))
    there = (area > 0) & front
    if not there.any():
        evolution.energy.start(front_surface)
        return []
    weights = area[there]
    image, both = (
        float(np.average(energy.force(surface, front, part)[there], weights=weights))
        for part in (np.zeros_like(variation), variation)
    )
    evolution.energy.start(front_surface)
    if not image < 0.0 < both:
        return []
    radius = 2.0 * alpha / (both - image)
    less = 0.5 * alpha * -image / (both - image)
    given = (
        f"--smoothness {less - of_terms:.2g}"
        if less > of_terms
        else f"--energy chan-vese:area={less:.2g}"
    )
    return [
        f"area: the start has a radius of about {radius:.3g} mm; with the area weight {alpha:.3g} mm, whatever is "
        f"smaller than {2.0 * alpha / -image:.3g} mm shrinks; try {given}"
    ]
