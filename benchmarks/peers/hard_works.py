"""Works where one threshold cannot help, with exact truth, and what a person would take for each.

Every program gets the same clicks: balls inside and outside, (z, y, x) and radius in voxels. ``means`` are the image's
true means inside and outside: programs that need a threshold are told them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from accelsurf.measure.metrics import dice
from accelsurf.phantoms.recipes import Recipe, make
from benchmarks.peers.objects import mean_dice
from tests.support.tissues import membrane_cells

Ball = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Work:
    """An image, its truth (0 outside, else an object's id), and clicks: the ball in each object, and balls outside."""

    image: np.ndarray
    truth: np.ndarray
    inside: dict[int, Ball]
    outside: tuple[Ball, ...] = ()

    @property
    def means(self) -> tuple[float, float]:
        """True means inside and outside."""
        outside = self.truth == 0
        return float(self.image[~outside].mean()), float(
            self.image[outside].mean()
        ) if outside.any() else 0.0

    def score(self, labels: np.ndarray) -> float:
        """Dice; of several objects the mean of each with its own label."""
        if self.truth.max() > 1:
            return mean_dice(np.asarray(labels, np.int32), self.truth)
        return dice(labels > 0, self.truth > 0)


def drawn(shape: tuple[int, ...], ball: Ball) -> np.ndarray:
    """The ball's voxels.

    Examples
    --------
    >>> int(drawn((5, 5, 5), (2, 2, 2, 1.0)).sum())
    7
    """
    far = sum(
        (axis - at) ** 2
        for axis, at in zip(np.ogrid[tuple(map(slice, shape))], ball[:3], strict=True)
    )
    return np.asarray(far <= ball[3] ** 2)


def deepest(mask: np.ndarray, part: float = 0.5) -> Ball:
    """The ball at the deepest voxel, of ``part`` of its depth."""
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1, 1:-1]
    z, y, x = np.unravel_index(int(depth.argmax()), mask.shape)
    return float(z), float(y), float(x), max(part * float(depth.max()), 1.0)


def uneven(seed: int, side: int) -> Work:
    """A turned box in light that varies by 60 % of its contrast."""
    part = side / 96
    made = make(
        Recipe(
            kind="box",
            shape=(side,) * 3,
            sides=(56 * part, 44 * part, 36 * part),
            rotation=(20.0, 35.0, 10.0),
            background=100.0,
            contrast=100.0,
            bias=0.4,
            noise=20.0,
            blur=0.7,
            seed=seed,
        )
    )
    truth = made.truth.array.astype(np.int32)
    return Work(made.image.array.astype(np.float32), truth, {1: deepest(truth > 0, 0.3)})


def neighbours(seed: int, side: int) -> Work:
    """Two balls of one brightness that overlap by a neck; only one is meant."""
    middle, part = 0.5 * (side - 1), side / 96
    z, y, x = np.indices((side,) * 3) - middle
    radius, away = 20.0 * part, 17.0 * part
    one, other = ((z**2 + y**2 + (x - sign * away) ** 2) < radius**2 for sign in (-1, 1))
    truth = (one & (x < 0)).astype(np.int32)
    random = np.random.default_rng(seed)
    image = ndimage.gaussian_filter(100.0 * (one | other), 0.8) + random.normal(
        0.0, 30.0, truth.shape
    )
    at = middle - away, middle + away
    inside, outside = ((middle, middle, place, 0.4 * radius) for place in at)
    return Work(image.astype(np.float32), truth, {1: inside}, (outside,))


def vessels(seed: int, side: int) -> Work:
    """A tree of tubes that ends at a radius of 1.3 voxels."""
    part = side / 96
    made = make(
        Recipe(
            kind="vessel",
            shape=(side,) * 3,
            radius=3.5 * part,
            length=30.0 * part,
            levels=4,
            angle=35.0,
            taper=0.72,
            tree_seed=seed,
            background=100.0,
            contrast=100.0,
            antialias=True,
            blur=0.5,
            noise=30.0,
            seed=seed,
        )
    )
    truth = made.truth.array.astype(np.int32)
    return Work(made.image.array.astype(np.float32), truth, {1: deepest(truth > 0)})


def cells(seed: int, side: int) -> Work:
    """Fifty cells between membranes."""
    image, truth, centres = membrane_cells(
        (side // 2, side, side), 50 if side >= 96 else 6, noise=0.3, seed=seed
    )
    depth = ndimage.distance_transform_edt(image < 0.5)
    clicks = {
        i: (*map(float, at), max(1.0, 0.5 * float(depth[tuple(at)])))
        for i, at in enumerate(centres, 1)
    }
    return Work(image, truth, clicks)


WORKS: dict[str, Callable[[int, int], Work]] = {
    "uneven": uneven,
    "neighbours": neighbours,
    "vessels": vessels,
    "cells": cells,
}


def seeds_of(work: Work) -> np.ndarray:
    """Int32: object ids in their clicks, -1 in clicks outside, 0 elsewhere."""
    found = np.zeros(work.truth.shape, np.int32)
    for ball in work.outside:
        found[drawn(found.shape, ball)] = -1
    for own, ball in work.inside.items():
        found[drawn(found.shape, ball)] = own
    return found
