"""Tools: to look, to press and draw a size, to start; to paint corrections, drawn until the surface obeys."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.arrays import Floats
from accelsurf.grid.clicks import Side
from accelsurf.viewer.actions.tool import AllActions, Feature, Tool, ball_text, finest, numbers_text
from accelsurf.viewer.core.size_drag import Dragging
from accelsurf.viewer.core.status import View
from accelsurf.viewer.scene.space import Picked


class Look(Tool):
    """Moves the slices through the point."""

    name = "look"
    key = "V"
    text = "Look"
    tip = "Click or drag in a slice: the other slices go through that place"

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._before: NDArray[np.float64] | None = None

    def press(self, at: Picked) -> None:
        self._before = self.actions.scene.cursor
        self.move(at)

    def move(self, at: Picked) -> None:
        if at.world is not None:
            self.actions.scene.cursor = at.world

    def release(self) -> None:
        self._before = None

    def cancel(self) -> None:
        if self._before is not None:
            self.actions.scene.cursor = self._before
        self._before = None


class Ball(Tool):
    """Places a ball from which the run starts."""

    name = "ball"
    key = "B"
    text = "Ball"
    tip = "Press in a slice and drag: a ball to start from"

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self.center: NDArray[np.float64] | None = None

    def press(self, at: Picked) -> None:
        self.center = at.world
        self.resize()

    move = press

    def resize(self) -> None:
        if self.center is not None:
            self.actions.scene.mark_ball(self.center, self.radius)

    def release(self) -> None:
        if self.center is not None:
            self.actions.scene.cursor = self.center
            self.actions.ask(self.actions.session.start_from([ball_text(self.center, self.radius)]))
        # The mark stays until the surface is drawn that it has led to.
        self.center = None

    def leave(self) -> None:
        self.center = None


class Size(Tool):
    """Presses in an object and draws its size out."""

    name = "size"
    key = "S"
    text = "Size"
    tip = "Press in the object and drag outwards until the outline fits, or only click"

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._center: NDArray[np.float64] | None = None
        self._dragging: Dragging | None = None
        self.drag_mm = 0.0

    def press(self, at: Picked) -> None:
        if at.world is None:
            return
        self._center, self.drag_mm = at.world, 0.0
        press = functools.partial(self.actions.session.press, object_id=self.actions.object_id)
        self._dragging = Dragging(press, ball_text(at.world, self.radius))
        self.actions.ask(self._dragging.pressed)
        self.actions.scene.cursor = at.world
        self.actions.scene.mark_ball(at.world, self.radius)

    def move(self, at: Picked) -> None:
        if self._center is None or self._dragging is None or at.world is None:
            return
        self.drag_mm = float(np.linalg.norm(at.world - self._center))
        drag = self._dragging.at(self.drag_mm)
        if drag is not None:
            self.actions.scene.mark_size(drag, self.drag_mm)

    def release(self) -> None:
        if self._dragging is not None:
            # Who moves by less than a voxel has not dragged: the hand was not still.
            is_dragged = self.drag_mm >= finest(self.actions.scene.geometry)
            self.actions.ask(self.actions.session.release(self.drag_mm if is_dragged else 0.0))
        self.leave()

    def leave(self) -> None:
        self._center = self._dragging = None
        self.actions.scene.mark_size(None)


#: Those that do not paint.
TOOLS: tuple[type[Tool], ...] = (Size, Look, Ball)
#: All tools in the order of their buttons: the most needed first.
ORDER = ("size", "inside", "outside", "look", "ball", "split")


#: A stroke has a place each time it has moved by this part of its radius, and at least by a voxel.
STROKE_STEP = 0.5
#: A stroke on a surface that jumps by this number of radii, over an edge of the visible part, begins anew there.
JUMP = 4.0


class Inside(Tool):
    """Paints a stroke of voxels that are inside, which is sent as a correction."""

    #: In whose colour it is drawn.
    side: Side = "inside"
    name = "inside"
    key = "I"
    text = "Inside"
    tip = "Click or draw on what is missing: it is in the object, and stays in it"

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        #: Pieces of the stroke, each a line of places.
        self._pieces: list[list[Floats]] = []
        self._mark = 0
        #: Corrections that were sent, each with its stroke, which is drawn until the surface obeys.
        self.sent: list[tuple[int, Future[Any]]] = []

    @property
    def width(self) -> float:
        """Radius, mm; 0 where it is no larger than a voxel, so that a click is a point."""
        return self.radius if self.radius > 0.5001 * finest(self.actions.scene.geometry) else 0.0

    def press(self, at: Picked) -> None:
        """Begin a stroke, and show how far around its first place the surface may move while the button is down."""
        if at.world is None:
            return
        self.leave()
        mark = self._mark = self.actions.scene.marks.new_stroke()
        self.move(at)
        where = (click_text([at.world], self.width),)

        def show(reach: float | None) -> None:
            if reach is not None and self._mark == mark:
                self.actions.scene.mark_ball(at.world, reach + self.width)
                self.actions.note(f"the surface moves within {reach:.3g} mm of the click")

        self.actions.ask(
            self.actions.session.reach_of(self.side, where, self.actions.object_id), show
        )

    def move(self, at: Picked) -> None:
        strokes = self.actions.scene.marks
        if at.world is None or not self._mark:
            return
        # As the settings will have it, so that the stroke as drawn is the click, to the last voxel.
        world = np.array([float(part) for part in numbers_text(at.world).split(",")])
        last = self._pieces[-1][-1] if self._pieces else None
        away = np.inf if last is None else float(np.linalg.norm(world - last))
        step = max(STROKE_STEP * self.width, finest(self.actions.scene.geometry))
        if away < step:
            return
        if last is None or (at.tile == "space" and away > max(JUMP * self.width, 4.0 * step)):
            self._pieces.append([world])
        else:
            self._pieces[-1].append(world)
        strokes.add(self._mark, self.side, self._pieces[-1][-2:], self.width)

    def release(self) -> None:
        if self._pieces:
            future = self.send(self._pieces)
            self.actions.ask(future)
            self.sent.append((self._mark, future))
        self._pieces, self._mark = [], 0
        self.actions.scene.mark_ball(None)
        self.actions.note("", 0.0)  # the effect of the correction is said next

    def leave(self) -> None:
        if self._mark:
            self.actions.scene.marks.end(self._mark)
            self.actions.scene.mark_ball(None)
        self._pieces, self._mark = [], 0

    def send(self, pieces: Sequence[Sequence[Floats]]) -> Future[None]:
        """Have the session make the correction."""
        texts = tuple(click_text(piece, self.width) for piece in pieces)
        return self.actions.session.add_click(self.side, texts, self.actions.object_id)

    def end_obeyed(self) -> None:
        """Remove strokes that the surface has obeyed, or the session refused."""
        for mark, future in self.sent:
            if future.done():
                self.actions.scene.marks.end(mark)
        self.sent = [(mark, future) for mark, future in self.sent if not future.done()]


class Outside(Inside):
    """Marks voxels that are not."""

    side: Side = "outside"
    name = "outside"
    key = "O"
    text = "Outside"
    tip = "Click or draw on what is too much: it is not in the object, and stays out of it"


class CorrectionsFeature(Feature):
    """The tools that paint."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._tools = tuple(kind(actions) for kind in (Inside, Outside))

    def tools(self) -> Sequence[Tool]:
        return self._tools

    def update(self, view: View) -> None:
        for tool in self._tools:
            tool.end_obeyed()


def click_text(places: Sequence[Floats], radius: float) -> str:
    """Return a piece of a stroke as a click: a point, a ball or a path.

    Examples
    --------
    >>> click_text([np.array([1.0, 2.0, 3.0])], 0.0), click_text([np.array([1.0, 2.0, 3.0])], 4.0)
    ('point:1,2,3', 'ball:1,2,3,4')
    >>> click_text([np.array([1.0, 2.0, 3.0]), np.array([5.0, 2.0, 3.0])], 4.0)
    'path:1,2,3,4;5,2,3,4'
    """
    if len(places) == 1:
        return ball_text(places[0], radius) if radius > 0 else f"point:{numbers_text(places[0])}"
    return "path:" + ";".join(numbers_text((*place, radius)) for place in places)
