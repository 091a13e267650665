"""Strokes: what is inside, what is not, a brush that grows and shrinks; drawn at once, until the surface obeys."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.clicks import Side
from accelsurf.viewer.core.status import View
from accelsurf.viewer.scene.picking import Picked
from accelsurf.viewer.workplace.feature import Feature
from accelsurf.viewer.workplace.tool import Tool, ball_text, finest, numbers_text

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.workplace import Workplace

#: A stroke has a place each time it has moved by this part of its radius, and at least by a voxel.
STROKE_STEP = 0.5
#: On a surface a stroke that jumps by so many radii, over an edge of what is seen, begins anew there.
JUMP = 4.0

Place = NDArray[np.float64]


class StrokeTool(Tool):
    """Paints a stroke; what it is sent as is up to its kinds."""

    #: In whose colour it is drawn.
    side: Side = "inside"

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        #: Pieces of the stroke, each a line of places.
        self._pieces: list[list[Place]] = []
        self._mark = 0
        #: Strokes that were sent, and what waits for the surface to obey.
        self.sent: list[tuple[int, Future[Any]]] = []

    @property
    def width(self) -> float:
        """Radius, mm; 0 where it is no larger than a voxel, so that a click is a point."""
        return self.radius if self.radius > 0.5001 * finest(self.workplace.scene.geometry) else 0.0

    def press(self, at: Picked) -> None:
        if at.world is None:
            return
        self.leave()
        self._mark = self.workplace.scene.marks.strokes.new_stroke()
        self.move(at)

    def move(self, at: Picked) -> None:
        strokes = self.workplace.scene.marks.strokes
        if at.world is None or not self._mark:
            return
        # As the settings will have it, so that what is drawn is what is clicked, to the last voxel.
        world = np.array([float(part) for part in numbers_text(at.world).split(",")])
        last = self._pieces[-1][-1] if self._pieces else None
        away = np.inf if last is None else float(np.linalg.norm(world - last))
        step = max(STROKE_STEP * self.width, finest(self.workplace.scene.geometry))
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
            self.workplace.ask(future)
            self.sent.append((self._mark, future))
        self._pieces, self._mark = [], 0

    def leave(self) -> None:
        if self._mark:
            self.workplace.scene.marks.strokes.end(self._mark)
        self._pieces, self._mark = [], 0

    def send(self, pieces: Sequence[Sequence[Place]]) -> Future[None]:
        """Have the session make the stroke."""
        raise NotImplementedError

    def end_obeyed(self) -> None:
        """Draw no longer what the surface has obeyed, or the session refused."""
        for mark, future in self.sent:
            if future.done():
                self.workplace.scene.marks.strokes.end(mark)
        self.sent = [(mark, future) for mark, future in self.sent if not future.done()]


class Inside(StrokeTool):
    """Says what is inside."""

    name, key, text = "inside", "I", "Inside"
    tip = "Click, or draw a stroke, in a slice or on the surface: this is in the object, and stays in it"

    def send(self, pieces: Sequence[Sequence[Place]]) -> Future[None]:
        texts = tuple(click_text(piece, self.width) for piece in pieces)
        return self.workplace.session.add_click(self.side, texts, self.workplace.object_id)


class Outside(Inside):
    """Says what is not."""

    side: Side = "outside"
    name, key, text = "outside", "O", "Outside"
    tip = "Click, or draw a stroke, in a slice or on the surface: this is not in the object, and stays out of it"


class Grow(StrokeTool):
    """Adds what the brush covers."""

    kind: Literal["add", "remove"] = "add"
    name, key, text = "grow", "G", "Grow"
    tip = "Press and drag in a slice or on the surface: add what the brush covers"

    def send(self, pieces: Sequence[Sequence[Place]]) -> Future[None]:
        balls = tuple(ball_text(place, self.radius) for piece in pieces for place in piece)
        return self.workplace.session.edit_balls(self.kind, balls, self.workplace.object_id)


class Shrink(Grow):
    """Removes what the brush covers."""

    side: Side = "outside"
    kind: Literal["add", "remove"] = "remove"
    name, key, text = "shrink", "K", "Shrink"
    tip = "Press and drag in a slice or on the surface: remove what the brush covers"


class StrokesFeature(Feature):
    """The tools that paint."""

    def __init__(self, workplace: Workplace) -> None:
        super().__init__(workplace)
        self._tools = tuple(kind(workplace) for kind in (Inside, Outside, Grow, Shrink))

    def tools(self) -> Sequence[Tool]:
        return self._tools

    def update(self, view: View) -> None:
        for tool in self._tools:
            tool.end_obeyed()


def click_text(places: Sequence[Place], radius: float) -> str:
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
