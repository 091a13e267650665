"""Where games are kept: one JSON file per method, written after every game, so that a stopped run goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PREFIX = "clicks_"
#: Digits that are kept of Dice and of seconds.
DIGITS = {
    "dice": 5,
    "wall_s": 3,
    "cpu_s": 3,
    "radius": 4,
    "sureness": 4,
    "nsd": 4,
    "mean_mm": 4,
    "p95_mm": 4,
    "mean_voxels": 4,
    "p95_voxels": 4,
}


def key_of(name: str, variant: str, settings: Mapping[str, Any]) -> str:
    """Under which a game is kept.

    Examples
    --------
    >>> key_of("liver", "plain", {"beta": 100.0, "reach": 4.0})
    'liver/plain/beta=100.0,reach=4.0'
    """
    return f"{name}/{variant}/{','.join(f'{k}={settings[k]}' for k in sorted(settings))}"


class Store:
    """The games of one method.

    Parameters
    ----------
    folder : Path
    method : str
    """

    def __init__(self, folder: Path, method: str) -> None:
        self.path = folder / f"{PREFIX}{method}.json"
        self.results: dict[str, Any] = {"method": method, "games": {}}
        if self.path.is_file():
            self.results = json.loads(self.path.read_text())

    def played(self, key: str) -> dict[str, Any] | None:
        """A game with all clicks that were played."""
        game: dict[str, Any] | None = self.results["games"].get(key)
        return game

    def get(self, key: str, clicks: int) -> dict[str, Any] | None:
        """The first clicks of a game, if it went on for so many or until nothing was wrong."""
        game = self.played(key)
        if game is None or (len(game["clicks"]) < clicks and not game["perfect"]):
            return None
        return {
            "clicks": game["clicks"][:clicks],
            "perfect": game["perfect"] and len(game["clicks"]) <= clicks,
        }

    def put(self, key: str, game: Mapping[str, Any]) -> None:
        """Keep a game, and write the file: whole, or not at all."""
        self.results["games"][key] = rounded(game)
        staged = self.path.with_suffix(f".{os.getpid()}.draft")
        lines = ",\n".join(
            f"{json.dumps(k)}: {json.dumps(v)}" for k, v in sorted(self.results["games"].items())
        )
        head = json.dumps({k: v for k, v in self.results.items() if k != "games"})[:-1]
        staged.write_text(f'{head}, "games": {{\n{lines}\n}}}}\n')
        staged.replace(self.path)

    def forget(self, keys: set[str]) -> None:
        """Leave out games that are to be played again."""
        self.results["games"] = {k: v for k, v in self.results["games"].items() if k not in keys}


def brief(game: Mapping[str, Any]) -> dict[str, Any]:
    """A game without the places of its clicks, for the many of a grid."""
    return {
        **game,
        "clicks": [{k: click[k] for k in ("dice", "wall_s", "cpu_s")} for click in game["clicks"]],
    }


def rounded(game: Mapping[str, Any]) -> dict[str, Any]:
    """A game with the digits that mean something."""
    clicks = [{k: _rounded(k, value) for k, value in click.items()} for click in game["clicks"]]
    return {**game, "clicks": clicks}


def _rounded(name: str, value: Any) -> Any:
    return round(value, DIGITS[name]) if name in DIGITS and value is not None else value
