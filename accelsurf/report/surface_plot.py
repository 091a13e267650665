"""The surface in 3D, with a scale bar and the directions of the world's axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.report.axes import LABEL_SIZE, TITLE_SIZE, round_step
from accelsurf.report.canvas import INK, Box, Canvas
from accelsurf.settings.wording import in_unit

if TYPE_CHECKING:
    from accelsurf.report.preview_content import PreviewContent
    from accelsurf.report.rasterizer import Picture

#: Below the surface, for the scale bar and the arrows, pixels.
_BELOW = 70


def draw_surface(
    canvas: Canvas, panel: Box, content: PreviewContent, box: NDArray[Any] | None = None, color: str = ""
) -> None:
    """Draw the surface, in its own colour unless one is given.

    ``box``, points (k, 3) in mm that the picture has to show, gives several runs one scale.
    """
    left, top, right, bottom = panel
    if content.surface is None or not len(content.surface.faces):
        canvas.text(((left + right) / 2, (top + bottom) / 2), "no surface", LABEL_SIZE, anchor="mm")
        return
    # Not with the module: a picture of slices alone needs no compiled code.
    from accelsurf.report.rasterizer import render

    size = int(min(right - left, bottom - top - _BELOW))
    paint: NDArray[np.float64] = _light(color or content.color())
    counts = [one.vertices for one in content.objects]
    if sum(counts) == len(content.surface.vertices):
        paint = np.repeat([_light(content.color(place)) for place in range(len(counts))], counts, axis=0)
    picture = render(content.surface.vertices, content.surface.faces, size=size, color=paint, box=box)
    first = (left + right - size) / 2
    canvas.image((255 * picture.pixels + 0.5).astype(np.uint8), (first, top, first + size, top + size))
    canvas.text(((left + right) / 2, top - 7), "Surface", TITLE_SIZE, anchor="md")
    per_pixel = in_unit(picture.mm_per_pixel, content.unit)
    _draw_scale_bar(canvas, first + size, bottom, per_pixel, size, content.unit)
    _draw_arrows(canvas, (first + 34, bottom - 22), picture, "LPS" if content.anatomical else "xyz")


def _light(color: str) -> NDArray[np.float64]:
    """Red, green, blue in 0..1 of a colour, lighter: shading darkens it."""
    return np.array([0.2 + 0.8 * int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)])


def _draw_scale_bar(canvas: Canvas, right: float, bottom: float, per_pixel: float, size: int, unit: str) -> None:
    """Draw a bar of a round length, about a fifth of the picture."""
    length = round_step(0.22 * size * per_pixel)
    pixels = length / per_pixel
    y = bottom - 14
    canvas.line([(right - 12 - pixels, y), (right - 12, y)], INK, 3)
    canvas.text((right - 12 - pixels / 2, y - 6), f"{length:g} {unit}", 11, anchor="md")


def _draw_arrows(canvas: Canvas, at: tuple[float, float], picture: Picture, letters: str) -> None:
    """Draw where the world's axes point."""
    for (right, up), letter in zip(picture.axes, letters, strict=True):
        along = np.array([right, -up])
        tip = np.asarray(at) + 34 * along
        canvas.line([at, tip - 4 * along], INK, 1.5)
        length = float(np.hypot(*along))
        if length > 0.2:  # an axis towards the viewer has no head
            head, aside = along / length, np.array([-along[1], along[0]]) / length
            canvas.polygon([tip, tip - 8 * head + 3.5 * aside, tip - 8 * head - 3.5 * aside], INK)
        canvas.text((at[0] + 46 * along[0], at[1] + 46 * along[1]), letter, 11, anchor="mm")
