"""Volumes against time, as a picture."""

from __future__ import annotations

import numpy as np

from accelsurf.analysis.beats import Beat, find_beat
from accelsurf.report.axes import LABEL_SIZE, Axes, range_of
from accelsurf.report.canvas import Canvas, fitting, object_color
from accelsurf.report.track_frames import TrackSet

#: Objects that are named beside the curves at most, and drawn.
MAX_NAMES, MAX_CURVES = 18, 200
#: Volumes below this, ml, are written as mm3.
SMALL = 0.1
WIDTH, HEIGHT = 900, 460


def beats_of(tracks: TrackSet) -> dict[int, Beat]:
    """The beat of each object that has one, over the frames in which it is seen."""
    found = {}
    for own, life in tracks.by_object.items():
        seen = [(row.time, one.volume_mm3) for row, one in life if one.seen]
        beat = find_beat(*zip(*seen, strict=True)) if len(seen) > 1 else None
        if beat is not None:
            found[own] = beat
    return found


def curves_png(tracks: TrackSet) -> bytes:
    """Draw the volume of each object against time, with a gap where it is not seen.

    Returns
    -------
    bytes
        A PNG file.
    """
    ids, beats = list(tracks.by_object), beats_of(tracks)
    largest = max((one.volume_mm3 for row in tracks.rows for one in row.objects), default=0.0)
    unit, scale = ("mm\u00b3", 1.0) if largest < 1e3 * SMALL else ("ml", 1e-3)
    curves = {
        own: [(row.time, scale * one.volume_mm3 if one.seen else np.nan) for row, one in tracks.by_object[own]]
        for own in ids[:MAX_CURVES]
    }
    canvas = Canvas(WIDTH, HEIGHT, fitting(_title(tracks, beats), 17, WIDTH - 40))
    times = [row.time for row in tracks.rows] or [0.0]
    right = WIDTH - (130 if len(ids) > 1 else 30)
    x = (min(times), max(times)) if max(times) > min(times) else (min(times) - 0.5, min(times) + 0.5)
    low, high = range_of([value for curve in curves.values() for _, value in curve])
    axes = Axes(canvas, (90, 56, right, HEIGHT - 58), x, (max(low, 0.0), high))
    axes.frame("time (s)" if tracks.sequence.time_unit == "s" else "frame", f"volume ({unit})", grid=True)
    for number, (own, curve) in enumerate(curves.items()):
        color = object_color(number)
        at, values = zip(*curve, strict=True)
        axes.curve(at, values, color, 2.0)
        for place, value in zip(axes.to_canvas(curve), values, strict=True):
            if np.isfinite(value) and len(curve) <= MAX_CURVES:
                canvas.circle((float(place[0]), float(place[1])), 2.5, color)
        if 1 < len(ids) and number < MAX_NAMES:
            y = 66 + 20 * number
            canvas.line([(right + 14, y), (right + 40, y)], color, 2.5)
            canvas.text((right + 46, y), f"object {own}", LABEL_SIZE, anchor="lm")
    return canvas.png()


def _title(tracks: TrackSet, beats: dict[int, Beat]) -> str:
    words = [f"{tracks.name}: volume"]
    if len(beats) == 1:
        (beat,) = beats.values()
        words.append(f"ejection fraction {beat.ejection_fraction:.0%}")
        if beat.period is not None:
            unit = " s" if tracks.sequence.time_unit == "s" else " frames"
            words.append(f"period {beat.period:.3g}{unit}")
    return ", ".join(words)
