"""All that is compared, by name: accelsurf, its start without the surface, and the peers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from accelsurf.image.volume import Volume
from benchmarks.clicks.domain import CroppedSession
from benchmarks.clicks.folds import tuned_on
from benchmarks.clicks.games import Hints, Segmenter, Session, score
from benchmarks.clicks.objects import ClickObject, selected
from benchmarks.clicks.peers import PEERS, ClickPeer
from benchmarks.clicks.store import Store, key_of

#: Clicks that are spent on each object when settings are selected.
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

            def made(image: Volume, hints: Hints) -> Session:
                session = CroppedSession(
                    image, peer.solver, settings, peer.cap, hints.box, hints.points
                )
                return cast(Session, session)

            return made
        # Compiled code is loaded only when it is asked for, after the number of threads is set.
        from benchmarks.clicks import own

        return own.segmenter(self.name)

    @property
    def default(self) -> dict[str, Any]:
        """Settings while none are selected: the last of the grid."""
        return self.grid[-1]

    def settings(self, store: Store, fold: str) -> dict[str, Any] | None:
        """Best settings on the other folds than ``fold``; None while a game of the grid on one of them is missing.

        Games of a grid need `TUNED_CLICKS` clicks. Phantoms are never selected on.
        """
        if len(self.grid) == 1:
            return self.grid[0]
        others = selected(tuned_on(fold))
        scores: list[float] = []
        for settings in self.grid:
            games = [game for each in others if (game := tuned(store, each, settings)) is not None]
            if len(games) < len(others):
                return None
            scores.append(score(games))
        return self.grid[scores.index(max(scores))]


def tuned(store: Store, which: ClickObject, settings: dict[str, Any]) -> dict[str, Any] | None:
    """A game that settings are selected by, if it was played."""
    return store.get(key_of(which.name, "plain", settings), TUNED_CLICKS)


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
    >>> [each.name for each in named(["watershed", "accelsurf"])]
    ['accelsurf', 'watershed']
    """
    wanted = {each for name in names for each in (PEERS if name == "peers" else [name])}
    for name in sorted(wanted - set(METHODS)):
        raise ValueError(f"{name}: no such method; there are {', '.join(METHODS)}, peers")
    return [method for name, method in METHODS.items() if name in wanted or not names]


def volume_shape(image: Volume) -> str:
    """For messages."""
    return " x ".join(map(str, image.array.shape[::-1]))
