"""Even surroundings of a click: the largest ball around it in which nothing differs.

The radius of a click says how deep the object is around it. A point, or a small ball, in a large object says too
little: nothing differs in the windows that it is first read in, and no window tells where the object ends. It is
read as a person's ball in the homogeneous region around it, which is a part of the object, whatever the object is.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.clicks.model.windows import DEEPER, Scene, Seed, inscribed_radius, seed_of
from accelsurf.grid.arrays import Singles
from accelsurf.grid.boxes import Box
from accelsurf.grid.clicks import Click

#: A click is read anew from this radius of the homogeneous region on, in the smallest spacings: around a smaller region
#: the nearest window of a point shows the differences.
FROM = 7.5
#: And where it is below this part of that radius; it is then read with the second part. Drawn balls and discs in noise
#: are found with .6 to .8 of their radius (benchmarks/notes/clicks-reading.md).
TOO_SMALL = 0.5
READ = 0.7
#: The click's radius is sure up to this multiple of the region's radius.
TRUSTED = 1.1
#: A click's inscribed radius is at most this part of the image's middle side: an object needs surroundings.
OF_IMAGE = 0.35
#: Radius, in the smallest spacings, beyond which a click is larger than people make them.
BEYOND = 9.0
#: It is also read as one of this radius, which still tells something of the object's (`windows.LARGEST`).
PEOPLES = 7.0
#: A shell is this much wider than the ball in it, and this part of a spacing at least.
WIDER = 1.15
MIN_WIDER = 0.75
#: Least difference of a mean or a spread, in standard errors; of a value, in spreads. Values of a shell may differ in
#: this part of it, plus this number of voxels.
ERRORS = 5.0
FAR = 4.0
FAR_PART = 1e-3
FAR_VOXELS = 2
#: Values that differ by less are the same; of the image's range between percentiles.
SAME = 1e-6
#: Approximate number of samples along a ball's radius.
FINE = 12
#: A ball of this radius, in the smallest spacings, grows no further.
MAX_STEPS = 128.0
#: The middle moves by these parts of the radius, to where a ball wider by `WIDER` is even; most moves.
MOVES = (0.5, 0.25)
MAX_MOVES = 24
#: Noise below this part of a window's range counts as none. The networks know no image without: then its blocks get
#: noise of the second part. In CT the noise of tissue is a hundredth of the range from air to bone, and is enough.
NO_NOISE = 1e-3
DITHER = 0.02


class HomogeneousBall(NamedTuple):
    """A ball in which nothing differs.

    Attributes
    ----------
    middle : ndarray (3,) float64
        Voxel (z, y, x).
    radius : float
        mm.
    noise : float
        Largest standard deviation of a channel in it.
    """

    middle: NDArray[np.float64]
    radius: float
    noise: float


class _Values(NamedTuple):
    """Values (channels, n) of the voxels of a ball, ``distance`` (n,) of each from its middle, mm, and its sector."""

    values: NDArray[np.float64]
    distance: NDArray[np.float64]
    sector: NDArray[np.int64]


class AsRead(NamedTuple):
    """A first click as it is read.

    Attributes
    ----------
    seed : Seed
    noise : float or None
        Standard deviation in the homogeneous region around it; None where no region is known.
    is_confident : bool
        The homogeneous region around it is as deep as the click says.
    """

    seed: Seed
    noise: float | None = None
    is_confident: bool = False


def as_large(seed: Seed, scene: Scene) -> AsRead:
    """Return a first click as it is read: as large as the homogeneous region around it says, and as fits the image.

    Raises
    ------
    LeavesWindow
        When the homogeneous region comes near an open face of the scene's part.
    """
    radius, most = inscribed_radius(seed, scene), OF_IMAGE * _middle_side(scene)
    homogeneous = homogeneous_ball(scene, seed)
    noise, is_confident = None, False
    if (
        homogeneous is not None
        and _whole(scene) > homogeneous.radius >= FROM * scene.step
        and not _is_longer(seed, homogeneous.radius, scene)
    ):
        noise, is_confident = homogeneous.noise, radius <= TRUSTED * homogeneous.radius
        if radius < TOO_SMALL * homogeneous.radius:
            return AsRead(
                _ball(homogeneous.middle, READ * homogeneous.radius / DEEPER, seed, scene),
                noise,
                is_confident,
            )
    if radius > max(most, FROM * scene.step):
        return AsRead(_ball(seed.core[0], most / DEEPER, seed, scene), noise, is_confident)
    return AsRead(seed, noise, is_confident)


def is_beyond_people(seed: Seed, scene: Scene) -> bool:
    """Test if a click is larger than people make them: how it reads is known of no drawn scene."""
    return seed.radius > BEYOND * scene.step


def smaller_clicks(seed: Seed, scene: Scene) -> tuple[Seed, ...]:
    """Return clicks in the middle of a larger one: the least whose object is as deep as it is, and a person's largest.

    All of a click lies in its object. Where the first is no larger than a person's, both are one.
    """
    largest = PEOPLES * scene.step
    radii = dict.fromkeys((max(largest, seed.radius / DEEPER), largest))
    return tuple(_ball(seed.core[0], radius, seed, scene) for radius in radii)


def dithered(values: Singles, noise: float) -> Singles:
    """Blocks with noise added, where there is none around the click; the same noise for the same shape."""
    span = float(np.ptp(values))
    if noise >= NO_NOISE * span:
        return values
    drawn = np.random.default_rng(0).standard_normal(values.shape)
    return (values + DITHER * span * drawn).astype(np.float32)


def homogeneous_ball(scene: Scene, seed: Seed) -> HomogeneousBall | None:
    """Return the largest ball around a click's middle that is found to be even; None where its own is not.

    The ball grows as long as the next shell, and each of its sectors, has the mean and the spread of the values within.
    Then it moves to where a larger one is even that still holds the click's middle.
    """
    start, first = seed.core[0].copy(), max(seed.radius, 1.5 * scene.step)
    found = _grown(scene, start, first)
    if found is None or found.radius <= first:
        return found
    known = _values_around(scene, start, found.radius)
    assert known is not None
    mm, corner = np.asarray(scene.spacing), np.array(scene.corner)
    whole = np.array(scene.whole_shape)
    flat = whole == 1
    ways = [
        np.array(way) / np.sqrt(np.abs(way).sum())
        for way in product((-1, 0, 1), repeat=3)
        if any(way) and not any(np.array(way)[flat])
    ]
    for _ in range(MAX_MOVES):
        for part, way in product(MOVES, ways):
            middle = np.rint(found.middle + part * found.radius * way / mm)
            wider = WIDER * found.radius
            is_within = ((middle + corner >= 0) & (middle + corner < whole)).all()
            if not is_within or np.sqrt((((middle - start) * mm) ** 2).sum()) > found.radius:
                continue
            ball = _values_around(scene, middle, wider)
            if ball is not None and _is_like(ball, known):
                found, known = _grown(scene, middle, wider) or found, ball
                break
        else:
            break
    return found


def _grown(scene: Scene, middle: NDArray[np.float64], radius: float) -> HomogeneousBall | None:
    """Grow a ball from a radius on."""
    ball = _values_around(scene, middle, radius)
    if ball is None:
        return None
    most = min(_whole(scene), MAX_STEPS * scene.step)
    while radius < most:
        wider = max(WIDER * radius, radius + MIN_WIDER * scene.step)
        around = _values_around(scene, middle, wider)
        if around is None or not _is_like(_shell(around, radius), ball):
            break
        radius, ball = wider, around
    return HomogeneousBall(middle, radius, float(ball.values.std(axis=1).max()))


def _values_around(scene: Scene, middle: NDArray[np.float64], radius: float) -> _Values | None:
    """Values in a ball; None where the object cannot be in all of it.

    Raises
    ------
    LeavesWindow
        When it comes near an open face of the scene's part.
    """
    axes, sides = [], []
    for at, h, first, n in zip(middle, scene.spacing, scene.corner, scene.whole_shape, strict=True):
        step = max(int(radius / FINE / h), 1)
        most = int(radius / h / step)
        places = int(at) + step * np.arange(-most, most + 1)
        places = places[(places >= -first) & (places < n - first)]
        axes.append((places - at) * h)
        sides.append(slice(int(places[0]), int(places[-1]) + 1, step))
    box: Box = (sides[0], sides[1], sides[2])
    if scene.part is not None:
        scene.part.check_box(box)
    z, y, x = np.meshgrid(*axes, indexing="ij", sparse=True)
    square = z * z + y * y + x * x
    within = square <= radius * radius
    if scene.open is not None and not scene.open[box][within].all():
        return None
    sector = (4 * (z >= 0) + 2 * (y >= 0) + (x >= 0)) + np.zeros(square.shape, np.int64)
    values = np.stack([image[box][within] for image in scene.images]).astype(np.float64)
    return _Values(values, np.sqrt(square[within]), sector[within])


def _shell(ball: _Values, radius: float) -> _Values:
    """Return the values beyond a radius."""
    is_beyond = ball.distance > radius
    return _Values(ball.values[:, is_beyond], ball.distance[is_beyond], ball.sector[is_beyond])


def _is_like(part: _Values, known: _Values) -> bool:
    """Test if values, in all and in each sector, look like known ones."""
    count, of_known = part.values.shape[1], known.values.shape[1]
    if count == 0:
        return True  # beyond the image, or between voxels
    for values, usual in zip(part.values, known.values, strict=True):
        mean, spread = float(usual.mean()), float(usual.std()) + SAME
        if np.count_nonzero(np.abs(values - mean) > FAR * spread) > FAR_PART * count + FAR_VOXELS:
            return False
        for some in (values, *(values[part.sector == n] for n in np.unique(part.sector))):
            error = spread * np.sqrt(1.0 / len(some) + 1.0 / of_known)
            if abs(float(some.mean()) - mean) > ERRORS * error:
                return False
        ratio = np.log((float(values.std()) + SAME) / spread)
        if abs(ratio) > ERRORS * np.sqrt(0.5 / count + 0.5 / of_known):
            return False
    return True


def _is_longer(seed: Seed, radius: float, scene: Scene) -> bool:
    """Test if a click goes farther from its middle than a radius: a stroke, which says more than its ball."""
    voxels = np.argwhere(seed.click.mask) + [side.start for side in seed.click.box]
    apart = ((voxels - seed.core[0]) * np.asarray(scene.spacing)) ** 2
    return bool(apart.sum(axis=1).max() > radius**2)


def _ball(middle: NDArray[np.float64], radius: float, seed: Seed, scene: Scene) -> Seed:
    """The click of a ball."""
    places = [int(round(float(at))) for at in middle]
    ends = [
        (max(at - int(radius / h), 0), min(at + int(radius / h) + 1, n))
        for at, h, n in zip(places, scene.spacing, scene.shape, strict=True)
    ]
    box: Box = (slice(*ends[0]), slice(*ends[1]), slice(*ends[2]))
    z, y, x = np.ogrid[box]
    square = sum(
        ((axis - at) * h) ** 2 for axis, at, h in zip((z, y, x), places, scene.spacing, strict=True)
    )
    mask = np.asarray(square <= radius * radius)
    if scene.open is not None:
        mask &= scene.open[box]
    return seed_of(Click(seed.click.side, box, mask), scene)


def _whole(scene: Scene) -> float:
    """Length of the image's diagonal, mm: nothing differs in the image where a ball has grown so far."""
    return float(np.sqrt(((np.array(scene.whole_shape) * scene.spacing) ** 2).sum()))


def _middle_side(scene: Scene) -> float:
    """The middle one of the image's sides, mm; of a flat image the smaller one."""
    sides = [n * h for n, h in zip(scene.whole_shape, scene.spacing, strict=True) if n > 1]
    return sorted(sides)[-2] if len(sides) > 1 else max(sides, default=0.0)
