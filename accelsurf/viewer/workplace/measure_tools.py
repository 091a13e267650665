"""The tools that measure: distances and angles in slices and on surfaces."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from accelsurf.viewer.core.measurements import Measurements
from accelsurf.viewer.scene.picking import Picked
from accelsurf.viewer.workplace.tool import Tool

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.workplace import Workplace

#: An end is grabbed from so many pixels away, of a usual screen.
GRAB = 9.0
#: A press that has moved by no more is a click.
CLICK = 2.0


class Distance(Tool):
    """Draws a line from a press to a release, or from click to click; its ends can be dragged."""

    name, key, text = "distance", "D", "Length"
    tip = "Drag from one end to the other, or click both; drag an end to move it"

    def __init__(self, workplace: Workplace, measurements: Measurements) -> None:
        super().__init__(workplace)
        self._measurements = measurements
        #: Number of the measurement, and its end, that moves with the mouse.
        self._held: tuple[int, int] | None = None
        self._unfinished: int | None = None
        #: Takes back what the last press has done, until the button is up.
        self._restore: Callable[[], None] | None = None
        self._pixel_mm = 0.0

    def press(self, at: Picked) -> None:
        if at.world is None:
            return
        known = self._measurements
        tiles = self.workplace.scene.tiles
        self._pixel_mm = tiles.pixel_ratio * tiles.mm_per_pixel(at.tile)
        near = known.nearest(at.world, GRAB * self._pixel_mm)
        if self._unfinished is not None and near != (self._unfinished, len(known[self._unfinished].points) - 1):
            known.add_point(self._unfinished, at.world)
            self._restore = functools.partial(known.shorten, self._unfinished)
            self._held = self._unfinished, len(known[self._unfinished].points) - 1
        elif near is not None:
            self._held = near
            self._restore = functools.partial(known.move, *near, known[near[0]].points[near[1]])
        else:
            one = known.add(self.name, [at.world, at.world])
            self._held, self._unfinished, self._restore = (one.number, 1), one.number, self.forget
        self._show()

    def move(self, at: Picked) -> None:
        if self._held is not None and at.world is not None:
            self._measurements.move(*self._held, at.world)
            self._show(at.tile)

    def release(self) -> None:
        held, self._held, self._restore = self._held, None, None
        if held is not None and held[0] == self._unfinished:
            self._finish(held[0])
        self._show()

    def _finish(self, number: int) -> None:
        """The button went up while this one was drawn: has it all its points?"""
        one = self._measurements[number]
        if len(one.points) == 2 and np.linalg.norm(np.subtract(*one.points)) <= CLICK * self._pixel_mm:
            self._measurements.shorten(one.number)  # a click: the next one is the second point
        elif one.is_complete:
            self._unfinished = None

    def cancel(self) -> None:
        """What was clicked before this press stays."""
        restore, self._restore, self._held = self._restore, None, None
        if restore is not None:
            restore()
        self._show()

    def leave(self) -> None:
        """Another tool is used: what has not all its points is forgotten."""
        self.forget()
        self._show()

    def forget(self) -> None:
        """Let go of what is held, and delete what is unfinished."""
        if self._unfinished is not None and self._unfinished in self._measurements:
            self._measurements.delete(self._unfinished)
        self._held = self._unfinished = self._restore = None

    def _show(self, dragged_in: str | None = None) -> None:
        self.workplace.scene.measures.show(self._measurements, dragged_in)
        self.workplace.changed = True


class Angle(Distance):
    """Draws two arms: a drag along the first to the corner, then a press or a drag at the end of the second."""

    name, key, text = "angle", "J", "Angle"
    tip = "Drag (or click twice) from an end to the corner, then press at the other end"


