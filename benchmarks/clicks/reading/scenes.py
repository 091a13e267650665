"""Scenes to learn from: labels that are drawn, images that are painted of them, objects that are clicked.

A scene has cells that touch, classes of a smooth field, folded layers or a few large objects; in it lie blobs, tubes
with branches, shells; around it there may be air. Objects are of few brightnesses, some of several parts; the image has
texture, uneven light, membranes, blur, noise of several kinds, thick slices. Nothing is taken from a scan.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from accelsurf.image.volume import Volume

Floats = NDArray[np.floating]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]
Random = np.random.Generator
SIDE, BASE_SEED = 88, 2026
#: Objects have at least so many voxels, at most this part of the scene, and at least this depth.
LEAST_VOXELS, MOST_PART, LEAST_DEPTH, MOST_OBJECTS = 100, 0.6, 1.6, 4
#: Part of the objects that are two labels which touch, and part of those that have their holes filled.
JOINED, FILLED = 0.12, 0.15
#: Part of the images without noise.
NOISELESS = 0.1


def scene(seed: int) -> tuple[Volume, list[Mask]]:
    """An image, and objects in it as masks; the same seed gives the same."""
    random = np.random.default_rng([BASE_SEED, seed])
    thick = int(random.choice([2, 2, 3, 4, 5])) if random.random() < 0.4 else 1
    while True:
        labels = drawn(random)
        image = painted(random, labels)
        if thick > 1:
            slices = SIDE // thick
            image = image[: slices * thick].reshape(slices, thick, SIDE, SIDE).mean(1)
            labels = labels[thick // 2 : slices * thick : thick]
        spacing = (float(thick), 1.0, 1.0)
        objects = _objects(random, labels, spacing)
        if objects:
            return Volume.from_array(np.ascontiguousarray(image, np.float32), spacing), objects


def _objects(random: Random, labels: Labels, spacing: Sequence[float]) -> list[Mask]:
    """The largest parts of some labels."""
    out: list[Mask] = []
    for label in random.permutation(np.unique(labels[labels > 0]))[:12]:
        wanted = labels == label
        kind = random.random()
        if kind < JOINED:
            around = labels[ndimage.binary_dilation(wanted) & ~wanted]
            around = around[around > 0]
            if len(around):
                wanted |= labels == np.bincount(around).argmax()
        parts, _ = ndimage.label(
            ndimage.binary_fill_holes(wanted) if kind < JOINED + FILLED else wanted
        )
        counts = np.bincount(parts.ravel())[1:]
        mask = parts == counts.argmax() + 1
        if LEAST_VOXELS <= counts.max() <= MOST_PART * mask.size and len(out) < MOST_OBJECTS:
            if ndimage.distance_transform_edt(mask, sampling=spacing).max() >= LEAST_DEPTH:
                out.append(mask)
    return out


def drawn(random: Random) -> Labels:
    """Labels of a scene; 0 is nothing."""
    warp = random.uniform(0.0, 1.0)
    kind = random.choice(5, p=[0.3, 0.22, 0.13, 0.2, 0.15])
    layers = int(random.choice([0, 1, 2], p=[0.2, 0.5, 0.3]))
    if kind < 3:
        labels = (_cells, _classes, _folds)[kind](random, warp)
    else:
        labels, layers = np.ones((SIDE,) * 3, np.int32), int(random.integers(1, 3))
        if kind == 3:
            _add_blobs(random, labels, warp, large=True)
    for _ in range(layers):
        if random.random() < 0.62:
            _add_blobs(random, labels, warp, large=random.random() < 0.25)
        else:
            _add_tubes(random, labels)
    if random.random() < 0.22:
        for label in random.permutation(np.unique(labels[labels > 0]))[
            : int(random.integers(1, 6))
        ]:
            mask = labels == label
            rim = ndimage.binary_dilation(mask, iterations=int(random.integers(1, 4))) & ~mask
            labels[rim] = labels.max() + 1
    if random.random() < 0.3:  # air around
        middle, axes = SIDE * random.uniform(0.3, 0.7, 3), _coordinates(random, 0.0)
        apart = [
            ((axis - m) / (SIDE * random.uniform(0.35, 0.7))) ** 2
            for axis, m in zip(axes, middle, strict=True)
        ]
        labels[sum(apart) + 0.12 * rough(random, (SIDE,) * 3, 10.0) > 1.0] = 0
    return labels


def painted(random: Random, labels: Labels) -> Floats:
    """An image of labels."""
    shape = labels.shape
    ids, where = np.unique(labels, return_inverse=True)
    where = where.reshape(shape).astype(np.int32)
    tones = random.uniform(0.0, 1.0, int(random.integers(2, 7)))
    apart = random.choice([0.0, 0.03, 0.08, 0.2], p=[0.35, 0.3, 0.25, 0.1])
    value = random.choice(tones, len(ids)) + apart * random.standard_normal(len(ids))
    texture = random.choice([0.0, 0.02, 0.05, 0.12], len(ids), p=[0.4, 0.3, 0.2, 0.1])
    texture = texture * np.exp(random.uniform(-1.0, 0.7, len(ids)))
    if ids[0] == 0 and random.random() < 0.85:
        value[0], texture[0] = random.choice([0.0, 0.0, -0.2, random.uniform(0.0, 1.0)]), 0.0
    contrast = max(float(np.std(value)), 0.05)
    where, value, texture = _with_parts(random, where, ids, value, texture)
    image = value[where].astype(np.float32)
    if random.random() < 0.2:  # membranes
        edge = ndimage.maximum_filter(labels, 2) != ndimage.minimum_filter(labels, 2)
        if random.random() < 0.4:
            edge = ndimage.binary_dilation(edge)
        if random.random() < 0.4:
            edge &= rough(random, shape, 4.0) < random.uniform(0.0, 1.6)
        image[edge] = random.uniform(-0.3, 1.4)
    if texture.max() > 0:
        image += texture[where].astype(np.float32) * rough(
            random, shape, _between(random, 0.7, 4.0)
        )
    if random.random() < 0.45:
        image *= 1.0 + random.uniform(0.0, 0.3) * rough(random, shape, _between(random, 14.0, 40.0))
    if random.random() < 0.15:
        image += random.uniform(0.0, 0.4) * rough(random, shape, _between(random, 10.0, 30.0))
    image = ndimage.gaussian_filter(image, _between(random, 0.35, 1.3))
    noise = 0.0 if random.random() < NOISELESS else _between(random, 0.02, 0.5)
    return _degraded(random, image, noise * contrast)


def _degraded(random: Random, image: Floats, amount: float) -> Floats:
    """An image with noise of some kind, a window, a curve of brightness."""
    noise = random.standard_normal(image.shape).astype(np.float32)
    if random.random() < 0.4:
        noise = ndimage.gaussian_filter(noise, random.uniform(0.4, 0.9))
        noise /= noise.std()
    kind = random.random()
    if kind < 0.6:
        image = image + amount * noise
    elif kind < 0.75:
        image = np.hypot(image + amount * noise, amount * random.standard_normal(image.shape))
    else:
        image = image + amount * noise * np.sqrt(np.abs(image) + 0.02) * 1.5
    if random.random() < 0.25:
        image = np.clip(
            image, *np.quantile(image, [random.uniform(0.0, 0.05), random.uniform(0.9, 1.0)])
        )
    if random.random() < 0.25:
        low, high = float(image.min()), float(image.max())
        image = ((image - low) / (high - low + 1e-9)) ** _between(random, 0.5, 2.0)
    return image


def _with_parts(
    random: Random, where: Labels, ids: NDArray[np.int32], value: Floats, texture: Floats
) -> tuple[Labels, Floats, Floats]:
    """Give some objects a rim, a core or inclusions of another brightness."""
    out = where.copy()
    values = list(value)
    textures = list(texture)
    counts = np.bincount(where.ravel(), minlength=len(ids))
    for index in np.argsort(-counts)[:40]:
        kind = random.random()
        if kind > 0.3 or counts[index] < 120 or ids[index] == 0:
            continue
        box = ndimage.find_objects((where == index).astype(np.uint8))[0]
        mask = where[box] == index
        if kind < 0.2:
            depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1, 1:-1]
            part = mask & (
                depth <= random.uniform(1.0, 3.5)
                if kind < 0.13
                else depth > random.uniform(2.0, 7.0)
            )
        else:
            field = rough(random, mask.shape, _between(random, 1.0, 4.0))
            part = mask & (field > np.quantile(field, random.uniform(0.5, 0.93)))
        out[box][part] = len(values)
        values.append(values[index] + random.choice([-1.0, 1.0]) * random.uniform(0.08, 0.6))
        textures.append(textures[index])
    return out, np.array(values), np.array(textures)


def rough(random: Random, shape: Sequence[int], width: float) -> Floats:
    """Smooth random field of deviation 1; bumps are about ``width`` voxels wide."""
    step = max(1.0, width / 1.5)
    field = random.standard_normal([int(np.ceil(n / step)) + 3 for n in shape]).astype(np.float32)
    field = ndimage.gaussian_filter(field, width / step, mode="wrap")
    field /= field.std() + 1e-9
    for axis, n in enumerate(shape):
        at = np.arange(n) / step + 1.0
        below = np.floor(at).astype(int)
        part = (at - below).astype(np.float32).reshape([-1 if i == axis else 1 for i in range(3)])
        above = np.minimum(below + 1, field.shape[axis] - 1)
        field = np.take(field, below, axis) * (1 - part) + np.take(field, above, axis) * part
    return field


def _between(random: Random, low: float, high: float) -> float:
    """A number between two, its logarithm uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _coordinates(random: Random, warp: float) -> list[Floats]:
    """Coordinates z, y, x, bent by a warp from 0 to 1."""
    axes = [axis.astype(np.float32) for axis in np.indices((SIDE,) * 3)]
    if warp > 0:
        for width, part in ((16.0, 0.45), (6.0, 0.25)):
            axes = [axis + warp * part * width * rough(random, axis.shape, width) for axis in axes]
    return axes


def _rotation(random: Random) -> Floats:
    return np.linalg.qr(random.standard_normal((3, 3)))[0]


def _cells(random: Random, warp: float) -> Labels:
    axes = _coordinates(random, warp)
    count = min(max(3, int((SIDE / _between(random, 9.0, 34.0)) ** 3) + 1), 400)
    shear = _rotation(random) * np.exp(random.uniform(-0.4, 0.4, 3))
    places = random.uniform(-0.15, 1.15, (count, 3)) * SIDE
    _, nearest = cKDTree(places @ shear).query(np.stack([axis.ravel() for axis in axes], 1) @ shear)
    labels = (nearest + 1).reshape((SIDE,) * 3).astype(np.int32)
    if random.random() < 0.35:  # some are missing
        labels[random.random(count + 1)[labels] > random.uniform(0.3, 0.9)] = 0
    if random.random() < 0.3:  # gaps between
        gap = ndimage.maximum_filter(labels, 2) != ndimage.minimum_filter(labels, 2)
        labels[ndimage.binary_dilation(gap) if random.random() < 0.4 else gap] = 0
    return labels


def _classes(random: Random, warp: float) -> Labels:
    shape = (SIDE,) * 3
    field = rough(random, shape, _between(random, 4.0, 14.0))
    field = field + random.uniform(0.0, 0.5) * rough(random, shape, _between(random, 1.5, 4.0))
    if random.random() < 0.3:  # sheets
        return (np.abs(field) < random.uniform(0.12, 0.45)).astype(np.int32) + 1
    cuts = np.sort(random.uniform(0.08, 0.92, int(random.integers(1, 4))))
    return np.digitize(field, np.quantile(field, cuts)).astype(np.int32) + 1


def _folds(random: Random, warp: float) -> Labels:
    axes, shape = _coordinates(random, 0.0), (SIDE,) * 3
    middle = SIDE * (0.5 + random.uniform(-0.12, 0.12, 3))
    apart = [
        (axis - m) ** 2 * np.exp(random.uniform(-0.3, 0.3))
        for axis, m in zip(axes, middle, strict=True)
    ]
    depth = np.sqrt(sum(apart)) - random.uniform(0.25, 0.5) * SIDE
    depth += random.uniform(2.0, 8.0) * rough(random, shape, _between(random, 3.0, 7.0))
    depth += random.uniform(0.0, 6.0) * rough(random, shape, 12.0)
    rind = random.uniform(2.0, 7.0)
    return (1 + np.digitize(depth, [0.0, rind, rind + random.uniform(1.0, 5.0)])).astype(np.int32)


def _add_blobs(random: Random, labels: Labels, warp: float, large: bool) -> None:
    axes = _coordinates(random, warp)
    count = int(_between(random, 1.0, 5.0 if large else 40.0))
    base = _between(random, 10.0, 0.45 * SIDE) if large else _between(random, 3.5, 15.0)
    power = random.choice([2.0, 2.0, 2.5, 4.0])
    first = int(labels.max()) + 1
    covers = random.random() < 0.5
    for number in range(count):
        radii = base * np.exp(random.uniform(-0.35, 0.35)) * np.exp(random.uniform(-0.45, 0.45, 3))
        middle, turn = random.uniform(0.0, SIDE, 3), _rotation(random) / radii[:, None]
        reach = 1.7 * radii.max() + 3.0
        box = tuple(slice(int(max(m - reach, 0)), int(min(m + reach, SIDE)) + 1) for m in middle)
        place = np.stack([axis[box] - m for axis, m in zip(axes, middle, strict=True)])
        inside = (np.abs(np.tensordot(turn, place, 1)) ** power).sum(0) < 1.0
        labels[box][inside & (covers | (labels[box] < first))] = first + number


def _add_tubes(random: Random, labels: Labels) -> None:
    first, joined = int(labels.max()) + 1, random.random() < 0.4
    for number in range(int(random.integers(1, 6))):
        thin = random.random() < 0.35
        radius, curl = (
            _between(random, 0.9, 2.5) if thin else _between(random, 1.3, 9.0),
            random.uniform(0.03, 0.3),
        )
        todo = [(random.uniform(0.1, 0.9, 3) * SIDE, random.standard_normal(3), radius, 0)]
        while todo:
            place, way, radius, branching = todo.pop()
            for _ in range(int(random.integers(15, 70))):
                way = way / np.linalg.norm(way) + curl * random.standard_normal(3)
                place = place + way / np.linalg.norm(way) * max(1.0, 0.45 * radius)
                if (place < -6).any() or (place > SIDE + 6).any():
                    break
                here = max(radius * (1.0 + 0.1 * random.standard_normal()), 0.8 if thin else 1.0)
                low, high = (
                    np.maximum(np.floor(place - here), 0).astype(int),
                    np.ceil(place + here).astype(int) + 1,
                )
                box = tuple(slice(a, max(b, 0)) for a, b in zip(low, high, strict=True))
                z, y, x = (np.arange(*s.indices(SIDE)) - p for s, p in zip(box, place, strict=True))
                ball = z[:, None, None] ** 2 + y[:, None] ** 2 + x**2 < here**2
                labels[box][ball] = first if joined else first + number
                if branching < 3 and random.random() < (0.1 if thin else 0.05):
                    thinner = radius * random.uniform(0.6, 0.9)
                    todo.append((place, way + random.standard_normal(3), thinner, branching + 1))
