"""Mouse events of the window's scene, as requests."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, QPointF, Qt
from PySide6.QtGui import (
    QEventPoint,
    QInputDevice,
    QMouseEvent,
    QNativeGestureEvent,
    QTouchEvent,
    QWheelEvent,
)
from pyvistaqt import QtInteractor

from accelsurf.viewer.actions.actions import Actions
from accelsurf.viewer.actions.mouse import LEFT, MIDDLE, RIGHT, ZOOM, MouseFeature
from accelsurf.viewer.actions.slices import SlicesFeature

_BUTTONS = {
    Qt.MouseButton.LeftButton: LEFT,
    Qt.MouseButton.MiddleButton: MIDDLE,
    Qt.MouseButton.RightButton: RIGHT,
}
_PRESSES = (QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick)
#: After these the screen may have other pixels.
_FITS = (QEvent.Type.Show, QEvent.Type.Resize, QEvent.Type.DevicePixelRatioChange)
_KEYS = (QEvent.Type.KeyPress, QEvent.Type.KeyRelease)


class CanvasEvents(QObject):
    """Passes the events of the canvas on as requests; VTK gets none of the mouse's.

    Parameters
    ----------
    actions : Actions
    canvas : pyvistaqt.QtInteractor
    refresh : callable
        Draws changes at once.
    """

    def __init__(self, actions: Actions, canvas: QtInteractor, refresh: Callable[[], None]) -> None:
        super().__init__(canvas)
        self._actions = actions
        self._canvas = canvas
        self._refresh = refresh
        canvas.setMouseTracking(True)
        canvas.setAttribute(Qt.WidgetAttribute.WA_AcceptTouchEvents)
        canvas.installEventFilter(self)

    # -- events -------------------------------------------------------------------------------------------

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Mouse and keys on the canvas; False passes an event on to VTK."""
        if event.type() in _KEYS:
            # VTK has keys of its own, which close windows and change how things are drawn.
            return True
        if event.type() in _FITS:
            self._actions.scene.tiles.pixel_ratio = self._canvas.devicePixelRatioF()
            self._actions.feature(SlicesFeature).fit_layout(
                self._canvas.width(), self._canvas.height()
            )
        if isinstance(event, QWheelEvent):
            zoom = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
            turned = event.angleDelta().y()
            if turned:
                self._ask("scroll", event.position(), turned / 120.0, zoom)
            return True
        if isinstance(event, QNativeGestureEvent):
            if event.gestureType() == Qt.NativeGestureType.ZoomNativeGesture:
                self._ask("scroll", event.position(), event.value() / (ZOOM - 1.0), True)
            return True
        if (
            isinstance(event, QTouchEvent)
            and event.device().type() == QInputDevice.DeviceType.TouchScreen
        ):
            self._touch(event)
            event.accept()  # so that Qt makes no mouse of it
            return True
        if isinstance(event, QMouseEvent):
            self._mouse(event)
            return True
        return bool(super().eventFilter(watched, event))

    def _mouse(self, event: QMouseEvent) -> None:
        kind, place = event.type(), event.position()
        if kind == QEvent.Type.MouseButtonDblClick and event.button() == Qt.MouseButton.LeftButton:
            self._ask("double", place)
        if kind in _PRESSES and event.button() in _BUTTONS:
            shift = bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
            self._ask("press", place, _BUTTONS[event.button()], shift)
        elif kind == QEvent.Type.MouseMove:
            is_dragging = self._actions.feature(MouseFeature).is_dragging
            self._ask("move" if is_dragging else "hover", place)
        elif kind == QEvent.Type.MouseButtonRelease:
            if event.button() in _BUTTONS:
                self._actions.request("release", _BUTTONS[event.button()])
            self._refresh()

    def _touch(self, event: QTouchEvent) -> None:
        """Request the actions of touches on a screen."""
        if event.type() == QEvent.Type.TouchCancel:
            self._actions.request("touch_cancel")
        for point in event.points():
            if point.state() == QEventPoint.State.Pressed:
                self._request(
                    "touch_down",
                    point.position(),
                    point.id(),
                    event.type() == QEvent.Type.TouchBegin,
                )
            elif point.state() == QEventPoint.State.Updated:
                self._request("touch_move", point.position(), point.id())
            elif point.state() == QEventPoint.State.Released:
                self._actions.request("touch_up", point.id())
        self._refresh()

    def _ask(self, name: str, place: QPointF, *more: object) -> None:
        """A request with a place, whose effect is drawn at once."""
        self._request(name, place, *more)
        self._refresh()

    def _request(self, name: str, place: QPointF, *more: object) -> None:
        """A request with a place as parts of the canvas; a drag may leave it."""
        across = place.x() / max(self._canvas.width() - 1, 1)
        down = place.y() / max(self._canvas.height() - 1, 1)
        self._actions.request(name, min(max(across, 0.0), 1.0), min(max(down, 0.0), 1.0), *more)
