"""Marks of what a person does, and of where to look: strokes that are painted, doubtful places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.scene.redraw import Redraw
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import SpaceTile
from accelsurf.viewer.scene.stroke_marks import StrokeMarks


class Marks:
    """The marks of a scene.

    Parameters
    ----------
    geometry : Geometry
        Of the image.
    slices : mapping of str to SliceTile
    space : SpaceTile or None
    redraw : Redraw

    Attributes
    ----------
    strokes : StrokeMarks
    places : tuple of (float, float, float)
        Doubtful places (x, y, z), world mm.
    """

    def __init__(
        self, geometry: Geometry, slices: Mapping[str, SliceTile], space: SpaceTile | None, redraw: Redraw
    ) -> None:
        self._geometry, self._slices, self._space, self._redraw = geometry, slices, space, redraw
        self.strokes = StrokeMarks(geometry, slices.values(), space, redraw)
        self.places: tuple[tuple[float, float, float], ...] = ()

    def show_places(self, places: Sequence[tuple[float, float, float]]) -> None:
        """Draw doubtful places in place of those drawn before."""
        self.places = tuple(places)
        if self._space is not None:
            self._space.mark_places(np.array(self.places).reshape(-1, 3))
            self._redraw.mark(self._space.renderer)
        self._show_places()

    def show_slices(self) -> None:
        """Draw what lies in the slices that are shown now."""
        self.strokes.show_slices()
        self._show_places()

    def _show_places(self) -> None:
        index = np.array([self._geometry.world_to_index(place) for place in self.places]).reshape(-1, 3)
        for tile in self._slices.values():
            tile.mark_places(index)
            self._redraw.mark(tile.renderer)
