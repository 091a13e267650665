"""Show a result, or an image, in a notebook or a window, or write it to a file."""

from __future__ import annotations

import base64
import html
import os
import sys
from pathlib import Path
from typing import Any

import pyvista as pv

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.io import ImageLike, as_volume
from accelsurf.output import given_labels, png_bytes
from accelsurf.run import Result
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.export import html_page, write_html
from accelsurf.viewer.scene.headless import GraphicsError
from accelsurf.viewer.scene.scene import SIZE, Scene


def show(
    what: Result | ImageLike,
    *,
    reference: ImageLike | None = None,
    theme: str = "light",
    planes: bool = False,
    size: tuple[int, int] = SIZE,
    to: str | Path | None = None,
    title: str | None = None,
) -> Any:
    """Show a result, or an image, as `accelsurf view` does: the surfaces in mm, three slices, the energies.

    Parameters
    ----------
    what : Result or image
        From `segment`, or an image alone, as `segment` takes it.
    reference : label map, optional
        Labels on the same grid (above 0 is the object) to compare with, with Dice.
    theme : str, optional
        "light" or "dark".
    planes : bool, optional
        Draw the three slices in 3D as well.
    size : (int, int), optional
        Width and height, pixels.
    to : str or Path, optional
        Write to this file instead: a picture (.png), or a page whose surface can be turned in any browser, without
        the internet (.html).
    title : str, optional
        First line over the picture, and of the window; the name of the image's file unless given.

    Returns
    -------
    object
        In a notebook the output of the cell; otherwise None, once the window is closed or the file written.

    Raises
    ------
    UsageError
        For an unknown theme or suffix.
    InputError
        When it is no image, or the reference is on another grid.
    GraphicsError
        When nothing can be drawn here.
    """
    suffix = _check(to)
    image = what.volume if isinstance(what, Result) else as_volume(what)
    reference = None if reference is None else as_volume(reference)
    title = title or (image.source.name if image.source else "accelsurf")
    plotter = None if to is not None else _plotter(image.geometry, size, title)
    scene = Scene(image, theme=theme, reference=reference, plotter=plotter, size=size, title=title)
    if isinstance(what, Result):
        scene.name_objects(given_labels(what.config))
        scene.update(Frame.of_result(what), [segmented.history for segmented in what.objects])
    scene.show_planes(planes)
    if plotter is not None:
        return scene.plotter.show()
    try:
        if to is None:
            return SceneOutput(scene)
        if suffix == ".png":
            scene.screenshot(to)
        else:
            write_html(scene, to)
        return None
    finally:
        scene.close()


def _plotter(geometry: Geometry, size: tuple[int, int], title: str) -> pv.Plotter | None:
    """A plotter for a window; None in a notebook, which gets a page of our own."""
    if in_notebook():
        return None
    if not _has_screen():
        raise GraphicsError(
            "no screen was found for a window", "write a picture or a page: to='a.png', to='a.html'"
        )
    return pv.Plotter(window_size=list(size), title=title, **Scene.layout(geometry))


def _check(to: str | Path | None) -> str:
    """Return the suffix of the file to be written; refuse an unknown one."""
    suffix = "" if to is None else Path(to).suffix.lower()
    if to is not None and suffix not in (".png", ".html", ".htm"):
        raise UsageError(
            f"{Path(to).name}: {suffix or 'no suffix'} was given, expected .png or .html"
        )
    return suffix


class SceneOutput:
    """The output of a notebook cell: a page whose surface can be turned; of one slice, a picture.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self.picture = png_bytes(scene.screenshot())
        self._page = "" if scene.space is None else html_page(scene)
        self._height = scene.plotter.render_window.GetSize()[1]

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """The output in the formats that Jupyter asks for."""
        picture = base64.b64encode(self.picture).decode()
        if not self._page:
            return {"image/png": picture}
        style = f'width="100%" height="{self._height}" frameborder="0"'
        return {
            "text/html": f'<iframe srcdoc="{html.escape(self._page)}" {style}></iframe>',
            "image/png": picture,
        }


def _has_screen() -> bool:
    """Test if there may be a screen; VTK would end the process where there is none."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def in_notebook() -> bool:
    """Test if a Jupyter kernel runs this."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")
