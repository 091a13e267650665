"""Show a result, or an image, in a notebook or a window, or put it into a file."""

from __future__ import annotations

import base64
import html
import os
import sys
from pathlib import Path
from typing import Any

import pyvista as pv

from accelsurf.errors import UsageError, check_known
from accelsurf.grid.volume import Volume
from accelsurf.segmentation.api import Result
from accelsurf.viewer.core.frame import Frame
from accelsurf.viewer.frontends.export import html_page, write_html
from accelsurf.viewer.scene.grey_images import png_bytes
from accelsurf.viewer.scene.headless import GraphicsError, require_graphics
from accelsurf.viewer.scene.scene import SIZE, Scene

#: PyVista's backends for notebooks.
BACKENDS = ("static", "client", "server", "trame", "html", "none")


def show(
    what: Result | Volume,
    *,
    reference: Volume | None = None,
    theme: str = "light",
    volume: bool = False,
    planes: bool = False,
    size: tuple[int, int] = SIZE,
    to: str | Path | None = None,
    backend: str | None = None,
) -> Any:
    """Show a result, or an image, as `accelsurf view` does: the surface in mm, three slices, the energies.

    Parameters
    ----------
    what : Result or Volume
        From `segment`, or an image alone.
    reference : Volume, optional
        Labels on the same grid (above 0 is the object) to compare with, with Dice.
    theme : str, optional
        "light" or "dark".
    volume, planes : bool, optional
        Draw the image itself, translucent, or the three slices in 3D as well.
    size : (int, int), optional
        Width and height, pixels.
    to : str or Path, optional
        Write to this file instead: a picture (.png), or a page whose surface can be turned in any browser, without
        the internet (.html).
    backend : str, optional
        In a notebook: one of PyVista's Jupyter backends in place of a page that needs nothing.

    Returns
    -------
    object
        In a notebook what shows itself there; otherwise None, once the window is closed or the file written.

    Raises
    ------
    UsageError
        For something else than these, an unknown theme, backend or suffix.
    InputError
        When the reference is on another grid.
    GraphicsError
        When nothing can be drawn here.
    """
    if not isinstance(what, (Result, Volume)):
        raise UsageError(f"show: a {type(what).__name__} was given, expected a Result or a Volume")
    if backend is not None:
        check_known("backend", backend, BACKENDS)
    image = what.volume if isinstance(what, Result) else what
    suffix = "" if to is None else Path(to).suffix.lower()
    if to is not None and suffix not in (".png", ".html", ".htm"):
        raise UsageError(f"{Path(to).name}: {suffix or 'no suffix'} was given, expected .png or .html")
    notebook = to is None and in_notebook()
    if to is None and not notebook and not _has_screen():
        raise GraphicsError("no screen was found for a window", "write a picture or a page: to='a.png', to='a.html'")
    plotter = None
    if to is None and (backend is not None or not notebook):
        if notebook:
            require_graphics()
        plotter = pv.Plotter(
            off_screen=notebook, notebook=notebook, window_size=list(size), **Scene.layout(image.geometry)
        )
    scene = Scene(image, theme=theme, reference=reference, plotter=plotter, size=size)
    if isinstance(what, Result):
        scene.update(Frame.of_psi(what.psi, what.geometry, what.history[-1]), what.history)
    scene.show_volume(volume)
    scene.show_planes(planes)
    if plotter is not None:
        return _shown(scene, backend)
    try:
        if to is None:
            return Shown(scene)
        if suffix == ".png":
            scene.screenshot(to)
        else:
            write_html(scene, to)
    finally:
        scene.close()
    return None


def _shown(scene: Scene, backend: str | None) -> Any:
    """Leave it to PyVista: a window, or one of its backends."""
    try:
        return scene.plotter.show(jupyter_backend=backend) if backend is not None else scene.plotter.show()
    except ImportError as error:
        raise UsageError(f"backend: {backend} needs what is not installed ({error})", 'pip install "pyvista[jupyter]"'
                         ) from None


class Shown:
    """What a notebook shows: the page whose surface can be turned; of one slice, the picture.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self.picture = png_bytes(scene.screenshot())
        self._page = "" if scene.space is None else html_page(scene)
        self._height = scene.plotter.render_window.GetSize()[1]

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """What Jupyter asks for."""
        picture = base64.b64encode(self.picture).decode()
        if not self._page:
            return {"image/png": picture}
        style = f'width="100%" height="{self._height}" frameborder="0"'
        return {"text/html": f'<iframe srcdoc="{html.escape(self._page)}" {style}></iframe>', "image/png": picture}


def _has_screen() -> bool:
    """Whether there may be a screen; VTK would end the process where there is none."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def in_notebook() -> bool:
    """Whether a Jupyter kernel runs this."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")
