"""A feature of the workplace: what a person can ask of it, and what it shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from accelsurf.viewer.core.status import Status, View

if TYPE_CHECKING:
    from accelsurf.viewer.workplace.tool import Tool
    from accelsurf.viewer.workplace.workplace import Workplace


class Key(NamedTuple):
    """What a key does: a ``request`` with its ``values``, and the ``text`` of the help."""

    request: str
    values: tuple[Any, ...]
    text: str


class Feature:
    """A feature of the workplace; knows neither the window nor the page.

    Parameters
    ----------
    workplace : Workplace
        Has session and scene.
    """

    def __init__(self, workplace: Workplace) -> None:
        self.workplace = workplace

    def requests(self) -> Mapping[str, Callable[..., None]]:
        """What can be asked for, by name. Values come from a page and are not trusted: each is checked."""
        return {}

    def tools(self) -> Sequence[Tool]:
        """What a drag of the left button may do."""
        return ()

    def keys(self) -> Mapping[str, Key]:
        """What each key does, by Qt's names: ``Space``, ``Ctrl+Z``, ``N``."""
        return {}

    def state(self, status: Status) -> dict[str, Any]:
        """What panels show, in types of JSON; names are unique over all features. Must be cheap."""
        return {}

    def update(self, view: View) -> None:
        """A new frame has been drawn."""

    def save_beside(self, folder: Path) -> list[Path]:
        """Write what belongs beside the files of the run, which have been saved; return the paths."""
        return []
