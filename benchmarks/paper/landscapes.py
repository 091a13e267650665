"""Volumes with known truth whose energy may trap a surface, and the balls from which surfaces start.

Contrast 1, voxels of 1 mm, 48 along each axis; a seed decides all that is random in one. Energies are Chan and Vese's,
without an area weight, as in the paper, unless one is given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

N = 48
Array = np.ndarray


class Ball(NamedTuple):
    """A ball to start from: middle z, y, x from the middle of the volume, and radius, voxels."""

    z: float
    y: float
    x: float
    radius: float

    def distance(self) -> Array:
        """Signed distance from the ball, voxels."""
        z, y, x = axes()
        return np.asarray(
            np.sqrt((z - self.z) ** 2 + (y - self.y) ** 2 + (x - self.x) ** 2) - self.radius
        )


#: The paper's three placements, for the box: inside, in a corner of it, around it.
INSIDE, CORNER, AROUND = (
    Ball(2.0, -1.0, 3.0, 6.0),
    Ball(-7.0, 7.0, -6.0, 5.0),
    Ball(0.0, 0.0, 0.0, 21.0),
)
THREE = {"inside": INSIDE, "in a corner": CORNER, "around": AROUND}


class Landscape(NamedTuple):
    """A landscape: ``make`` gives image and truth of a seed; surfaces begin at each of the ``starts``.

    ``alpha`` is the weight of the area in its energy.
    """

    words: str
    make: Callable[[int], tuple[Array, Array]]
    starts: dict[str, Ball]
    alpha: float = 0.0


def axes() -> Array:
    """Coordinates (3, n, n, n) of the voxels from the middle, z y x."""
    return np.indices((N, N, N)) - 0.5 * (N - 1)


def box() -> Array:
    """The object: 24 x 28 x 26 voxels."""
    z, y, x = np.abs(axes())
    return np.asarray((z < 12) & (y < 14) & (x < 13))


def white(sigma: float) -> Callable[[int], tuple[Array, Array]]:
    """The box in white noise."""

    def make(seed: int) -> tuple[Array, Array]:
        truth = box()
        return truth + np.random.default_rng(seed).normal(0.0, sigma, truth.shape), truth

    return make


def correlated(sigma: float, length: float) -> Callable[[int], tuple[Array, Array]]:
    """The box in noise that is smoothed over ``length`` voxels and has the standard deviation ``sigma`` after it."""

    def make(seed: int) -> tuple[Array, Array]:
        truth = box()
        return truth + sigma * smooth_noise(seed, length), truth

    return make


def smooth_noise(seed: int, length: float) -> Array:
    """Noise of standard deviation 1 with a Gaussian correlation."""
    noise = ndimage.gaussian_filter(
        np.random.default_rng(seed).normal(size=(N, N, N)), length, mode="wrap"
    )
    return np.asarray(noise / noise.std())


def walled(depth: float, thick: float) -> Callable[[int], tuple[Array, Array]]:
    """The box parted by three dark walls across its axes, at places that the seed decides."""

    def make(seed: int) -> tuple[Array, Array]:
        random, truth = np.random.default_rng(seed), box()
        image = truth.astype(float)
        for axis, at in enumerate(random.uniform(-6.0, -4.0, 3) * random.choice([-1, 1], 3)):
            image[truth & (np.abs(axes()[axis] - at) < 0.5 * thick)] = 1.0 - depth
        return image + random.normal(0.0, 0.2, truth.shape), truth

    return make


def core_middle(random: np.random.Generator) -> Array:
    """Draw the middle of the core, z y x from the middle of the volume: the first that is drawn from a seed."""
    return random.uniform(-2.0, 2.0, 3)


def about_core(seed: int, radius: float) -> Ball:
    """Return the ball of a radius about the core that a seed draws."""
    return Ball(*core_middle(np.random.default_rng(seed)).tolist(), radius)


def phases(core: float, sigma: float) -> Callable[[int], tuple[Array, Array]]:
    """The box with a brighter core: the surface starts in the core, and shall find the whole box."""

    def make(seed: int) -> tuple[Array, Array]:
        random, truth = np.random.default_rng(seed), box()
        z, y, x = axes() - core_middle(random).reshape(3, 1, 1, 1)
        image = truth + (core - 1.0) * (np.sqrt(z**2 + y**2 + x**2) < 7.0)
        return image + random.normal(0.0, sigma, truth.shape), truth

    return make


def textured(amplitude: float, wave: float) -> Callable[[int], tuple[Array, Array]]:
    """The box filled with a gyroid of ``wave`` voxels, turned and shifted by the seed."""

    def make(seed: int) -> tuple[Array, Array]:
        random, truth = np.random.default_rng(seed), box()
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        a, b, c = 2.0 * np.pi / wave * np.tensordot(turn, axes(), 1) + random.uniform(
            0.0, 6.3, 3
        ).reshape(3, 1, 1, 1)
        gyroid = np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a)
        return truth * (1.0 + amplitude * gyroid) + random.normal(0.0, 0.2, truth.shape), truth

    return make


def two_rooms(thick: float) -> Callable[[int], tuple[Array, Array]]:
    """The box beside another of the same brightness, behind a dark wall: only the first is the object."""

    def make(seed: int) -> tuple[Array, Array]:
        random = np.random.default_rng(seed)
        z, y, x = axes()
        rooms = (np.abs(z) < 12) & (np.abs(y) < 14) & (np.abs(x) < 20)
        at = random.uniform(-1.0, 1.0)
        image = rooms & (np.abs(x - at) > 0.5 * thick)
        return image + random.normal(0.0, 0.2, rooms.shape), image & (x > at)

    return make


ONE, IN_ROOM = {"inside": INSIDE}, {"inside": Ball(2.0, -1.0, 10.0, 6.0)}
LANDSCAPES = {
    "white noise": Landscape("the box in white noise as strong as the contrast", white(1.0), THREE),
    "weak contrast": Landscape(
        "the box in white noise of twice the contrast; the program's area weight, 1.2",
        white(2.0),
        ONE,
        1.2,
    ),
    "correlated noise": Landscape(
        "the box in noise of 0.5 of the contrast, correlated over 1.5 voxels; area weight 0.3",
        correlated(0.5, 1.5),
        ONE,
        0.3,
    ),
    "walls": Landscape(
        "the box parted by three dark walls of 2 voxels, noise 0.2", walled(0.7, 2.0), ONE
    ),
    "several phases": Landscape(
        "the box with a core 2.4 times as bright, noise 0.1",
        phases(2.4, 0.1),
        {**ONE, "at the core": Ball(0.0, 0.0, 0.0, 7.0)},
    ),
    "texture": Landscape(
        "the box filled with a gyroid of 10 voxels, noise 0.2", textured(0.7, 10.0), ONE
    ),
    "two rooms": Landscape(
        "the box beside another one, behind a dark wall of 2 voxels; noise 0.2",
        two_rooms(2.0),
        IN_ROOM,
    ),
    "thin wall": Landscape("the same behind a wall of 1 voxel", two_rooms(1.0), IN_ROOM),
}
#: The box with a core of each brightness, in noise of 0.1: the scan that shows how wide the range is.
CORES = {
    f"core {core:g}": Landscape(
        f"the box with a core {core:g} times as bright, noise 0.1", phases(core, 0.1), ONE
    )
    for core in (2.2, 2.3, 2.4, 2.5, 2.6, 2.7, 2.8, 3.0)
}
ALL = {**LANDSCAPES, **CORES}
