"""Quality of a result: measures of surface and image that need no reference, and the place to look at next.

The probability that a result is good is a logistic model of a few measures, calibrated by ``scripts/study quality``.
There are two: ``clicks`` for a result whose model of clicks says how sure it is, and ``image`` for all others. The
study writes them into the file beside this one: for each feature its mean, standard deviation and weight; the constant
term; and the probability below which a warning is given.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf.grid.boxes import Box, bounding_box, slabs
from accelsurf.grid.geometry import Geometry, axis_steps
from accelsurf.image.smoothing import gaussian_mm
from accelsurf.measure import evidence as places
from accelsurf.settings.wording import place_text, volume_text

if TYPE_CHECKING:
    from accelsurf.clicks.model import Answer
    from accelsurf.clicks.model.confidence import Confidence
    from accelsurf.evolution.records import StepRecord, Stop
    from accelsurf.measure.evidence import Evidence

#: A note is made beyond these: fraction of the surface on the border, and without an edge; contrast across the surface
#: in units of the noise; relative growth over the last steps; share of the object unlike what was learned. A Gaussian
#: has 1.2 % beyond the bounds.
MAX_ON_BORDER, MAX_WITHOUT_EDGE, MIN_CONTRAST, MAX_GROWTH, LAST_STEPS, MAX_UNLIKE = 0.2, 0.4, 2.0, 0.02, 20, 0.1
#: A plateau is noted where the object has grown to so many times its size since.
MIN_BURST = 1.1
#: What counts for an object without clicks as its volume over theirs, where no click has corrected it (radii), and as
#: compactness where no surface was measured.
USUAL_BEYOND, USUAL_CORRECTION, USUAL_COMPACTNESS = 20.0, 0.37, 0.49
#: A gradient is an edge if it is above this percentile of the gradients inside the object, at least so many voxels from
#: its surface, and above this fraction of the image's range over the scale that gradients are computed at.
INTERIOR_PERCENTILE, INTERIOR_DEPTH, MIN_EDGE = 75.0, 3, 0.005
#: Gradients inside the object are sampled at about so many voxels.
GRADIENT_SAMPLES = 1 << 18
#: A slab has at least so many planes for each plane around it that is needed besides.
MIN_SLAB_HALOS = 4
#: A part counts from this fraction of the object's volume on; a neck is at most so many voxels to either side; so many
#: parts are examined.
LARGE_PART, NECK, MAX_PARTS = 0.05, 2, 200
#: The file with the models of the probability.
MODEL_FILE = "good_result.json"
#: Names of the models.
ModelKind = Literal["clicks", "image"]


class ValueRange(NamedTuple):
    """An interval of the image's values."""

    low: float
    high: float


class PlateauNote(NamedTuple):
    """A plateau of the front: its ``step``, its ``volume_mm3`` then, and the ``place`` (x, y, z; mm, LPS) near which
    the front broke through at step ``left_at``.
    """

    step: int
    volume_mm3: float
    left_at: int
    place: tuple[float, float, float]


class Quality(NamedTuple):
    """Measures of a result that need no reference.

    Attributes
    ----------
    probability : float
        That the result is good (a Dice of 0.8 or more), by a logistic model of the measures below; how it was
        calibrated stands in docs/explanation/quality.md.
    next_click : (x, y, z) or None
        World mm (LPS): the most uncertain place, where to click next.
    next_doubt : float
        Uncertainty there, 0 to 1.
    border_fraction : float
        Share of the object's surface that lies on the volume's border.
    contrast : float
        Median difference of the image across the surface, in units of how much it differs within the object over the
        same distance.
    no_edge_fraction : float
        Share of the surface where the image has no edge: a gradient within the lower three quarters of those inside the
        object.
    evidence : float
        Mean evidence of the image for the surface, 0 to 1: an edge, and beyond it values unlike the object's.
    clicked : float
        Mean evidence of clicks: 1 where all of the surface lies beside one.
    beyond_clicks : float or None
        Volume of the object over that of the clicked voxels in it; None without clicks.
    inside_like : float
        Share of the surface beyond which the image has values of the object.
    drift : float
        Difference of the object's values between shells around its middle, in units of their deviation.
    compactness : float
        36 pi V^2/A^3, 1 for a ball; in one slice 4 pi A/L^2.
    parts_beyond_necks : int
        Large parts that remain when necks of less than four voxels are removed; 1 for a compact object.
    growth : float
        Volume at the end over that of the start.
    late_growth : float
        Relative change of the volume over the last 20 steps.
    level_overlap, size_spread, correction : float or None
        How sure the model of the clicks is: ``overlap``, ``spread`` and ``correction`` of
        `accelsurf.clicks.model.confidence.Confidence`; None without one.
    unlike_learned : float or None
        Share of the object, without the voxels next to its surface, whose values lie further than 2.5 standard
        deviations from the mean of those that it was learned from; None where no model was learned once.
    leaked : bool
        Whether it grew beyond ``max_volume``.
    rests : tuple of PlateauNote
        Plateaus of the front before it broke through.
    warnings : tuple of str
        What is uncertain, each with a command to try next.
    notes : tuple of str
        Remarks worth knowing and mostly harmless.
    answers : tuple of Answer
        To the first click: the one that was taken, and others that are likely; none without a model of clicks.
    """

    probability: float
    next_click: tuple[float, float, float] | None
    next_doubt: float
    border_fraction: float
    contrast: float
    no_edge_fraction: float
    evidence: float
    clicked: float
    beyond_clicks: float | None
    inside_like: float
    drift: float
    compactness: float
    parts_beyond_necks: int
    growth: float
    late_growth: float
    level_overlap: float | None
    size_spread: float | None
    correction: float | None
    unlike_learned: float | None
    leaked: bool
    rests: tuple[PlateauNote, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    answers: tuple[Answer, ...] = ()


def assess(
    labels: NDArray[np.uint8],
    image: NDArray[np.float32],
    geometry: Geometry,
    history: Sequence[StepRecord],
    stop: Stop,
    learned: ValueRange | None = None,
    plateaus: Sequence[PlateauNote] = (),
    clicked: NDArray[np.bool_] | None = None,
    confidence: Confidence | None = None,
) -> Quality:
    """Measure the quality of a result.

    Parameters
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
    plateaus : sequence of PlateauNote, optional
    clicked : ndarray (nz, ny, nx) of bool, optional
        Voxels that a person clicked, on either side.
    confidence : Confidence, optional
        Of the model of the clicks.
    """
    inside, spacing = labels > 0, geometry.spacing
    finest = [row for row in history if row.level == 0]
    first, last = (history[0].volume_mm3, history[-1].volume_mm3) if history else (0.0, 0.0)
    before = finest[max(-LAST_STEPS - 1, -len(finest))].volume_mm3 if finest else 0.0
    found, volume = places.gather(inside, image, spacing, clicked), np.count_nonzero(inside) * geometry.voxel_volume
    place, uncertainty = (None, 0.0) if found is None else places.uncertain_places(found, spacing, volume)[0]
    measured = Quality(
        probability=0.0,
        next_click=None if place is None else _world(geometry, place),
        next_doubt=uncertainty,
        border_fraction=_border_fraction(inside, spacing),
        **_along_surface(found),
        no_edge_fraction=no_edge_fraction(inside, image, spacing),
        beyond_clicks=None if clicked is None else _beyond(inside, clicked),
        compactness=_compactness(history[-1] if history else None, geometry),
        parts_beyond_necks=parts_beyond_necks(inside),
        growth=last / first if first > 0 else 0.0,
        late_growth=(last - before) / last if last > 0 else 0.0,
        **_by_clicks(confidence),
        unlike_learned=None if learned is None else _unlike_fraction(inside, image, learned),
        leaked=stop.reason == "leaked",
        rests=tuple(plateaus),
        warnings=(),
        notes=(),
    )
    likely = probability_good(model_kind(measured), features(measured, stop.reason, last))
    measured = measured._replace(probability=likely)
    warnings, notes = _warnings(measured, stop, last, inside, geometry), _notes(measured, last, geometry)
    return measured._replace(warnings=tuple(warnings), notes=tuple(notes))


def _along_surface(found: Evidence | None) -> dict[str, Any]:
    """The measures along the surface; those of a result of which nothing is known where it has none."""
    if found is None:
        return {"contrast": 0.0, "evidence": 0.0, "clicked": 0.0, "inside_like": 1.0, "drift": 0.0}
    means = {"evidence": float(found.of_image.mean()), "clicked": float(found.click.mean())}
    return {"contrast": found.contrast, **means, "inside_like": found.inside_like, "drift": found.drift}


def _by_clicks(confidence: Confidence | None) -> dict[str, Any]:
    """The measures by the model of the clicks; without one they are None."""
    overlap, spread, correction, answers = confidence or (None, None, None, ())
    return {"level_overlap": overlap, "size_spread": spread, "correction": correction, "answers": answers}


def model_kind(found: Quality) -> ModelKind:
    """Return the model that tells the probability."""
    return "image" if found.level_overlap is None else "clicks"


def features(found: Quality, reason: str, volume_mm3: float) -> dict[str, float]:
    """Return the features of the probability, by name."""
    clicks = click_features(found)
    return image_features(found, reason, volume_mm3) if clicks is None else clicks


def click_features(found: Quality) -> dict[str, float] | None:
    """Return the features of the model of the clicks; None without one."""
    if found.level_overlap is None or found.size_spread is None:
        return None
    overlap = min(max(found.level_overlap, 0.01), 0.99)
    correction = USUAL_CORRECTION if found.correction is None else found.correction
    return {
        "level_overlap": math.log(overlap / (1.0 - overlap)),
        "correction": math.log(min(max(correction, 0.03), 5.0)),
        "size_spread": min(found.size_spread, 3.0),
        "compactness": _round(found),
    }


def image_features(found: Quality, reason: str, volume_mm3: float) -> dict[str, float]:
    """Return the features of the surface, the image and the run."""
    burst = max((volume_mm3 / note.volume_mm3 for note in found.rests[:1] if note.volume_mm3 > 0), default=1.0)
    return {
        "contrast": math.log(min(max(found.contrast, 0.1), 100.0)),
        "evidence": found.evidence,
        "clicked": found.clicked,
        "beyond_clicks": math.log(min(max(found.beyond_clicks or USUAL_BEYOND, 1.0), 1000.0)),
        "inside_like": found.inside_like,
        "drift": math.log1p(min(found.drift, 20.0)),
        "compactness": _round(found),
        "border": min(found.border_fraction, 1.0),
        "burst": math.log(min(max(burst, 1.0), 20.0)),
        "growth": math.log(min(max(found.growth, 0.1), 1000.0)),
        "no_edge": found.no_edge_fraction,
        "unconverged": float(reason not in ("converged", "rested")),
    }


def _round(found: Quality) -> float:
    """The compactness as a feature: 0 of a ball; that of most objects where no surface was measured."""
    return math.log(min(max(found.compactness or USUAL_COMPACTNESS, 1e-3), 1.0))


def _beyond(inside: NDArray[np.bool_], clicked: NDArray[np.bool_]) -> float:
    """Voxels of an object over the clicked ones in it."""
    return float(np.count_nonzero(inside)) / max(float(np.count_nonzero(inside & clicked)), 1.0)


def _world(geometry: Geometry, index: Sequence[int]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in geometry.index_to_world(index))
    return x, y, z


def _compactness(last: StepRecord | None, geometry: Geometry) -> float:
    if last is None or not last.area_mm2 > 0:
        return 0.0
    if geometry.slice_axis is not None:
        return 4.0 * math.pi * last.volume_mm3 * geometry.spacing[geometry.slice_axis] / last.area_mm2**2
    return 36.0 * math.pi * last.volume_mm3**2 / last.area_mm2**3


def _warnings(
    found: Quality, stop: Stop, last: float, inside: NDArray[np.bool_], geometry: Geometry
) -> list[str]:
    """Return the warnings, each with one command to try."""
    warnings = []
    there = "" if found.next_click is None else place_text(found.next_click, geometry.steps)
    if found.leaked:
        warnings.append(f"leak: {stop.message}; try {_against_leak(found, there, geometry)}")
    if found.probability < warning_threshold(model_kind(found)) and found.next_click is not None:
        click = f"look at {there} first and try --inside point:{there}, or --outside if it is not the object"
        sure = f"{found.probability:.0%} likely to be good"
        warnings.append(f"doubt: probably not right ({_why(found)}; {sure}); {click}")
    if found.next_click is None and stop.reason not in ("vanished", "filled"):
        tried = f"; try --inside ball:{_larger_ball(inside, geometry)}" if inside.any() else ""
        warnings.append(f"doubt: its surface cannot be judged, at {volume_text(last)}{tried}")
    if abs(found.late_growth) > MAX_GROWTH and stop.reason not in ("converged", "rested", "leaked"):
        change = f"the volume changed by {found.late_growth:+.0%} in the last {LAST_STEPS} steps"
        # After a plateau more steps lead farther away.
        tried = "--stop-at-rest" if found.rests else f"--max-steps {2 * stop.steps}"
        warnings.append(f"growth: {change}; try {tried}")
    return warnings


def _against_leak(found: Quality, uncertain: str, geometry: Geometry) -> str:
    """Return a remedy of a leak: a click where the front broke through, else at the most uncertain location."""
    if found.rests:
        return f"--outside point:{place_text(found.rests[-1].place, geometry.steps)}, near which it broke through"
    return f"--outside point:{uncertain}, its most doubtful place" if uncertain else "--stop-at-rest"


def _larger_ball(inside: NDArray[np.bool_], geometry: Geometry) -> str:
    """X,Y,Z,R of a ball around a small object, larger than it."""
    voxels = np.argwhere(inside)
    middle = voxels[int(np.argmin(((voxels - voxels.mean(axis=0)) ** 2).sum(axis=1)))]
    radius = 2.0 * max(geometry.steps) + 0.5 * max(np.ptp(voxels, axis=0) * geometry.spacing)
    return f"{place_text(_world(geometry, middle.tolist()), geometry.steps)},{radius:.2g}"


def _why(found: Quality) -> str:
    """The measure that speaks most against it, in words."""
    words = {
        "contrast": f"the contrast across the surface is {found.contrast:.1f} times the noise",
        "evidence": f"little holds the surface: evidence {found.evidence:.2f}",
        "clicked": "it is hardly larger than its clicks",
        "beyond_clicks": f"it is {found.beyond_clicks or USUAL_BEYOND:.3g} times its clicks",
        "inside_like": f"beyond {found.inside_like:.0%} of the surface the image is like the object",
        "drift": f"values drift by {found.drift:.1f} deviations from its middle outwards",
        "compactness": f"the shape is far from compact, {found.compactness:.2f}",
        "border": f"{found.border_fraction:.0%} of the surface lies on the volume's border",
        "burst": "it broke through after a rest",
        "growth": f"it grew {found.growth:.3g} times",
        "no_edge": f"under {found.no_edge_fraction:.0%} of the surface the image has no edge",
        "unconverged": "it did not converge",
        "level_overlap": "slightly more or less would be another object",
        "size_spread": "other sizes are likely too",
    }
    if found.correction is not None:
        words["correction"] = f"the last click was {found.correction:.2g} radii away from what was found before"
    last = found.rests[0].volume_mm3 if found.rests else 0.0
    return words[lowest_term(model_kind(found), features(found, "converged", last), words)]


def _notes(found: Quality, last: float, geometry: Geometry) -> list[str]:
    notes = []
    for plateau in found.rests:
        if last > MIN_BURST * plateau.volume_mm3:
            notes.append(
                f"rest: rested at step {plateau.step} at {volume_text(plateau.volume_mm3)}, then broke through near "
                f"{place_text(plateau.place, geometry.steps)}, to {volume_text(last)} in the end; try --stop-at-rest"
            )
    if found.unlike_learned is not None and found.unlike_learned > MAX_UNLIKE:
        notes.append(
            f"values: {found.unlike_learned:.0%} of the object is unlike what it was learned from: it may have leaked, "
            "or what it was learned from is not typical"
        )
    if found.border_fraction > MAX_ON_BORDER:
        notes.append(f"border: {found.border_fraction:.0%} of the surface lies on the volume's border")
    if found.contrast < MIN_CONTRAST:
        notes.append(
            f"contrast: inside and outside differ by {found.contrast:.2f} times what the object itself differs by"
        )
    if found.no_edge_fraction > MAX_WITHOUT_EDGE:
        notes.append(f"edge: under {found.no_edge_fraction:.0%} of the surface the image has no edge")
    if found.parts_beyond_necks > 1:
        notes.append(
            f"necks: {found.parts_beyond_necks} large parts are connected by less than four voxels only; has it leaked?"
        )
    return notes


def _around(inside: NDArray[np.bool_], margin: int) -> Box:
    """The object's box with so many voxels around it; a box without voxels when there is no object."""
    return bounding_box(inside, margin) or (slice(0, 0), slice(0, 0), slice(0, 0))


def _border_fraction(inside: NDArray[np.bool_], spacing: tuple[float, float, float]) -> float:
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


def _unlike_fraction(inside: NDArray[np.bool_], image: NDArray[np.float32], learned: ValueRange) -> float:
    """Share of the object, without the voxels next to its surface, with values outside of an interval."""
    box = _around(inside, 1)
    part = ndimage.binary_erosion(inside[box], border_value=1)
    values = image[box][part if part.any() else inside[box]]
    return float(((values < learned.low) | (values > learned.high)).mean()) if values.size else 0.0


def no_edge_fraction(
    inside: NDArray[np.bool_], image: NDArray[np.float32], spacing: tuple[float, float, float]
) -> float:
    """Share of the voxels next to the surface, on its inside, where the smoothed image has no edge."""
    scale = max(axis_steps(inside.shape, spacing))
    halo = INTERIOR_DEPTH + 5 * int(np.ceil(scale / spacing[0])) + 1
    box = bounding_box(inside, INTERIOR_DEPTH + 5 * int(np.ceil(scale / min(spacing))) + 1)
    if box is None:
        return 0.0
    inside, image = inside[box], image[box]
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
            slab = mask[before:after]
            found.append(gradients(smooth, spacing, np.flatnonzero(slab)[::each] + before * slab[0].size))
    surface, interior = np.concatenate(on_surface), np.concatenate(within)
    if surface.size == 0:
        return 0.0
    # A thin object has no inside to compare with.
    usual = float(np.percentile(interior, INTERIOR_PERCENTILE)) if interior.size else 0.0
    return float((surface <= max(usual, MIN_EDGE / scale)).mean())


def gradients(
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


def parts_beyond_necks(inside: NDArray[np.bool_]) -> int:
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


@functools.cache
def calibrated_models() -> dict[str, dict[str, Any]]:
    """Return the models by kind: ``features`` (name: mean, deviation, weight), ``constant``, ``threshold``."""
    text = (resources.files("accelsurf.measure") / MODEL_FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def warning_threshold(kind: ModelKind) -> float:
    """Return the probability below which a warning is given."""
    return float(calibrated_models()[kind]["threshold"])


def probability_good(kind: ModelKind, features: Mapping[str, float]) -> float:
    """Return the probability that a result with these features is good, 0 to 1."""
    total = float(calibrated_models()[kind]["constant"]) + sum(_terms(kind, features).values())
    return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


def lowest_term(kind: ModelKind, features: Mapping[str, float], names: Collection[str]) -> str:
    """Return which of the features that are named lowers the probability most."""
    terms = _terms(kind, features)
    return min((name for name in terms if name in names), key=terms.__getitem__)


def _terms(kind: ModelKind, features: Mapping[str, float]) -> dict[str, float]:
    return {
        name: weight * (features[name] - mean) / deviation
        for name, (mean, deviation, weight) in calibrated_models()[kind]["features"].items()
    }
