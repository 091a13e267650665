"""The force of the image over the slices: where a surface would grow and where it would shrink, before it moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from accelsurf.viewer.scene.colors import SHADES, color_range
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.shapes import Texture
from accelsurf.viewer.scene.slices import SliceTile

#: Opacity of the largest force; and how far towards the ends of the colour map it goes, which are almost black.
OPACITY, ENDS = 0.6, 0.75
#: Of every so many values the scale is made.
SCALE_STEP = 5
#: Between the image and the cursor's lines, in the order of drawing.
DEPTH = 0.5


class ForceSlice(NamedTuple):
    """The outward force in the slice of a `SliceTile.sight`, (rows, columns), its first row lowest; NaN: unknown."""

    sight: tuple[bool, int]
    values: NDArray[np.float32]


class _Layer(NamedTuple):
    """Layer over a tile: an actor and its picture."""

    actor: pv.Actor
    texture: Texture


class ForceOverlay:
    """A translucent picture over each slice, shown only where the slice is the one that it was computed for.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    scale : float
        The force that has the full colour.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene, self.scale = scene, 0.0
        self._table = np.asarray(pv.LookupTable(SHADES["force"].cmap, n_values=256).values, np.uint8)
        self._layers: dict[str, _Layer] = {}
        self._slices: dict[str, ForceSlice] = {}
        scene.plotter.render_window.AddObserver("StartEvent", lambda *_: self._follow_slices())

    def show(self, forces: Mapping[str, ForceSlice]) -> None:
        """Show forces by name of the tile in place of all before, on a common scale; none hides all."""
        self._slices = {}
        values = [force.values.ravel()[::SCALE_STEP] for force in forces.values()]
        self.scale = color_range(np.concatenate(values), True)[1] if values else 0.0
        self.add(forces)
        for tile in self._scene.slice_tiles.values():
            tile.mark()

    def add(self, forces: Mapping[str, ForceSlice]) -> None:
        """Show forces in some tiles, on the scale that there is; the other tiles stay."""
        self._slices |= forces
        for name, force in forces.items():
            tile = self._scene.slice_tiles[name]
            layer = self._layers.get(name) or self._make(name, tile)
            layer.texture.show(force_colors(force.values, self.scale, self._table))
            tile.mark()

    @property
    def shown(self) -> tuple[str, ...]:
        """The tiles over whose present slice there is a force."""
        tiles = self._scene.slice_tiles
        return tuple(name for name, force in self._slices.items() if force.sight == tiles[name].sight)

    def _follow_slices(self) -> None:
        """Before each picture: hide what belongs to another slice."""
        shown = self.shown
        for name, layer in self._layers.items():
            layer.actor.SetVisibility(name in shown)

    def _make(self, name: str, tile: SliceTile) -> _Layer:
        texture = Texture(is_smooth=False)
        actor = tile.add_picture(texture, DEPTH)
        actor.ForceTranslucentOn()
        self._layers[name] = _Layer(actor, texture)
        return self._layers[name]


def force_colors(values: NDArray[np.float32], scale: float, table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture (rows, columns, 4): the side of the map by the sign, the opacity by the size; clear for NaN.

    Parameters
    ----------
    values : ndarray (rows, columns)
    scale : float
        What has the full colour.
    table : ndarray (256, 4)
        Colours from the lowest to the highest.
    """
    share = np.clip(np.nan_to_num(values / max(scale, 1e-30), nan=0.0), -1.0, 1.0)
    picture = table[np.rint(127.5 + 127.5 * ENDS * np.sign(share)).astype(np.uint8)]
    picture[..., 3] = np.rint(255.0 * OPACITY * np.sqrt(np.abs(share))).astype(np.uint8)
    return picture
