"""Quality of a result: measures of surface and image that need no reference, and the place to look at next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.arrays import Image, Mask, Singles
from accelsurf.grid.boxes import Box, bounding_box, slabs, whole_box
from accelsurf.grid.geometry import Geometry, axis_steps
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.measure import evidence as places
from accelsurf.measure.likely import (
    UNSURE,
    Plateau,
    Quality,
    features,
    model_kind,
    probability_good,
    warning_threshold,
    why,
)
from accelsurf.settings.wording import size_text, volume_text
from accelsurf.text.coordinates import place_text

if TYPE_CHECKING:
    from accelsurf.clicks import Confidence
    from accelsurf.evolution import StepRecord, Stop
    from accelsurf.measure.evidence import Evidence


#: A note is made beyond these: fraction of the surface on the border, and without an edge; contrast across the surface
#: in units of the noise; relative growth over the last steps; share of the object unlike the learned values. A Gaussian
#: has 1.2 % beyond the bounds.
MAX_ON_BORDER = 0.2
MAX_WITHOUT_EDGE = 0.4
MIN_CONTRAST = 2.0
MAX_GROWTH = 0.02
LAST_STEPS = 20
MAX_UNLIKE = 0.1
#: A result of clicks is ambiguous where it has this part of the image's corners, or one of them and this part has its
#: grey values; or where it is `MANY_CLICKS` times as large
#: as the clicks, in `MANY_PIECES` parts of at least `SPECK` of it, with `MAX_ON_BORDER` of its surface on the border.
MANY_CORNERS = 0.75
MANY_CLICKS = 150.0
MANY_PIECES = 4
SPECK = 1e-4
#: An outside click is said to take away much from this share of the object on.
MAX_TAKEN = 0.5
#: A plateau is noted where the object has grown since, by more than this factor.
MIN_BURST = 1.1
#: A gradient is an edge if it is above this percentile of the gradients inside the object, at least this number of
#: voxels from its surface, and above this fraction of the image's range over the scale of the gradients.
INTERIOR_PERCENTILE = 75.0
INTERIOR_DEPTH = 3
MIN_EDGE = 0.005
#: Approximate number of voxels at which gradients inside the object are sampled.
GRADIENT_SAMPLES = 1 << 18
#: Least number of planes in a slab for each plane of its halo.
MIN_SLAB_HALOS = 4
#: A part counts from this fraction of the object's volume on; largest half width of a neck, voxels; most parts that
#: are examined.
LARGE_PART = 0.05
NECK = 2
MAX_PARTS = 200


class ValueRange(NamedTuple):
    """An interval of the image's values."""

    low: float
    high: float


class Judged(NamedTuple):
    """A result whose quality is measured.

    Attributes
    ----------
    labels : ndarray (nz, ny, nx)
        Above 0 inside.
    image : ndarray (nz, ny, nx)
        As energies see it, 0 and 1 at its percentiles.
    geometry : Geometry
        Their grid.
    history : sequence of StepRecord
    stop : Stop
    learned : ValueRange, optional
        The values that a model learned from the start gives the object.
    plateaus : sequence of Plateau, optional
    clicked : ndarray (nz, ny, nx) of bool, optional
        Voxels that a person clicked, on either side.
    confidence : Confidence, optional
        Of the model of the clicks.
    """

    labels: NDArray[np.uint8]
    image: Image
    geometry: Geometry
    history: Sequence[StepRecord]
    stop: Stop
    learned: ValueRange | None = None
    plateaus: Sequence[Plateau] = ()
    clicked: Mask | None = None
    confidence: Confidence | None = None


def assess(seen: Judged, before: float | None = None) -> Quality:
    """Measure the quality of a result.

    Parameters
    ----------
    seen : Judged
    before : float, optional
        The probability before the last correction by a click, which is the most that it is now.
    """
    found = measured(seen)
    inside, geometry = seen.labels > 0, seen.geometry
    last = seen.history[-1].volume_mm3 if seen.history else 0.0
    found = found._replace(probability=probability_good(model_kind(found), features(found)))
    if found.answers and last > 0:  # the surface has moved since
        taken = found.answers[0]._replace(volume_mm3=last)
        found = found._replace(answers=(taken, *found.answers[1:]))
    unclear = "" if seen.confidence is None else _ambiguity(found, inside, seen.image, geometry)
    if unclear:
        found = found._replace(is_ambiguous=True, probability=min(found.probability, UNSURE))
    if before is not None:
        found = found._replace(probability=min(found.probability, before), is_corrected=True)
    warnings = _warnings(found, seen.stop, last, inside, geometry, unclear)
    notes = _notes(found, last, geometry)
    parts = 1 if seen.clicked is None else clicked_parts(inside, seen.clicked)
    if parts > 1:
        notes.append(
            f"parts: {parts} separate parts were clicked; if they are objects of their own, try --objects"
        )
    notes += _alike_note(found, inside)
    return found._replace(warnings=tuple(warnings), notes=tuple(notes))


def _alike_note(found: Quality, inside: Mask) -> list[str]:
    """Say how many parts an answer has that was connected before the surface smoothed it."""
    if not found.answers:
        return []
    from accelsurf.clicks import OF_ALIKE

    box = bounding_box(inside)
    if found.answers[0].number != OF_ALIKE or box is None:
        return []
    pieces = int(ndimage.label(inside[box])[1])
    if pieces == 1:
        return []
    return [
        f"alike: all that is alike was connected, but the surface smooths thin bridges away: it has {pieces} parts"
    ]


def measured(seen: Judged) -> Quality:
    """Measure the quality of a result, without its probability, warnings and notes."""
    inside, image = seen.labels > 0, seen.image
    geometry, spacing = seen.geometry, seen.geometry.spacing
    history, clicked = seen.history, seen.clicked
    finest = [row for row in history if row.level == 0]
    first, last = (history[0].volume_mm3, history[-1].volume_mm3) if history else (0.0, 0.0)
    before = finest[max(-LAST_STEPS - 1, -len(finest))].volume_mm3 if finest else 0.0
    found, volume = (
        places.gather_evidence(inside, image, spacing, clicked),
        np.count_nonzero(inside) * geometry.voxel_volume,
    )
    place, uncertainty = (
        (None, 0.0) if found is None else places.uncertain_places(found, spacing, volume)[0]
    )
    unlike = None if seen.learned is None else _unlike_fraction(inside, image, seen.learned)
    return Quality(
        probability=0.0,
        next_click=None if place is None else _world(geometry, place),
        next_uncertainty=uncertainty,
        rim_fraction=_rim_fraction(inside),
        border_fraction=_border_fraction(inside, spacing),
        **_along_surface(found),
        no_edge_fraction=no_edge_fraction(inside, image, spacing),
        beyond_clicks=None if clicked is None else _beyond(inside, clicked),
        compactness=_compactness(history[-1] if history else None, geometry),
        parts_beyond_necks=parts_beyond_necks(inside),
        growth=last / first if first > 0 else 0.0,
        late_growth=(last - before) / last if last > 0 else 0.0,
        **_by_clicks(seen.confidence),
        unlike_learned=unlike,
        leaked=seen.stop.reason == "leaked",
        plateaus=tuple(seen.plateaus),
        warnings=(),
        notes=(),
    )


def _along_surface(found: Evidence | None) -> dict[str, Any]:
    """The measures along the surface; without a surface, the values of no evidence."""
    if found is None:
        return {"contrast": 0.0, "evidence": 0.0, "clicked": 0.0, "inside_like": 1.0, "drift": 0.0}
    means = {"evidence": float(found.of_image.mean()), "clicked": float(found.click.mean())}
    return {
        "contrast": found.contrast,
        **means,
        "inside_like": found.inside_like,
        "drift": found.drift,
    }


def _by_clicks(confidence: Confidence | None) -> dict[str, Any]:
    """The measures by the model of the clicks; without one they are None."""
    overlap, spread, correction, unchanged, taken, disagreement, answers, is_ambiguous = (
        confidence
        or (
            *(None,) * 6,
            (),
            False,
        )
    )
    return {
        "level_overlap": overlap,
        "size_spread": spread,
        "correction": correction,
        "unchanged": unchanged,
        "taken": taken,
        "disagreement": disagreement,
        "answers": answers,
        "is_ambiguous": is_ambiguous,
    }


def clicked_parts(inside: Mask, clicked: Mask) -> int:
    """Number of separate parts of an object that have a click in them.

    Examples
    --------
    >>> row = np.array([[[1, 1, 0, 1, 0, 1]]], bool)
    >>> clicked_parts(row, np.array([[[1, 0, 0, 0, 0, 1]]], bool))
    2
    """
    tight = bounding_box(inside)
    if tight is None:
        return 0
    found, _ = ndimage.label(inside[tight])
    return len(np.unique(found[clicked[tight] & inside[tight]]))


def _beyond(inside: Mask, clicked: Mask) -> float:
    """Voxels of an object over the clicked ones in it."""
    return float(np.count_nonzero(inside)) / max(float(np.count_nonzero(inside & clicked)), 1.0)


def _world(geometry: Geometry, index: Sequence[int]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in geometry.index_to_world(index))
    return x, y, z


def _compactness(last: StepRecord | None, geometry: Geometry) -> float:
    if last is None or not last.area_mm2 > 0:
        return 0.0
    if geometry.slice_axis is not None:
        return (
            4.0
            * math.pi
            * last.volume_mm3
            * geometry.spacing[geometry.slice_axis]
            / last.area_mm2**2
        )
    return 36.0 * math.pi * last.volume_mm3**2 / last.area_mm2**3


def _ambiguity(found: Quality, inside: Mask, image: Image, geometry: Geometry) -> str:
    """Return why the clicks may mean an object of quite another size; empty where nothing says so."""
    if found.is_ambiguous and len(found.answers) > 1:
        taken, other = found.answers[0], found.answers[1]
        sizes = sorted(answer.volume_mm3 or 0.0 for answer in (taken, other))
        texts = " or ".join(extent_text(size, geometry) for size in sizes)
        is_smaller = (taken.volume_mm3 or 0.0) <= (other.volume_mm3 or 0.0)
        which = "smaller" if is_smaller else "larger"
        return (
            f"the click may mean {texts} (--answer {other.number} takes the other one); the {which} one was taken; try "
            "--size with about how large the object is"
        )
    corners = np.ix_(*((0, -1) if n > 1 else (0,) for n in inside.shape))
    held, count = int(np.count_nonzero(inside[corners])), inside[corners].size
    if held >= MANY_CORNERS * count:
        return (
            f"it holds {held} of the {count} corners of the image, as the surroundings of objects do; try --inside at "
            "the object"
        )
    if held:
        values = image[inside]
        middle, deviation = places.median_and_deviation(values)
        like = np.abs(image[corners] - middle) <= places.LIKE * deviation
        alike = int(np.count_nonzero(inside[corners] | like))
        if alike >= MANY_CORNERS * count:
            return (
                f"it holds {held} of the {count} corners of the image and {alike} of them have its grey values, as the "
                "surroundings of objects do; try --inside at the object"
            )
    is_large = found.beyond_clicks is not None and found.beyond_clicks >= MANY_CLICKS
    if is_large and found.border_fraction >= MAX_ON_BORDER:
        parts = _parts_of(inside)
        if parts >= MANY_PIECES:
            return (
                f"it is {found.beyond_clicks:.0f} times as large as the click, in {parts} parts, and "
                f"{found.border_fraction:.0%} of its surface lies on the border; try --size with about how large the "
                "object is"
            )
    return ""


def _parts_of(inside: Mask) -> int:
    """Number of separate parts, specks apart."""
    parts, _ = ndimage.label(inside[bounding_box(inside) or whole_box(inside.shape)])
    sizes = np.bincount(parts.ravel())[1:]
    return int(np.count_nonzero(sizes >= SPECK * sizes.sum()))


def extent_text(volume_mm3: float, geometry: Geometry) -> str:
    """Return the volume of an object in words; of an image of one slice the area of that volume.

    Examples
    --------
    >>> extent_text(2000.0, Geometry((9, 9, 9), (2.0, 1.0, 1.0)))
    '2 ml'
    >>> extent_text(2000.0, Geometry((1, 9, 9), (2.0, 1.0, 1.0)))
    '1000 mm2'
    """
    axis = geometry.slice_axis
    if axis is None:
        return volume_text(volume_mm3, geometry.unit)
    return size_text(volume_mm3 / geometry.spacing[axis], geometry.unit, power=2)


def _warnings(
    found: Quality, stop: Stop, last: float, inside: Mask, geometry: Geometry, unclear: str
) -> list[str]:
    """Return the warnings, each with one command to try where one is known to help."""
    warnings, at_rest = [], "; try --stop-at-rest" if found.plateaus else ""
    if unclear:
        warnings.append(f"ambiguous: {unclear}")
    if found.leaked:
        # Neither more steps nor a click at the most doubtful place was found to help (benchmarks/hints.py).
        warnings.append(f"leak: {stop.message}{at_rest}")
    is_doubtful = found.probability < warning_threshold(found) and not unclear
    if is_doubtful and found.next_click is not None:
        # No place is named: a click where the surface has the least evidence was found to help in few cases. A run
        # without clicks is seldom mended by one, and mostly by clicks from the first step on.
        likelihood = found.likely
        at_fault = "or --outside where it is most wrong"
        tried = at_fault if found.beyond_clicks is not None else "at the object in place of --start"
        warnings.append(
            f"doubt: probably not right ({why(found)}; {likelihood}); try --inside {tried}"
        )
    if found.next_click is None and stop.reason not in ("vanished", "filled"):
        tried = f"; try --inside ball:{_larger_ball(inside, geometry)}" if inside.any() else ""
        warnings.append(
            f"doubt: the object is too small to judge ({volume_text(last, geometry.unit)}){tried}"
        )
    if abs(found.late_growth) > MAX_GROWTH and stop.reason not in ("converged", "rested", "leaked"):
        change = f"the volume changed by {found.late_growth:+.0%} in the last {LAST_STEPS} steps"
        warnings.append(f"growth: {change}{at_rest}")
    return warnings


def _larger_ball(inside: Mask, geometry: Geometry) -> str:
    """Return a ball, as options take it, around a small object, larger than it."""
    voxels = np.argwhere(inside)
    middle = voxels[int(np.argmin(((voxels - voxels.mean(axis=0)) ** 2).sum(axis=1)))]
    radius = 2.0 * max(geometry.steps) + 0.5 * max(np.ptp(voxels, axis=0) * geometry.spacing)
    return place_text(_world(geometry, middle.tolist()), geometry, radius)


def _notes(found: Quality, last: float, geometry: Geometry) -> list[str]:
    notes = []
    for plateau in found.plateaus:
        if last > MIN_BURST * plateau.volume_mm3:
            then, now = (volume_text(mm3, geometry.unit) for mm3 in (plateau.volume_mm3, last))
            notes.append(
                f"rest: it rested at step {plateau.step} with {then}, then broke through near "
                f"{place_text(plateau.place, geometry)} and ended with {now}; try --stop-at-rest"
            )
    if found.unlike_learned is not None and found.unlike_learned > MAX_UNLIKE:
        notes.append(
            f"values: {found.unlike_learned:.0%} of the object has other grey values than its start or clicks: it may "
            "have leaked, or these are not typical"
        )
    if found.border_fraction > MAX_ON_BORDER:
        notes.append(
            f"border: {found.border_fraction:.0%} of the surface lies on the volume's border"
        )
    if found.contrast < MIN_CONTRAST:
        notes.append(
            f"contrast: grey values change at the surface by {found.contrast:.2f} times their spread in the object"
        )
    if found.no_edge_fraction > MAX_WITHOUT_EDGE:
        notes.append(
            f"edge: {found.no_edge_fraction:.0%} of the surface lies where the image has no edge"
        )
    if found.taken is not None and found.taken > MAX_TAKEN:
        notes.append(
            f"outside: the last click outside took away {found.taken:.0%} of the object; click inside what was taken "
            "wrongly"
        )
    if found.parts_beyond_necks > 1:
        notes.append(
            f"necks: {found.parts_beyond_necks} large parts are joined by bridges below four voxels; did it leak?"
        )
    return notes


def _around(inside: Mask, margin: int) -> Box:
    """The object's box with a margin of voxels around it; a box without voxels when there is no object."""
    return bounding_box(inside, margin) or (slice(0, 0), slice(0, 0), slice(0, 0))


def _border_fraction(inside: Mask, spacing: tuple[float, float, float]) -> float:
    """Share of the object's faces on the border, by their areas."""
    within = inside[_around(inside, 2)]
    total = on_border = 0.0
    for axis in range(3):
        if inside.shape[axis] == 1:
            continue
        area = float(np.prod([h for other, h in enumerate(spacing) if other != axis]))
        m = np.moveaxis(within, axis, 0)
        on_border += area * sum(
            float(np.take(inside, end, axis=axis).sum()) for end in (0, inside.shape[axis] - 1)
        )
        total += area * float(np.count_nonzero(m[1:] != m[:-1]))
    total += on_border
    return on_border / total if total > 0 else 0.0


def _rim_fraction(inside: Mask) -> float:
    """Share of the object's voxels with a neighbour outside; beyond the array the object goes on."""
    box = bounding_box(inside, 1)
    if box is None:
        return 1.0
    part = inside[box]
    deep = np.count_nonzero(places.eroded(part))
    return 1.0 - float(deep) / float(np.count_nonzero(part))


def _unlike_fraction(inside: Mask, image: Image, learned: ValueRange) -> float:
    """Share of the object, without the voxels next to its surface, with values outside of an interval."""
    box = _around(inside, 1)
    part = places.eroded(inside[box])
    values = image[box][part if part.any() else inside[box]]
    return float(((values < learned.low) | (values > learned.high)).mean()) if values.size else 0.0


def no_edge_fraction(inside: Mask, image: Image, spacing: tuple[float, float, float]) -> float:
    """Share of the voxels next to the surface, on its inside, where the smoothed image has no edge."""
    scale = max(axis_steps(inside.shape, spacing))
    halo = INTERIOR_DEPTH + 5 * int(np.ceil(scale / spacing[0])) + 1
    box = bounding_box(inside, INTERIOR_DEPTH + 5 * int(np.ceil(scale / min(spacing))) + 1)
    if box is None:
        return 0.0
    inside, image = inside[box], image[box]
    on_surface: list[Image] = []
    within: list[Image] = []
    every = max(1, inside.size // GRADIENT_SAMPLES)
    for planes in slabs(inside.shape, at_least=MIN_SLAB_HALOS * halo):
        low, high = max(planes.start - halo, 0), min(planes.stop + halo, inside.shape[0])
        smooth = gaussian_mm(image[low:high], spacing, scale)
        before, after = planes.start - low, planes.stop - low
        part = inside[low:high]
        within_rim = deep = places.eroded(part)
        for _ in range(INTERIOR_DEPTH - 1):
            deep = places.eroded(deep)
        for mask, found, each in ((part & ~within_rim, on_surface, 1), (deep, within, every)):
            slab = mask[before:after]
            found.append(
                gradients(smooth, spacing, np.flatnonzero(slab)[::each] + before * slab[0].size)
            )
    surface, interior = np.concatenate(on_surface), np.concatenate(within)
    if surface.size == 0:
        return 0.0
    # A thin object has no inside to compare with.
    usual = float(np.percentile(interior, INTERIOR_PERCENTILE)) if interior.size else 0.0
    return float((surface <= max(usual, MIN_EDGE / scale)).mean())


def gradients(
    smooth: Image, spacing: tuple[float, float, float], cells: NDArray[np.int64]
) -> Singles:
    """|grad I| at raveled voxels (n,) of a smoothed image: centred differences, one-sided on the border."""
    flat = smooth.reshape(-1)
    total = np.zeros(cells.size, np.float32)
    step = smooth.size
    for n, h in zip(smooth.shape, spacing, strict=True):
        step //= n
        if n > 1:
            index = cells // step % n
            low, high = (index > 0).astype(np.int64), (index < n - 1).astype(np.int64)
            total += (
                (flat[cells + high * step] - flat[cells - low * step])
                / (np.float32(h) * (low + high))
            ) ** 2
    return np.sqrt(total)


def parts_beyond_necks(inside: Mask) -> int:
    """Large parts that remain of the largest component without its necks."""
    box = bounding_box(inside, 1)
    if box is None:
        return 0
    parts, count = ndimage.label(inside[box])
    if count == 0:
        return 0
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    body = parts == sizes.argmax()
    # An object that meets the border continues beyond it; a single slice has no depth across.
    padded = np.pad(body, [(NECK, NECK) if n > 1 else (0, 0) for n in inside.shape], mode="edge")
    del parts, body
    cores, count = ndimage.label(places.eroded(padded, NECK))
    large = LARGE_PART * np.count_nonzero(padded)
    # A core grows by at most NECK + 1 voxels to either side.
    rooms = (
        math.prod(s.stop - s.start + 2 * (NECK + 1) for s in core)
        for core in ndimage.find_objects(cores)
    )
    if sum(room >= large for room in rooms) < 2:
        return 1
    # Fewer than MAX_PARTS parts can be large; numbered as bytes they need a quarter of the memory.
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
    return max(1, int((volumes >= large).sum()))
