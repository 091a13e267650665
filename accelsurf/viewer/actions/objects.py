"""The objects: a list with names, colours, volumes; the active one takes corrections and sizes; merge and split."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from accelsurf.errors import UsageError
from accelsurf.settings.corrections import MAX_ID
from accelsurf.settings.labels import MAX_NAME
from accelsurf.settings.wording import volume_text
from accelsurf.viewer.actions.tool import (
    AllActions,
    Feature,
    Key,
    Tool,
    number,
    numbers_text,
    short,
    text,
    whole,
    word,
)
from accelsurf.viewer.core.status import Status, View
from accelsurf.viewer.scene.space import Picked

#: In place of an id: the object that is nearest to where a correction begins.
NEAREST = "nearest"
#: The state of an object that was added and has no voxel yet.
NOT_BEGUN = "not begun"
_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


class Split(Tool):
    """Splits off the component under a click."""

    name = "split"
    key = "Q"
    text = "Split"
    tip = "Click in a part of an object: what is connected to it becomes an object of its own"

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        self._at: tuple[float, ...] = ()

    def press(self, at: Picked) -> None:
        self._at = () if at.world is None else tuple(map(float, at.world))

    def release(self) -> None:
        at, self._at = self._at, ()
        if at:
            self.actions.request("object_split", *at)

    def leave(self) -> None:
        self._at = ()


class ObjectsFeature(Feature):
    """Changes objects, and the style in which each is drawn."""

    def __init__(self, actions: AllActions) -> None:
        super().__init__(actions)
        #: Sizes of the objects in the last frame.
        self._sizes: dict[int, dict[str, Any]] = {}

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
        return (Split(self.actions),)

    def keys(self) -> Mapping[str, Key]:
        return {
            "U": Key("object_add", (), "a further object: the next press or click inside begins it")
        }

    def state(self, status: Status) -> dict[str, Any]:
        self._take_names(status)
        return {
            "object_active": self.actions.object_id or 0,
            "object_rows": [self._described(object_id, status) for object_id in self._ids(status)],
        }

    def update(self, view: View) -> None:
        self._sizes = {
            surface.id: {
                "volume": volume_text(surface.record.volume_mm3, self.actions.scene.unit),
                "voxels": surface.voxels,
            }
            for surface in view.frame.surfaces
        }
        self._take_names(view.status)

    # -- state --------------------------------------------------------------------------------------------

    def _ids(self, status: Status) -> list[int]:
        """Ids of all objects, and of one that was added and has not begun."""
        object_id = self.actions.object_id
        ids = list(status.objects or (1,))
        return ids if object_id is None or object_id in ids else [*ids, object_id]

    def _described(self, object_id: int, status: Status) -> dict[str, Any]:
        size = self._sizes.get(object_id) if object_id in (status.objects or (1,)) else None
        return {
            "id": object_id,
            **self.actions.scene.styles[object_id]._asdict(),
            **(size or {"volume": "", "voxels": 0}),
            "word": status.object_words.get(object_id, NOT_BEGUN),
        }

    def _take_names(self, status: Status) -> None:
        """Draw each object with its name and colour, where those have changed."""
        if status.labels is not self.actions.scene.styles.labels:
            self.actions.scene.name_objects(status.labels)

    def _known(self, wanted: Any) -> int:
        """The id of an object in the list.

        Raises
        ------
        UsageError
        """
        ids = self._ids(self.actions.session.status)
        object_id = whole(wanted, 1, MAX_ID)
        if object_id not in ids:
            raise UsageError(
                f"object {object_id} was given, expected one of {', '.join(map(str, ids[:20]))}"
            )
        return object_id

    # -- requests -----------------------------------------------------------------------------------------

    def _active(self, wanted: Any) -> None:
        ids = self._ids(self.actions.session.status)
        name = str(int(wanted)) if isinstance(wanted, float) and wanted.is_integer() else wanted
        name = str(name) if isinstance(name, int) and not isinstance(name, bool) else name
        known = word(name, (NEAREST, *map(str, ids)))
        self.actions.object_id = None if known == NEAREST else int(known)

    def _add(self) -> None:
        status = self.actions.session.status
        object_id = max(status.objects or (1,)) + 1
        if object_id > MAX_ID:
            raise UsageError("objects: there is no further id")
        self.actions.object_id = object_id
        self.actions.request("tool", "size")
        how = "press in it and drag outwards until the outline fits, or click inside"
        self.actions.note(f"object {object_id}: {how}", 30)

    def _remove(self, wanted: Any) -> None:
        object_id, ids = self._known(wanted), self.actions.session.status.objects or (1,)
        if object_id in ids:
            self.actions.ask(
                self.actions.session.objects(lambda objects: objects.remove(object_id))
            )
        if self.actions.object_id == object_id:
            self.actions.object_id = None

    def _name(self, wanted: Any, name: Any) -> None:
        object_id, name = self._known(wanted), text(name, MAX_NAME)
        if not name:
            raise UsageError(f"object {object_id}: no name was given")
        self._describe(object_id, name=name)

    def _color(self, wanted: Any, color: Any) -> None:
        object_id, color = self._known(wanted), text(color, 7)
        if not _COLOR.fullmatch(color):
            raise UsageError(f"color: {short(color)} was given, expected #rrggbb")
        self._describe(object_id, color=color)

    def _describe(self, object_id: int, name: str = "", color: str = "") -> None:
        """Name or colour an object. Files then have a name and a colour for each: those that are seen."""
        ids = self._ids(self.actions.session.status)
        styles = {each: self.actions.scene.styles[each] for each in ids}
        before = styles[object_id]
        styles[object_id] = before._replace(name=name or before.name, color=color or before.color)
        said = {each: (style.name, style.color) for each, style in styles.items()}
        self.actions.ask(
            self.actions.session.objects(lambda objects: objects.describe(said, object_id))
        )

    def _visible(self, wanted: Any, on: Any) -> None:
        self.actions.scene.styles.show(self._known(wanted), bool(on))
        self.actions.scene.restyle()

    def _set_opacity(self, wanted: Any, opacity: Any) -> None:
        self.actions.scene.styles.fade(self._known(wanted), number(opacity, 0.0, 1.0))
        self.actions.scene.restyle()

    def _merge(self, *wanted: Any) -> None:
        ids = tuple(self._known(named) for named in wanted)
        if len(ids) < 2 or len(set(ids)) < len(ids):
            raise UsageError("merge: expected at least two objects")
        self.actions.ask(self.actions.session.objects(lambda objects: objects.merge(ids)))
        if self.actions.object_id in ids:
            self.actions.object_id = ids[0]

    def _split(self, x: Any, y: Any, z: Any) -> None:
        place = numbers_text(number(part, -1e9, 1e9) for part in (x, y, z))
        self.actions.ask(
            self.actions.session.objects(lambda objects: objects.split(f"point:{place}"))
        )
