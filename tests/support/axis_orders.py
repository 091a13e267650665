"""One scan stored in all orders and directions of its axes."""

from itertools import permutations, product

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

#: (order of the index axes z, y, x; which of the new ones are run through backwards)
Way = tuple[tuple[int, ...], tuple[bool, ...]]
WAYS: list[Way] = [
    (order, flips) for order in permutations(range(3)) for flips in product((False, True), repeat=3)
]


def permuted(array: np.ndarray, way: Way) -> np.ndarray:
    """An array of a volume with its axes in another order, some of them backwards."""
    order, flips = way
    return np.ascontiguousarray(
        np.flip(array.transpose(order), [axis for axis, flip in enumerate(flips) if flip])
    )


def restored(array: np.ndarray, way: Way) -> np.ndarray:
    """The inverse of `permuted`."""
    order, flips = way
    return np.flip(array, [axis for axis, flip in enumerate(flips) if flip]).transpose(
        np.argsort(order)
    )


def stored(volume: Volume, way: Way) -> Volume:
    """The volume with its axes in another order, some of them backwards; every voxel stays in its place."""
    order, flips = way
    corner = np.zeros(3)
    direction = volume.geometry.direction[:, ::-1][:, list(order)]  # columns by index axes z, y, x
    for axis, flipped in enumerate(flips):
        if flipped:
            corner[order[axis]] = volume.array.shape[order[axis]] - 1
            direction[:, axis] *= -1
    array = permuted(volume.array, way)
    spacing = tuple(volume.geometry.spacing[axis] for axis in order)
    origin = tuple(volume.geometry.index_to_world(corner))
    return Volume(array, Geometry(array.shape, spacing, origin, direction[:, ::-1]))
