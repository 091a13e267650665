"""Every kernel compiled and stored before it is needed: the small runs and trackings, and a small picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from accelsurf.api import warmup
from accelsurf.output.pictures.rasterizer import render
from accelsurf.track import track


def small_runs() -> dict[str, Callable[[], Any]]:
    """Runs by name, that together call every kernel."""
    return {**warmup.small_runs(), **track.small_runs(), "a picture": _picture}


def _picture() -> None:
    """A triangle that faces the viewer."""
    render([[0, 0, 0], [9, 0, 0], [0, 0, 9]], [[0, 1, 2]], size=8)
