"""What a mouse does to a scene: turn, shift and zoom in 3D, drag slices, place balls; for pages, which send events.

Positions are pixels of the picture, counted from its lower left corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import check_known
from accelsurf.grid.clicks import SIDES
from accelsurf.viewer.scene.scene import Scene

#: What a drag of the left button does: look around; place a ball that becomes the start, is added or removed, or says
#: what is inside or outside; or press in an object and draw its size out.
MODES = ("look", "start", "add", "remove", "inside", "outside", "size")
#: Degrees that the camera turns per pixel of a picture 720 high; zoom per notch of the wheel.
TURN, ZOOM = 0.45, 1.12
#: A brush or a stroke that is drawn makes a ball each time it has moved by this fraction of its radius.
STROKE_STEP = 0.5


class Mouse:
    """A mouse over a scene.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    mode : str
        One of `MODES`.
    radius : float
        Of the ball that is placed, mm.
    drag_mm : float
        In the mode ``size``: how far the mouse is from where it was pressed.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.mode, self.radius = "look", 0.1 * min(scene.geometry.extent_mm)
        self._tile: str | None = None
        self._at, self._shifting = (0.0, 0.0), False
        self._ball: NDArray[np.float64] | None = None
        self._stroke: list[str] = []
        self.drag_mm = 0.0

    def set_mode(self, mode: str) -> None:
        """Use one of `MODES`.

        Raises
        ------
        UsageError
            For another one.
        """
        check_known("mouse", mode, MODES)
        self.mode = mode
        self._drop_ball()

    def press(self, x: float, y: float, shift: bool = False) -> None:
        """A button goes down; with ``shift`` (or another button) the picture in 3D is shifted, not turned."""
        picked = self._scene.pick(x, y)
        self._tile, self._at, self._shifting = picked.tile, (x, y), shift
        self._ball, self._stroke, self.drag_mm = None, [], 0.0
        self.move(x, y)

    @property
    def ball(self) -> str | None:
        """The ball that is being placed, ``ball:X,Y,Z,R``."""
        if self._ball is None:
            return None
        return ball_text(self._ball, self.radius)

    def move(self, x: float, y: float) -> None:
        """The mouse moves with a button down."""
        if self._tile is None:
            return
        scene, (before_x, before_y) = self._scene, self._at
        self._at = (x, y)
        if self.mode != "look":
            picked = scene.pick(x, y)
            if picked.world is not None and self.mode == "size" and self._ball is not None:
                if picked.tile == self._tile:
                    self.drag_mm = float(np.linalg.norm(picked.world - self._ball))
            elif picked.world is not None:
                if self.mode in SIDES:
                    self._draw(picked.tile, picked.world)
                else:
                    self._ball = picked.world
                scene.mark_ball(self._ball, self.radius)
        elif self._tile in scene.slice_tiles:
            picked = scene.pick(x, y)
            if picked.tile == self._tile and picked.world is not None:
                scene.cursor = picked.world
        elif self._tile == "space" and scene.space is not None:
            if self._shifting:
                scene.space.shift(x - before_x, y - before_y)
            else:
                height = float(scene.plotter.render_window.GetSize()[1])
                scene.space.turn(TURN * 720.0 / height * (before_x - x), TURN * 720.0 / height * (before_y - y))

    def _draw(self, tile: str, world: NDArray[np.float64]) -> None:
        """Go on with a stroke of balls: one more each time the mouse has moved by a part of the radius."""
        if self._ball is None or (
            tile == self._tile and np.linalg.norm(world - self._ball) >= STROKE_STEP * self.radius
        ):
            self._ball = world
            self._stroke.append(ball_text(world, self.radius))

    def release(self) -> tuple[str, tuple[str, ...]] | None:
        """The button goes up; returns the mode and the balls, ``ball:X,Y,Z,R``, that were placed, or None.

        Several are a stroke, of the modes ``inside`` and ``outside``.
        """
        self._tile = None
        text, stroke = self.ball, tuple(self._stroke)
        if text is None or self.mode == "look":
            return None
        self._drop_ball()
        return self.mode, stroke or (text,)

    def wheel(self, x: float, y: float, notches: float) -> None:
        """Zoom in 3D; change the slice elsewhere."""
        picked = self._scene.pick(x, y)
        if picked.tile in self._scene.slice_tiles:
            self._scene.step_slice(picked.tile, 1 if notches > 0 else -1)
        elif self._scene.space is not None and picked.tile == "space":
            self._scene.space.zoom(ZOOM ** float(np.clip(notches, -5.0, 5.0)))

    def _drop_ball(self) -> None:
        self._ball, self._stroke = None, []
        self._scene.mark_ball(None)


def ball_text(center: NDArray[np.float64], radius: float) -> str:
    """A ball as settings have it, ``ball:X,Y,Z,R``."""
    return "ball:" + ",".join(f"{value:.6g}" for value in (*center, radius))
