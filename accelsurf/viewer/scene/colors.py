"""Colours of the scene, dark and light, and of quantities on the surface; told apart with any colour vision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.report import canvas
from accelsurf.report.canvas import GREEN, PURPLE, VERMILION, YELLOW


class Theme(NamedTuple):
    """Colours of everything but the data: behind the surface, behind charts, text and curves, lines of charts and
    boxes.
    """

    background: str
    paper: str
    ink: str
    lines: str


THEMES = {
    "dark": Theme("#14171C", "#1D2128", "#F2F2F2", "#5A6270"),
    "light": Theme("#FFFFFF", "#FFFFFF", "#1A1A1A", "#9AA0A8"),
}
#: Surfaces and contours of the objects, in order of their ids; the first, also the accent of controls; the reference:
#: as in the pictures of reports.
OBJECT_COLORS, SURFACE, REFERENCE = canvas.OBJECT_COLORS, canvas.SURFACE, canvas.REFERENCE
#: What is written on the accent; the accent of thin lines and of text, which on light must be darker to be read.
ON_SURFACE, EDGE = "#101010", {"dark": SURFACE, "light": "#8F5F00"}
#: Of error messages, which also begin with a word that says so.
ALARM = {"dark": "#FF9A7A", "light": "#B03A00"}
#: The cursor's lines; a ball that is being placed.
CURSOR, MARK = YELLOW, PURPLE
#: Measurements, and the rim around their lines.
MEASURE, RIM = YELLOW, "#101010"
#: Clicks.
INSIDE, OUTSIDE = GREEN, VERMILION


class Shade(NamedTuple):
    """How a quantity is shown: title of its scale, colour map of matplotlib, whether 0 is the middle of the map."""

    title: str
    cmap: str
    signed: bool


#: Purple to orange, and cividis, can be read without telling red from green.
SHADES = {
    "speed": Shade("outward speed, mm per unit time (above 0: grows)", "PuOr", True),
    "force": Shade("outward force (above 0: grows)", "PuOr", True),
    "density": Shade("density, mass per mm2", "cividis", False),
}


def theme_named(name: str) -> Theme:
    """Return a theme by its name.

    Raises
    ------
    UsageError
        When there is no such theme.
    """
    if name not in THEMES:
        raise UsageError(f"theme: {name} was given, expected {' or '.join(THEMES)}")
    return THEMES[name]


def color_range(values: NDArray[np.float32], signed: bool) -> tuple[float, float]:
    """Return the values at both ends of the scale: round numbers, so that it seldom changes from step to step.

    Examples
    --------
    >>> color_range(np.array([-0.4, 0.1, 3.1], np.float32), True)
    (-5.0, 5.0)
    >>> color_range(np.array([0.9, 1.0, 1.2], np.float32), False)
    (0.0, 2.0)
    """
    finite = values[np.isfinite(values)]
    largest = float(np.percentile(np.abs(finite), 98)) if finite.size else 0.0
    if not largest > 0:
        return (-1.0, 1.0) if signed else (0.0, 1.0)
    decade = 10.0 ** np.floor(np.log10(largest))
    high = float(min(step * decade for step in (1.0, 2.0, 5.0, 10.0) if step * decade >= largest * (1 - 1e-9)))
    return (-high, high) if signed else (0.0, high)
