"""The box in which a run is made: drawn and dragged in the slices, or laid around the object; the setting roi."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.run.region_of_interest import region_of_interest
from accelsurf.viewer.actions.tool import AllActions, Feature, Tool
from accelsurf.viewer.core.status import Status
from accelsurf.viewer.scene.box import BoxOverlay, VoxelBox
from accelsurf.viewer.scene.space import Picked

#: How much a box is larger than the object it is laid around, to each side: of the object's extent, and voxels.
AROUND, AROUND_VOXELS = 0.25, 6


class BoxFeature(Feature):
    """Shows the region of interest, and changes it.

    Attributes
    ----------
    overlay : BoxOverlay
    """

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self.overlay = BoxOverlay(actions.scene)
        self._tool = BoxTool(actions, self)
        self._shown: str | None = None
        self._is_stale = False

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {"box_around": self._around, "box_none": lambda: self.use(None)}

    def tools(self) -> Sequence[Tool]:
        return (self._tool,)

    def state(self, status: Status) -> dict[str, Any]:
        if (self._is_stale or status.settings.roi != self._shown) and not self._tool.is_drawing:
            self._shown, self._is_stale = status.settings.roi, False
            self.overlay.show(self.in_force())
        return {"has_box": status.settings.roi is not None}

    def forget(self) -> None:
        """Draw the region of interest of the run again, in place of what was dragged."""
        self._is_stale = True

    def in_force(self) -> VoxelBox | None:
        """The region of interest of the run; None where it is the whole image."""
        roi = self.actions.session.status.settings.roi
        if roi is None:
            return None
        try:
            z, y, x = region_of_interest(roi, self.actions.scene.geometry)
        except AccelsurfError:  # the run says what is wrong with it
            return None
        return VoxelBox((z.start, y.start, x.start), (z.stop - 1, y.stop - 1, x.stop - 1))

    def use(self, box: VoxelBox | None) -> None:
        """Begin another run in a box, or in the whole image."""
        roi = None if box is None else box.text
        if roi == self.actions.session.status.settings.roi:
            return self.forget()
        future = self.actions.session.restart_with(roi=roi)
        future.add_done_callback(lambda _: self.forget())  # also where it is refused
        self.actions.ask(future)

    def _around(self) -> None:
        """Lay the box around all objects, with some of what lies around them."""
        frame, shape = self.actions.scene.frame, np.array(self.actions.scene.geometry.shape)
        ends = []
        for surface in () if frame is None else frame.surfaces:
            inside = np.argwhere(surface.psi < 0) if surface.has_surface else np.zeros((0, 3))
            if len(inside):
                ends += [surface.to_image(inside.min(axis=0)), surface.to_image(inside.max(axis=0))]
        if not ends:
            raise UsageError("box: there is no object to lay it around", "draw it in a slice")
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        margin = np.where(shape > 1, np.maximum(AROUND * (high - low), AROUND_VOXELS), 0.0)
        self.use(VoxelBox.between(low - margin, high + margin, self.actions.scene.geometry.shape))


class BoxTool(Tool):
    """Draws a box in a slice, or drags one of its sides or corners.

    Attributes
    ----------
    is_drawing : bool
        Whether a box is being drawn or dragged.
    """

    name, key, text = "box", "Z", "Box"
    tip = "Drag in a slice: the box in which the run is made; drag its sides and corners to change it"

    def __init__(self, actions: AllActions, feature: BoxFeature) -> None:
        super().__init__(actions)
        self._feature, self.is_drawing = feature, False
        self._fixed = self._moving = np.zeros(3)
        self._axes: list[int] = []

    def press(self, at: Picked) -> None:
        scene, overlay = self.actions.scene, self._feature.overlay
        if at.world is None or at.tile not in scene.slice_tiles:
            return
        tile, index = scene.slice_tiles[at.tile], scene.geometry.world_to_index(at.world)
        box, self.is_drawing = overlay.box, True
        sides = overlay.sides_at(tile, index)
        if box is not None and sides:
            low, high = np.array(box.low, float), np.array(box.high, float)
            upper = np.array([sides.get(axis, 1) for axis in range(3)], bool)
            self._fixed, self._moving = np.where(upper, low, high), np.where(upper, high, low)
            self._axes = list(sides)
            return
        last = np.array(scene.geometry.shape) - 1.0
        self._axes = [axis for axis in range(3) if axis != tile.stack.axis]
        self._fixed, self._moving = index.copy(), index.copy()
        across = tile.stack.axis
        self._fixed[across] = 0.0 if box is None else box.low[across]
        self._moving[across] = last[across] if box is None else box.high[across]

    def move(self, at: Picked) -> None:
        if not self.is_drawing or at.world is None:
            return
        index = self.actions.scene.geometry.world_to_index(at.world)
        self._moving[self._axes] = index[self._axes]
        self._feature.overlay.show(self._box(), in_space=False)

    def release(self) -> None:
        if self.is_drawing and self._has_extent():
            self.is_drawing = False
            self._feature.use(self._box())
        self.leave()

    def leave(self) -> None:
        if self.is_drawing:
            self.is_drawing = False
            self._feature.forget()

    def _box(self) -> VoxelBox:
        return VoxelBox.between(self._fixed, self._moving, self.actions.scene.geometry.shape)

    def _has_extent(self) -> bool:
        """Test if the mouse has moved by more than a voxel: a click alone draws no box."""
        apart: NDArray[np.float64] = np.abs(self._moving - self._fixed)[self._axes]
        return bool((apart >= 1.0).all())
