"""Draws anew only the tiles that have changed: without a graphics card each costs milliseconds that a drag has not."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow

from accelsurf.viewer.scene.colors import ObjectStyles, Theme

#: A picture with the tile in 3D that takes more seconds is slow.
SLOW = 0.025


class Redraw:
    """Choice of the tiles of a window that are drawn anew; VTK keeps the pictures of the others.

    Parameters
    ----------
    window : vtkRenderWindow
    renderers : iterable of pyvista.Renderer
        All of its tiles.

    Attributes
    ----------
    is_painted : bool
        Whether the window system asks for each picture once more, to paint it, as Qt does: the picture is in
        VTK's memory then, and is not drawn again, unless a camera was moved or the size changed in between.
    """

    def __init__(self, window: vtkRenderWindow, renderers: Iterable[pv.Renderer]) -> None:
        self.window, self._renderers = window, tuple(renderers)
        self._shown: set[vtkRenderer] = set(self._renderers)
        self._waiting: set[vtkRenderer] = set(self._renderers)
        #: Renderer over a tile, drawn after it -> the tile.
        self._overlays: dict[vtkRenderer, pv.Renderer] = {}
        self._seconds = 0.0
        self._hurries = False
        self.is_painted = False
        self._is_empty = True
        #: Where each tile was seen from when it was drawn last; and the size of our last picture, until it is painted.
        self._sights: dict[vtkRenderer, tuple[Any, ...]] = {}
        self._unpainted: tuple[int, int] | None = None
        self._is_ours = False
        window.AddObserver("StartEvent", lambda *_: self._before_picture())  # type: ignore[arg-type]

    def overlay(self, tile: pv.Renderer, over: vtkRenderer) -> None:
        """Draw a renderer over a tile: with it, and alone when it alone has changed."""
        self._overlays[over] = tile
        self.window.AddRenderer(over)

    def mark(self, *renderers: vtkRenderer) -> None:
        """Draw these anew, tiles or renderers over them."""
        self._waiting.update(renderers)

    def mark_all(self) -> None:
        """Draw all anew."""
        self._waiting.update(self._renderers)

    def begin_anew(self) -> None:
        """Begin the next picture empty: nothing may wait."""
        self._is_empty = True
        self.mark_all()

    def show_only(self, renderers: Iterable[pv.Renderer]) -> None:
        """Draw no others from now on."""
        self._shown = set(renderers)
        self.begin_anew()

    def hurry(self, on: bool) -> None:
        """Have tiles with something over them (the one in 3D) wait if their last picture was slow, or no longer."""
        self._hurries = on

    @property
    def is_due(self) -> bool:
        """Test if `draw` has something to draw."""
        return bool(self._due())

    def draw(self) -> None:
        """Draw the renderers that have changed."""
        due = self._due()
        if not due:
            return
        self._choose(due)
        self._is_ours, began = True, time.perf_counter()
        # Python could collect the window of a closed scene meanwhile: freed within a picture it leaves VTK without this
        # one's graphics context, and the process ends.
        collects = gc.isenabled()
        gc.disable()
        try:
            self.window.Render()
        finally:
            self._is_ours = False
            if collects:
                gc.enable()
        if due & set(self._overlays.values()):
            self._seconds = time.perf_counter() - began
        self._is_empty = False
        self._waiting -= due
        self._note(due)
        self._choose(self._whole())
        self._unpainted = self.window.GetSize() if self.is_painted else None

    def _due(self) -> set[vtkRenderer]:
        """Return the renderers that have changed, are shown and need not wait, with the renderers over them."""
        due = self._waiting & self._shown
        over = {
            over
            for over, tile in self._overlays.items()
            if tile in self._shown and (tile in due or over in self._waiting)
        }
        waits = self._hurries and self._seconds > SLOW and not self._is_empty
        return (due | over) - set(self._overlays.values() if waits else ())

    def _whole(self) -> set[vtkRenderer]:
        return self._shown | {over for over, tile in self._overlays.items() if tile in self._shown}

    def _before_picture(self) -> None:
        """Before a picture that the window system has asked for: all of it is needed, unless it paints our last one."""
        if self._is_ours:
            return
        size, self._unpainted = self._unpainted, None
        if size is None or size != self.window.GetSize() or self._is_empty:
            self._note(self._whole())
            self._choose(self._whole())
            return
        # A hand that turns the object moves a camera without a word to us.
        moved = {tile for tile in self._shown if self._sights.get(tile) != _sight(tile)}
        self._note(moved)
        self._choose(moved | {over for over, tile in self._overlays.items() if tile in moved})

    def _note(self, renderers: Iterable[vtkRenderer]) -> None:
        """Note the cameras with which renderers are drawn."""
        self._sights.update((renderer, _sight(renderer)) for renderer in renderers)

    def _choose(self, renderers: set[vtkRenderer]) -> None:
        for renderer in self._renderers:
            renderer.SetDraw(renderer in renderers)
        for over, tile in self._overlays.items():
            over.SetViewport(tile.GetViewport())
            over.SetDraw(over in renderers)


def _sight(renderer: vtkRenderer) -> tuple[Any, ...]:
    """Return place and direction of a renderer's camera."""
    camera = renderer.GetActiveCamera()
    return (
        camera.GetPosition(),
        camera.GetFocalPoint(),
        camera.GetViewUp(),
        camera.GetParallelScale(),
    )


class TileContext(NamedTuple):
    """All that the tiles of a scene have in common.

    Attributes
    ----------
    redraw : Redraw
        Is told of changes.
    styles : ObjectStyles
    theme : Theme
        At first.
    anatomical : bool
        Whether directions may be named by letters.
    unit : str
        Of lengths in the file, in which they are written.
    """

    redraw: Redraw
    styles: ObjectStyles
    theme: Theme
    anatomical: bool
    unit: str
