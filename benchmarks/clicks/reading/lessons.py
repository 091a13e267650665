"""What the network of a block's surroundings learns from: whole windows of scenes, with the first network's answers.

It learns the cross entropy of each block and the Dice of the window: the first alone would ask for a level at which an
uncertain window counts as object, the second says what is worth counting.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from accelsurf.clicks.model.features import features_of_first
from accelsurf.clicks.model.model import first_blocks
from accelsurf.clicks.model.network import Network
from accelsurf.clicks.model.windows import SCALES, Window
from benchmarks.clicks.reading.around import Layers, backward, forward, started
from benchmarks.clicks.reading.games import OBJECTS, OFTEN, games

Floats = NDArray[np.floating]
#: Windows of a step, its largest rate, part of the steps in which it grows, and the decay of weights.
BATCH, RATE, WARM, DECAY = 4, 3e-3, 0.05, 1e-4
#: Means of slopes and of their squares fade by these; slopes are scaled down to at most this length.
FADING, SQUARES, LONGEST = 0.1, 0.005, 1.0
#: Part of the windows whose scale is drawn: the others have the one that a session takes.
DRAWN = 0.3
#: Every so many scenes one is held back.
HELD = 12


class Lesson(NamedTuple):
    """A window: standardised features (nz, ny, nx, k) and the first answer (logits), float16; shares, of 255.

    ``fixed``: blocks that clicks decide; ``mine``: those of them that are on the click's side.
    """

    features: NDArray[np.float16]
    answer: NDArray[np.float16]
    share: NDArray[np.uint8]
    fixed: NDArray[np.bool_]
    mine: NDArray[np.bool_]
    scene: int


def lessons_of_first(seed: int, networks: Mapping[str, Network]) -> list[Lesson]:
    """Windows of first clicks in a scene, a window an object."""
    out = []
    for game in games(seed, 4, OBJECTS, networks):
        if not game.click():
            continue
        if game.random.random() < DRAWN:
            window = game.window(int(game.random.choice(len(SCALES), p=OFTEN)))
        else:
            window = first_blocks(game.scene, game.seeds[0], network=networks["first"]).window
        out.append(_lesson(window, networks["first"], game.truth, seed))
    return out


def _lesson(window: Window, network: Network, truth: NDArray[np.bool_], seed: int) -> Lesson:
    values = network.standardised(features_of_first(window), window.values.shape)
    answer = network.logits(values)
    share = np.rint(window.means(truth) * 255).astype(np.uint8)
    last = np.ascontiguousarray(np.moveaxis(values, 0, -1))
    fixed = window.mine | window.theirs
    return Lesson(
        last.astype(np.float16), answer.astype(np.float16), share, fixed, window.mine, seed
    )


def written(
    work: Path, name: str, seeds: Sequence[int], make: Callable[[int], list[Lesson]], jobs: int
) -> list[Lesson]:
    """Lessons of scenes, a file a scene: those that are there already are read."""
    paths = [work / f"{name}-{seed}.pkl" for seed in seeds]
    missing = [(path, seed) for path, seed in zip(paths, seeds, strict=True) if not path.exists()]
    with ProcessPoolExecutor(jobs) as pool:
        list(pool.map(partial(_write, make=make), missing))
    return [lesson for path in paths for lesson in pickle.loads(path.read_bytes())]


def _write(job: tuple[Path, int], make: Callable[[int], list[Lesson]]) -> None:
    path, seed = job
    part = path.with_suffix(".part")
    part.write_bytes(pickle.dumps(make(seed), 4))
    part.replace(path)


def error(
    logits: Floats, share: Floats, fixed: NDArray[np.bool_], mine: NDArray[np.bool_]
) -> tuple[float, float, Floats]:
    """Cross entropy, Dice, and the slopes of their difference along the logits.

    ``fixed`` and ``mine`` are those of a `Lesson`.
    """
    free, p = ~fixed, expit(logits)
    count = max(int(np.count_nonzero(free)), 1)
    entropy = -float((share * np.log(p + 1e-6) + (1 - share) * np.log(1 - p + 1e-6))[free].mean())
    found = np.where(fixed, mine.astype(np.float32), p)
    both, total = 2.0 * float((found * share).sum()) + 1.0, float(found.sum() + share.sum()) + 1.0
    slope = (p - share) / count - (2.0 * share * total - both) / total**2 * p * (1.0 - p)
    return entropy, both / total, np.where(free, slope, 0.0).astype(np.float32)


#: Lessons of the processes that work on a step: they are copied when a process starts.
_HELD: list[Lesson] = []


def fitted(lessons: Sequence[Lesson], steps: int, jobs: int) -> tuple[Layers, dict[str, float]]:
    """Train on all lessons but those of some scenes, which say how well."""
    _HELD[:] = lessons
    taught = np.array([i for i, lesson in enumerate(lessons) if lesson.scene % HELD])
    held = [i for i, lesson in enumerate(lessons) if lesson.scene % HELD == 0]
    layers = started(lessons[0].features.shape[-1])
    parts = [part for layer in layers for part in layer]
    means, squares = ([np.zeros_like(part) for part in parts] for _ in range(2))
    random, order = np.random.default_rng(0), list[int]()
    with ProcessPoolExecutor(jobs) as pool:
        for step in range(1, steps + 1):
            while len(order) < BATCH:
                order += list(random.permutation(taught))
            todo, order = order[:BATCH], order[BATCH:]
            found = list(
                pool.map(_slopes, [(layers, int(i), (step, j)) for j, i in enumerate(todo)])
            )
            slopes = [
                np.sum([each[i] for each in found], axis=0) / BATCH for i in range(len(parts))
            ]
            less = min(
                1.0, LONGEST / max(float(np.sqrt(sum((part**2).sum() for part in slopes))), 1e-9)
            )
            share = step / steps
            rate = (
                RATE
                * min(share / WARM, 1.0)
                * 0.5
                * (1.0 + np.cos(np.pi * max(share - WARM, 0.0) / (1.0 - WARM)))
            )
            for i, slope in enumerate(slopes):
                means[i] += FADING * (less * slope - means[i])
                squares[i] += SQUARES * ((less * slope) ** 2 - squares[i])
                mean = means[i] / (1.0 - (1.0 - FADING) ** step)
                spread = np.sqrt(squares[i] / (1.0 - (1.0 - SQUARES) ** step)) + 1e-8
                change = mean / spread + DECAY * parts[i] * (i % 2 == 0)
                parts[i] = (parts[i] - np.float32(rate) * change).astype(np.float32)
            layers = list(zip(parts[::2], parts[1::2], strict=True))
        told = np.mean(list(pool.map(_told, [(layers, i) for i in held])), axis=0)
    names = ("cross_entropy_before", "dice_before", "cross_entropy", "dice")
    figures = dict(zip(names, (round(float(value), 4) for value in told), strict=True))
    counts = {
        "windows": float(len(lessons)),
        "parameters": float(sum(w.size + b.size for w, b in layers)),
    }
    return tuple(layers), counts | figures


def _slopes(job: tuple[Layers, int, tuple[int, int]]) -> list[Floats]:
    """Slopes of layers on a lesson that is turned and mirrored at random."""
    layers, index, seed = job
    random = np.random.default_rng(seed)
    axes = random.permutation(3)
    ends = tuple(slice(None, None, -1) if random.random() < 0.5 else slice(None) for _ in range(3))

    def turned(array: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.ascontiguousarray(array.transpose(*axes, *range(3, array.ndim))[ends])

    features, answer, share, fixed, mine = map(turned, _HELD[index][:5])
    logits, held = forward(layers, features.astype(np.float32), answer.astype(np.float32))
    slope = error(logits, share.astype(np.float32) / 255, fixed, mine)[2]
    return [part for layer in backward(layers, held, slope) for part in layer]


def _told(job: tuple[Layers, int]) -> tuple[float, float, float, float]:
    layers, index = job
    lesson = _HELD[index]
    answer, share = lesson.answer.astype(np.float32), lesson.share.astype(np.float32) / 255
    logits, _ = forward(layers, lesson.features.astype(np.float32), answer)
    before, after = (error(each, share, lesson.fixed, lesson.mine)[:2] for each in (answer, logits))
    return (*before, *after)
