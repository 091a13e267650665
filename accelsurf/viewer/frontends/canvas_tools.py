"""The mouse on the window's scene: slices, balls to start from, strokes that are inside or outside, a brush."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtGui import QMouseEvent, QWheelEvent
from pyvistaqt import QtInteractor

from accelsurf.grid.clicks import SIDES, Side
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.size_drag import Dragging
from accelsurf.viewer.scene.mouse import STROKE_STEP, ball_text
from accelsurf.viewer.scene.scene import Scene

#: Names of renderers without a graphics card.
SOFTWARE = ("llvmpipe", "softpipe", "SWR", "Software")


class CanvasTools(QObject):
    """Handles the events of the canvas; those that it does not use go to VTK's camera.

    Parameters
    ----------
    session : Session
    scene : Scene
        Drawn on the canvas.
    canvas : pyvistaqt.QtInteractor
    radius : callable
        Returns the radius of ball and brush, mm.
    object_id : callable
        Returns the id of the object that the brush changes; None is the nearest.

    Attributes
    ----------
    tool : str
        One of `controls.TOOLS`.
    """

    def __init__(
        self,
        session: Session,
        scene: Scene,
        canvas: QtInteractor,
        radius: Callable[[], float],
        object_id: Callable[[], int | None],
    ) -> None:
        super().__init__(canvas)
        self._session, self._scene, self._canvas = session, scene, canvas
        self._radius, self._object_id = radius, object_id
        self.tool = "look"
        self._dragged_tile = ""
        self._points: list[str] = []
        self._stroke: list[str] = []
        self._center: NDArray[np.float64] | None = None
        self._is_software: bool | None = None
        self._dragging: Dragging | None = None
        self._drag_mm = 0.0
        canvas.installEventFilter(self)

    @property
    def is_dragging(self) -> bool:
        """Whether a tool is in use, the button down."""
        return bool(self._dragged_tile)

    def use(self, tool: str) -> None:
        """Use a tool from now on."""
        self.tool, self._points, self._stroke = tool, [], []
        self._scene.mark_ball(None)
        self._canvas.setCursor(Qt.CursorShape.ArrowCursor if tool == "look" else Qt.CursorShape.CrossCursor)
        self._scene.render()

    def show_ball(self) -> None:
        """Draw the ball that is being placed, as after its radius has changed."""
        if self.tool == "ball" and self._center is not None:
            self._mark(self._center)

    # -- edges --------------------------------------------------------------------------------------------

    @property
    def is_software(self) -> bool:
        """Whether the processor draws, not a graphics card."""
        if self._is_software is None:
            capabilities = self._canvas.render_window.ReportCapabilities()
            self._is_software = any(name in capabilities for name in SOFTWARE)
        return self._is_software

    def smooth_edges(self, on: bool) -> None:
        """Smooth edges while nothing moves; a processor that draws needs three times as long for it."""
        self._scene.smooth_edges(on or not self.is_software)

    # -- events -------------------------------------------------------------------------------------------

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Mouse and keys on the canvas; False passes an event on to VTK."""
        kind = event.type()
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            # VTK has keys of its own, which close windows and change how things are drawn.
            return True
        if isinstance(event, QWheelEvent):
            return self._wheel(event)
        if isinstance(event, QMouseEvent) and event.button() in (Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton):
            x, y = self._pixel(event.position().x(), event.position().y())
            if kind in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick):
                return self._press(x, y)
            if kind == QEvent.Type.MouseMove and self.is_dragging:
                return self._drag(x, y)
            if kind == QEvent.Type.MouseButtonRelease:
                self.smooth_edges(not self._session.status.playing)
                return self._release() if self.is_dragging else self._end_camera_move()
        return bool(super().eventFilter(watched, event))

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        """A place in the widget, as VTK counts pixels."""
        ratio = self._canvas.devicePixelRatioF()
        return x * ratio, (self._canvas.height() - 1 - y) * ratio

    def _press(self, x: float, y: float) -> bool:
        tile, world = self._scene.pick(x, y)
        self.smooth_edges(False)
        if world is None or (tile == "space" and self.tool == "look"):
            return tile in self._scene.slice_tiles
        self._dragged_tile = tile
        self._apply(world)
        return True

    def _drag(self, x: float, y: float) -> bool:
        tile, world = self._scene.pick(x, y)
        if world is not None and tile == self._dragged_tile and self.tool != "points":
            self._apply(world)
        return True

    def _release(self) -> bool:
        self._dragged_tile = ""
        if self.tool == "ball" and self._center is not None:
            self._points = []
            self._session.start_from([self._ball(self._center)])
        elif self.tool in SIDES and self._stroke:
            side: Side = "inside" if self.tool == "inside" else "outside"
            self._session.add_click(side, tuple(self._stroke), self._object_id())
            self._stroke = []
        elif self.tool == "size":
            if self._dragging is not None and self._drag_mm > 0:
                self._session.release(self._drag_mm)
            self._dragging = None
            self._scene.mark_size(None)
        # The mark stays until the surface is drawn that it has led to.
        self._center = None
        return True

    def _end_camera_move(self) -> bool:
        """The camera was turned: VTK has to get the release of the button first, then the scene is drawn once more."""
        QTimer.singleShot(0, self._scene.render)
        return False

    def _wheel(self, event: QWheelEvent) -> bool:
        tile, _ = self._scene.pick(*self._pixel(event.position().x(), event.position().y()))
        if tile not in self._scene.slice_tiles:
            return tile != "space"
        self._scene.step_slice(tile, 1 if event.angleDelta().y() > 0 else -1)
        self._scene.render()
        return True

    # -- tools --------------------------------------------------------------------------------------------

    def _apply(self, world: NDArray[np.float64]) -> None:
        """Apply the tool at a point."""
        if self.tool == "look":
            self._scene.cursor = world
            self._scene.render()
            return
        if self.tool == "size":
            self._apply_size(world)
            return
        if self.tool == "ball":
            self._center = world
        elif self.tool == "points":
            self._points.append(self._ball(world))
            self._session.start_from(self._points)
        elif self._center is None or np.linalg.norm(world - self._center) >= STROKE_STEP * self._radius():
            goes_on, self._center = self._center is not None, world
            if self.tool in SIDES:
                self._stroke.append(self._ball(world))
            else:
                kind: Literal["add", "remove"] = "add" if self.tool == "grow" else "remove"
                self._session.edit_ball(kind, self._ball(world), self._object_id(), joined=goes_on)
        self._mark(world)

    def _apply_size(self, world: NDArray[np.float64]) -> None:
        """Press, or drag, the size of an object."""
        if self._center is None:
            self._center, self._drag_mm = world, 0.0
            self._dragging = Dragging(self._session.press, self._ball(world))
            self._mark(world)
            return
        self._drag_mm = float(np.linalg.norm(world - self._center))
        drag = None if self._dragging is None else self._dragging.at(self._drag_mm)
        if drag is not None:
            self._scene.mark_size(drag, self._drag_mm)
            self._scene.render()

    def _mark(self, world: NDArray[np.float64]) -> None:
        self._scene.mark_ball(world, self._radius())
        self._scene.render()

    def _ball(self, world: NDArray[np.float64]) -> str:
        return ball_text(world, self._radius())
