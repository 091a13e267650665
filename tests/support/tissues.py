"""Phantoms of tissue with exact labels: cells between membranes, a tumour with a rim, an organelle.

What they have and the solids of recipes lack: several brightnesses in one object, or neighbours of the same brightness.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

Image = NDArray[np.float32]
Labels = NDArray[np.int32]
Shape = tuple[int, int, int]


def _finished(
    values: NDArray[np.float64], blur: float, noise: float, random: np.random.Generator
) -> Image:
    """Values after a scanner: blurred (sigma in voxels), with noise."""
    smooth = ndimage.gaussian_filter(values, blur)
    return np.asarray(smooth + random.normal(0.0, noise, values.shape), np.float32)


def _from_middle(shape: Shape) -> Iterator[NDArray[np.float64]]:
    """Yield coordinates z, y, x of the voxels, from the middle on."""
    return (axis - 0.5 * (n - 1) for axis, n in zip(np.indices(shape), shape, strict=True))


def membrane_cells(
    shape: Shape = (48, 96, 96),
    count: int = 33,
    *,
    membrane: float = 1.2,
    noise: float = 0.25,
    seed: int = 0,
) -> tuple[Image, Labels, NDArray[np.int64]]:
    """Cells that fill the volume, equally bright inside, between bright membranes.

    Parameters
    ----------
    shape : (nz, ny, nx)
    count : int
        Number of cells.
    membrane : float
        Half the thickness of a membrane, voxels.
    noise : float
        Standard deviation; a membrane has the value 1, the inside of a cell 0.
    seed : int

    Returns
    -------
    image : ndarray (nz, ny, nx), float32
    labels : ndarray (nz, ny, nx), int32
        1 to ``count``; each voxel belongs to the nearest centre.
    centres : ndarray (count, 3), int64
        The deepest voxel of each cell.

    Examples
    --------
    >>> image, labels, centres = membrane_cells((16, 32, 32), 5)
    >>> image.shape, int(labels.max()), [int(labels[tuple(c)]) for c in centres]
    ((16, 32, 32), 5, [1, 2, 3, 4, 5])
    """
    random = np.random.default_rng(seed)
    size = np.array(shape, float)
    points: list[NDArray[np.float64]] = []
    apart = 0.7 * (size.prod() / count) ** (1 / 3)
    while len(points) < count:
        point = random.uniform(0.0, size - 1.0)
        if all(np.linalg.norm(point - other) > apart for other in points):
            points.append(point)
        else:
            apart *= 0.999
    distances, nearest = KDTree(points).query(np.indices(shape).reshape(3, -1).T, k=2)
    wall = 0.5 * (distances[:, 1] - distances[:, 0]).reshape(shape) < membrane
    found = (nearest[:, 0] + 1).astype(np.int32).reshape(shape)
    inner = ndimage.distance_transform_edt(~wall)
    centres = [
        np.unravel_index(int(np.argmax(np.where(found == n, inner, -1.0))), shape)
        for n in range(1, count + 1)
    ]
    image = _finished(wall.astype(float), 0.7, noise, random)
    return image, found, np.array(centres, np.int64)


def nuclei(shape: Shape, count: int, *, seed: int = 0) -> tuple[Image, Labels]:
    """Ellipsoids with half axes of 5 to 8 voxels, 80 to 120 bright on 20, blurred, in noise of 15; and their labels."""
    random, size, places = np.random.default_rng(seed), np.array(shape), np.zeros((0, 3))
    while len(places) < count:
        at = random.uniform(6.0, size - 7.0)
        if len(places) % 4:  # beside an earlier one
            way = random.normal(size=3)
            at = places[random.integers(len(places))] + 11.5 * way / np.linalg.norm(way)
        apart = np.linalg.norm(places - at, axis=1).min(initial=99.0)
        if apart > 11.0 and (at >= 5.0).all() and (at <= size - 6.0).all():
            places = np.vstack([places, at])
    truth, far, image = (
        np.zeros(shape, np.int32),
        np.ones(shape, np.float32),
        np.full(shape, 20.0, np.float32),
    )
    for number, at in enumerate(places, 1):
        box = tuple(slice(max(int(a) - 9, 0), int(a) + 10) for a in at)
        axes, bright = random.uniform(5.0, 8.0, 3), random.uniform(80.0, 120.0)
        z, y, x = (
            ((np.arange(*s.indices(n)) - a) / r) ** 2
            for s, n, a, r in zip(box, shape, at, axes, strict=True)
        )
        away = (z[:, None, None] + y[:, None] + x).astype(np.float32)
        nearer = away < far[box]
        far[box][nearer], truth[box][nearer], image[box][nearer] = away[nearer], number, bright
    return _finished(image, 1.0, 15.0, random), truth


def tumour(
    shape: Shape = (40, 64, 64), *, noise: float = 8.0, seed: int = 0
) -> tuple[Image, Labels]:
    """A lobed mass with a bright rim and a dim middle in homogeneous tissue, as with contrast agent in MR."""
    random = np.random.default_rng(seed)
    z, y, x = _from_middle(shape)
    angle = np.arctan2(y, x)
    radius = np.sqrt(x**2 + y**2 + (1.3 * z) ** 2) / (
        1 + 0.15 * np.sin(3 * angle) + 0.1 * np.cos(2 * angle + z / 6)
    )
    inside = radius < 15
    values = np.full(shape, 80.0)
    values[inside] = 130.0
    values[radius < 9] = 112.0
    texture = ndimage.gaussian_filter(random.normal(0, 1, shape), 2.0)
    values += 4.0 * texture / texture.std()
    return _finished(values, 0.7, noise, random), inside.astype(np.int32)


def organelle(
    shape: Shape = (40, 72, 72), *, noise: float = 12.0, seed: int = 0
) -> tuple[Image, Labels]:
    """A cell in electron microscopy: as bright as its surroundings, in a dark membrane, with dark organelles inside."""
    random = np.random.default_rng(seed)
    z, y, x = _from_middle(shape)
    radius = np.sqrt((x / 1.15) ** 2 + y**2 + (1.4 * z) ** 2)
    inside = radius < 21
    values = np.full(shape, 150.0)
    values[np.abs(radius - 21) < 1.5] = 70.0
    for _ in range(14):  # organelles, inside and outside
        place = random.uniform(-1, 1, 3) * np.array([14, 30, 30])
        at = np.sqrt(((z - place[0]) * 1.2) ** 2 + (y - place[1]) ** 2 + (x - place[2]) ** 2)
        values[at < random.uniform(1.5, 3.0)] = 95.0
    return _finished(values, 0.6, noise, random), inside.astype(np.int32)
