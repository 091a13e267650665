"""The legend: what each colour is, at the upper right of a tile; and a scale of colours."""

from __future__ import annotations

from collections.abc import Sequence

import pyvista as pv
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

from accelsurf.viewer.scene.overlay import Label, Pixels

#: Height of the first line in the tile, from 0 to 1; from one line to the next, heights of text.
TOP, LINE = 0.985, 1.4


class Legend:
    """Lines of text, each in its own colour.

    Parameters
    ----------
    renderer : pyvista.Renderer
        Of the tile.
    """

    def __init__(self, renderer: pv.Renderer) -> None:
        self._renderer = renderer
        self._labels: list[Label] = []

    def show(self, lines: Sequence[tuple[str, str]]) -> None:
        """Write lines, (text, colour) each, in place of those before."""
        while len(self._labels) < len(lines):
            self._labels.append(Label(self._renderer, "white", (0.985, TOP), top=True))
        for label in self._labels[len(lines) :]:
            label.text = ""
        for label, (text, color) in zip(self._labels, lines, strict=False):
            label.text = text
            label.paint(color)

    @property
    def lines(self) -> tuple[str, ...]:
        """What is written."""
        return tuple(label.text for label in self._labels if label.text)

    def fit(self, pixels: Pixels) -> None:
        """Make the text readable, and put the lines below each other."""
        line = LINE * pixels.text / max(self._renderer.GetSize()[1], 1)
        for place, label in enumerate(self._labels):
            label.fit(pixels)
            label.move(0.985, TOP - line * place)


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
