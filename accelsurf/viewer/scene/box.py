"""A box in the image: its rectangle in the slices, its edges in 3D, and which of its sides lie under the mouse."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from accelsurf.viewer.scene.colors import MARK
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.shapes import add_actor, box_edges
from accelsurf.viewer.scene.slices import SliceTile

#: Over contours and the cursor's lines, in the order of drawing.
DEPTH = 4.0
#: Opacity of the rectangle in slices that the box does not reach.
BESIDE = 0.3
#: Pixels of a usual screen: from a side within which it is taken, and how wide its lines are.
REACH, LINE = 8.0, 2.2


class VoxelBox(NamedTuple):
    """The first and the last voxel (z, y, x) of a box."""

    low: tuple[int, int, int]
    high: tuple[int, int, int]

    @classmethod
    def between(cls, corner: NDArray[Any], opposite: NDArray[Any], shape: tuple[int, int, int]) -> VoxelBox:
        """Return the box between two indices, within an image, of at least two voxels along axes that have them."""
        last = np.array(shape) - 1
        low = np.clip(np.rint(np.minimum(corner, opposite)), 0, np.maximum(last - 1, 0)).astype(int)
        high = np.clip(np.rint(np.maximum(corner, opposite)), np.minimum(low + 1, last), last).astype(int)
        z, y, x = (int(v) for v in low)
        far_z, far_y, far_x = (int(v) for v in high)
        return cls((z, y, x), (far_z, far_y, far_x))

    @property
    def text(self) -> str:
        """Text of the box as ``--roi`` takes it, its first corner below the second.

        Examples
        --------
        >>> VoxelBox((1, 2, 3), (4, 5, 6)).text, VoxelBox((0, 2, 3), (0, 5, 6)).text
        ('3,2,1,6,5,4vox', '3,2,-0.5,6,5,0.5vox')
        """
        wide = [0.5 if a == b else 0 for a, b in zip(self.low, self.high, strict=True)]
        first = [a - w for a, w in zip(self.low, wide, strict=True)]
        last = [b + w for b, w in zip(self.high, wide, strict=True)]
        return ",".join(str(v) for v in (*first[::-1], *last[::-1])) + "vox"


class BoxOverlay:
    """Draws a box.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    box : VoxelBox or None
        What is drawn.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.box: VoxelBox | None = None
        self._actors: dict[str, pv.Actor] = {}
        #: Which slice each rectangle was drawn for.
        self._sights: dict[str, tuple[bool, int]] = {}
        scene.plotter.render_window.AddObserver("StartEvent", lambda *_: self._fit())

    def show(self, box: VoxelBox | None, in_space: bool = True) -> None:
        """Draw a box in place of the one before, in the slices and, unless it is being dragged, in 3D; None: none."""
        self.box = box
        scene, empty = self._scene, pv.PolyData()
        for name, tile in scene.slice_tiles.items():
            self._sights[name] = tile.sight
            self._draw(name, tile.renderer, empty if box is None else _rectangle(tile, box))
        if scene.space is not None and in_space:
            edges = empty if box is None else box_edges(scene.geometry, box.low, box.high)
            self._draw("space", scene.space.renderer, edges)

    def sides_at(self, tile: SliceTile, index: NDArray[np.float64]) -> dict[int, int]:
        """Sides of the box within reach of an index in a slice: array axis -> 0 for the lower, 1 for the upper."""
        box, found = self.box, {}
        if box is None:
            return {}
        reach = REACH * self._scene.tiles.pixel_ratio * tile.mm_per_pixel()
        for axis in (other for other in range(3) if other != tile.stack.axis):
            step = self._scene.geometry.spacing[axis]
            away = [abs(index[axis] - box.low[axis] + 0.5) * step, abs(index[axis] - box.high[axis] - 0.5) * step]
            if min(away) <= reach:
                found[axis] = int(away[1] < away[0])
        # A side ends at the corners.
        for axis in (other for other in range(3) if other != tile.stack.axis):
            margin = reach / self._scene.geometry.spacing[axis]
            if not box.low[axis] - 0.5 - margin <= index[axis] <= box.high[axis] + 0.5 + margin:
                return {}
        return found

    def _draw(self, name: str, renderer: pv.Renderer, mesh: pv.PolyData) -> None:
        if name not in self._actors:
            self._actors[name] = add_actor(renderer, mesh, MARK)
        self._actors[name].mapper.SetInputData(mesh)
        self._actors[name].SetVisibility(mesh.n_points > 0)
        self._scene.tiles.redraw.mark(renderer)

    def _fit(self) -> None:
        """Before each picture: lines as wide as the screen asks for, fainter where the slice is not one of the box."""
        for actor in self._actors.values():
            actor.prop.line_width = LINE * self._scene.tiles.pixel_ratio
        for name, tile in self._scene.slice_tiles.items():
            if self.box is not None and name in self._actors:
                if self._sights[name] != tile.sight:  # what a slice cuts aslant differs from slice to slice
                    self._sights[name] = tile.sight
                    self._actors[name].mapper.SetInputData(_rectangle(tile, self.box))
                self._actors[name].prop.opacity = 1.0 if tile.stack.cuts(tile.index, *self.box) else BESIDE


def _rectangle(tile: SliceTile, box: VoxelBox) -> pv.PolyData:
    """Return the cut of a slice through a box; where it cuts none, that of a slice through the box's middle."""
    middle = tile.stack.to_place(0.5 * (np.array(box.low) + np.array(box.high)))[2]
    across = tile.across if tile.stack.cuts(tile.index, *box) else float(middle)
    corners = tile.stack.outline(across, *box)
    points = np.column_stack([corners, np.full(len(corners), DEPTH)])
    return pv.PolyData(points, lines=np.array([len(points) + 1, *range(len(points)), 0]))
