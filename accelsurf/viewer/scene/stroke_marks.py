"""Marks: strokes as they are painted, voxels in the slices at once and beads in 3D; uncertain locations; answers.

In 3D the beads are drawn over the picture, so that the surface, which takes longer, is not drawn anew for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer

from accelsurf.clicks import segment_voxels
from accelsurf.grid.clicks import SIDES, Click, Side
from accelsurf.grid.geometry import Geometry
from accelsurf.image.slice_stack import SliceStack
from accelsurf.viewer.core.frame import SurfaceFrame
from accelsurf.viewer.scene.colors import INSIDE, OUTSIDE
from accelsurf.viewer.scene.redraw import Redraw
from accelsurf.viewer.scene.shapes import Texture
from accelsurf.viewer.scene.slices import SliceTile
from accelsurf.viewer.scene.space import SpaceTile

#: How much of the picture below shows through, of 255; the depth of the layer in a tile, below the contours.
OPACITY = 160
DEPTH = 1.5
COLORS = {"inside": INSIDE, "outside": OUTSIDE}
#: Colours (red, green, blue, opacity) of voxels outside all strokes, of strokes inside and outside.
_TABLE = np.array(
    [[0, 0, 0, 0], *((*pv.Color(COLORS[side]).int_rgb, OPACITY) for side in SIDES)], np.uint8
)
#: The same with a number for each colour: a slice of 512 x 512 is looked up in a tenth of the time.
_PACKED = _TABLE.view(np.uint32).ravel()


class Marks:
    """Strokes that are being painted, or that the surface has not obeyed yet; and places to look at.

    Parameters
    ----------
    geometry : Geometry
        Of the image.
    tiles : iterable of SliceTile
    space : SpaceTile or None
    redraw : Redraw

    Attributes
    ----------
    places : tuple of (float, float, float)
        Uncertain locations (x, y, z), world mm.
    answers : tuple of SurfaceFrame
        Other answers to the first click.
    """

    def __init__(
        self,
        geometry: Geometry,
        tiles: Iterable[SliceTile],
        space: SpaceTile | None,
        redraw: Redraw,
    ) -> None:
        self._geometry, self._space = geometry, space
        self.layers = [_Layer(tile) for tile in tiles]
        self._beads = None if space is None else _Beads(space, redraw)
        self._strokes: dict[int, list[Click]] = {}
        self._last = 0
        self.places: tuple[tuple[float, float, float], ...] = ()
        self.answers: tuple[SurfaceFrame, ...] = ()

    def new_stroke(self) -> int:
        """Begin a stroke; returns its number."""
        self._last += 1
        self._strokes[self._last] = []
        return self._last

    def add(
        self, stroke: int, side: Side, places: Sequence[NDArray[np.float64]], radius: float
    ) -> None:
        """Draw a piece of a stroke: the voxels near one or two places (x, y, z), world mm."""
        index = np.array([self._geometry.world_to_index(place) for place in places])
        found = segment_voxels(index, [radius] * len(places), self._geometry)
        if found is None or stroke not in self._strokes:
            return
        piece = Click(side, *found)
        self._strokes[stroke].append(piece)
        for layer in self.layers:
            layer.add(piece)
        if self._beads is not None:
            self._beads.add(side, places[-1], radius)

    def end(self, stroke: int) -> None:
        """Draw a stroke no longer."""
        if self._strokes.pop(stroke, []):
            self.show_slices()
            if self._beads is not None and not any(self._strokes.values()):
                self._beads.clear()

    @property
    def count(self) -> int:
        """Number of strokes that are drawn."""
        return sum(bool(pieces) for pieces in self._strokes.values())

    def show_places(self, places: Sequence[tuple[float, float, float]]) -> None:
        """Draw uncertain locations in place of those drawn before."""
        self.places = tuple(places)
        if self._space is not None:
            self._space.mark_places(np.array(self.places).reshape(-1, 3))
        self.show_slices()

    def show_answers(self, answers: Sequence[SurfaceFrame]) -> None:
        """Draw outlines of other answers to the first click in place of those drawn before."""
        self.answers = tuple(answers)
        for layer in self.layers:
            layer.tile.mark_answers(self.answers)

    def show_slices(self) -> None:
        """Draw strokes, places and answers in the slices that are shown now."""
        pieces = [piece for stroke in self._strokes.values() for piece in stroke]
        index = np.array([self._geometry.world_to_index(place) for place in self.places]).reshape(
            -1, 3
        )
        for layer in self.layers:
            layer.show(pieces)
            layer.tile.mark_places(index)
            layer.tile.mark_answers(self.answers)


def voxels_of(
    piece: Click, stack: SliceStack, number: int
) -> tuple[slice, slice, NDArray[np.bool_]] | None:
    """Return rows and columns of a part of a slice, with `SliceStack.fine` pixels along its pitch, and which pixels
    there lie in a voxel of a click; None where the slice does not cut its box.
    """
    low, high = ([getattr(side, end) for side in piece.box] for end in ("start", "stop"))
    if not stack.cuts(number, low, np.array(high) - 1):
        return None
    patch = stack.patch(number, low, np.array(high) - 1, stack.fine)
    inside = np.ones(
        (patch.rows.stop - patch.rows.start, patch.columns.stop - patch.columns.start), np.bool_
    )
    at = []
    for place, first, n in zip(patch.places, low, piece.mask.shape, strict=True):
        offset = np.rint(place).astype(np.intp) - first
        inside &= (offset >= 0) & (offset < n)
        at.append(np.clip(offset, 0, n - 1))
    return patch.rows, patch.columns, inside & piece.mask[at[0], at[1], at[2]]


class _Layer:
    """Named voxels over a slice."""

    def __init__(self, tile: SliceTile) -> None:
        self.tile, self._texture = tile, Texture(is_smooth=False)
        #: Which side the voxel at each pixel of the slice is on, its first row lowest.
        self.sides, self._is_empty = np.zeros((0, 0), np.uint8), True
        self._actor = tile.add_picture(self._texture, DEPTH)
        self._actor.SetVisibility(False)

    def show(self, pieces: Sequence[Click]) -> None:
        """Draw pieces alone."""
        was_empty, size = self._is_empty, self.tile.stack.size(self.tile.stack.fine)
        if self.sides.shape != size:
            self.sides = np.zeros(size, np.uint8)
        self.sides[:], self._is_empty = 0, True
        for piece in pieces:
            self._put(piece)
        if not (self._is_empty and was_empty):
            self._draw()

    def add(self, piece: Click) -> None:
        """Draw a further piece, if this slice cuts it."""
        if self._put(piece):
            self._draw()

    def _put(self, piece: Click) -> bool:
        named = voxels_of(piece, self.tile.stack, self.tile.index)
        if named is None:
            return False
        rows, columns, mask = named
        self.sides[rows, columns][mask] = 1 + SIDES.index(piece.side)
        self._is_empty = False
        return True

    def _draw(self) -> None:
        self.tile.mark()
        self._actor.SetVisibility(not self._is_empty)
        if not self._is_empty:
            self._texture.show(
                _PACKED.take(self.sides).view(np.uint8).reshape(*self.sides.shape, 4)
            )


class _Beads:
    """Balls along strokes in 3D, in a renderer of their own that is drawn over the surface."""

    def __init__(self, space: SpaceTile, redraw: Redraw) -> None:
        self._redraw, self._space = redraw, space
        self.renderer = vtkRenderer(
            active_camera=space.renderer.camera, erase=False, interactive=False
        )
        redraw.overlay(space.renderer, self.renderer)
        self._ball = pv.Sphere(radius=1.0, theta_resolution=10, phi_resolution=8)
        self._actors: list[vtkActor] = []

    def add(self, side: Side, place: NDArray[np.float64], radius: float) -> None:
        """Draw a further ball."""
        size = max(radius, self._space.smallest)
        mapper = vtkPolyDataMapper(input_data=self._ball)
        actor = vtkActor(mapper=mapper, position=place.tolist(), scale=(size, size, size))
        actor.GetProperty().SetColor(*pv.Color(COLORS[side]).float_rgb)
        self.renderer.AddActor(actor)
        self._actors.append(actor)
        self._redraw.mark(self.renderer)

    def clear(self) -> None:
        """Draw none."""
        for actor in self._actors:
            self.renderer.RemoveActor(actor)
        self._actors = []
        self._space.mark()
