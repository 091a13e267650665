"""How many clicks a segmentation takes: a simulated person on whole scans, accelsurf beside its peers.

scripts/benchmark clicks [--folds 1,2|phantoms] [--methods A,B|peers] [--objects A,B] [--games plain,size,...]
                         [--clicks N] [--default]
scripts/benchmark clicks --grid --methods peers     play all settings of the peers, so that folds can choose
scripts/benchmark clicks --render                   tables and picture again, from the games that are kept
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.clicks.folds import NAMES
from benchmarks.clicks.games import KINDS, play, variants
from benchmarks.clicks.methods import TUNED_CLICKS, Method, named
from benchmarks.clicks.objects import ClickObject, load, selected, size_factor
from benchmarks.clicks.pictures import Album
from benchmarks.clicks.store import Store, brief, key_of
from benchmarks.peers.measure import MissingError, scans_folder, set_threads

RESULTS = Path(__file__).resolve().parent.parent / "results"


class Task(NamedTuple):
    """A game to be played: an object, a variant, the method's settings, how many clicks, surfaces measured or not."""

    object: ClickObject
    variant: str
    settings: dict[str, Any]
    clicks: int
    surface: bool = True

    @property
    def key(self) -> str:
        """Key under which the game is kept."""
        return key_of(self.object.name, self.variant, self.settings)


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
    parser = argparse.ArgumentParser(
        prog="scripts/benchmark clicks", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--folds", type=_names, default=[], help=f"only objects of these: {', '.join(NAMES)}"
    )
    parser.add_argument(
        "--objects", type=_names, default=[], help="only these, chosen by the rule or not"
    )
    parser.add_argument(
        "--methods", type=_names, default=[], help="only these; peers: all but ours"
    )
    parser.add_argument(
        "--games", type=_names, default=["plain"], help=f"of {', '.join(KINDS)} (plain)"
    )
    parser.add_argument("--clicks", type=int, default=10, help="clicks on each object (10)")
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument(
        "--volumes",
        type=Path,
        default=scans_folder(),
        help="folder of the scans (default: ACCELSURF_VOLUMES)",
    )
    parser.add_argument(
        "--results",
        type=Path,
        default=RESULTS,
        help="folder of JSON and picture (benchmarks/results)",
    )
    parser.add_argument(
        "--grid",
        action="store_true",
        help=f"all settings of the methods, {TUNED_CLICKS} exact clicks",
    )
    parser.add_argument(
        "--default", action="store_true", help="default settings where none are chosen yet"
    )
    parser.add_argument("--again", action="store_true", help="play games again that are kept")
    parser.add_argument(
        "--pictures", action="store_true", help="of the result after each click that is played"
    )
    parser.add_argument("--render", action="store_true", help="play nothing")
    options = parser.parse_args(arguments)
    if options.clicks < 1 or options.threads < 1:
        parser.error("--clicks and --threads must be at least 1")
    for kind in options.games:
        if kind not in KINDS:
            parser.error(f"{kind}: no such game; there are {', '.join(KINDS)}")
    try:
        options.methods, options.objects = (
            named(options.methods),
            selected(options.folds, options.objects),
        )
    except ValueError as wrong:
        parser.error(str(wrong))
    return options


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def tasks(method: Method, store: Store, options: argparse.Namespace) -> Iterator[Task]:
    """Games of a method, by the command line; folds without selected settings are said and left out."""
    kinds = [kind for kind in options.games if kind != "size" or method.takes_size]
    selected_by_fold: dict[str, dict[str, Any] | None] = {}
    for which in options.objects:
        if options.grid:
            yield from (
                Task(which, "plain", settings, TUNED_CLICKS, False) for settings in method.grid
            )
            continue
        if which.fold not in selected_by_fold:
            found = method.settings(store, which.fold)
            if found is None and not options.default:
                print(
                    f"{method.name}: fold {which.fold} skipped, no settings chosen yet: --grid --methods "
                    f"{method.name}, or --default",
                    flush=True,
                )
            selected_by_fold[which.fold] = (
                method.default if found is None and options.default else found
            )
        settings = selected_by_fold[which.fold]
        if settings is not None:
            yield from (
                Task(which, variant, settings, options.clicks) for variant in variants(kinds)
            )


def run(method: Method, options: argparse.Namespace) -> None:
    """Play all games of one method that are not kept yet."""
    store = Store(options.results, method.name)
    every = list(tasks(method, store, options))
    if options.again:
        store.forget({task.key for task in every})
    for task in every:
        if store.get(task.key, task.clicks) is None:
            album = Album(method.name, task.object.name, task.variant) if options.pictures else None
            game = play_task(method, task, options.volumes, album)
            if album is not None:
                print(f"written: {album.write(options.results)}", flush=True)
            store.put(task.key, brief(game) if options.grid else game)


def play_task(
    method: Method, task: Task, folder: Path | None, album: Album | None = None
) -> dict[str, Any]:
    """Play a game and print it."""
    scene = load(task.object, folder)
    watch = None if album is None else album.watcher(scene.image, scene.truth)
    game = play(
        method.segmenter(task.settings),
        scene,
        task.clicks,
        task.variant,
        size_factor(task.object),
        watch,
        task.surface,
    )
    dices = " ".join(f"{click['dice']:.3f}" for click in game["clicks"])
    seconds = sum(click["wall_s"] for click in game["clicks"]) / max(len(game["clicks"]), 1)
    print(
        f"{method.name} {task.object.name} {task.variant} {task.settings or ''}: {dices}; {seconds:.2f} s/click",
        flush=True,
    )
    return game


if __name__ == "__main__":
    sys.exit(main())
