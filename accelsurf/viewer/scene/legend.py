"""The legend: what each colour is, at the upper right of a tile; and a scale of colours."""

from __future__ import annotations

from collections.abc import Sequence

import pyvista as pv
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

from accelsurf.viewer.scene.colors import Theme
from accelsurf.viewer.scene.overlay import FlatLine, Label, Pixels

#: Place of the right end in the tile, from 0 to 1, and height of the first line; from one line to the next, heights of
#: text; of its height so much is coloured, with a rim of so many pixels of a usual screen.
RIGHT, TOP, LINE, SWATCH, RIM = 0.985, 0.985, 1.4, 0.7, 1.0


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
        """Write lines, text and what colour it names, in place of those before."""
        while len(self._labels) < len(lines):
            self._labels.append(Label(self._renderer, self._ink, (RIGHT, TOP), top=True))
            self._swatches.append((FlatLine(self._renderer, self._ink), FlatLine(self._renderer, self._ink)))
        self._has_color = [color is not None for _, color in lines]
        for number, (label, (rim, swatch)) in enumerate(zip(self._labels, self._swatches, strict=True)):
            text, color = lines[number] if number < len(lines) else ("", None)
            label.text = text
            rim.show(color is not None)
            swatch.show(color is not None)
            swatch.paint(color or self._ink)

    @property
    def lines(self) -> tuple[str, ...]:
        """What is written."""
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
    scale = vtkScalarBarActor()
    scale.SetOrientationToHorizontal()
    scale.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    scale.SetPosition(0.2, 0.1)
    scale.SetWidth(0.6)
    scale.SetHeight(0.025)
    scale.SetBarRatio(1.0)
    scale.SetNumberOfLabels(0)
    scale.DrawTickLabelsOff()
    scale.SetMaximumNumberOfColors(256)
    scale.VisibilityOff()
    renderer.AddViewProp(scale)
    return scale
