"""Overlays of a picture: lines of text, a scale bar in mm, the marker that tells directions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingAnnotation import vtkAnnotatedCubeActor
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D

from accelsurf.grid.orientation import LETTERS
from accelsurf.settings.wording import in_unit

#: Height of text, parts of the window's height, and the smallest that can be read, pixels of a usual screen.
TEXT = 1 / 50
MIN_TEXT = 12
#: Thickness of a scale bar, and of the letters' edges on the cube of directions, pixels of a usual screen.
BAR = 4.0
EDGE = 1.0
#: Pixels of an inch, so that the size of text in points is that in pixels: VTK would scale it a second time.
DPI = 72


class Pixels(NamedTuple):
    """Size of text and lines.

    Attributes
    ----------
    height : int
        Of the window, in pixels of the device; of a narrow one the height of a 16:9 window of its width.
    ratio : float
        Pixels of the device for one of a usual screen, by which widths of lines are given; 2 on many fine screens.

    Examples
    --------
    >>> Pixels(1440, 2.0).text, Pixels(480, 1.0).text
    (29, 12)
    """

    height: int
    ratio: float = 1.0

    @property
    def text(self) -> int:
        """Height of text, in pixels of the device."""
        return round(max(MIN_TEXT * self.ratio, self.height * TEXT))


class Label:
    """Text at a place in a renderer, (0, 0) its lower left corner and (1, 1) its upper right.

    Parameters
    ----------
    renderer : pyvista.Renderer
    color : str
    place : (float, float)
        Of the text's left end in the left part of the renderer, of its centre in the middle, of its right end in the
        right part.
    text : str, optional
    boxed : bool, optional
        Bold on a dark ground, to be read on any image; the place is that of its middle.
    top : bool, optional
        The place is that of the text's upper edge.
    backed : bool, optional
        On a dark ground.
    """

    def __init__(
        self,
        renderer: pv.Renderer,
        color: str,
        place: tuple[float, float],
        text: str = "",
        boxed: bool = False,
        top: bool = False,
        backed: bool = False,
    ) -> None:
        side = (place[0] >= 0.4) + (place[0] > 0.6)
        style = pv.TextProperty(
            color=color,
            font_family="arial",
            bold=boxed,
            justification_horizontal="center" if boxed else ("left", "center", "right")[side],
            justification_vertical="center" if boxed else "top" if top else "bottom",
            background_color="black",
            background_opacity=0.65 if boxed or backed else 0.0,
        )
        self._actor = pv.Text()
        self._actor.prop = style
        self._actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
        self.move(*place)
        renderer.AddViewProp(self._actor)
        self.text = text

    @property
    def text(self) -> str:
        """Text that is written; several lines are allowed."""
        return str(self._actor.input or "")

    @text.setter
    def text(self, text: str) -> None:
        self._actor.input = text
        self._actor.SetVisibility(bool(text))

    def fit(self, pixels: Pixels) -> None:
        """Make the text readable."""
        self._actor.prop.font_size = pixels.text

    def move(self, right: float, up: float) -> None:
        """Change the place."""
        self._actor.GetPositionCoordinate().SetValue(right, up)

    def paint(self, color: str) -> None:
        """Change the colour."""
        self._actor.prop.color = color


class FlatLine:
    """A horizontal line at a place in a renderer, (0, 0) its lower left corner and (1, 1) its upper right.

    Parameters
    ----------
    renderer : pyvista.Renderer
    color : str
    """

    def __init__(self, renderer: pv.Renderer, color: str) -> None:
        self._mesh = pv.PolyData(np.zeros((2, 3), np.float32), lines=[2, 0, 1])
        coordinate = vtkCoordinate()
        coordinate.SetCoordinateSystemToNormalizedViewport()
        mapper = vtkPolyDataMapper2D(input_data=self._mesh, transform_coordinate=coordinate)
        self._actor = vtkActor2D(mapper=mapper)
        renderer.AddViewProp(self._actor)
        self.paint(color)

    def move(self, left: float, right: float, up: float, thickness: float) -> None:
        """Change the place, and how many pixels of the device it is thick."""
        self._mesh.points = np.array([[left, up, 0.0], [right, up, 0.0]], np.float32)
        self._actor.GetProperty().SetLineWidth(thickness)

    def show(self, on: bool) -> None:
        """Draw it, or not."""
        self._actor.SetVisibility(on)

    def paint(self, color: str) -> None:
        """Change the colour."""
        self._actor.GetProperty().SetColor(pv.Color(color).float_rgb)


class ScaleBar:
    """A bar of a round length at the lower right of a renderer with parallel projection.

    Parameters
    ----------
    renderer : pyvista.Renderer
    color : str
    unit : str, optional
        Of lengths: mm, um or nm; the renderer's is mm.
    backed : bool, optional
        On a dark ground, to be read on any image.
    """

    def __init__(
        self, renderer: pv.Renderer, color: str, unit: str = "mm", backed: bool = False
    ) -> None:
        self._renderer, self._unit = renderer, unit
        self._label = Label(renderer, color, (0.97, 0.045), backed=backed)
        self._ground = FlatLine(renderer, "black") if backed else None
        self._bar = FlatLine(renderer, color)

    def fit(self, pixels: Pixels, up: float = 0.0) -> None:
        """Make the bar as long as the camera's scale asks for, so far above its place at the lower edge."""
        self._label.fit(pixels)
        width, height = self._renderer.GetSize()
        if not width or not height:
            return
        wide = in_unit(2.0 * self._renderer.camera.parallel_scale * width / height, self._unit)
        length = round_length(0.25 * wide)
        low, rim = up + 0.03, pixels.ratio / width
        if self._ground is not None:
            self._ground.move(
                0.97 - length / wide - rim, 0.97 + rim, low, (BAR + 2.0) * pixels.ratio
            )
        self._bar.move(0.97 - length / wide, 0.97, low, BAR * pixels.ratio)
        self._label.move(0.97, low + 0.015)
        self._label.text = f"{length:g} {self._unit}"

    def paint(self, color: str) -> None:
        """Change the colour."""
        self._bar.paint(color)
        self._label.paint(color)


def round_length(largest: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... (and tenths, ...) that is at most ``largest``.

    Examples
    --------
    >>> round_length(73.0), round_length(0.21)
    (50.0, 0.2)
    """
    decade = 10.0 ** math.floor(math.log10(largest))
    return float(
        f"{max(step * decade for step in (1, 2, 5) if step * decade <= largest * (1 + 1e-9)):g}"
    )


def round_up(least: float) -> float:
    """Return the smallest of 1, 2, 5, 10, ... (and tenths, ...) that is at least ``least``; 1 for 0.

    Examples
    --------
    >>> round_up(3.1), round_up(0.2), round_up(0.0)
    (5.0, 0.2, 1.0)
    """
    below = round_length(least) if least > 0 else 1.0
    return below if below >= least * (1 - 1e-9) else round_length(2.5 * below)


def orientation_cube(anatomical: bool) -> vtkAnnotatedCubeActor:
    """Return a cube whose faces name the world's directions: L R A P S I of a patient, else +x -x +y ...."""
    names = LETTERS if anatomical else (("-x", "+x"), ("-y", "+y"), ("-z", "+z"))
    cube = vtkAnnotatedCubeActor()
    for axis, (low, high) in zip("XYZ", names, strict=True):
        getattr(cube, f"Set{axis}MinusFaceText")(low)
        getattr(cube, f"Set{axis}PlusFaceText")(high)
    cube.SetFaceTextScale(0.6 if anatomical else 0.45)
    # The letters stand upright seen from any side, and from above seen from the front.
    cube.SetZFaceTextRotation(-90)
    cube.GetCubeProperty().SetColor(0.30, 0.33, 0.38)
    cube.GetTextEdgesProperty().SetColor(1.0, 1.0, 1.0)
    for axis in "XYZ":
        for side in ("Minus", "Plus"):
            face = getattr(cube, f"Get{axis}{side}FaceProperty")()
            face.SetColor(1.0, 1.0, 1.0)
            face.SetInterpolationToFlat()
            face.LightingOff()
    return cube
