"""Several objects in a session: ids, names, the one that is meant; objects that begin beside others, are merged, split
off, removed.

An object that a person adds is a correction, as `accelsurf refine` makes it: the others stay. While the run goes on
it goes to its end first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from accelsurf.clicks import CLICK_ROOM, Scene, first_blocks, seed_of
from accelsurf.errors import UsageError
from accelsurf.grid.boxes import corner_of, placed_at
from accelsurf.grid.clicks import Clicks, Side
from accelsurf.output import given_labels
from accelsurf.run import BoxMask, Run
from accelsurf.settings.labels import colored, named
from accelsurf.settings.run_config import RunConfig
from accelsurf.text.clicks import read_clicks
from accelsurf.viewer.core.corrected_run import Corrections
from accelsurf.viewer.core.first_answers import FirstAnswers
from accelsurf.viewer.core.restarted import FROM_CLICKS
from accelsurf.viewer.core.size_drag import SizeDrag


class Steered(Protocol):
    """A run that is steered; see `accelsurf.viewer.core.timeline.Timeline`."""

    run: Run
    corrections: Corrections
    answers: FirstAnswers

    @property
    def is_playing(self) -> bool:
        """True if more steps are to be made."""
        ...

    def say(self, message: str) -> None:
        """Have another message."""

    def refine(self, correction: dict[str, Any], said: str) -> None:
        """Make a correction of the run's end."""

    def start_with(self, settings: dict[str, Any], said: str) -> None:
        """Begin another run with other settings."""

    def play(self, last_step: int = -1) -> None:
        """Have steps made."""


class ObjectCommands:
    """The objects of a timeline.

    Parameters
    ----------
    timeline : Timeline
    config : RunConfig
        That it begins with; its names and colours.

    Attributes
    ----------
    labels : LabelTable
        Names and colours that were given, by id.
    """

    def __init__(self, timeline: Steered, config: RunConfig) -> None:
        self._timeline = timeline
        self._names, self._colors = dict[int, str](), dict[int, str]()
        self.labels = self._first = given_labels(config)
        self._drag: tuple[SizeDrag, int | None] | None = None

    # -- which there are -----------------------------------------------------------------------------------

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of the objects, also of those that are made again when the run ends; 1 for one without an id."""
        timeline = self._timeline
        corrected = timeline.corrections.ids
        if corrected is not None:
            return corrected
        ids = {evolving.id for evolving in timeline.run.objects}
        for correction in timeline.corrections.wanted:
            ids |= {correction.new} if correction.new is not None else set()
            ids -= {*correction.merge[1:], correction.remove}
        return tuple(sorted(id for id in ids if id is not None))

    @property
    def has_ids(self) -> bool:
        """True if labels are ids."""
        timeline = self._timeline
        return (
            timeline.run.has_ids
            or timeline.run.config.replace(refine=timeline.corrections.wanted).has_ids
        )

    @property
    def words(self) -> dict[int, str]:
        """The state of each object in one word: running, paused, or why it has ended."""
        timeline = self._timeline
        known = timeline.corrections.stops(timeline.run)
        pause = "running" if timeline.is_playing else "paused"
        stops = {id: known.get(id) for id in self.ids}
        return {id: pause if stop is None else stop.reason for id, stop in stops.items()}

    def named(self, object_id: int) -> int | None:
        """Return the id of the object that was named; None where there is one without an id."""
        return None if not self.has_ids and self.ids == (object_id,) else object_id

    # -- clicks and sizes ----------------------------------------------------------------------------------

    def begin_object(self, object_id: int, side: Side, where: tuple[str, ...]) -> None:
        """Begin an object at clicks.

        Raises
        ------
        UsageError, InputError
            When they are outside of it, or cannot be used.
        """
        if side != "inside":
            raise UsageError(
                f"object {object_id} has not begun, so nothing is outside of it",
                "click inside it first",
            )
        self._timeline.refine(
            {"new": object_id, "inside": list(where)}, f"new object {object_id}: {where[0]}"
        )

    def press(self, ball: str, size_mm3: float, object_id: int | None = None) -> SizeDrag:
        """Begin to drag the size of an object, see `Session.press`.

        Raises
        ------
        UsageError, InputError
            When it is no ball or lies outside, or there are several objects and none is named.
        """
        timeline, ids = self._timeline, self.ids
        if object_id is None and len(ids) > 1:
            raise UsageError(
                "a size is dragged for one object, there are several", "choose one, or add one"
            )
        taken = timeline.corrections.taken(timeline.run, ball, object_id or ids[0])
        drag = size_drag_of(timeline.run, ball, size_mm3, taken)
        self._drag = drag, object_id
        timeline.say(f"pressed {ball}: drag outwards until it fits")
        return drag

    def release(self, drag_mm: float) -> None:
        """Begin the object that was pressed with the size that a drag stands for, or without one for a drag of 0: alone
        another run, which plays, else beside the others.

        Raises
        ------
        UsageError
            When nothing was pressed.
        """
        if self._drag is None:
            raise UsageError(
                "nothing was pressed, so there is no size to take", "press in the object first"
            )
        (drag, object_id), self._drag = self._drag, None
        size, ids = drag.size_text(drag_mm) if drag_mm > 0 else None, self.ids
        words = drag.click if size is None else f"{drag.click}, size {size}"
        if len(ids) == 1 and object_id in (None, ids[0]) and not self.has_ids:
            return self.begin_with((drag.click,), f"inside: {words}", size)
        id = object_id or ids[0]
        said = f"{'object' if id in ids else 'new object'} {id}: {words}"
        sized = {} if size is None else {"size": size}
        return self._timeline.refine({"new": id, "inside": [drag.click], **sized}, said)

    def begin_with(self, clicks: tuple[str, ...], said: str, size: str | None = None) -> None:
        """Play another run, of one object, from clicks inside it: they say all that it needs."""
        settings: dict[str, Any] = {"inside": clicks, "outside": (), "start": FROM_CLICKS}
        self._timeline.start_with(settings | {"energy": "seeded", "size": size, "answer": 1}, said)
        self._timeline.play()
        self._timeline.say(said)

    def take_answer(self, number: int) -> None:
        """Play another run, of another answer to the first click; of the one that is taken nothing changes.

        Raises
        ------
        UsageError
            When there is no answer of this number, or something was corrected.
        """
        timeline = self._timeline
        settings = timeline.answers.settings_of(timeline.run, timeline.corrections.wanted, number)
        said = f"answer {number} to the first click"
        if number != timeline.run.settings.answer:
            timeline.start_with(settings, said)
            timeline.play()
        timeline.say(said)

    # -- merge, split, remove ------------------------------------------------------------------------------

    def merge(self, ids: tuple[int, ...]) -> None:
        """Make several objects the first of them."""
        self._timeline.refine({"merge": list(ids)}, f"merged {', '.join(map(str, ids))}")

    def split(self, point: str) -> None:
        """Make the part connected to a point an object."""
        self._timeline.refine({"split": point}, f"split at {point}")

    def remove(self, object_id: int) -> None:
        """Take an object away."""
        self._timeline.refine({"remove": object_id}, f"removed object {object_id}")

    # -- names and colours ---------------------------------------------------------------------------------

    def describe(self, said: Mapping[int, tuple[str, str]], changed: int) -> None:
        """Give objects names and colours, ``#rrggbb``; they go into the files.

        Parameters
        ----------
        said : mapping of int to (str, str)
            By id.
        changed : int
            Which of them the message is about.

        Raises
        ------
        UsageError
            When one is no name or no colour; nothing is changed then.
        """
        names = {id: f"{id}={named(f'{id}={name}')[1]}" for id, (name, _) in said.items()}
        colors = {id: f"{id}={color}" for id, (_, color) in said.items()}
        for text in colors.values():
            colored(text)
        self._names, self._colors = self._names | names, self._colors | colors
        self.labels = self._first.with_settings(
            tuple(self._names.values()), tuple(self._colors.values())
        )
        self._timeline.say(f"object {changed} is {said[changed][0]}")

    def named_settings(self, config: RunConfig) -> dict[str, Any]:
        """The settings of names and colours, as they are now; empty where nothing was named here."""
        out: dict[str, Any] = {}
        for key, texts in (("name", self._names), ("color", self._colors)):
            if texts:
                before = {
                    named(text)[0] if key == "name" else colored(text)[0]: text
                    for text in getattr(config, key)
                }
                out[key] = tuple((before | texts)[label] for label in sorted(before | texts))
        return out


def size_drag_of(
    run: Run, ball: str, size_mm3: float = 0.0, taken: BoxMask | None = None
) -> SizeDrag:
    """Find the objects around a ball by their size.

    Parameters
    ----------
    run : Run
        Its image and settings are used; it is not changed.
    ball : str
        ``ball:X,Y,Z,R``.
    size_mm3 : float, optional
        They have room up to this size.
    taken : BoxMask, optional
        Voxels of the region of interest that belong to other objects.

    Raises
    ------
    UsageError, InputError
        When it is no ball, or lies outside.
    """
    if not ball.startswith("ball:"):
        raise UsageError(f"press: {ball[:40]!r} was given, expected ball:X,Y,Z,R")
    clicks = read_clicks([ball], "inside", run.volume)
    geometry, box = run.volume.geometry, run.prepared.box
    context = run.objects[0].context
    (click,) = Clicks(tuple(clicks), geometry.shape).on_box(box).clicks or (None,)
    if click is None:
        raise UsageError(f"press: {ball} lies outside of the mask")
    distance = run.prepared.mask_distance
    passes = None if distance is None else np.asarray(distance < 0)
    if taken is not None:
        passes = np.ones(context.images[0].shape, np.bool_) if passes is None else passes
        passes[taken.box] &= ~taken.mask
    scene = Scene(tuple(context.images), context.spacing, passes)
    found = first_blocks(scene, seed_of(click, scene), size_mm3)
    window, levels = found.window, found.levels
    times = np.float32(1.0) - window.on_voxels(levels.blocks)
    first = placed_at(window.box, run.prepared.first)
    axis = geometry.slice_axis
    thickness = None if axis is None else geometry.spacing[axis]
    most = max(window.volume_mm3 / CLICK_ROOM, size_mm3) if window.faces.any() else math.inf
    drag = SizeDrag(ball, times, corner_of(first), geometry.voxel_volume, most, thickness)
    drag.level_of(size_mm3)  # sorts here, and not when the drag begins
    return drag
