"""What is wrong with a finished run, and the lines printed about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from accelsurf.errors import AccelsurfError, DivergedError, DoubtfulError, EmptyResultError, NotConvergedError
from accelsurf.io.metadata import UNIT_KEY
from accelsurf.settings.wording import size_text, volume_text

if TYPE_CHECKING:
    from accelsurf.cli.case import Finished
    from accelsurf.segmentation.result import Result, SegmentedObject

_LATER = "raise --max-steps; the outputs show how far it got"
_LOOK = "look at the picture; without --strict it is a warning"
_REPORT = "use a smaller --cfl; and please report this image and its settings"


def shortcoming(name: str, result: Result, strict: bool) -> tuple[AccelsurfError | None, list[str]]:
    """Return what is wrong with a result: an error or None, and warnings.

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
    if stop.reason in ("vanished", "filled") and not result.has_ids:
        return EmptyResultError(summary, "start closer to the object, or with less --smoothness"), []
    if result.has_ids and not any(one.has_surface for one in result.objects):
        return EmptyResultError(summary, "start closer to the objects, or with less --smoothness"), []
    if stop.reason == "diverged":
        return DivergedError(summary, _REPORT), []
    late = [text for one in result.objects for text in _late(name, result, one)]
    doubts = [text for one in result.objects for text in _doubts(result, one)]
    if strict and late:
        return NotConvergedError(f"{late[0]}{_and_more(late)}", _LATER), []
    if strict and doubts:
        start = "" if result.has_ids else f"{name}: "
        return DoubtfulError(f"{start}{doubts[0]}{_and_more(doubts)}", _LOOK), []
    return None, late + doubts


def _late(name: str, result: Result, one: SegmentedObject) -> list[str]:
    if one.stop.reason not in ("max-steps", "stalled"):
        return []
    return [_end_of(f"object {one.id}" if result.has_ids else name, result, one)]


def _doubts(result: Result, one: SegmentedObject) -> list[str]:
    if not result.has_ids:
        return list(one.quality.warnings)
    if not one.has_surface:
        return [_end_of(f"object {one.id}", result, one)]
    return [f"object {one.id}: {doubt}" for doubt in one.quality.warnings]


def _end_of(whose: str, result: Result, one: SegmentedObject) -> str:
    """How an object's evolution ended, and what to try."""
    tries = {
        "max-steps": f"; try --max-steps {2 * result.config.max_steps}",
        "vanished": "; try a start deeper in it, or a smaller --smoothness",
        "filled": "; try a box around it with --box, or a larger --smoothness",
    }
    stop = one.stop
    return f"{whose}: {stop.reason} after {stop.steps} steps: {stop.message}{tries.get(stop.reason, '')}"


def _and_more(texts: Sequence[str]) -> str:
    return f" (and {len(texts) - 1} more)" if len(texts) > 1 else ""


def summary_lines(name: str, done: Finished) -> list[str]:
    """Return the lines printed at the end: how the run ended, the measures, the files.

    Parameters
    ----------
    name : str
        Of the case.
    done : Finished
    """
    result = done.result
    lines = _ending(name, result, done.log.seconds["total"])
    by_kind: dict[str, list[str]] = {}
    shaped = [output for output in done.log.outputs if "largest_distance_mm" in output]
    for output in done.log.outputs:
        by_kind.setdefault(output["kind"], []).append(output["path"])
    if result.has_ids or {"surface", "contour"} & set(by_kind):
        lines.append(_measures(result))
    lines += [f"  {line}" for line in _judgement(result)]
    if shaped:
        furthest = max(shaped, key=lambda output: float(output["largest_distance_mm"]))
        lines.append(
            f"  mesh: {furthest['faces']} triangles, at most {furthest['largest_distance_mm']:.3g} mm from the surface"
        )
    for kind, paths in by_kind.items():
        if result.has_ids:
            more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
            lines.append(f"  {kind:8} {paths[0]}{more}")
        else:
            lines += [f"  {kind:8} {path}" for path in paths]
    return [*lines, f"  {'report':8} {done.place.report_path.absolute()}"]


def _ending(name: str, result: Result, seconds: float) -> list[str]:
    stop = result.stop
    if result.has_ids:
        return [f"{name}: {stop.message}; up to {stop.steps} steps, {seconds:.1f} s"]
    levels = f" on {len(result.levels)} levels" if len(result.levels) > 1 else ""
    return [f"{name}: {stop.reason} after {stop.steps} steps{levels}, {seconds:.1f} s ({stop.message})"]


def _judgement(result: Result) -> list[str]:
    """Lines about quality: how likely the result is good, where to click next, and notes."""
    lines = []
    for one in result.objects:
        if not one.has_surface:
            continue
        quality, whose = one.quality, f"object {one.id}: " if result.has_ids else ""
        if quality.next_click is not None:
            place = ",".join(f"{value:.1f}" for value in quality.next_click)
            lines.append(f"{whose}{quality.probability:.0%} likely to be good; most doubtful near {place}")
        lines += [f"{whose}note: {note}" for note in quality.notes]
    return lines


def _in_words(result: Result, said: str) -> str:
    """The volume in the unit that people use for its size, where that is another."""
    text = volume_text(result.volume_mm3)
    return "" if text.endswith(said.rpartition(" ")[2]) else f" ({text})"


def _measures(result: Result) -> str:
    is_2d = result.geometry.slice_axis is not None
    unit = result.volume.metadata.get(UNIT_KEY, "mm")
    volume, area = size_text(result.volume_mm3, unit, 3), size_text(result.area_mm2, unit, 2)
    sizes = f"volume {volume}{_in_words(result, volume)}, area {area}"
    if is_2d:
        enclosed, length = result.enclosed_mm2 or 0.0, result.length_mm or 0.0
        sizes = f"area {size_text(enclosed, unit, 2)}, length {size_text(length, unit)}"
    if result.has_ids:
        return f"{sizes} in all"
    parts = f"{result.components} component{'' if result.components == 1 else 's'}"
    border = f", touches the {'image' if is_2d else 'volume'}'s border" if result.touches_border else ""
    return f"{sizes}, {parts}{border}"
