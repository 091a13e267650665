"""Images of balls that touch, and label maps with a small cube in each to start from."""

import numpy as np

from accelsurf.image.volume import Volume

#: Id -> middle (z, y, x) and radius.
TOUCHING = {3: (12, 14, 12, 8.6), 8: (12, 14, 29, 8.6)}
#: A small one, and a large one that needs more steps.
UNEQUAL = {3: (12, 12, 12, 6.0), 8: (12, 20, 40, 11.0)}


def image(balls):
    """Noise, and the balls in it."""
    z, y, x = np.indices(shape(balls))
    inside = np.zeros(z.shape, bool)
    for k, j, i, r in balls.values():
        inside |= (z - k) ** 2 + (y - j) ** 2 + (x - i) ** 2 < r**2
    noise = np.random.default_rng(0).normal(0, 20, z.shape)
    return Volume.from_array((100 * inside + noise).astype(np.float32))


def starts(balls):
    """The label map on the same grid."""
    labels = np.zeros(shape(balls), np.uint8)
    for own, (z, y, x, _) in balls.items():
        labels[z - 3 : z + 4, y - 3 : y + 4, x - 3 : x + 4] = own
    return image(balls).with_array(labels)


def shape(balls):
    """Of the image, with room around the balls."""
    ends = np.array([(z + r, y + r, x + r) for z, y, x, r in balls.values()]).max(axis=0)
    return (24, int(ends[1]) + 6, int(ends[2]) + 6)
