"""Bases of actions: groups of requests, tools of the left button, keys; and checks of values that a page has sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.viewer.core.sequence_view import SequenceView
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.status import Status, View
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.space import Picked

P = TypeVar("P", bound="Feature")


class AllActions(Protocol):
    """All actions, as far as a group of them uses the others; see `accelsurf.viewer.actions.actions.Actions`."""

    session: Session
    scene: Scene
    folder: Path | None
    overwrite: bool
    frames: SequenceView | None
    object_id: int | None
    radius: float
    features: tuple[Feature, ...]
    tools: dict[str, Tool]

    def feature(self, kind: type[P]) -> P:
        """Return the feature of a kind."""

    def request(self, name: Any, *values: Any) -> None:
        """Carry out a request."""

    def ask(self, future: Future[Any], then: Callable[[Any], None] | None = None) -> None:
        """Wait for a command of the session, without blocking."""

    def note(self, line: str, seconds: float = 8.0) -> None:
        """Show a line for some time."""

    def copy(self, words: str) -> None:
        """Put a text on the clipboard."""


class Key(NamedTuple):
    """Effect of a key: a ``request`` with its ``values``, and the ``text`` of the help."""

    request: str
    values: tuple[Any, ...]
    text: str


class Feature:
    """A group of actions; knows neither the window nor the page.

    Parameters
    ----------
    actions : AllActions
        Has session and scene.
    """

    def __init__(self, actions: AllActions) -> None:
        self.actions = actions

    def requests(self) -> Mapping[str, Callable[..., None]]:
        """Return the requests by name. Values come from a page and are not trusted: each is checked."""
        return {}

    def tools(self) -> Sequence[Tool]:
        """Return the tools of the left button."""
        return ()

    def keys(self) -> Mapping[str, Key]:
        """Return the effect of each key, by Qt's names: ``Space``, ``Ctrl+Z``, ``N``."""
        return {}

    def state(self, status: Status) -> dict[str, Any]:
        """Return the state that panels show, in types of JSON; names are unique over all features. Must be cheap."""
        return {}

    def update(self, view: View) -> None:
        """Take a view that has been drawn."""


#: The largest number of letters of a value.
MAX_LETTERS = 40


def number(value: Any, low: float, high: float) -> float:
    """Return a finite number from ``low`` to ``high``; a text may stand for it.

    Raises
    ------
    UsageError
        For anything else.
    """
    if isinstance(value, str) and len(value) <= MAX_LETTERS:
        try:
            value = float(value)
        except ValueError:
            value = math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise UsageError(f"{short(value)} was given, expected a number from {low:g} to {high:g}")
    return float(value)


def whole(value: Any, low: int, high: int) -> int:
    """Return a whole number from ``low`` to ``high``; a fraction is cut off.

    Raises
    ------
    UsageError
        For anything else.
    """
    return int(number(value, low, high))


def word(value: Any, words: tuple[str, ...]) -> str:
    """Return one of the words.

    Raises
    ------
    UsageError
        For anything else.
    """
    if not isinstance(value, str) or value not in words:
        raise UsageError(f"{short(value)} was given, expected {', '.join(words)}")
    return value


def text(value: Any, letters: int) -> str:
    """Return a printable text of at most ``letters`` letters, without blanks at its ends.

    Raises
    ------
    UsageError
        For anything else.
    """
    if not isinstance(value, str) or len(value) > letters or not value.isprintable():
        raise UsageError(f"{short(value)} was given, expected a text of at most {letters} letters")
    return value.strip()


def carry_out(
    requests: Mapping[str, Callable[..., None]], name: Any, values: Sequence[Any]
) -> None:
    """Carry out a request that a page has sent.

    Raises
    ------
    UsageError
        When there is none of this name, or it takes another number of values; and the request's own errors.
    """
    work = requests.get(name) if isinstance(name, str) else None
    if work is None:
        raise UsageError(f"request: {short(name)} is not known")
    try:
        work(*values)
    except TypeError as error:
        if "argument" not in str(error):
            raise
        raise UsageError(
            f"{name}: {len(values)} values were given, another number expected"
        ) from None


def short(value: Any) -> str:
    """Return a value in a few letters, for messages."""
    kind = type(value).__name__ if isinstance(value, (list, dict)) else repr(value)
    shown = value if isinstance(value, str) else kind
    return "".join(c if c.isprintable() else "?" for c in shown[:MAX_LETTERS])


class Tool:
    """Effect of a drag with the left button.

    Parameters
    ----------
    actions : AllActions

    Attributes
    ----------
    name : str
        In requests.
    key, text, tip : str
        Its key, the text on its button, and a line about its effect.
    """

    name = key = text = tip = ""

    def __init__(self, actions: AllActions) -> None:
        self.actions = actions

    def press(self, at: Picked) -> None:
        """Begin where the button goes down in a slice or on a surface."""

    def move(self, at: Picked) -> None:
        """Go on to another place of the tile in which the button went down."""

    def release(self) -> None:
        """End: the button goes up."""

    def cancel(self) -> None:
        """Take back the press: all is as before it, and the button is up."""
        self.leave()

    def resize(self) -> None:
        """Use another radius."""

    def leave(self) -> None:
        """Let go: another tool is used from now on."""

    @property
    def radius(self) -> float:
        """Radius of click and ball, mm."""
        return self.actions.radius


def ball_text(center: NDArray[np.float64], radius: float) -> str:
    """Return a ball as settings have it, ``ball:X,Y,Z,R``."""
    return f"ball:{numbers_text((*center, radius))}"


def numbers_text(numbers: Iterable[float]) -> str:
    """Return numbers as settings have them.

    Examples
    --------
    >>> numbers_text((1.0, -2.5, 1 / 3))
    '1,-2.5,0.333333'
    """
    return ",".join(f"{value:.6g}" for value in numbers)


def finest(geometry: Geometry) -> float:
    """Return the smallest spacing of an image, mm, along axes of more than one voxel."""
    return min(
        (h for h, n in zip(geometry.spacing, geometry.shape, strict=True) if n > 1), default=1.0
    )


def first_radius(geometry: Geometry) -> float:
    """Return the radius of click and ball at first, mm."""
    sides = (h * n for h, n in zip(geometry.spacing, geometry.shape, strict=True) if n > 1)
    return max(0.012 * min(sides, default=1.0), 2.0 * finest(geometry))


#: Actions of the mouse by place.
MOUSE = (
    ("left in 3D", "turns"),
    ("left in a slice", "uses the tool; Look moves the slices through the point"),
    ("right in a slice", "grey values: sideways the width, up and down the level"),
    ("right in 3D", "zooms"),
    ("middle, or shift with left", "moves the picture"),
    ("wheel", "next slice; zooms in 3D; with Ctrl, or a pinch, zooms in a slice"),
    ("two fingers on a screen", "zoom and move what is under them"),
    ("double click", "with Look: this tile alone, and back"),
)


def help_rows(keys: Mapping[str, Key]) -> list[tuple[str, str]]:
    """Return the actions of keys and mouse, keys of the same kind of action in one row.

    Examples
    --------
    >>> help_rows({"V": Key("tool", ("look",), "look"), "S": Key("tool", ("size",), "size")})[0]
    ('V  S', 'look, size')
    """
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for key, does in keys.items():
        # Tools are one row of short words; other keys have a row each.
        names, texts = rows.setdefault("tool" if does.request == "tool" else key, ([], []))
        names.append(key)
        texts.append(does.text)
    return [("  ".join(names), ", ".join(texts)) for names, texts in rows.values()] + list(MOUSE)
