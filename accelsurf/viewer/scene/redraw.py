"""Draws anew only the tiles that have changed: without a graphics card each costs milliseconds that a drag has not."""

from __future__ import annotations

from collections.abc import Iterable

import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkRenderWindow


class Redraw:
    """Which tiles of a window are drawn anew; VTK keeps what the others show.

    Parameters
    ----------
    window : vtkRenderWindow
    renderers : iterable of pyvista.Renderer
        All of its tiles.
    """

    def __init__(self, window: vtkRenderWindow, renderers: Iterable[pv.Renderer]) -> None:
        self._window, self._renderers = window, tuple(renderers)
        self._shown = set(self._renderers)
        self._waiting: set[pv.Renderer] = set(self._renderers)
        self._is_ours = False
        window.AddObserver("StartEvent", lambda *_: self._before_picture())  # type: ignore[arg-type]

    def mark(self, *renderers: pv.Renderer) -> None:
        """These have changed."""
        self._waiting.update(renderers)

    def mark_all(self) -> None:
        """All have changed."""
        self._waiting.update(self._renderers)

    def show_only(self, renderers: Iterable[pv.Renderer]) -> None:
        """Draw no others from now on."""
        self._shown = set(renderers)
        self.mark_all()

    def draw(self) -> None:
        """Draw what has changed."""
        if not self._waiting & self._shown:
            return
        self._choose(self._waiting & self._shown)
        self._is_ours = True
        try:
            self._window.Render()
        finally:
            self._is_ours = False
        self._waiting.clear()
        self._choose(self._shown)

    def _before_picture(self) -> None:
        """Before a picture that the window system has asked for: all of it is needed."""
        if not self._is_ours:
            self._choose(self._shown)

    def _choose(self, renderers: set[pv.Renderer]) -> None:
        for renderer in self._renderers:
            renderer.SetDraw(renderer in renderers)
