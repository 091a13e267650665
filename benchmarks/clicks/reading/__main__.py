"""Train the learned reading, or play it: `python -m benchmarks.clicks.reading train --help`."""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmarks.clicks.reading.features import Features, features_of_first, table_of
from benchmarks.clicks.reading.network import Network, load, loss, save, trained
from benchmarks.clicks.reading.session import WEIGHTS, ReadingSession
from benchmarks.clicks.reading.windows import SCALES, Window, inscribed_radius
from numpy.typing import NDArray

from benchmarks.clicks.person import PersonClick, ball_voxels, next_click
from benchmarks.clicks.reading.scenes import scene

#: Objects of a scene that are clicked; windows of a click and blocks of a window that are learned from.
OBJECTS, WINDOWS, BLOCKS = 3, 2, 900
#: How often a window of each scale is taken.
OFTEN = (0.38, 0.3, 0.2, 0.12)
#: Part of the games in which clicks are not exact; of the clicks that are smaller than half the depth for no reason; of
#: the games in which the largest radius of a click is between these, in voxels.
JITTERED, SMALLER = 0.3, 0.1
LIMITED, LARGEST = 0.4, (0.5, 8.0)
#: Most clicks of a game; widths of the layers; passes over the rows; part of the scenes that is held back.
CLICKS, HIDDEN, PASSES, HELD = 6, (64, 32), 2, 0.08
#: Scenes of a file of rows.
CHUNK = 20


class Rows(NamedTuple):
    """Rows of a network: names of the features, a table (k, n) float16, shares that are wanted, scenes."""

    names: list[str]
    table: NDArray[np.float16]
    wanted: NDArray[np.float16]
    scenes: NDArray[np.int64]


def sampled(
    features: Features, share: NDArray[np.floating], where: NDArray[np.int64], random: np.random.Generator
) -> tuple[list[str], NDArray[np.float16], NDArray[np.float16]]:
    """Some of the blocks ``where``, half of them near the click."""
    names = sorted(features)
    near = where[np.asarray(features["distance"]).ravel()[where] < 2.0]
    parts = [random.choice(part, BLOCKS // 2) for part in (near, where) if len(part)]
    rows = np.concatenate(parts)
    return names, table_of(features, names, rows).astype(np.float16), share.ravel()[rows].astype(np.float16)


def first_rows(seed: int) -> list[Rows]:
    """Rows of first clicks in a scene."""
    volume, objects = scene(seed)
    out = []
    for number, truth in enumerate(objects[:OBJECTS]):
        random = np.random.default_rng([seed, number, 1])
        session = ReadingSession(volume, {}, largest_of(random))
        click = clicked(truth, None, session, random)
        session.clicks = [click] if click is not None else []
        for scale in random.choice(len(SCALES), WINDOWS, replace=False, p=OFTEN) if session.clicks else ():
            window = session.window(int(scale))
            features = features_of_first(window, inscribed_radius(session.clicks[0], session.spacing))
            everywhere = np.arange(window.values.size)
            rows = sampled(features, window.means(truth), everywhere, random)
            out.append(Rows(*rows, np.full(len(rows[2]), seed)))
    return out


def later_rows(seed: int, networks: dict[str, Network]) -> list[Rows]:
    """Rows of later clicks of games in a scene."""
    volume, objects = scene(seed)
    out = []
    for number, truth in enumerate(objects[: OBJECTS - 1]):
        random = np.random.default_rng([seed, number, 2])
        session, exact = ReadingSession(volume, networks, largest_of(random)), random.random() >= JITTERED
        labels = None
        for count in range(int(random.integers(2, CLICKS + 1))):
            click = clicked(truth, labels, session, random, exact)
            if click is None:
                break
            if count:
                session.clicks.append(click)
                out += _rows_of_last(session, truth, seed, random)
                session.clicks.pop()
            labels = (
                session.click(click).copy()
                if count == 0 or "later" in networks
                else _mended(session, click, truth, random)
            )
    return out


def _rows_of_last(
    session: ReadingSession, truth: NDArray[np.bool_], seed: int, random: np.random.Generator
) -> Iterator[Rows]:
    for scale in random.choice(len(SCALES), WINDOWS, replace=False, p=OFTEN):
        window: Window = session.window(int(scale))
        features, side = session.later_features(window)
        free = np.flatnonzero(~side)
        if len(free):
            share = window.means(truth)
            share = share if session.clicks[-1].side == "inside" else 1.0 - share
            rows = sampled(features, share, free, random)
            yield Rows(*rows, np.full(len(rows[2]), seed))


def _mended(
    session: ReadingSession, click: PersonClick, truth: NDArray[np.bool_], random: np.random.Generator
) -> NDArray[np.bool_]:
    """Labels with the truth near a click: how a game goes on before there is a network for later clicks."""
    session.clicks.append(click)
    wide = click._replace(radius=click.radius * random.uniform(1.0, 3.5))
    box, ball = ball_voxels(wide, session.image.geometry)
    part, inside = session.labels[box], click.side == "inside"
    part[ball & (truth[box] == inside)] = inside
    return session.labels.copy()


def largest_of(random: np.random.Generator) -> float | None:
    """Largest radius (mm) of a game's clicks, None for the usual one; scenes have voxels of 1 mm in their slices."""
    return float(np.exp(random.uniform(*np.log(LARGEST)))) if random.random() < LIMITED else None


def clicked(
    truth: NDArray[np.bool_],
    labels: NDArray[np.bool_] | None,
    session: ReadingSession,
    random: np.random.Generator,
    exact: bool | None = None,
) -> PersonClick | None:
    """Click of a person who is not always exact, and sometimes takes a smaller ball."""
    exact = random.random() >= JITTERED if exact is None else exact
    click = next_click(truth, labels, session.image.geometry, None if exact else random)
    if click is None:
        return None
    part = random.uniform(0.3, 1.0) if random.random() < SMALLER else 1.0
    least = 0.5 * min(session.spacing)
    return click._replace(radius=max(min(part * click.radius, session.largest), least))


def gathered(work: Path, name: str, first: int, count: int, make: object, jobs: int) -> Rows:
    """Rows of scenes, file by file: those that are there already are read."""
    chunks = [
        (work / f"{name}-{start}.npz", range(start, min(start + CHUNK, first + count)))
        for start in range(first, first + count, CHUNK)
    ]
    missing = [(path, seeds) for path, seeds in chunks if not path.exists()]
    with ProcessPoolExecutor(jobs) as pool:
        for done in pool.map(partial(_written, make=make), missing):
            print(done, flush=True)
    parts = [np.load(path) for path, _ in chunks]
    names = [str(text) for text in parts[0]["names"]]
    return Rows(names, *(np.concatenate([part[key] for part in parts]) for key in ("table", "wanted", "scenes")))


def _written(job: tuple[Path, range], make: object) -> str:
    path, seeds = job
    rows = [each for seed in seeds for each in make(seed)]  # type: ignore[operator]
    partial_file = path.with_suffix(".part.npz")
    np.savez(
        partial_file,
        names=np.array(rows[0].names),
        table=np.concatenate([r.table for r in rows]),
        wanted=np.concatenate([r.wanted for r in rows]),
        scenes=np.concatenate([r.scenes for r in rows]),
    )
    partial_file.replace(path)
    return path.name


def fitted(rows: Rows, passes: int) -> tuple[Network, dict[str, float]]:
    """Train on all scenes but some, which say how well."""
    held = rows.scenes % round(1 / HELD) == 0
    wanted = rows.wanted.astype(np.float32).clip(0.0, 1.0)
    network = trained(rows.names, rows.table[~held], wanted[~held], HIDDEN, passes)
    share = float(wanted[held].mean())
    figures = {
        "rows": len(wanted),
        "scenes": len(np.unique(rows.scenes)),
        "parameters": network.parameters,
        "cross_entropy_held": loss(network, rows.table[held], wanted[held]),
        "cross_entropy_of_the_mean": -(share * np.log(share) + (1 - share) * np.log(1 - share)),
    }
    return network, {key: round(float(value), 4) for key, value in figures.items()}


def train(work: Path, scenes: int, jobs: int, passes: int, out: Path) -> dict[str, object]:
    """Train both networks; later clicks in two rounds, the second on games of the first."""
    work.mkdir(parents=True, exist_ok=True)
    began, record = time.monotonic(), dict[str, object]()
    networks: dict[str, Network] = {}
    networks["first"], record["first"] = fitted(gathered(work, "first", 0, scenes, first_rows, jobs), passes)
    print(record, flush=True)
    rough = gathered(work, "rough", 100_000, scenes // 2, partial(later_rows, networks=dict(networks)), jobs)
    networks["later"], record["rough"] = fitted(rough, passes)
    played = gathered(work, "later", 200_000, scenes // 2, partial(later_rows, networks=dict(networks)), jobs)
    both = Rows(rough.names, *(np.concatenate(pair) for pair in zip(rough[1:], played[1:], strict=True)))
    networks["later"], record["later"] = fitted(both, passes)
    save(out, networks)
    record["minutes"] = round((time.monotonic() - began) / 60.0, 1)
    record["sha256"] = hashlib.sha256(out.read_bytes()).hexdigest()
    out.with_suffix(".json").write_text(json.dumps(record, indent=1) + "\n")
    return record


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.clicks.reading", description=__doc__)
    commands = parser.add_subparsers(required=True)
    training = commands.add_parser("train", help="train on scenes drawn on the fly; goes on where it was interrupted")
    training.add_argument("--work", type=Path, required=True, help="folder for rows; about 1 MB a scene")
    training.add_argument("--scenes", type=int, default=1200)
    training.add_argument("--jobs", type=int, default=2)
    training.add_argument("--passes", type=int, default=PASSES)
    training.add_argument("--out", type=Path, default=WEIGHTS)
    training.set_defaults(run=lambda a: print(train(a.work, a.scenes, a.jobs, a.passes, a.out)))
    showing = commands.add_parser("show", help="print what the weights are")
    showing.set_defaults(run=lambda a: print({n: (w.parameters, w.names) for n, w in load(WEIGHTS).items()}))
    asked = parser.parse_args()
    asked.run(asked)


if __name__ == "__main__":
    main()
