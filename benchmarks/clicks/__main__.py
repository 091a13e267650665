"""How many clicks a segmentation takes: a simulated person on whole scans, accelsurf beside its peers.

scripts/benchmark clicks [--half tune|report] [--methods A,B|peers] [--objects A,B] [--clicks N]
                         [--variants plain,size,jitter]
scripts/benchmark clicks --tune --methods peers     choose the peers' settings on the tuning half
scripts/benchmark clicks --render                   table and picture again, from the games that are kept
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from benchmarks.clicks.games import play, variants
from benchmarks.clicks.methods import TUNED_CLICKS, Method, named, volume_shape
from benchmarks.clicks.objects import HALVES, ClickObject, chosen, load, size_factor
from benchmarks.clicks.pictures import Album
from benchmarks.clicks.store import Store, brief, key_of
from benchmarks.peers.measure import MissingError, scans_folder, set_threads

RESULTS = Path(__file__).resolve().parent.parent / "results"
KINDS = ("plain", "size", "jitter")


def main(arguments: list[str] | None = None) -> int:
    """Play what is asked for and not kept yet; 1 when the scans are missing."""
    options = parse(arguments)
    options.results.mkdir(parents=True, exist_ok=True)
    set_threads(options.threads)
    os.environ.setdefault("NUMBA_NUM_THREADS", str(options.threads))
    try:
        if not options.render:
            for method in options.methods:
                run(method, options)
    except MissingError as missing:
        print(f"clicks: not run: {missing}", file=sys.stderr)
        return 1
    from benchmarks.clicks import tables

    # Results elsewhere are trials: the docs show those of the repository.
    page = tables.PAGE if options.results == RESULTS else None
    for path in tables.write(options.results, page):
        print(f"written: {path}")
    return 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark clicks", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--half", choices=HALVES, default="tune", help="which objects (tune)")
    parser.add_argument("--objects", type=_names, default=[], help="of that half, only these")
    parser.add_argument("--methods", type=_names, default=[], help="only these; peers: all but ours")
    parser.add_argument("--variants", type=_names, default=["plain"], help=f"of {', '.join(KINDS)} (plain)")
    parser.add_argument("--clicks", type=int, default=20, help="clicks on each object (20)")
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--volumes", type=Path, default=scans_folder(),
                        help="folder of the scans (default: ACCELSURF_VOLUMES)")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of JSON and picture (benchmarks/results)")
    parser.add_argument("--tune", action="store_true", help=f"all settings of the grids, {TUNED_CLICKS} clicks")
    parser.add_argument("--again", action="store_true", help="play games again that are kept")
    parser.add_argument("--pictures", action="store_true", help="of the result after each click that is played")
    parser.add_argument("--render", action="store_true", help="play nothing")
    options = parser.parse_args(arguments)
    if options.clicks < 1 or options.threads < 1:
        parser.error("--clicks and --threads must be at least 1")
    for kind in options.variants:
        if kind not in KINDS:
            parser.error(f"{kind}: no such variant; there are {', '.join(KINDS)}")
    if options.tune and options.half != "tune":
        parser.error("--tune is for the half to tune on")
    try:
        options.methods, options.objects = named(options.methods), chosen(options.half, options.objects)
    except ValueError as wrong:
        parser.error(str(wrong))
    return options


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def run(method: Method, options: argparse.Namespace) -> None:
    """Play all games of one method that are not kept yet."""
    store = Store(options.results, method.name)
    if options.tune:
        grid: list[dict[str, Any]] = method.grid
    else:
        best = method.settings(store)
        if best is None:
            print(f"{method.name}: skipped, no settings chosen yet: --tune --methods {method.name}", flush=True)
            return
        grid = [best]
    clicks = TUNED_CLICKS if options.tune else options.clicks
    kinds = [kind for kind in options.variants if kind != "size" or method.takes_size]
    tasks = [(one, kind, settings) for one in options.objects for kind in variants(kinds) for settings in grid]
    if options.again:
        store.forget({key_of(one.name, kind, settings) for one, kind, settings in tasks})
    for one, kind, settings in tasks:
        if store.get(key_of(one.name, kind, settings), clicks) is None:
            album = Album(method.name, one.name, kind) if options.pictures else None
            game = play_one(method, one, kind, settings, clicks, options.volumes, album)
            if album is not None:
                print(f"written: {album.write(options.results)}", flush=True)
            store.put(key_of(one.name, kind, settings), brief(game) if options.tune else game)


def play_one(
    method: Method, one: ClickObject, kind: str, settings: dict[str, Any], clicks: int, folder: Path | None,
    album: Album | None = None,
) -> dict[str, Any]:
    """Play a game and print it."""
    image, truth = load(one, folder)
    watch = None if album is None else album.watcher(image, truth)
    game = play(method.segmenter(settings), image, truth, clicks, kind, size_factor(one), watch)
    dices = " ".join(f"{click['dice']:.3f}" for click in game["clicks"])
    seconds = sum(click["wall_s"] for click in game["clicks"]) / max(len(game["clicks"]), 1)
    print(f"{method.name} {one.name} {volume_shape(image)} {kind} {settings or ''}: {dices}; {seconds:.2f} s/click",
          flush=True)
    return game


if __name__ == "__main__":
    sys.exit(main())
