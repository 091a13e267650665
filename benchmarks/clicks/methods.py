"""All that is compared, by name: accelsurf, its start without the surface, and the peers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from accelsurf.image.volume import Volume
from benchmarks.clicks.domain import CroppedSession
from benchmarks.clicks.games import Segmenter, Session, score
from benchmarks.clicks.objects import ClickObject, chosen
from benchmarks.clicks.peers import PEERS, ClickPeer
from benchmarks.clicks.store import Store, key_of

#: Clicks that are spent on each object when settings are chosen.
TUNED_CLICKS = 5


@dataclass(frozen=True)
class Method:
    """One row of the table: a name, the settings to choose from, and whether it can make use of a stated size."""

    name: str
    grid: list[dict[str, Any]] = field(default_factory=lambda: [{}])
    takes_size: bool = False
    peer: ClickPeer | None = None

    def segmenter(self, settings: dict[str, Any]) -> Segmenter:
        """What makes sessions with these settings."""
        if self.peer is not None:
            peer = self.peer
            return lambda image, size: cast(Session, CroppedSession(image, peer.solver, settings, peer.cap))
        # Compiled code is loaded only when it is asked for, after the number of threads is set.
        from benchmarks.clicks import own

        return own.segmenter(self.name)

    def settings(self, store: Store) -> dict[str, Any] | None:
        """The best settings on the tuning half; None while a game of the grid is missing."""
        if len(self.grid) == 1:
            return self.grid[0]
        scores: list[float] = []
        for one in self.grid:
            games = [game for o in chosen("tune") if (game := tuned(store, o, one)) is not None]
            if len(games) < len(chosen("tune")):
                return None
            scores.append(score(games))
        return self.grid[scores.index(max(scores))]


def tuned(store: Store, one: ClickObject, settings: dict[str, Any]) -> dict[str, Any] | None:
    """A game that settings are chosen by, if it was played."""
    return store.get(key_of(one.name, "plain", settings), TUNED_CLICKS)


OWN = ("accelsurf", "accelsurf-rerun", "accelsurf-start")
METHODS = {
    **{name: Method(name, takes_size=True) for name in OWN},
    **{name: Method(name, peer.grid, peer=peer) for name, peer in PEERS.items()},
}


def named(names: Sequence[str]) -> list[Method]:
    """Methods by name, "peers" for all that are not ours; all of them for none.

    Raises
    ------
    ValueError
        When there is no such method.

    Examples
    --------
    >>> [one.name for one in named(["watershed", "accelsurf"])]
    ['accelsurf', 'watershed']
    """
    wanted = {one for name in names for one in (PEERS if name == "peers" else [name])}
    for name in sorted(wanted - set(METHODS)):
        raise ValueError(f"{name}: no such method; there are {', '.join(METHODS)}, peers")
    return [method for name, method in METHODS.items() if name in wanted or not names]


def volume_shape(image: Volume) -> str:
    """For messages."""
    return " x ".join(map(str, image.array.shape[::-1]))
