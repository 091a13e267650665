"""The objects: a list with names, colours, volumes; the active one takes strokes and sizes; merged, split, removed."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from accelsurf.errors import UsageError
from accelsurf.settings.edits import MAX_ID
from accelsurf.settings.labels import MAX_NAME
from accelsurf.viewer.core.status import Status, View
from accelsurf.viewer.scene.colors import OBJECT_COLORS
from accelsurf.viewer.scene.object_styles import ObjectStyle, unnamed
from accelsurf.viewer.scene.picking import Picked
from accelsurf.viewer.workplace.checks import number, short, text, whole, word
from accelsurf.viewer.workplace.feature import Feature, Key
from accelsurf.viewer.workplace.tool import Tool, numbers_text

#: In place of an id: the object that is nearest to where a stroke begins.
NEAREST = "nearest"
#: The state of an object that was added and has no voxel yet.
NOT_BEGUN = "not begun"
_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


class _Drawn(NamedTuple):
    """What the last frame shows of an object."""

    mm3: float
    voxels: int


class Split(Tool):
    """Splits off the component under a click."""

    name, key, text = "split", "Q", "Split"
    tip = "Click in a part of an object: what is connected to it becomes an object of its own"

    def __init__(self, workplace: Any) -> None:
        super().__init__(workplace)
        self._at: tuple[float, ...] = ()

    def press(self, at: Picked) -> None:
        self._at = () if at.world is None else tuple(map(float, at.world))

    def release(self) -> None:
        at, self._at = self._at, ()
        if at:
            self.workplace.request("object_split", *at)

    def leave(self) -> None:
        self._at = ()


class ObjectsFeature(Feature):
    """What a person does with objects, and how each is drawn."""

    def __init__(self, workplace: Any) -> None:
        super().__init__(workplace)
        self._hidden: set[int] = set()
        self._opacity: dict[int, float] = {}
        self._palette: dict[int, str] = {}
        self._drawn: dict[int, _Drawn] = {}

    def requests(self) -> Mapping[str, Callable[..., None]]:
        return {
            "object": self._active,  # as `object_active`
            "object_active": self._active,
            "object_add": self._add,
            "object_remove": self._remove,
            "object_name": self._name,
            "object_color": self._color,
            "object_visible": self._visible,
            "object_opacity": self._set_opacity,
            "object_merge": self._merge,
            "object_split": self._split,
        }

    def tools(self) -> Sequence[Tool]:
        return (Split(self.workplace),)

    def keys(self) -> Mapping[str, Key]:
        return {"U": Key("object_add", (), "a further object: the next press or click inside begins it")}

    def state(self, status: Status) -> dict[str, Any]:
        styles = self._styles(status)
        return {
            "object_active": self.workplace.object_id or 0,
            "object_rows": [self._described(own, style, status) for own, style in styles.items()],
        }

    def update(self, view: View) -> None:
        self._drawn = {one.id: _Drawn(one.record.volume_mm3, one.voxels) for one in view.frame.surfaces}
        self._show(view.status)

    # -- what is shown -------------------------------------------------------------------------------------

    def _ids(self, status: Status) -> list[int]:
        """Ids of all objects, and of one that was added and has not begun."""
        own = self.workplace.object_id
        ids = list(status.objects or (1,))
        return ids if own is None or own in ids else [*ids, own]

    def _styles(self, status: Status) -> dict[int, ObjectStyle]:
        styles = {}
        for own in self._ids(status):
            # A colour stays with its object, whatever becomes of the others.
            usual = self._palette.setdefault(own, OBJECT_COLORS[len(self._palette) % len(OBJECT_COLORS)])
            said = status.labels.entries.get(own)
            name = unnamed(own) if said is None else said.name
            color = usual if said is None else said.hex
            styles[own] = ObjectStyle(name, color, own not in self._hidden, self._opacity.get(own, 1.0))
        return styles

    def _described(self, own: int, style: ObjectStyle, status: Status) -> dict[str, Any]:
        drawn = self._drawn.get(own)
        is_there = drawn is not None and own in (status.objects or (1,))
        return {
            "id": own, **style._asdict(),
            "ml": f"{drawn.mm3 / 1000.0:.4g}" if is_there and drawn is not None else "",
            "voxels": drawn.voxels if is_there and drawn is not None else 0,
            "word": status.object_words.get(own, NOT_BEGUN),
        }

    def _show(self, status: Status) -> None:
        """Draw each object in its style, where that has changed."""
        styles = self._styles(status)
        if styles != self.workplace.scene.styles.given:
            self.workplace.scene.restyle(styles)
            self.workplace.changed = True

    def _known(self, wanted: Any) -> int:
        """The id of an object in the list.

        Raises
        ------
        UsageError
        """
        ids = self._ids(self.workplace.session.status)
        own = whole(wanted, 1, MAX_ID)
        if own not in ids:
            raise UsageError(f"object {own} was given, expected one of {', '.join(map(str, ids[:20]))}")
        return own

    # -- what is asked -------------------------------------------------------------------------------------

    def _active(self, wanted: Any) -> None:
        ids = self._ids(self.workplace.session.status)
        name = str(int(wanted)) if isinstance(wanted, float) and wanted.is_integer() else wanted
        name = str(name) if isinstance(name, int) and not isinstance(name, bool) else name
        known = word(name, (NEAREST, *map(str, ids)))
        self.workplace.object_id = None if known == NEAREST else int(known)

    def _add(self) -> None:
        status = self.workplace.session.status
        own = max(status.objects or (1,)) + 1
        if own > MAX_ID:
            raise UsageError("objects: there is no further id")
        self.workplace.object_id = own
        self.workplace.request("tool", "size")
        self.workplace.note(f"object {own}: press in it and drag outwards until the outline fits, or click inside", 30)

    def _remove(self, wanted: Any) -> None:
        own, ids = self._known(wanted), self.workplace.session.status.objects or (1,)
        if own in ids:
            self.workplace.ask(self.workplace.session.objects(lambda objects: objects.remove(own)))
        if self.workplace.object_id == own:
            self.workplace.object_id = None

    def _name(self, wanted: Any, name: Any) -> None:
        own, name = self._known(wanted), text(name, MAX_NAME)
        if not name:
            raise UsageError(f"object {own}: no name was given")
        self._describe(own, name=name)

    def _color(self, wanted: Any, color: Any) -> None:
        own, color = self._known(wanted), text(color, 7)
        if not _COLOR.fullmatch(color):
            raise UsageError(f"color: {short(color)} was given, expected #rrggbb")
        self._describe(own, color=color)

    def _describe(self, own: int, name: str = "", color: str = "") -> None:
        """Name or colour an object. Files then have a name and a colour for each: those that are seen."""
        styles = self._styles(self.workplace.session.status)
        before = styles[own]
        styles[own] = before._replace(name=name or before.name, color=color or before.color)
        said = {each: (style.name, style.color) for each, style in styles.items()}
        self.workplace.ask(self.workplace.session.objects(lambda objects: objects.describe(said, own)))

    def _visible(self, wanted: Any, on: Any) -> None:
        own = self._known(wanted)
        self._hidden = self._hidden - {own} if on else self._hidden | {own}
        self._show(self.workplace.session.status)

    def _set_opacity(self, wanted: Any, opacity: Any) -> None:
        own = self._known(wanted)
        self._opacity[own] = number(opacity, 0.0, 1.0)
        self._show(self.workplace.session.status)

    def _merge(self, *wanted: Any) -> None:
        ids = tuple(self._known(one) for one in wanted)
        if len(ids) < 2 or len(set(ids)) < len(ids):
            raise UsageError("merge: expected at least two objects")
        self.workplace.ask(self.workplace.session.objects(lambda objects: objects.merge(ids)))
        if self.workplace.object_id in ids:
            self.workplace.object_id = ids[0]

    def _split(self, x: Any, y: Any, z: Any) -> None:
        place = numbers_text(number(one, -1e9, 1e9) for one in (x, y, z))
        self.workplace.ask(self.workplace.session.objects(lambda objects: objects.split(f"point:{place}")))
