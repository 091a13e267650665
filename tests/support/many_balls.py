"""An image of several balls with a start in each: some touch, two are a gap apart, one grows far, some are alone."""

import math

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume

SHAPE = (40, 64, 112)
#: Turned a little about z, so that places have digits to lose.
TURN = ((math.cos(0.2), -math.sin(0.2), 0.0), (math.sin(0.2), math.cos(0.2), 0.0), (0.0, 0.0, 1.0))
GEOMETRY = Geometry(SHAPE, (1.2, 1.0, 0.9), (3.3, -7.1, 12.7), np.array(TURN))
#: id -> (z, y, x) voxel of the middle, radius in mm. 20 to 22 are a chain that touches, 31 and 32 a gap apart.
BALLS = {
    20: ((16, 16, 15), 7.0),
    21: ((16, 17, 29), 7.0),
    22: ((19, 17, 43), 7.0),
    31: ((17, 48, 15), 7.5),
    32: ((17, 48, 38), 8.5),
    47: ((18, 20, 84), 6.0),
    9: ((22, 50, 90), 6.5),
}
#: The object 47 is a rod along x, of which only one end has the start.
ROD_END = 104


def distance_to(middle, radius):
    """Signed distance, mm, to a ball."""
    steps = [
        (i - c) * h for i, c, h in zip(np.indices(SHAPE), middle, GEOMETRY.spacing, strict=True)
    ]
    return np.sqrt(sum(step**2 for step in steps)) - radius


def scene():
    """The image."""
    inside = np.zeros(SHAPE, np.bool_)
    for middle, radius in BALLS.values():
        inside |= distance_to(middle, radius) < 0
    z, y, x = np.indices(SHAPE)
    inside |= (abs(z - 18) < 4) & (abs(y - 20) < 5) & (x > 82) & (x < ROD_END)
    values = inside * 100.0 + np.random.default_rng(3).normal(0, 10, SHAPE)
    return Volume(values.astype(np.float32), GEOMETRY)


def label_map(ids=tuple(BALLS)):
    """A small ball with its id in each of some objects."""
    labels = np.zeros(SHAPE, np.uint16)
    for own in ids:
        labels[distance_to(BALLS[own][0], 3.0) < 0] = own
    return Volume(labels, GEOMETRY)


def write_table(path, ids=tuple(BALLS)):
    """A table of balls with a row for each of some objects."""
    rows = [f"{own},{x},{y},{z},3.5" for own, ((z, y, x), _) in BALLS.items() if own in ids]
    path.write_text("\n".join(["id,x_vox,y_vox,z_vox,r_vox", *rows, ""]))
    return str(path)
