"""What a page may ask of a session: each request is checked before anything is done.

A page is not trusted: it may send any name with any values. What is passed on is finite, within bounds, and of the
types that session and scene expect; everything else is reported as an error and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from accelsurf.errors import AccelsurfError, UsageError
from accelsurf.grid.clicks import SIDES
from accelsurf.settings.catalogue import choices, sliders
from accelsurf.viewer.core.frame import COLORS
from accelsurf.viewer.core.saving import KINDS
from accelsurf.viewer.core.session import Session
from accelsurf.viewer.core.size_drag import Dragging
from accelsurf.viewer.scene.colors import THEMES
from accelsurf.viewer.scene.mouse import MODES, Mouse
from accelsurf.viewer.scene.scene import Scene
from accelsurf.viewer.scene.space import VIEWS

#: Settings that a page may change, those of sliders and lists, and the largest number of letters of a value.
SETTINGS = (*sliders(), *choices())
MAX_LETTERS = 40
#: Smallest and largest size of a picture, pixels.
MIN_SIZE, MAX_SIZE = (480, 272), (2560, 1600)
#: Largest magnitude of a setting.
_MAX_SETTING = 1e6


class RequestHandler:
    """Checks and carries out the requests of a page.

    Parameters
    ----------
    session : Session
    scene : Scene
    folder : Path
        Where files are saved; nothing is read or written elsewhere.
    overwrite : bool, optional
        Replace files there that this session has not written.

    Attributes
    ----------
    changed : bool
        Whether the scene has changed since it was drawn last; whoever draws it resets this.
    message : str
        What went wrong last, in one line; empty when nothing did.
    files : dict of str to Path
        What has been saved, by name.
    object_id : int or None
        Id of the object that balls are added to or removed from; None is the nearest.
    """

    def __init__(self, session: Session, scene: Scene, folder: Path, overwrite: bool = False) -> None:
        self.session, self.scene, self.folder, self._overwrite = session, scene, folder, overwrite
        self.mouse = Mouse(scene)
        self.changed, self.message = True, ""
        self.files: dict[str, Path] = {}
        self.object_id: int | None = None
        self.color, self.theme, self.volume, self.planes = "plain", "dark", False, False
        self._dragging: Dragging | None = None
        self._waiting: list[tuple[Future[Any], Callable[[Any], None] | None]] = []
        self._requests: dict[str, Callable[..., None]] = {
            "play": lambda: self._ask(session.play()),
            "pause": lambda: self._ask(session.pause()),
            "toggle": self._toggle,
            "step": lambda: self._ask(session.single_step()),
            "go_to": lambda step: self._ask(session.go_to(_whole(step, 0, 10**9))),
            "restart": lambda: self._ask(session.restart()),
            "undo": lambda: self._ask(session.undo()),
            "redo": lambda: self._ask(session.redo()),
            "set": self._set,
            "save": self._save,
            "mode": lambda mode: self.mouse.set_mode(_word(mode, MODES)),
            "object": self._object,
            "radius": self._radius,
            "press": self._press,
            "move": self._move,
            "release": self._release,
            "wheel": lambda x, y, n: self.mouse.wheel(*self._pixel(x, y), _number(n, -100, 100)),
            "color": self._color,
            "theme": self._theme,
            "volume": self._volume,
            "planes": self._planes,
            "view": lambda name: scene.look_from(_word(name, tuple(VIEWS))),
            "size": self._size,
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the requests that there are."""
        return tuple(self._requests)

    def request(self, name: Any, *values: Any) -> None:
        """Carry out a request; what is wrong with it becomes `message`. Raises nothing."""
        try:
            work = self._requests.get(name) if isinstance(name, str) else None
            if work is None:
                raise UsageError(f"request: {_short(name)} is not known")
            try:
                work(*values)
            except TypeError as error:
                if "argument" not in str(error):
                    raise
                raise UsageError(f"{name}: {len(values)} values were given, another number expected") from None
            self.changed = True
        except AccelsurfError as error:
            self.message = error.message
        except Exception as error:
            self.message = f"internal error: {type(error).__name__}: {error}"[:300]

    def collect_results(self) -> None:
        """Read the results and errors of the commands that have been carried out."""
        waiting, self._waiting = self._waiting, []
        for future, then in waiting:
            if not future.done():
                self._waiting.append((future, then))
            elif error := future.exception():
                self.message = error.message if isinstance(error, AccelsurfError) else str(error)
            elif then is not None:
                then(future.result())

    # -- requests -----------------------------------------------------------------------------------------

    def _ask(self, future: Future[Any], then: Callable[[Any], None] | None = None) -> None:
        self.message = ""
        self._waiting.append((future, then))

    def _toggle(self) -> None:
        self._ask(self.session.pause() if self.session.status.playing else self.session.play())

    def _set(self, key: Any, value: Any) -> None:
        key = _word(key, SETTINGS)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            value = str(_number(value, -_MAX_SETTING, _MAX_SETTING))
        if not isinstance(value, str) or len(value) > MAX_LETTERS or not value.isprintable():
            raise UsageError(f"{key}: {_short(value)} was given, expected a number or a word")
        self._ask(self.session.change(**{key: value.strip()}))

    def _save(self, *what: Any) -> None:
        kinds = [_word(kind, KINDS) for kind in what] or list(KINDS)
        self._ask(self.session.save(self.folder, kinds, self._overwrite), self._saved)

    def _saved(self, paths: list[Path]) -> None:
        home = self.folder.resolve()
        # The session chooses the names; a file elsewhere would not be served all the same.
        self.files |= {path.name: path for path in paths if path.resolve().parent == home}

    def _object(self, number: Any) -> None:
        ids = self.session.status.objects
        known = {"nearest": None, **{str(own): own for own in ids}}
        word = str(_whole(number, 0, 2**32)) if isinstance(number, (int, float)) else number
        self.object_id = known[_word(word, tuple(known))]

    def _radius(self, mm: Any) -> None:
        self.mouse.radius = _number(mm, 0.0, float(max(self.scene.geometry.extent_mm)))

    def _press(self, x: Any, y: Any, shift: Any) -> None:
        self.mouse.press(*self._pixel(x, y), bool(shift))
        if self.mouse.mode == "size" and self.mouse.ball is not None:
            self._dragging = Dragging(self.session.press, self.mouse.ball)
            self._ask(self._dragging.pressed)

    def _move(self, x: Any, y: Any) -> None:
        self.mouse.move(*self._pixel(x, y))
        drag = None if self._dragging is None else self._dragging.at(self.mouse.drag_mm)
        if drag is not None:
            self.scene.mark_size(drag, self.mouse.drag_mm)

    def _release(self) -> None:
        placed, dragging = self.mouse.release(), self._dragging
        self._dragging = None
        self.scene.mark_size(None)
        if placed is None:
            return
        mode, balls = placed
        if mode == "size":
            if dragging is not None and self.mouse.drag_mm > 0:
                self._ask(self.session.release(self.mouse.drag_mm))
        elif mode in SIDES:
            self._ask(self.session.add_click("inside" if mode == "inside" else "outside", balls, self.object_id))
        elif mode == "start":
            self._ask(self.session.start_from(balls))
        else:
            self._ask(self.session.edit_ball("add" if mode == "add" else "remove", balls[0], self.object_id))

    def _color(self, name: Any) -> None:
        self.color = _word(name, COLORS)
        self.scene.color_by(self.color)

    def _theme(self, name: Any) -> None:
        self.theme = _word(name, tuple(THEMES))
        self.scene.paint(self.theme)

    def _volume(self, on: Any) -> None:
        self.volume = bool(on)
        self.scene.show_volume(self.volume)

    def _planes(self, on: Any) -> None:
        self.planes = bool(on)
        self.scene.show_planes(self.planes)

    def _size(self, width: Any, height: Any) -> None:
        # In steps of 8, so that resizing a window does not redraw the scene for every pixel.
        sides = [
            int(min(max(_number(side, 0, 1e6), low), high)) // 8 * 8
            for side, low, high in zip((width, height), MIN_SIZE, MAX_SIZE, strict=True)
        ]
        self.scene.resize(*sides)

    def _pixel(self, x: Any, y: Any) -> tuple[float, float]:
        """Pixels from the lower left corner, of fractions of the width and of the height from the top."""
        width, height = self.scene.plotter.render_window.GetSize()
        return _number(x, 0.0, 1.0) * width, (1.0 - _number(y, 0.0, 1.0)) * height


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, str) and len(value) <= MAX_LETTERS:
        try:
            value = float(value)
        except ValueError:
            value = math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise UsageError(f"{_short(value)} was given, expected a number from {low:g} to {high:g}")
    return float(value)


def _whole(value: Any, low: int, high: int) -> int:
    return int(_number(value, low, high))


def _word(value: Any, words: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in words:
        raise UsageError(f"{_short(value)} was given, expected {', '.join(words)}")
    return value


def _short(value: Any) -> str:
    """A value in a few letters, for messages."""
    text = value if isinstance(value, str) else type(value).__name__ if isinstance(value, (list, dict)) else repr(value)
    return "".join(c if c.isprintable() else "?" for c in text[:MAX_LETTERS])
