"""A frame with scales on a canvas: what curves and slices are drawn in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from accelsurf.report.canvas import GRID, INK, PALE, SOLID, Box, Canvas, Dashes, fitting

#: Height of the numbers at the ticks, of labels and of titles, pixels.
TICK_SIZE, LABEL_SIZE, TITLE_SIZE = 11, 12, 14
#: A side shorter than this has no room for a label along it, pixels.
MIN_FOR_LABEL = 60


class Axes:
    """A rectangle of a canvas with a scale along each side.

    Parameters
    ----------
    canvas : Canvas
    box : (left, top, right, bottom)
        Pixels.
    x, y : (float, float)
        Values at the left and right, and at the lower and upper side.
    """

    def __init__(self, canvas: Canvas, box: Box, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.canvas, self.box, self.x, self.y = canvas, box, x, y

    def to_canvas(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixels (n, 2) of values (n, 2)."""
        values = np.asarray(points, float).reshape(-1, 2)
        left, top, right, bottom = self.box
        across = left + (values[:, 0] - self.x[0]) / (self.x[1] - self.x[0]) * (right - left)
        down = bottom + (values[:, 1] - self.y[0]) / (self.y[1] - self.y[0]) * (top - bottom)
        return np.stack([across, down], axis=1)

    def curve(self, x: ArrayLike, y: ArrayLike, color: str, width: float = 2.0, dashes: Dashes = SOLID) -> None:
        """Draw a curve, with a gap where a value is NaN."""
        places = self.to_canvas(np.stack([np.asarray(x, float), np.asarray(y, float)], axis=1))
        valid = np.isfinite(places).all(axis=1)
        for part in np.split(places, np.flatnonzero(~valid)):
            self.canvas.line(part[np.isfinite(part).all(axis=1)], color, width, dashes)

    def title(self, text: str, color: str = INK) -> None:
        """Write above the frame, shortened if it is wider than that and half as much again."""
        left, top, right, _ = self.box
        self.canvas.text(
            ((left + right) / 2, top - 7),
            "\n".join(fitting(line, TITLE_SIZE, 1.3 * (right - left)) for line in text.split("\n")),
            TITLE_SIZE, color, "md",
        )  # fmt: skip

    def frame(self, xlabel: str = "", ylabel: str = "", *, grid: bool = False, color: str = INK) -> None:
        """Draw the frame, its ticks and labels; with ``grid`` lines across, which are to be drawn before curves."""
        left, top, right, bottom = self.box
        for at, text in ticks(*self.x, max(2, int((right - left) / 70))):
            x = float(self.to_canvas([(at, self.y[0])])[0, 0])
            if grid:
                self.canvas.line([(x, top), (x, bottom)], GRID, 1)
            self.canvas.line([(x, bottom), (x, bottom + 4)], PALE, 1)
            self.canvas.text((x, bottom + 7), text, TICK_SIZE, INK, "ma")
        for at, text in ticks(*self.y, max(2, int((bottom - top) / 45))):
            y = float(self.to_canvas([(self.x[0], at)])[0, 1])
            if grid:
                self.canvas.line([(left, y), (right, y)], GRID, 1)
            self.canvas.line([(left - 4, y), (left, y)], PALE, 1)
            self.canvas.text((left - 7, y), text, TICK_SIZE, INK, "rm")
        self.canvas.rectangle(self.box, outline=PALE)
        self.canvas.text(((left + right) / 2, bottom + 24), xlabel, LABEL_SIZE, INK, "ma")
        if bottom - top > MIN_FOR_LABEL:
            self.canvas.text((left - 60, (top + bottom) / 2), ylabel, LABEL_SIZE, color, "mm", upward=True)

    def right_scale(self, label: str, color: str) -> None:
        """Draw the ticks and label of ``y`` at the right side instead."""
        _, top, right, bottom = self.box
        for at, text in ticks(*self.y, max(2, int((bottom - top) / 45))):
            y = float(self.to_canvas([(self.x[0], at)])[0, 1])
            self.canvas.line([(right, y), (right + 4, y)], PALE, 1)
            self.canvas.text((right + 7, y), text, TICK_SIZE, INK, "lm")
        self.canvas.text((right + 56, (top + bottom) / 2), label, LABEL_SIZE, color, "mm", upward=True)


def round_step(wanted: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a length.

    Examples
    --------
    >>> round_step(37.0), round_step(0.9)
    (20.0, 0.5)
    """
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in (1, 2, 5) if step * decade <= wanted * (1 + 1e-9))


def ticks(first: float, last: float, count: int) -> list[tuple[float, str]]:
    """Round values between two, at most about ``count``, with their texts.

    Examples
    --------
    >>> [text for _, text in ticks(0.0, 1.0, 4)]
    ['0.0', '0.5', '1.0']
    """
    low, high = min(first, last), max(first, last)
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        return [(low, f"{low:.4g}")]
    decade = 10.0 ** math.floor(math.log10((high - low) / max(count, 1)))
    step = next(times * decade for times in (1, 2, 5, 10, 20) if (high - low) / (times * decade) <= count)
    values = [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
    large = max(map(abs, values), default=0.0)
    if large >= 1e5 or (0 < large < 1e-3):
        return [(value, _power(value, step)) for value in values]
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return [(value, f"{value:.{digits}f}") for value in values]


def _power(value: float, step: float) -> str:
    """A value as 1.5e6, with as many digits as the step needs."""
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)) + 1e-12)
    digits = max(0, power - math.floor(math.log10(step) + 1e-9))
    return f"{value / 10**power:.{digits}f}e{power}"


def range_of(values: Any, margin: float = 0.05) -> tuple[float, float]:
    """Lowest and highest finite value, with a margin; 0 to 1 where there is none, or no difference."""
    numbers = np.asarray(values, float)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return 0.0, 1.0
    low, high = float(numbers.min()), float(numbers.max())
    room = margin * (high - low) or 0.5 * abs(high) or 0.5
    return low - room, high + room
