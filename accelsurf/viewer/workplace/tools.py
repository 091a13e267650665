"""The tools that do not paint: to look, to press and draw a size, to start."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from accelsurf.viewer.core.size_drag import Dragging
from accelsurf.viewer.scene.picking import Picked
from accelsurf.viewer.workplace.tool import Tool, ball_text

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.workplace import Workplace


class Look(Tool):
    """Moves the slices through the point."""

    name, key, text = "look", "V", "Look"
    tip = "Turn the surface; drag in a slice to move the slices"

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        self._before: NDArray[np.float64] | None = None

    def press(self, at: Picked) -> None:
        self._before = self.workplace.scene.cursor
        self.move(at)

    def move(self, at: Picked) -> None:
        if at.world is not None:
            self.workplace.scene.cursor = at.world

    def release(self) -> None:
        self._before = None

    def cancel(self) -> None:
        if self._before is not None:
            self.workplace.scene.cursor = self._before
        self._before = None


class Ball(Tool):
    """Places a ball from which the run starts."""

    name, key, text = "ball", "B", "Ball"
    tip = "Press in a slice or on the surface and drag: a ball to start from"

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        self.center: NDArray[np.float64] | None = None

    def press(self, at: Picked) -> None:
        self.center = at.world
        self.resize()

    move = press

    def resize(self) -> None:
        if self.center is not None:
            self.workplace.scene.mark_ball(self.center, self.radius)

    def release(self) -> None:
        if self.center is not None:
            self.workplace.scene.cursor = self.center
            self.workplace.ask(self.workplace.session.start_from([ball_text(self.center, self.radius)]))
        # The mark stays until the surface is drawn that it has led to.
        self.center = None

    def leave(self) -> None:
        self.center = None


class Points(Tool):
    """Places a small ball at each click; the run starts from all."""

    name, key, text = "points", "P", "Points"
    tip = "Click in a slice: small balls to start from, one for each point"

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        self._balls: list[str] = []
        self._center: NDArray[np.float64] | None = None

    def press(self, at: Picked) -> None:
        self._center = at.world
        self.workplace.scene.mark_ball(self._center, self.radius)

    move = press

    def release(self) -> None:
        if self._center is not None:
            self._balls.append(ball_text(self._center, self.radius))
            self.workplace.scene.cursor = self._center
            self.workplace.ask(self.workplace.session.start_from(self._balls))
        self._center = None

    def cancel(self) -> None:
        self._center = None  # those placed before stay

    def leave(self) -> None:
        self._balls, self._center = [], None


class Size(Tool):
    """Presses in an object and draws its size out."""

    name, key, text = "size", "S", "Size"
    tip = "Press in the object and drag outwards until the outline fits: a click and a size"

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        self._center: NDArray[np.float64] | None = None
        self._dragging: Dragging | None = None
        self.drag_mm = 0.0

    def press(self, at: Picked) -> None:
        if at.world is None:
            return
        self._center, self.drag_mm = at.world, 0.0
        press = functools.partial(self.workplace.session.press, object_id=self.workplace.object_id)
        self._dragging = Dragging(press, ball_text(at.world, self.radius))
        self.workplace.ask(self._dragging.pressed)
        self.workplace.scene.cursor = at.world
        self.workplace.scene.mark_ball(at.world, self.radius)

    def move(self, at: Picked) -> None:
        if self._center is None or self._dragging is None or at.world is None:
            return
        self.drag_mm = float(np.linalg.norm(at.world - self._center))
        drag = self._dragging.at(self.drag_mm)
        if drag is not None:
            self.workplace.scene.mark_size(drag, self.drag_mm)

    def release(self) -> None:
        if self._dragging is not None and self.drag_mm > 0:
            self.workplace.ask(self.workplace.session.release(self.drag_mm))
        self.leave()

    def leave(self) -> None:
        self._center = self._dragging = None
        self.workplace.scene.mark_size(None)


#: In the order of their buttons; those that paint follow.
TOOLS: tuple[type[Tool], ...] = (Look, Size, Ball, Points)
