"""Text over the picture: step, level and volume; the legend at the upper right of a tile; a scale of colours."""

from __future__ import annotations

from collections.abc import Sequence

import pyvista as pv
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

from accelsurf.grid.geometry import Geometry
from accelsurf.settings.wording import in_unit
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.scene.colors import REFERENCE, ObjectStyle, Theme, unnamed
from accelsurf.viewer.scene.overlay import FlatLine, Label, Pixels

#: Place of the right end in the tile, from 0 to 1, and height of the first line; from one line to the next, heights of
#: text; coloured part of its height, and the width of the rim, pixels of a usual screen.
RIGHT = 0.985
TOP = 0.985
LINE = 1.4
SWATCH = 0.7
RIM = 1.0


class Legend:
    """Lines of text, each beside the colour that it names: text in that colour could not always be read.

    Parameters
    ----------
    renderer : pyvista.Renderer
        Of the tile.
    ink : str
        Colour of the text.
    """

    def __init__(self, renderer: pv.Renderer, ink: str) -> None:
        self._renderer, self._ink = renderer, ink
        self._labels: list[Label] = []
        #: Rim and colour beside each line, and whether there is one.
        self._swatches: list[tuple[FlatLine, FlatLine]] = []
        self._has_color: list[bool] = []

    def show(self, lines: Sequence[tuple[str, str | None]]) -> None:
        """Write lines, text and the colour that it names, in place of those before."""
        while len(self._labels) < len(lines):
            self._labels.append(Label(self._renderer, self._ink, (RIGHT, TOP), top=True))
            self._swatches.append(
                (FlatLine(self._renderer, self._ink), FlatLine(self._renderer, self._ink))
            )
        self._has_color = [color is not None for _, color in lines]
        for number, (label, (rim, swatch)) in enumerate(
            zip(self._labels, self._swatches, strict=True)
        ):
            text, color = lines[number] if number < len(lines) else ("", None)
            label.text = text
            rim.show(color is not None)
            swatch.show(color is not None)
            swatch.paint(color or self._ink)

    @property
    def lines(self) -> tuple[str, ...]:
        """Lines that are written."""
        return tuple(label.text for label in self._labels if label.text)

    def fit(self, pixels: Pixels) -> None:
        """Make the text readable, and put the lines below each other."""
        width, height = (max(side, 1) for side in self._renderer.GetSize())
        text = pixels.text
        for number, label in enumerate(self._labels):
            up = TOP - LINE * number * text / height
            has_color = number < len(self._has_color) and self._has_color[number]
            label.fit(pixels)
            label.move(RIGHT - (1.4 * text / width if has_color else 0.0), up)
            for line, rim in zip(self._swatches[number], (RIM * pixels.ratio, 0.0), strict=True):
                left, right = RIGHT - (text + rim) / width, RIGHT + rim / width
                line.move(left, right, up - 0.5 * text / height, SWATCH * text + 2.0 * rim)

    def paint(self, theme: Theme) -> None:
        """Use another theme."""
        self._ink = theme.ink
        for label, (rim, _) in zip(self._labels, self._swatches, strict=True):
            label.paint(theme.ink)
            rim.paint(theme.ink)


def color_scale(renderer: pv.Renderer) -> vtkScalarBarActor:
    """Return a horizontal scale of the colours at the lower edge, hidden until something is coloured."""
    scale = vtkScalarBarActor(
        position=(0.2, 0.1),
        width=0.6,
        height=0.025,
        bar_ratio=1.0,
        number_of_labels=0,
        draw_tick_labels=False,
        maximum_number_of_colors=256,
        visibility=False,
    )
    scale.SetOrientationToHorizontal()
    scale.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    renderer.AddViewProp(scale)
    return scale


#: Lines of the legend at most.
MAX_LEGEND = 20
#: From this volume on ml are written, mm3.
MIN_ML = 100.0


def caption(frame: Frame, geometry: Geometry, unit: str = "mm") -> list[str]:
    """Return step and level, or frame and time, and the volume (of one slice the area), in the file's unit.

    Nothing of a run that has not begun. Once the volume is estimated it is the estimate, and its interval has a line.
    """
    if not frame.surfaces and not frame.said:
        return []
    step = frame.said or f"step {frame.step}" + (
        f", level {frame.level} (coarse grid)" if frame.level else ""
    )
    step += ", corrected" if frame.corrected_at is not None else ""
    axis = geometry.slice_axis
    if axis is None:
        found = frame.estimated
        if found is None:
            return [step, f"volume {volume_line(frame.volume_mm3, unit)}"]
        ends = [measure(in_unit(end, unit, 3)) for end in found.interval_mm3 or ()]
        around = f"95 %: {' to '.join(ends)} {unit}3" if ends else "its error cannot be told"
        return [step, f"volume {volume_line(found.best_mm3, unit)}", around]
    return [
        step,
        f"area {measure(in_unit(frame.volume_mm3 / geometry.spacing[axis], unit, 2))} {unit}2",
    ]


def volume_line(mm3: float, unit: str = "mm") -> str:
    """Return a volume in the unit of the file, with ml beside it where people use them.

    Examples
    --------
    >>> volume_line(67033.2), volume_line(12.5), volume_line(4.2e-7, "um")
    ('67 033 mm3 = 67.03 ml', '12.5 mm3', '420 um3')
    """
    ml = f" = {mm3 / 1000:.4g} ml" if unit == "mm" and mm3 >= MIN_ML else ""
    return f"{measure(in_unit(mm3, unit, 3))} {unit}3{ml}"


def legend_lines(
    frame: Frame, dice: float | None, styles: Sequence[ObjectStyle]
) -> list[tuple[str, str | None]]:
    """Return each line of the legend, and the colour that it names; none for one object without a reference.

    Parameters
    ----------
    frame : Frame
    dice : float, optional
        Of the objects and the reference; None without one.
    styles : sequence of ObjectStyle
        Of the surfaces.
    """
    several = len(frame.surfaces) > 1
    if not several and dice is None:
        return []
    lines: list[tuple[str, str | None]] = [
        # One object alone is the surface, unless somebody has named it.
        (style.name if several or style.name != unnamed(surface.id) else "surface", style.color)
        for surface, style in zip(frame.surfaces[:MAX_LEGEND], styles, strict=False)
        if style.visible
    ]
    if len(frame.surfaces) > MAX_LEGEND:
        lines.append((f"and {len(frame.surfaces) - MAX_LEGEND} more", None))
    return lines if dice is None else [*lines, (f"reference, Dice {dice:.3f}", REFERENCE)]


def measure(value: float) -> str:
    """Return a measure with four digits, or all before the point, in groups of three.

    Examples
    --------
    >>> measure(0.123456), measure(1234567.8)
    ('0.1235', '1 234 568')
    """
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}".replace(",", " ")
