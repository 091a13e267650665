"""Colours of the scene, of objects and of quantities on the surface; told apart with any colour vision."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.output import (
    GREEN,
    PURPLE,
    REFERENCE_COLOR,
    SURFACE_COLOR,
    VERMILION,
    YELLOW,
    object_color,
)
from accelsurf.settings.labels import LabelTable
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.overlay import round_up


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
SURFACE = SURFACE_COLOR
REFERENCE = REFERENCE_COLOR
#: Text on the accent; the accent of thin lines and of text, which on light must be darker to be read.
ON_SURFACE = "#101010"
EDGE = {"dark": SURFACE, "light": "#8F5F00"}
#: Of error messages, which also begin with a word that says so.
ALARM = {"dark": "#FF9A7A", "light": "#B03A00"}
#: The cursor's lines; a ball that is being placed.
CURSOR = YELLOW
MARK = PURPLE
#: Clicks.
INSIDE = GREEN
OUTSIDE = VERMILION


class Shade(NamedTuple):
    """Display of a quantity: title of its scale, colour map of matplotlib, whether 0 is the middle of the map."""

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
        When there is no theme of this name.
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
    high = round_up(largest)
    return (-high, high) if signed else (0.0, high)


class ObjectStyle(NamedTuple):
    """Style of an object.

    Attributes
    ----------
    name : str
    color : str
        ``#rrggbb``.
    visible : bool
    opacity : float
        From 0 to 1.
    """

    name: str
    color: str
    visible: bool = True
    opacity: float = 1.0


def unnamed(object_id: int) -> str:
    """Return the name of an object that nobody has named.

    Examples
    --------
    >>> unnamed(3)
    'object 3'
    """
    return f"object {object_id}"


class ObjectStyles:
    """Styles of objects by id: the name and colour that were given, or else a colour that stays with the object.

    Attributes
    ----------
    labels : LabelTable
        Names and colours that were given.
    """

    def __init__(self) -> None:
        self.labels = LabelTable()
        self._hidden: set[int] = set()
        self._opacity: dict[int, float] = {}
        self._palette: dict[int, str] = {}

    def __getitem__(self, object_id: int) -> ObjectStyle:
        """Return the style of an object.

        Examples
        --------
        >>> from accelsurf.output.label_files import given_labels
        >>> from accelsurf.settings.run_config import RunConfig
        >>> styles = ObjectStyles()
        >>> styles.give(given_labels(RunConfig(name=["liver"], color=["#c83c3c"])))
        >>> styles[1], styles[7].name
        (ObjectStyle(name='liver', color='#c83c3c', visible=True, opacity=1.0), 'object 7')
        """
        self.choose_colors((object_id,))
        said = self.labels.entries.get(object_id)
        return ObjectStyle(
            unnamed(object_id) if said is None else said.name,
            self._palette[object_id] if said is None else said.hex,
            object_id not in self._hidden,
            self._opacity.get(object_id, 1.0),
        )

    def choose_colors(self, ids: Iterable[int]) -> None:
        """Choose colours for these objects in this order; one that an object has stays, whatever becomes of others."""
        for object_id in ids:
            self._palette.setdefault(object_id, object_color(len(self._palette)))

    def of(self, frame: Frame | None) -> list[ObjectStyle]:
        """Return the style of each surface of a frame."""
        return [] if frame is None else [self[surface.id] for surface in frame.surfaces]

    def give(self, labels: LabelTable) -> None:
        """Use these names and colours from now on."""
        self.labels = labels

    def show(self, object_id: int, on: bool) -> None:
        """Draw an object, or not."""
        self._hidden = self._hidden - {object_id} if on else self._hidden | {object_id}

    def fade(self, object_id: int, opacity: float) -> None:
        """Draw an object with an opacity from 0 to 1."""
        self._opacity[object_id] = opacity
