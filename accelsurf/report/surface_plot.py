"""The surface in 3D, with a scale bar and the directions of the world's axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.report.canvas import INK, SKY
from accelsurf.report.rasterizer import render

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from accelsurf.report.preview_content import PreviewContent


def draw_surface(axes: Axes, content: PreviewContent, box: NDArray[Any] | None = None, color: str = SKY) -> None:
    """Draw the surface; ``box``, points (k, 3) in mm that the picture has to show, gives several runs one scale."""
    axes.set_axis_off()
    if content.surface is None or not len(content.surface.faces):
        axes.text(0.5, 0.5, "no surface", ha="center", va="center", transform=axes.transAxes, color=INK)
        return
    size = 360  # as many as the picture has there
    red, green, blue = (0.2 + 0.8 * int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    picture = render(content.surface.vertices, content.surface.faces, size=size, color=(red, green, blue), box=box)
    axes.imshow(picture.pixels, extent=(0, size, 0, size))
    axes.set_title("Surface", fontsize=10, color=INK)
    _draw_scale_bar(axes, size, picture.mm_per_pixel)
    letters = "LPS" if content.anatomical else "xyz"
    for (right, up), letter in zip(picture.axes, letters, strict=True):
        arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.1, "shrinkA": 0}
        axes.annotate("", xy=(32 + 34 * right, -42 + 34 * up), xytext=(32, -42), arrowprops=arrow)
        axes.text(32 + 47 * right, -42 + 47 * up, letter, ha="center", va="center", fontsize=8.5, color=INK)
    axes.set(xlim=(0, size), ylim=(-66, size))


def _draw_scale_bar(axes: Axes, size: int, mm_per_pixel: float) -> None:
    """Draw a bar of a round length, about a fifth of the picture."""
    wanted = 0.22 * size * mm_per_pixel
    decade = 10.0 ** np.floor(np.log10(wanted))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= wanted)
    right, pixels = size - 12, length / mm_per_pixel
    axes.plot([right - pixels, right], [-48, -48], color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(right - pixels / 2, -42, f"{length:g} mm", ha="center", va="bottom", fontsize=8.5, color=INK)
