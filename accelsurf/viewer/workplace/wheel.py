"""How far a wheel has turned: notches, whole ones of a mouse, fractions of one under two fingers on a trackpad."""

from __future__ import annotations

import math

from accelsurf.viewer.workplace.checks import number, whole

#: Zoom per notch.
ZOOM = 1.12
#: What browsers report for a notch, in pixels, lines and pages: the modes in which they count, in this order.
PER_NOTCH = (100.0, 3.0, 1.0)
#: From this part of a notch in pixels on it is a mouse's, which turns by whole notches: how many pixels one has depends
#: on the system and on the browser's own zoom.
WHOLE = 0.5
#: Largest magnitude that a browser may report.
MAX_DELTA = 1e6


def notches_of(delta: object, mode: object, zoom: bool) -> float:
    """Return the notches of what a browser reports of a wheel, up positive.

    Parameters
    ----------
    delta, mode : object
        ``deltaY`` and ``deltaMode`` of the event, not trusted.
    zoom : bool
        Whether it zooms: a small turn is then a pinch on a trackpad, of which 100 pixels are a factor of e.

    Raises
    ------
    UsageError
        When they are no such numbers.

    Examples
    --------
    >>> notches_of(-120, 0, False), notches_of(-4, 0, False), notches_of(3, 1, False), notches_of(0, 0, False)
    (1.0, 0.04, -1.0, 0.0)
    """
    unit = whole(mode, 0, len(PER_NOTCH) - 1)
    turned = 0.0 - number(delta, -MAX_DELTA, MAX_DELTA) / PER_NOTCH[unit]
    if unit == 0 and abs(turned) >= WHOLE:
        return math.copysign(min(max(round(abs(turned)), 1), 100), turned)
    if unit == 0 and zoom:
        return turned / math.log(ZOOM)
    return min(max(turned, -100.0), 100.0)


class SliceTurns:
    """Turns of the wheel over slices: fractions of a notch add up until they are a whole slice."""

    def __init__(self) -> None:
        self._tile, self._left = "", 0.0

    def add(self, tile: str, notches: float) -> int:
        """Add a turn over a tile; returns how many slices further it is now."""
        if tile != self._tile or notches * self._left < 0:
            self._left = 0.0
        self._tile, self._left = tile, self._left + notches
        slices = int(self._left + math.copysign(1e-9, self._left))
        self._left -= slices
        return slices
