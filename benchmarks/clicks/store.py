"""Where games are kept: one JSON file per method, written after every game, so that a stopped run goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PREFIX = "clicks_"
#: Digits that are kept of Dice and of seconds.
DIGITS = {"dice": 5, "wall_s": 3, "cpu_s": 3, "radius": 4}


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
        self.facts: dict[str, Any] = {"method": method, "games": {}}
        if self.path.is_file():
            self.facts = json.loads(self.path.read_text())

    def get(self, key: str, clicks: int) -> dict[str, Any] | None:
        """A game that was played, if it went on for so many clicks or until nothing was wrong."""
        game = self.facts["games"].get(key)
        if game is None or (len(game["clicks"]) < clicks and not game["perfect"]):
            return None
        return {"clicks": game["clicks"][:clicks], "perfect": game["perfect"] and len(game["clicks"]) <= clicks}

    def put(self, key: str, game: Mapping[str, Any]) -> None:
        """Keep a game, and write the file: whole, or not at all."""
        self.facts["games"][key] = rounded(game)
        draft = self.path.with_suffix(f".{os.getpid()}.draft")
        lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in sorted(self.facts["games"].items()))
        head = json.dumps({k: v for k, v in self.facts.items() if k != "games"})[:-1]
        draft.write_text(f'{head}, "games": {{\n{lines}\n}}}}\n')
        draft.replace(self.path)

    def forget(self, keys: set[str]) -> None:
        """Leave out games that are to be played again."""
        self.facts["games"] = {k: v for k, v in self.facts["games"].items() if k not in keys}


def rounded(game: Mapping[str, Any]) -> dict[str, Any]:
    """A game with the digits that mean something."""
    clicks = [{k: round(v, DIGITS[k]) if k in DIGITS else v for k, v in one.items()} for one in game["clicks"]]
    return {**game, "clicks": clicks}
