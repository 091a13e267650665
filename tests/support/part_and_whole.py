"""A bright ball that belongs to something larger and less bright, in noise: a click in it may mean either."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from tests.support import clicked_balls

SHAPE, SPACING = (24, 44, 46), (2.0, 1.0, 1.0)
#: In the bright ball, and in the rest.
CLICK, BEYOND = "ball:14,16,24,4", "ball:32,32,24,2"


def part_and_whole() -> tuple[Volume, NDArray[Any], NDArray[Any]]:
    """The image, the part and the whole."""

    def ball(middle: tuple[int, int, int], radius: float) -> NDArray[Any]:
        return np.asarray(clicked_balls.distance(middle, SHAPE, SPACING) <= radius)

    part = ball((12, 16, 14), 9.0)
    whole = part | ball((12, 32, 32), 8.0) | ball((12, 24, 23), 5.0)
    image = np.where(part, 100.0, 75.0 * whole) + np.random.default_rng(5).normal(0.0, 15.0, SHAPE)
    return Volume(image.astype(np.float32), Geometry(SHAPE, SPACING)), part, whole
