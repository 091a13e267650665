"""Games in drawn scenes, and the rows of features that networks learn from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks.model import ClickModel
from accelsurf.clicks.model import Scene as Images
from accelsurf.clicks.model.boundary import features_near
from accelsurf.clicks.model.features import Features, features_of_first, features_of_later
from accelsurf.clicks.model.model import first_blocks, first_model, with_click
from accelsurf.clicks.model.network import Network
from accelsurf.clicks.model.windows import SCALES, Seed, Window, seed_of, window_around
from accelsurf.grid.boxes import whole_box, widened
from accelsurf.image.volume import Volume
from benchmarks.clicks.person import MOST_SPACINGS, PersonClick, ball_voxels, next_click, voxels_of
from benchmarks.clicks.reading.scenes import scene

Random = np.random.Generator
Mask = NDArray[np.bool_]
#: Objects of a scene that are clicked; windows of a click and blocks of a window that are learned from.
OBJECTS, WINDOWS, BLOCKS = 3, 2, 900
#: Voxels near a boundary that are learned from; objects found with less than this Dice are left out there.
NEAR, LEAST_DICE = 2500, 0.3
#: How often a window of each scale is taken.
OFTEN = (0.38, 0.3, 0.2, 0.12)
#: Part of the games in which clicks are not exact; of the first clicks that are smaller than half the depth for no
#: reason, to which part at least; of the games in which clicks are as large as clicks get from a radius on, voxels.
JITTERED, SMALLER, SMALLEST = 0.3, 0.2, 0.15
LIMITED, LARGEST = 0.35, (0.5, 8.0)
#: Most clicks of a game.
CLICKS = 6


class Rows(NamedTuple):
    """Rows of a network: names of the features, a table (k, n) float16, shares that are wanted, scenes."""

    names: list[str]
    table: NDArray[np.float16]
    wanted: NDArray[np.float16]
    scenes: NDArray[np.int64]


class Game:
    """A person who clicks an object of a drawn scene; not always exact, and sometimes with a smaller ball.

    Parameters
    ----------
    volume : Volume
    truth : ndarray of bool
        The object.
    random : numpy.random.Generator
    networks : mapping of str to Network
        Those that are trained already.
    """

    def __init__(
        self, volume: Volume, truth: Mask, random: Random, networks: Mapping[str, Network]
    ) -> None:
        self.volume = volume
        self.truth = truth
        self.random = random
        self.networks = networks
        self.scene = Images((volume.as_float32(),), volume.geometry.spacing)
        self.largest = MOST_SPACINGS * min(volume.geometry.spacing)
        if random.random() < LIMITED:
            self.largest = float(np.exp(random.uniform(*np.log(LARGEST))))
        self.is_exact = random.random() >= JITTERED
        self.seeds: list[Seed] = []
        self.model: ClickModel | None = None
        self.labels = np.zeros(volume.geometry.shape, np.bool_)

    def click(self) -> bool:
        """Add the next click; False where nothing is wrong."""
        labels = self.labels if self.seeds else None
        click = next_click(
            self.truth, labels, self.volume.geometry, None if self.is_exact else self.random
        )
        if click is None:
            return False
        part = 1.0
        if not self.seeds and self.random.random() < SMALLER:
            part = float(np.exp(self.random.uniform(np.log(SMALLEST), 0.0)))
        radius = max(min(part * click.radius, self.largest), 0.5 * min(self.scene.spacing))
        seed = seed_of(voxels_of(click._replace(radius=radius), self.volume.geometry), self.scene)
        self.seeds.append(
            seed._replace(is_limited=seed.is_limited or radius >= self.largest * (1 - 1e-6))
        )
        return True

    def window(self, number: int) -> Window:
        """A window around the last click, by number of its scale."""
        return window_around(self.scene, self.seeds, SCALES[number])

    def later_features(self, window: Window) -> tuple[Features, Mask]:
        """Features of a later click's window, and the blocks that are on its side already."""
        return features_of_later(
            window, self.labels[window.box], len(self.seeds), int(np.count_nonzero(self.labels))
        )

    def answer(self) -> None:
        """Find the labels after the last click; with the truth near it while no network answers later clicks."""
        if len(self.seeds) == 1:
            shape = self.volume.geometry.shape
            self.model = first_model(self.scene, self.seeds[0], shape, None, 1, self.networks)
        elif "later" in self.networks and self.model is not None:
            self.model = with_click(self.model, self.scene, self.seeds, self.networks)
        else:
            box, ball = self._widened()
            inside = self.seeds[-1].click.side == "inside"
            self.labels[box][ball & (self.truth[box] == inside)] = inside
            return
        assert self.model is not None
        self.labels = self.model.inside_on(whole_box(self.volume.geometry.shape))

    def _widened(self) -> tuple[tuple[slice, slice, slice], Mask]:
        """A ball some times as wide as the last click."""
        seed = self.seeds[-1]
        z, y, x = (int(i) for i in seed.core[0])
        wide = seed.radius * self.random.uniform(1.0, 3.5)
        return ball_voxels(
            PersonClick("inside", (z, y, x), (0.0, 0.0, 0.0), wide), self.volume.geometry
        )


def games(seed: int, kind: int, objects: int, networks: Mapping[str, Network]) -> Iterator[Game]:
    """Games for some objects of a scene, not begun; each ``kind`` has its own random numbers."""
    volume, truths = scene(seed)
    for number, truth in enumerate(truths[:objects]):
        yield Game(volume, truth, np.random.default_rng([seed, number, kind]), networks)


def sampled(
    features: Features,
    share: NDArray[np.floating],
    where: NDArray[np.int64],
    seed: int,
    random: Random,
) -> Rows:
    """Some of the blocks ``where``, half of them near the click."""
    near = where[np.asarray(features["distance"]).ravel()[where] < 2.0]
    rows = np.concatenate([random.choice(part, BLOCKS // 2) for part in (near, where) if len(part)])
    return rows_of(features, share.ravel()[rows], rows, seed)


def rows_of(
    features: Features, wanted: NDArray[np.floating], rows: NDArray[np.int64], seed: int
) -> Rows:
    """Rows of some blocks, by flat index."""
    names = sorted(features)
    columns = [
        np.broadcast_to(f, len(rows)) if f.ndim == 0 else f.ravel()[rows]
        for f in map(features.get, names)
    ]
    table = np.stack(columns, 1).astype(np.float16)
    return Rows(names, table, wanted.astype(np.float16), np.full(len(rows), seed))


def first_rows(seed: int) -> list[Rows]:
    """Rows of first clicks in a scene."""
    out = []
    for game in games(seed, 1, OBJECTS, {}):
        if not game.click():
            continue
        for scale in game.random.choice(len(SCALES), WINDOWS, replace=False, p=OFTEN):
            window = game.window(int(scale))
            features = features_of_first(window)
            everywhere = np.arange(window.values.size)
            out.append(sampled(features, window.means(game.truth), everywhere, seed, game.random))
    return out


def later_rows(seed: int, networks: Mapping[str, Network]) -> list[Rows]:
    """Rows of later clicks of games in a scene."""
    out: list[Rows] = []
    for game in games(seed, 2, OBJECTS - 1, networks):
        for count in range(int(game.random.integers(2, CLICKS + 1))):
            if not game.click():
                break
            if count:
                out += _rows_of_last(game, seed)
            game.answer()
    return out


def _rows_of_last(game: Game, seed: int) -> Iterator[Rows]:
    for scale in game.random.choice(len(SCALES), WINDOWS, replace=False, p=OFTEN):
        window = game.window(int(scale))
        features, side = game.later_features(window)
        free = np.flatnonzero(~side)
        if len(free):
            share = window.means(game.truth)
            share = share if game.seeds[-1].click.side == "inside" else 1.0 - share
            yield sampled(features, share, free, seed, game.random)


def boundary_rows(seed: int, networks: Mapping[str, Network]) -> list[Rows]:
    """Rows of voxels near the boundary after a few clicks in a scene."""
    out: list[Rows] = []
    for game in games(seed, 3, OBJECTS - 1, networks):
        for _ in range(int(game.random.integers(1, 4))):
            if not game.click():
                break
            game.answer()
        if game.model is None:
            continue
        first = first_blocks(game.scene, game.seeds[0], network=networks["first"]).window
        steps = [int(step) for step in first.steps]
        box = widened(game.model.box, game.truth.shape, [2 * step + 2 for step in steps])
        inside, wanted = game.model.inside_on(box), game.truth[box]
        total = np.count_nonzero(inside) + np.count_nonzero(wanted)
        if 2 * np.count_nonzero(inside & wanted) < LEAST_DICE * total:
            continue
        image, field = game.scene.images[0][box], game.model.field_on(box)
        features, where = features_near(image, game.scene.spacing, field, inside, steps)
        rows = game.random.choice(len(where), min(NEAR, len(where)), replace=False)
        out.append(rows_of(features, wanted.ravel()[where[rows]], rows, seed))
    return out
