"""What a scene draws of a sequence: another image in its place, predictions, and the ways of tracked objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

if TYPE_CHECKING:
    from accelsurf.grid.volume import Volume
    from accelsurf.viewer.scene.scene import Scene

#: Dashes around a closed line, and how opaque a predicted surface is.
DASHES, TRANSLUCENT = 24, 0.25


def show_image(scene: Scene, volume: Volume) -> None:
    """Show another image on the same grid; cursor, camera and grey values stay."""
    scene.volume = volume
    for tile in scene.slice_tiles.values():
        tile.use_image(volume.array)
    if scene.space is not None:
        scene.space.use_image(volume.array)
        scene.show_planes(scene.shows_planes)
    scene.tiles.redraw.mark_all()


def dashed(lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every second part of the segments (n, 2, 2) of a closed line, by their direction from its middle."""
    if not len(lines):
        return lines
    away = lines.mean(axis=1) - lines.mean(axis=(0, 1))
    part = np.floor((np.arctan2(away[:, 1], away[:, 0]) / (2.0 * np.pi) + 0.5) * 2 * DASHES)
    return lines[part.astype(int) % 2 == 0]


def path_lines(paths: Sequence[NDArray[np.float64]]) -> pv.PolyData:
    """The ways (n, 3), world mm, as lines; empty without one of two places."""
    ends = [np.stack([path[:-1], path[1:]], axis=1).reshape(-1, 3) for path in paths if len(path) > 1]
    if not ends:
        return pv.PolyData()
    points = np.concatenate(ends)
    cells = np.column_stack([np.full(len(points) // 2, 2), np.arange(len(points)).reshape(-1, 2)])
    return pv.PolyData(points, lines=cells.ravel())
