"""A session with the learned reading: a click, its answer, the next click."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import ndimage

from accelsurf.grid.boxes import connected_to
from accelsurf.image.volume import Volume
from benchmarks.clicks.person import MOST_SPACINGS, PersonClick, ball_voxels
from benchmarks.clicks.reading.features import Features, features_of_first, features_of_later, table_of
from benchmarks.clicks.reading.network import Network, load
from benchmarks.clicks.reading.windows import SCALES, Floats, Mask, Window, inscribed_radius, window_around

#: The networks as they were trained last.
WEIGHTS = Path(__file__).with_name("weights.npz")
#: A block is object from this probability on. A later inside click adds from `ADDED` on, an outside click removes from
#: 1 - `ADDED` on: of an object with the Dice d a voxel is worth taking from d/2 on.
FROM, ADDED = 0.47, 0.43
#: An answer that covers more than this part of the open faces asks for the next scale.
TOUCHES = 0.02


@lru_cache(maxsize=1)
def weights() -> Mapping[str, Network]:
    """The networks "first" and "later" of the package."""
    return load(WEIGHTS)


class ReadingSession:
    """One object: labels after each click.

    Parameters
    ----------
    image : Volume
    networks : dict of Network, optional
        Those of the package if not given.
    largest : float, optional
        Largest radius of a click, mm; that of `benchmarks.clicks.person` if not given.
    """

    def __init__(
        self, image: Volume, networks: Mapping[str, Network] | None = None, largest: float | None = None
    ) -> None:
        self.image, self.networks = image, weights() if networks is None else networks
        self.largest = MOST_SPACINGS * min(image.geometry.spacing) if largest is None else largest
        self.values, self.spacing = image.as_float32(), image.geometry.spacing
        self.clicks: list[PersonClick] = []
        self.labels: Mask = np.zeros(image.geometry.shape, np.bool_)

    def click(self, click: PersonClick) -> Mask:
        """Labels (nz, ny, nx) after one more click."""
        self.clicks.append(click)
        self.labels = self._first() if len(self.clicks) == 1 else self._later()
        for known in self.clicks:
            box, ball = ball_voxels(known, self.image.geometry)
            self.labels[box][ball] = known.side == "inside"
        return self.labels

    def asked(self, features: Features, name: str, window: Window) -> Floats:
        """Probability of each block that it is on the click's side."""
        network, shape = self.networks[name], window.values.shape
        return network.probability(table_of(features, network.names, np.arange(window.values.size))).reshape(shape)

    def first_of(self, window: Window) -> Floats:
        """Probability of each block after the first click."""
        return self.asked(features_of_first(window, inscribed_radius(self.clicks[-1], self.spacing)), "first", window)

    def later_features(self, window: Window) -> tuple[Features, Mask]:
        """Features of the last click's window, with the labels before it."""
        last = self.clicks[-1]
        volume = float(np.count_nonzero(self.labels)) * self.image.geometry.voxel_volume
        radius = inscribed_radius(last, self.spacing)
        return features_of_later(window, radius, self.labels, last.side == "inside", len(self.clicks), volume)

    def window(self, number: int) -> Window:
        """The window around the last click, by number of its scale."""
        return window_around(self.values, self.spacing, self.clicks, SCALES[number], self.largest)

    def _first(self) -> Mask:
        for number in range(len(SCALES)):
            window = self.window(number)
            probability = self.first_of(window)
            found = connected_to((probability > FROM) | window.mine, window.mine)
            if not _touches(found, window):
                break
        field = _on_side(probability - FROM, found)
        field[ndimage.binary_fill_holes(found) & ~found] = 1e-3
        out = np.zeros_like(self.labels)
        out[window.box] = window.on_voxels(field) > 0
        return out

    def _later(self) -> Mask:
        inside = self.clicks[-1].side == "inside"
        for number in range(len(SCALES)):
            window = self.window(number)
            features, side = self.later_features(window)
            probability = self.asked(features, "later", window)
            probability[window.theirs] = 0.0
            least = ADDED if inside else 1.0 - ADDED
            found = connected_to(((probability > least) & ~side) | window.mine, window.mine)
            if not _touches(found & ~side, window):
                break
        field = _on_side(probability - least, found)
        field[side] = np.maximum(field[side], 0.1)
        changed = window.on_voxels(field) > 0
        out = self.labels.copy()
        out[window.box] = out[window.box] | changed if inside else out[window.box] & ~changed
        return out


def _on_side(field: Floats, found: Mask) -> Floats:
    """The field, above 0 where something was found and below elsewhere."""
    return np.where(found, np.maximum(field, 1e-3), np.minimum(field, -1e-3)).astype(np.float32)


def _touches(found: Mask, window: Window) -> bool:
    """Test if what was found goes on beyond the window."""
    count = np.count_nonzero(window.faces)
    return count > 0 and np.count_nonzero(found & window.faces) > TOUCHES * count
