"""Fingers on a screen: one is the left button; two move what is under them, and zoom it, both at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from accelsurf.viewer.workplace.checks import number, whole
from accelsurf.viewer.workplace.feature import Feature
from accelsurf.viewer.workplace.mouse import LEFT, MIDDLE, MouseFeature

#: Fingers that are counted; and the largest magnitude of the number by which a screen knows one.
MAX_FINGERS, MAX_NUMBER = 10, 2**31
#: Two fingers are never nearer than so many pixels: their distance is divided by.
NEAR = 10.0


class FingersFeature(Feature):
    """Makes of fingers what the mouse does.

    The first one draws. With the second one a gesture of two begins, so what the first has begun is cancelled, and
    nothing is drawn until all are up: who lifts one finger of two does not mean a stroke.
    """

    def __init__(self, workplace: Any) -> None:
        super().__init__(workplace)
        #: Places of all that are down, parts of the width and of the height from the top.
        self._places: dict[int, tuple[float, float]] = {}
        #: Those whose moves count: one, two, or none where the rest of a gesture is waited for.
        self._leading: tuple[int, ...] = ()
        self._gesture = 0

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "finger_down": self._down,
            "finger_move": self._move,
            "finger_up": self._up,
            "finger_cancel": self._cancel,
        }

    @property
    def _mouse(self) -> MouseFeature:
        return self.workplace.feature(MouseFeature)

    @property
    def _leads(self) -> bool:
        """Whether what is dragged now was begun by these fingers, not by a mouse or a pen meanwhile."""
        return bool(self._leading) and self._mouse.is_dragging and self._mouse.gesture == self._gesture

    def _down(self, x: Any, y: Any, finger: Any, first: Any = False) -> None:
        """A finger comes down; ``first`` when the screen knows of no other: any that are known here were lost."""
        finger, place = _number(finger), _place(x, y)
        if first:
            self._cancel()
        if len(self._places) >= MAX_FINGERS or (not self._places and self._mouse.is_dragging):
            return  # a hand that rests on the screen while a pen draws
        is_alone = not self._places
        self._places[finger] = place
        if is_alone:
            self._begin_with((finger,), LEFT)
        elif len(self._leading) == 1 and finger not in self._leading:
            if self._leads:
                self._mouse.cancel()
                self._begin_with((*self._leading, finger), MIDDLE)
            else:  # a pen draws meanwhile, or what was begun has ended by a key
                self._leading = ()

    def _begin_with(self, fingers: tuple[int, ...], button: int) -> None:
        self._leading = fingers
        try:
            self._mouse.press(*self._middle(), button)
        finally:  # a tool may be refused; the button is down all the same
            self._gesture = self._mouse.gesture

    def _move(self, x: Any, y: Any, finger: Any) -> None:
        finger, place = _number(finger), _place(x, y)
        if finger not in self._places:
            return
        before, self._places[finger] = self._apart(), place
        if finger in self._leading and self._leads:
            self._mouse.move(*self._middle())
            if len(self._leading) == 2:
                self._mouse.zoom(*self._middle(), self._apart() / before)

    def _up(self, finger: Any) -> None:
        self._forget(_number(finger), self._mouse.release)

    def _cancel(self, finger: Any = None) -> None:
        """The system has taken a finger, or all, for something else."""
        for one in (*self._places,) if finger is None else (_number(finger),):
            self._forget(one, self._mouse.cancel)

    def _forget(self, finger: int, end: Callable[[], None]) -> None:
        """A finger is no longer down; what it has begun ends with ``end``."""
        self._places.pop(finger, None)
        if finger in self._leading:
            leads, self._leading = self._leads, ()
            if leads:
                end()

    def _middle(self) -> tuple[float, float]:
        """Between the fingers that lead."""
        x, y = zip(*(self._places[finger] for finger in self._leading), strict=True)
        return sum(x) / len(x), sum(y) / len(y)

    def _apart(self) -> float:
        """Pixels between the two fingers that lead."""
        if len(self._leading) != 2:
            return NEAR
        width, height = self.workplace.scene.plotter.render_window.GetSize()
        (x, y), (far_x, far_y) = (self._places[finger] for finger in self._leading)
        return max(math.hypot((far_x - x) * width, (far_y - y) * height), NEAR)


def _number(finger: Any) -> int:
    return whole(finger, -MAX_NUMBER, MAX_NUMBER)


def _place(x: Any, y: Any) -> tuple[float, float]:
    return number(x, 0.0, 1.0), number(y, 0.0, 1.0)
