"""Identities: who begins where, is seen in which frames, came from whom, and why it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from accelsurf.tracking.records import Lineage, Link, Track

END = "end of sequence"


@dataclass
class _Life:
    """Frames in which an identity is seen, and why it ends after the last."""

    seen: set[int] = field(default_factory=set)
    end: str = END


class Identities:
    """The identities of a tracking while it goes on, in rising and in falling order of the frames.

    What is a division in one order of the frames is a merging in the other: tracks and links are always told in rising
    order of time.
    """

    def __init__(self) -> None:
        self._lives: dict[int, _Life] = {}
        self._links: list[Link] = []

    def new_id(self) -> int:
        """The lowest number above all so far."""
        return max(self._lives, default=0) + 1

    def see(self, id: int, frame: int) -> None:
        """Note that a frame shows an object; its identity begins there if there is none."""
        self._lives.setdefault(id, _Life()).seen.add(frame)

    def forget(self, id: int, frame: int) -> None:
        """Note that a frame shows others in place of an object."""
        self._lives[id].seen.discard(frame)

    def end(self, id: int, why: str) -> None:
        """Note why an object is not seen after its last frame."""
        self._lives[id].end = why

    def divide(self, whole: int, parts: Sequence[int], frame: int, before: int) -> None:
        """Note that an object became several.

        Parameters
        ----------
        whole : int
        parts : sequence of int
            Seen in ``frame``.
        frame, before : int
            The frame, and the one that was done before it: in falling order that is the later one.
        """
        if before < frame:
            self._link_division(whole, parts, frame)
        else:
            self._link_merging(parts, whole, before)

    def merge(self, parts: Sequence[int], union: int, frame: int, before: int) -> None:
        """Note that several objects became one, seen in ``frame``; ``before`` as for `divide`."""
        if before < frame:
            self._link_merging(parts, union, frame)
        else:
            self._link_division(union, parts, before)

    def _link_division(self, whole: int, parts: Sequence[int], frame: int) -> None:
        self._links += [Link(whole, id, frame, "division") for id in parts]
        self.end(whole, "divided")

    def _link_merging(self, parts: Sequence[int], union: int, frame: int) -> None:
        self._links += [Link(id, union, frame, "merging") for id in parts]
        for id in parts:
            self.end(id, "merged")

    def lineage(self) -> Lineage:
        """All tracks and links so far."""
        tracks = []
        for id, life in sorted(self._lives.items()):
            if life.seen:
                first, last = min(life.seen), max(life.seen)
                gaps = tuple(n for n in range(first, last) if n not in life.seen)
                tracks.append(Track(id, first, last, gaps, life.end))
        return Lineage(tuple(tracks), tuple(sorted(self._links, key=attrgetter("frame", "parent", "child"))))

    def state(self) -> dict[str, Any]:
        """State as a value, for `restore`."""
        lives = [[id, life.end, sorted(life.seen)] for id, life in sorted(self._lives.items())]
        return {"lives": lives, "links": [list(link) for link in self._links]}

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a `state`."""
        self._lives = {id: _Life(set(seen), end) for id, end, seen in state["lives"]}
        self._links = [Link(*link) for link in state["links"]]
