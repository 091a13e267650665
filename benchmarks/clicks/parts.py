"""What each part of the model of clicks is worth: games of exact clicks without it.

python -m benchmarks.clicks.parts [--clicks N] [--volumes DIR] [--render]

Features of a group are made unknown: the networks get their means. They were not trained without them, so a group may
be worth less than what is lost here. The row with the surface is the whole program, from the games of
`scripts/benchmark clicks`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import statistics
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.clicks.model.network import Layer, Network, networks
from benchmarks.clicks.folds import PHANTOMS
from benchmarks.clicks.games import play, summary
from benchmarks.clicks.objects import load, selected
from benchmarks.clicks.own import StartAlone
from benchmarks.clicks.store import Store, key_of
from benchmarks.clicks.tables import PAGE, collected, of_scans
from benchmarks.pages import head_of, put_table, row_of
from benchmarks.peers.measure import scans_folder

RESULTS = Path(__file__).resolve().parent.parent / "results"
SHOWN = (1, 2, 3, 5)
#: Groups of features, by what their names begin with.
GROUPS = {
    "fronts that march from the clicks": r"front",
    "shortest paths over changes of value": r"path",
    "random walker": r"walk",
    "barriers between a block and the click": r"(value|gradient) barrier|ray",
    "edges": r"gradient$|wide gradient|gradient barrier|ray gradient",
    "appearance (values and their likelihood)": r"(wide )?(value|difference|likelihood|click against|side against)",
    "distances to clicks and sizes": r"distance|size|blocks|number|limited",
}
#: Other parts, which can be left out as a whole.
AROUND, BOUNDARY = "what is around a block (first click)", "boundary within a block"


def without(part: str, whole: Mapping[str, Network]) -> dict[str, Network]:
    """The networks without a part.

    Examples
    --------
    >>> sorted(without(BOUNDARY, networks())), without(AROUND, networks())["first"].around
    (['first', 'later'], ())
    """
    if part == BOUNDARY:
        return {name: network for name, network in whole.items() if name != "boundary"}
    if part == AROUND:
        return {**whole, "first": dataclasses.replace(whole["first"], around=())}
    return {
        name: network if name == "boundary" else blind(network, GROUPS[part])
        for name, network in whole.items()
    }


def blind(network: Network, pattern: str) -> Network:
    """A network for which the features that fit a pattern have their means."""
    unknown = [i for i, name in enumerate(network.names) if re.match(pattern, name)]
    if not unknown:
        raise ValueError(f"{pattern}: no feature fits")
    layers, around = (tuple(part) for part in (network.layers, network.around))
    return dataclasses.replace(
        network, layers=_without(layers, unknown), around=_without(around, unknown)
    )


def _without(layers: tuple[Layer, ...], rows: list[int]) -> tuple[Layer, ...]:
    """Layers of which the first takes nothing from some channels: their means are 0 once standardised."""
    if not layers:
        return ()
    weights = layers[0].weights.copy()
    weights[rows] = 0.0
    return (Layer(weights, layers[0].biases), *layers[1:])


def main(arguments: list[str] | None = None) -> int:
    """Play what is not kept yet, and write table and JSON."""
    summary_line = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.clicks.parts", description=summary_line
    )
    parser.add_argument("--clicks", type=int, default=SHOWN[-1])
    parser.add_argument("--volumes", type=Path, default=scans_folder())
    parser.add_argument("--render", action="store_true", help="play nothing")
    options = parser.parse_args(arguments)
    objects = [each for each in selected() if each.fold != PHANTOMS]
    stores = {
        part: Store(RESULTS / "parts", re.sub(r"\W+", "-", part))
        for part in (*GROUPS, AROUND, BOUNDARY)
    }
    (RESULTS / "parts").mkdir(exist_ok=True)
    for which in [] if options.render else objects:
        scene, key = load(which, options.volumes), key_of(which.name, "plain", {})
        for part, store in stores.items():
            if store.get(key, options.clicks) is None:
                session = partial(StartAlone, asked=without(part, networks()))
                game = play(session, scene, options.clicks, "plain", surface=False)
                clicks = [
                    {name: click[name] for name in ("dice", "wall_s", "cpu_s")}
                    for click in game["clicks"]
                ]
                store.put(key, {**game, "clicks": clicks})
        print(which.name, flush=True)
    played = {
        part: {which.name: store.played(key_of(which.name, "plain", {})) for which in objects}
        for part, store in stores.items()
    }
    whole = {name: of_scans(games) for name, games in collected(RESULTS, "plain").items()}
    rows = {"the model": whole["accelsurf-start"], "the model, and the surface": whole["accelsurf"]}
    rows |= {f"without: {part}": games for part, games in played.items() if all(games.values())}  # type: ignore[misc]
    figures = {row: figures_of(games) for row, games in rows.items()}
    (RESULTS / "clicks_parts.json").write_text(json.dumps(figures, indent=1) + "\n")
    put_table(PAGE, "parts", text_of(figures), "python -m benchmarks.clicks.parts")
    return 0


def figures_of(games: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Medians and means of the Dice after the clicks of `SHOWN`, and share of clicks after which it fell."""
    found = summary([{**game, "clicks": game["clicks"][: SHOWN[-1]]} for game in games.values()])
    dice = {str(n): [round(found["dice"][n], 3), round(found["mean"][n], 3)] for n in SHOWN}
    return {"objects": found["objects"], "fell": round(found["fell"], 4), **dice}


def text_of(figures: Mapping[str, dict[str, Any]]) -> str:
    """The table: a row a part."""
    lines = head_of(
        ("games of", *(f"Dice {n}" for n in SHOWN), "mean of all, less the model's", "fell")
    )
    level = np.mean([figures["the model"][str(n)][1] for n in SHOWN])
    for row, found in figures.items():
        apart = statistics.mean(found[str(n)][1] for n in SHOWN) - level
        dice = [f"{found[str(n)][0]:.3f} ({found[str(n)][1]:.3f})" for n in SHOWN]
        lines.append(row_of((row, *dice, f"{apart:+.3f}", f"{found['fell']:.1%}")))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
