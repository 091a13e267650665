"""Where a slice cuts surfaces, functions of the image and drags: segments (n, 2, 2) in the slice's plane, mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.slice_stack import Patch, SliceStack, linear
from accelsurf.viewer.core.frame import SurfaceFrame
from accelsurf.viewer.core.size_drag import SizeDrag
from accelsurf.viewer.scene.shapes import contour, slice_of

Floats = NDArray[np.float64]
NONE = np.zeros((0, 2, 2))


def surface_lines(surface: SurfaceFrame, stack: SliceStack, number: int) -> Floats:
    """The contour of an object in a slice."""
    if not surface.has_surface:
        return NONE
    if not stack.is_straight:
        part = slice_of(surface, stack.axis, number)
        return NONE if part is None else stack.to_place(surface.to_image(_ends(contour(part), stack.axis)))[..., :2]
    last = np.array(surface.psi.shape) - 1.0
    patch = stack.patch(number, surface.to_image((0.0, 0.0, 0.0)), surface.to_image(last))
    index = surface.from_image(np.stack(np.broadcast_arrays(*patch.places), axis=-1))
    lines = contour(linear(surface.psi, (index[..., 0], index[..., 1], index[..., 2])))
    return _in_plane(lines, patch, stack, number, surface.to_image((-0.5,) * 3), surface.to_image(last + 0.5))


def function_lines(function: NDArray[np.float32], stack: SliceStack, number: int) -> Floats:
    """Where a function (nz, ny, nx) of the whole image, negative inside, is 0 in a slice."""
    if not stack.is_straight:
        return stack.to_place(_ends(contour(np.asarray(function.take(number, axis=stack.axis))), stack.axis))[..., :2]
    patch = stack.patch(number)
    lines = contour(linear(function, patch.places))
    return _in_plane(lines, patch, stack, number, (-0.5,) * 3, np.array(function.shape) - 0.5)


class DragLines:
    """The outline of what belongs to an object of a size, in a tile; in a straight slice its times are read once."""

    def __init__(self) -> None:
        self._read_for: tuple[SizeDrag, SliceStack, int] | None = None
        self._times = np.zeros((0, 0), np.float32)

    def lines(self, drag: SizeDrag, volume_mm3: float, stack: SliceStack, number: int) -> Floats:
        """The outline in a slice, of a volume."""
        first = np.asarray(drag.first, float)
        if not stack.is_straight:
            plane = drag.plane(stack.axis, number, volume_mm3)
            return NONE if plane is None else stack.to_place(_ends(contour(plane), stack.axis) + first)[..., :2]
        last = first + drag.times.shape - 1.0
        patch = stack.patch(number, first, last)
        if self._read_for != (drag, stack, number):  # drags and stacks are themselves alone
            z, y, x = (place - corner for place, corner in zip(patch.places, first, strict=True))
            self._read_for, self._times = (drag, stack, number), drag.times_at((z, y, x))
        lines = contour(drag.signed(self._times, volume_mm3))
        return _in_plane(lines, patch, stack, number, first - 0.5, last + 0.5)


def ball_lines(center: Floats, radius: float, stack: SliceStack, number: int) -> Floats:
    """The circle in which a ball around an index (z, y, x) of the image, radius in mm, cuts a slice."""
    place = stack.to_place(center)
    off = place[2] - stack.across(number)
    if abs(off) >= radius:
        return NONE
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    ring = place[:2] + np.sqrt(radius**2 - off**2) * np.stack([np.cos(turn), np.sin(turn)], -1)
    return np.stack([ring[:-1], ring[1:]], axis=1)


def _ends(lines: Floats, axis: int) -> Floats:
    """Ends (n, 2, 3) as indices (z, y, x), 0 along an axis, of segments (n, 2, 2) of rows and columns."""
    places = np.zeros((len(lines), 2, 3))
    rows, columns = (other for other in range(3) if other != axis)
    places[..., rows], places[..., columns] = lines[..., 0], lines[..., 1]
    return places


def _in_plane(
    lines: Floats, patch: Patch, stack: SliceStack, number: int, low: object, high: object
) -> Floats:
    """Segments (n, 2, 2) of rows and columns of a patch, in mm; without those beyond a box, where nothing is known."""
    if not len(lines):
        return NONE
    left, _, bottom, _ = stack.extent
    right, up = stack.pitch
    places = np.empty_like(lines)
    places[..., 0] = left + right * (patch.columns.start + lines[..., 1] + 0.5)
    places[..., 1] = bottom + up * (patch.rows.start + lines[..., 0] + 0.5)
    middles = places.mean(axis=1)
    index = stack.to_index(np.column_stack([middles, np.full(len(middles), stack.across(number))]))
    within = (index >= np.asarray(low, float)) & (index <= np.asarray(high, float))
    return np.asarray(places[within.all(axis=1)])
