"""Train the networks that read clicks, from drawn scenes alone: `python -m benchmarks.clicks.reading --help`."""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

import accelsurf.clicks.model
from accelsurf.clicks.model.network import WEIGHTS, Layer, Network, load, save
from benchmarks.clicks.reading import lessons
from benchmarks.clicks.reading.games import Rows, boundary_rows, first_rows, later_rows
from benchmarks.clicks.reading.training import loss, trained

#: The networks of the package.
PLACE = Path(accelsurf.clicks.model.__file__).with_name(WEIGHTS)
#: Widths of the layers, and rows of a step, by network.
HIDDEN, BATCH = {"first": (64, 32), "later": (64, 32), "boundary": (16,)}, {"boundary": 1024}
#: Passes over the rows; part of the scenes that is held back; scenes of a file of rows.
PASSES, HELD, CHUNK = 2, 0.08, 20
#: Scenes of whole windows, as a part of those of rows; steps over windows.
AROUND, STEPS = 1.0, 4000


def gathered(
    work: Path, name: str, first: int, count: int, make: Callable[[int], list[Rows]], jobs: int
) -> Rows:
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
    return Rows(
        names,
        *(np.concatenate([part[key] for part in parts]) for key in ("table", "wanted", "scenes")),
    )


def _written(job: tuple[Path, range], make: Callable[[int], list[Rows]]) -> str:
    path, seeds = job
    rows = [each for seed in seeds for each in make(seed)]
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


def fitted(name: str, rows: Rows, passes: int) -> tuple[Network, dict[str, float]]:
    """Train on all scenes but some, which say how well."""
    held = rows.scenes % round(1 / HELD) == 0
    wanted = rows.wanted.astype(np.float32).clip(0.0, 1.0)
    batch = {"batch": BATCH[name]} if name in BATCH else {}
    network = trained(rows.names, rows.table[~held], wanted[~held], HIDDEN[name], passes, **batch)
    share = float(wanted[held].mean())
    figures = {
        "rows": len(wanted),
        "scenes": len(np.unique(rows.scenes)),
        "parameters": network.parameters,
        "cross_entropy_held": loss(network, rows.table[held], wanted[held]),
        "cross_entropy_of_the_mean": -(share * np.log(share) + (1 - share) * np.log(1 - share)),
    }
    return network, {key: round(float(value), 4) for key, value in figures.items()}


def train(
    work: Path, scenes: int, jobs: int, passes: int, steps: int, out: Path
) -> dict[str, object]:
    """Train all networks; later clicks in two rounds, the second on games of the first."""
    work.mkdir(parents=True, exist_ok=True)
    began, record = time.monotonic(), dict[str, object]()
    networks: dict[str, Network] = {}

    def fit(name: str, stage: str, rows: Rows) -> None:
        networks[name], record[stage] = fitted(name, rows, passes)
        print(stage, record[stage], flush=True)

    def as_asked() -> None:
        """Round the weights as they are in a file."""
        save(work / WEIGHTS, networks)
        networks.update(load(work / WEIGHTS))

    fit("first", "first", gathered(work, "first", 0, scenes, first_rows, jobs))
    as_asked()
    seeds = range(400_000, 400_000 + round(AROUND * scenes))
    seen = lessons.written(
        work, "around", seeds, partial(lessons.lessons_of_first, networks=dict(networks)), jobs
    )
    layers, record["around"] = lessons.fitted(seen, steps, jobs)
    networks["first"] = dataclasses.replace(
        networks["first"], around=tuple(Layer(*pair) for pair in layers)
    )
    as_asked()
    print("around", record["around"], flush=True)
    rough = gathered(
        work, "rough", 100_000, scenes // 2, partial(later_rows, networks=dict(networks)), jobs
    )
    fit("later", "rough", rough)
    played = gathered(
        work, "later", 200_000, scenes // 2, partial(later_rows, networks=dict(networks)), jobs
    )
    both = Rows(
        rough.names, *(np.concatenate(pair) for pair in zip(rough[1:], played[1:], strict=True))
    )
    fit("later", "later", both)
    as_asked()
    near = gathered(
        work, "near", 300_000, scenes // 3, partial(boundary_rows, networks=dict(networks)), jobs
    )
    fit("boundary", "boundary", near)
    save(out, networks)
    record["minutes"] = round((time.monotonic() - began) / 60.0, 1)
    record["sha256"] = hashlib.sha256(out.read_bytes()).hexdigest()
    out.with_suffix(".json").write_text(json.dumps(record, indent=1) + "\n")
    return record


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.clicks.reading", description=__doc__
    )
    commands = parser.add_subparsers(required=True)
    training = commands.add_parser(
        "train", help="train on scenes drawn on the fly; goes on where it was interrupted"
    )
    training.add_argument(
        "--work", type=Path, required=True, help="folder for rows; about 1 MB a scene"
    )
    training.add_argument("--scenes", type=int, default=1200)
    training.add_argument("--jobs", type=int, default=2)
    training.add_argument("--passes", type=int, default=PASSES)
    training.add_argument(
        "--steps", type=int, default=STEPS, help="of the network that sees a block's surroundings"
    )
    training.add_argument("--out", type=Path, default=PLACE)
    training.set_defaults(
        run=lambda a: print(train(a.work, a.scenes, a.jobs, a.passes, a.steps, a.out))
    )
    showing = commands.add_parser("show", help="print what the weights are")
    showing.set_defaults(
        run=lambda a: print({n: (w.parameters, w.names) for n, w in load(PLACE).items()})
    )
    asked = parser.parse_args()
    asked.run(asked)


if __name__ == "__main__":
    main()
