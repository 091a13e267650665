"""Judgement of a finished run, and the lines printed about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelsurf.errors import (
    AccelsurfError,
    DivergedError,
    DoubtfulError,
    EmptyResultError,
    NotConvergedError,
)
from accelsurf.measure import extent_text
from accelsurf.settings.wording import in_unit, rounded_text, size_text, volume_text
from accelsurf.text.coordinates import place_text

if TYPE_CHECKING:
    from accelsurf.grid.geometry import Geometry
    from accelsurf.measure import Quality
    from accelsurf.run import Result, SegmentedObject

EMPTY = ("vanished", "filled")
#: The checks before the first step that foretell these, see `accelsurf.run.start_checks`.
CAUSES = {"vanished": ("start", "area"), "filled": ("window", "start")}
_LATER = "raise --max-steps; the outputs show how far it got"
_LOOK = "look at the picture; without --strict it is a warning"
_REPORT = "use a smaller --cfl; and please report this image and its settings"


def shortcoming(name: str, result: Result, strict: bool) -> tuple[AccelsurfError | None, list[str]]:
    """Return the shortcomings of a result: an error or None, and warnings.

    Of several objects, one that vanished is a warning; it is an error when none remains.

    Parameters
    ----------
    name : str
        Of the case.
    result : Result
    strict : bool
        Whether a run that did not converge, or whose result is doubtful, counts as failed.
    """
    stop = result.stop
    summary = f"{name}: {stop.message}"
    if not result.has_ids:
        summary = f"{name}: {stop.reason} after {stop.steps} steps: {stop.message}"
    if not any(segmented.has_surface for segmented in result.objects) and (
        result.has_ids or stop.reason in EMPTY
    ):
        tried = _try_of(result, result.objects[0])
        return EmptyResultError(summary, f"try {tried}" if tried else ""), []
    if stop.reason == "diverged":
        return DivergedError(summary, _REPORT), []
    late = [text for segmented in result.objects for text in _late(name, result, segmented)]
    quality_warnings = [
        text for segmented in result.objects for text in _warnings_of(result, segmented)
    ]
    if strict and late:
        return NotConvergedError(f"{late[0]}{_and_more(late)}", _LATER), []
    if strict and quality_warnings:
        start = "" if result.has_ids else f"{name}: "
        return DoubtfulError(
            f"{start}{quality_warnings[0]}{_and_more(quality_warnings)}", _LOOK
        ), []
    return None, late + quality_warnings


def _late(name: str, result: Result, segmented: SegmentedObject) -> list[str]:
    if segmented.stop.reason not in ("max-steps", "stalled"):
        return []
    return [_end_of(f"object {segmented.id}" if result.has_ids else name, result, segmented)]


def _warnings_of(result: Result, segmented: SegmentedObject) -> list[str]:
    if not result.has_ids:
        return list(segmented.quality.warnings)
    if not segmented.has_surface:
        return [_end_of(f"object {segmented.id}", result, segmented)]
    return [f"object {segmented.id}: {warning}" for warning in segmented.quality.warnings]


def _end_of(whose: str, result: Result, segmented: SegmentedObject) -> str:
    """Say how an object's evolution ended, and give the command to try."""
    tried, stop = _try_of(result, segmented), segmented.stop
    return f"{whose}: {stop.reason} after {stop.steps} steps: {stop.message}{f'; try {tried}' if tried else ''}"


def _try_of(result: Result, segmented: SegmentedObject) -> str:
    """One command for an object without a surface; empty where none is known to help (benchmarks/hints.py).

    A warning from before the first step gives the cause. A start that is clicked cannot vanish, and shows the
    appearance of the object.
    """
    if segmented.stop.reason not in EMPTY:
        return ""
    config, prefix = result.config, f"object {segmented.id}: " if result.has_ids else ""
    for check in CAUSES[segmented.stop.reason]:
        for line in result.warnings:
            if line.startswith(f"{prefix}{check}: ") and "; try " in line:
                return line.rpartition("; try ")[2]
    if segmented.stop.reason == "filled":
        return "--stop-at-rest" if segmented.plateaus else ""
    if config.smoothness > 0:
        return f"--smoothness {0.25 * config.smoothness:.2g}"
    if result.has_ids or "start" in result.given or len(config.start) != 1:
        return "--energy threshold:learned,learned"
    return f"--inside {config.start[0]} in place of --start and --energy"


def _and_more(texts: Sequence[str]) -> str:
    return f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""


def summary_lines(
    name: str, result: Result, outputs: Sequence[Mapping[str, Any]], seconds: float, report: Path
) -> list[str]:
    """Return the lines printed at the end: how the run ended, the measures, the files.

    Parameters
    ----------
    name : str
        Of the case.
    result : Result
    outputs : sequence of mapping
        The files, as the report lists them.
    seconds : float
        Wall time of the whole run.
    report : Path
    """
    lines = _ending(name, result, seconds)
    shaped = [output for output in outputs if "largest_distance_mm" in output]
    if result.has_ids or {"surface", "contour"} & {output["kind"] for output in outputs}:
        lines += [_measures(result), *_around_measures(result)]
    lines += [f"  {line}" for line in _judgement(result)]
    if shaped:
        furthest = max(shaped, key=lambda output: float(output["largest_distance_mm"]))
        far = size_text(furthest["largest_distance_mm"], result.geometry.unit, digits=3)
        lines.append(f"  mesh: {furthest['faces']} triangles, at most {far} from the surface")
    return [*lines, *file_lines(outputs, report, first_alone=result.has_ids)]


def file_lines(outputs: Sequence[Mapping[str, Any]], report: Path, first_alone: bool) -> list[str]:
    """Return lines with the files by kind, the report last; with ``first_alone`` one line for each kind."""
    by_kind: dict[str, list[str]] = {}
    for output in outputs:
        by_kind.setdefault(output["kind"], []).append(output["path"])
    lines = []
    for kind, paths in by_kind.items():
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        shown = [paths[0] + more] if first_alone else paths
        lines += [f"  {kind:10} {path}" for path in shown]
    return [*lines, f"  {'report':10} {report.absolute()}"]


def _ending(name: str, result: Result, seconds: float) -> list[str]:
    stop = result.stop
    if result.has_ids:
        return [f"{name}: {stop.message}; up to {stop.steps} steps, {seconds:.1f} s"]
    if _stayed(result):
        return [
            f"{name}: the first surface stays, {seconds:.1f} s (none of {stop.steps} steps was better)"
        ]
    levels = f" on {len(result.levels)} levels" if len(result.levels) > 1 else ""
    return [
        f"{name}: {stop.reason} after {stop.steps} steps{levels}, {seconds:.1f} s ({stop.message})"
    ]


def _stayed(result: Result) -> bool:
    """True if the run ended at the surface that it began with, as no step had a lower energy."""
    history = result.run_history
    return (
        result.stop.reason == "converged"
        and len(history) > 1
        and history[-1].returned
        and history[-1].potential == history[0].potential
    )


def _judgement(result: Result) -> list[str]:
    """Lines about quality: how likely the result is good, where to click next, and notes."""
    lines = []
    if _began_in_the_middle(result):
        lines.append(
            "note: it began as a ball in the middle of the image; --inside says where the object is"
        )
    if _may_be_several(result):
        lines.append("note: all clicks inside are in one object; for a label each: --objects TABLE")
    for segmented in result.objects:
        if not segmented.has_surface:
            continue
        quality, whose = segmented.quality, f"object {segmented.id}: " if result.has_ids else ""
        if quality.next_click is not None:
            place = place_text(quality.next_click, result.geometry)
            lines.append(f"{whose}{quality.likely} (Dice 0.8 or more); most doubtful near {place}")
        lines += [f"{whose}{line}" for line in _other_answers(quality, result.geometry)]
        lines += [f"{whose}note: {note}" for note in quality.notes]
    return lines


def _began_in_the_middle(result: Result) -> bool:
    """True if nothing was said of where the object is."""
    config = result.config
    said = bool(config.inside or config.objects or config.labels or result.given)
    return not said and "start" not in config.model_fields_set and config.start == ("center",)


def _may_be_several(result: Result) -> bool:
    """True if clicks inside may be in objects of their own: they gave parts, or a doubtful object."""
    if result.has_ids or len(result.config.inside) < 2:
        return False
    return result.components > 1 or bool(result.objects[0].quality.warnings)


def _other_answers(quality: Quality, geometry: Geometry) -> list[str]:
    """A line about other answers to the first click, as long as no click has corrected the one that was taken.

    All that is alike is an answer to every click: it is named beside a part, and where there are warnings. Where the
    answer is ambiguous, a warning has named the other one.
    """
    if quality.is_ambiguous or len(quality.answers) < (2 if quality.warnings else 3):
        return []
    others = []
    for answer in quality.answers[1:]:
        volume = answer.volume_mm3
        said = extent_text(volume, geometry) if volume else "all that is alike and connected"
        others.append(f"{said} (--answer {answer.number})")
    return [f"the first click may also mean {' or '.join(others)}"]


def _in_words(result: Result, said: str) -> str:
    """The volume in the unit that people use for its size, where that is another."""
    text = volume_text(result.estimates.volume_mm3)
    return "" if text.endswith(said.rpartition(" ")[2]) else f" ({text})"


def _measures(result: Result) -> str:
    is_2d = result.geometry.slice_axis is not None
    unit, best = result.geometry.unit, result.estimates
    volume, area = size_text(best.volume_mm3, unit, 3), size_text(best.area_mm2, unit, 2)
    sizes = f"volume {volume}{_in_words(result, volume)}, area {area}"
    if is_2d:
        enclosed, length = result.enclosed_mm2 or 0.0, result.length_mm or 0.0
        sizes = f"area {size_text(enclosed, unit, 2)}, length {size_text(length, unit)}"
    if result.has_ids:
        return f"{sizes} in all"
    parts = f"{result.components} component{'' if result.components == 1 else 's'}"
    border = (
        f", touches the {'image' if is_2d else 'volume'}'s border" if result.touches_border else ""
    )
    return f"{sizes}, {parts}{border}"


def _around_measures(result: Result) -> list[str]:
    """A line with the intervals around the measures of one object in a volume."""
    found = result.objects[0]
    if result.has_ids or result.geometry.slice_axis is not None or not found.has_surface:
        return []
    if found.intervals is None:
        return ["  how exact that is cannot be told: there is no edge in the image to measure by"]
    unit = result.geometry.unit
    texts = []
    for power, (key, interval) in zip((3, 2, 1), found.intervals._asdict().items(), strict=True):
        ends = [rounded_text(in_unit(end, unit, power)) for end in interval or ()]
        text = (
            f"{' to '.join(ends)} {unit}{power if power > 1 else ''}" if ends else "cannot be told"
        )
        texts.append(f"{key.partition('_')[0]} {text}")
    return [f"  95 % interval: {', '.join(texts)}"]
