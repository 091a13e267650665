"""Features of each block of a window, for the learned reading.

Lengths are in inscribed radii of the click, volumes in volumes of its ball, values in spreads of the values under the
click: a feature means the same in every scan.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import reconstruction

from accelsurf.clicks.kernels.arrival import Appearance, shortest_paths
from accelsurf.clicks.kernels.walker import walk
from accelsurf.clicks.model.fronts import (
    COST,
    CROSS,
    EDGE,
    MIN_RANGE,
    MIN_SPREAD,
    enough,
    gradient,
    robust,
    times_from,
)
from accelsurf.clicks.model.windows import DEEPER, Seed, Window
from accelsurf.grid.arrays import Mask, Singles
from accelsurf.image.blocks import block_means

Features = dict[str, NDArray[np.floating]]
#: Smoothing before anything is learned, of the smallest side of a block; and of the wide maps, in blocks.
SMOOTHING = 0.6
WIDE = 1.5
#: Values are cut at this number of spreads.
CUT = 12.0
#: Length of a change by one spread on a shortest path, in blocks.
CHANGE = 16.0
#: Links of the walk fall off by this; its residual at the end, and most iterations.
SHARPNESS = 20.0
TOLERANCE = 2e-2
ITERATIONS = 200
#: Typical volume of an object over that of its largest ball; spread of the logarithm.
TIMES_BALL = 5.5
BALL_SPREAD = 1.2
#: Of a flat image, an area counts as its power: as the volume of something round.
FLAT = 1.5
#: Points along a ray from the click.
RAY = 10
#: Bins of the histograms of values, and the least density.
BINS = np.linspace(-CUT, CUT, 97)
LEAST = 1e-4
#: Longer lengths, in radii, count as this.
FAR = 20.0


class Looks:
    """Values under the click and around it: ``values`` smoothed, ``z`` in spreads from their median."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.values = ndimage.gaussian_filter(window.values, SMOOTHING * window.step / window.size)
        steepness = gradient(self.values, (1.0, 1.0, 1.0))
        sample = enough(window.mine)
        self.median, spread = robust(self.values[sample])
        self.noise = float(
            np.median(steepness[ndimage.binary_dilation(sample, CROSS, iterations=2)])
        )
        self.spread = max(
            spread, MIN_SPREAD * self.noise, MIN_RANGE * float(np.ptp(window.values)), 1e-9
        )
        self.z = np.clip((self.values - self.median) / self.spread, -CUT, CUT).astype(np.float32)
        self.gradient = (steepness / self.spread).astype(np.float32)
        self.relative = window.size / window.step

    def arrival(self, seeds: Mask, median: float, spread: float) -> Singles:
        """Arrival times of a front from seeds, slower at edges and where values differ from the median."""
        edge = EDGE * max(self.noise, 1e-6 * spread) / self.window.step
        appearance = Appearance(
            np.array([median]), np.array([spread]), np.array([edge]), np.array(COST)
        )
        return times_from(seeds, self.values, self.window.size.tolist(), appearance)

    def paths(self, seeds: Mask) -> Singles:
        """Geodesic distance from seeds, longer across changes of the values."""
        return np.asarray(shortest_paths(seeds, self.z[None], self.relative, CHANGE))

    def walk(self, outside: Mask) -> Singles:
        """Random-walker labelling, -1 at the click, 1 at outside blocks."""
        mine = self.window.mine
        out = np.where(mine, -1.0, np.where(outside, 1.0, 0.0))
        values = (self.z / 5.0)[None]
        sharpness = 0.2 * SHARPNESS / max(float(np.std(values)), 1e-6)
        walk(out, mine | outside, values, self.relative, sharpness, TOLERANCE, ITERATIONS)
        return np.clip(out, -1.0, 1.0).astype(np.float32)


def features_of_first(window: Window) -> Features:
    """Features for the answer to a click, whatever was answered before.

    Parameters
    ----------
    window : Window

    Returns
    -------
    dict of ndarray
        By name: (nz, ny, nx) of each block, or of no dimension where they are the same for all.
    """
    looks = Looks(window)
    mine = window.mine
    theirs = window.theirs
    z = looks.z
    radius = window.radius
    faces = window.faces & ~mine
    distance = window.distance_to(window.seed)
    wide, edges = ndimage.gaussian_filter(z, WIDE), ndimage.gaussian_filter(looks.gradient, 1.0)
    out: Features = {
        "value": z,
        "difference": np.abs(z),
        "wide value": wide,
        "wide difference": np.abs(wide),
        "gradient": looks.gradient,
        "wide gradient": edges,
        "distance": np.log2(distance / radius + 0.1),
        "blocks": np.array(np.log2(radius / window.width)),
        "face": _to(faces, window),
        "limited": np.array(float(window.seed.is_limited)),
    }
    front, path = looks.arrival(mine, looks.median, looks.spread), looks.paths(mine)
    for name, times, unit in (("front", front, radius), ("path", path, radius / window.step)):
        order = _sorted(times)
        out[f"{name} time"] = np.log2(times / unit + 1e-3)
        out[f"{name} volume"] = _volume(_ranks(order, times.shape), window)
        out |= _levels(name, times, order, looks)
    outside = theirs | faces
    out["walk"] = looks.walk(outside) if outside.any() else np.full(z.shape, -1.0, np.float32)
    out["walk volume"] = _volume(_ranks(_sorted(out["walk"]), z.shape), window)
    for name, cost in (("value", np.abs(wide)), ("gradient", edges)):
        start = np.where(mine, cost, cost.max())
        barrier = reconstruction(start, cost, "erosion").astype(np.float32)
        out[f"{name} barrier"] = barrier
        out[f"{name} barrier volume"] = _volume(
            _ranks(_sorted(barrier + 1e-6 * distance), z.shape), window
        )
    out["ray difference"], out["ray gradient"] = _rays(
        (np.abs(wide), edges), window.place_of(window.seed)[0]
    )
    beyond = (front > np.quantile(front, 0.5)) | theirs
    out["likelihood"] = _likelihood(z, ndimage.binary_dilation(mine, CROSS), beyond)
    out["wide likelihood"] = ndimage.gaussian_filter(out["likelihood"], WIDE)
    if theirs.any():
        median, spread = robust(looks.values[enough(theirs)])
        far = (
            looks.arrival(
                theirs, median, max(spread, MIN_RANGE * float(np.ptp(looks.values)), 1e-9)
            ),
            looks.paths(theirs),
        )
        out["front balance"] = (front - far[0]) / (front + far[0] + 1e-6)
        out["path balance"] = (path - far[1]) / (path + far[1] + 1e-6)
        out["distance to others"] = _nearest(window, window.others)
    return out


def features_of_later(
    window: Window, before: Mask, number: int, count: int
) -> tuple[Features, Mask]:
    """Features for the change by a later click, and the blocks that are on its side already.

    Parameters
    ----------
    window : Window
    before : ndarray (nz, ny, nx) of bool
        Labels before it, on the box of the window.
    number : int
        Of the click, from 1.
    count : int
        Number of voxels of the labels, those beyond the window too.
    """
    out = features_of_first(window)
    inside = window.seed.click.side == "inside"
    radius = window.radius
    share = block_means(before.astype(np.float32), window.steps.tolist())
    share = share if inside else 1.0 - share
    side, z = share >= 0.5, out["value"]
    signed = np.full(share.shape, FAR if side.all() else -FAR)
    if side.any() and not side.all():
        inner, outer = (
            ndimage.distance_transform_edt(part, sampling=window.size) for part in (side, ~side)
        )
        signed = np.clip((inner - outer) / radius, -8.0, 8.0)
    beyond = ~side & (out["distance"] > 1.3)
    out |= {
        "before": share,
        "distance inside": signed,
        "click against beyond": _likelihood(z, ndimage.binary_dilation(window.mine, CROSS), beyond),
        "side against beyond": _likelihood(z, side, beyond) if side.any() else np.zeros_like(z),
        "distance to friends": _nearest(window, window.friends)
        if window.friends
        else np.array(5.0),
        "number": np.array(min(number, 6.0)),
        "side": np.array(float(inside)),
        "size": _volume(np.array(max(count, 1e-9) / np.prod(window.steps)), window),
    }
    for name in ("front balance", "path balance", "distance to others"):
        out.setdefault(name, np.array(np.nan))  # there is no click on the other side
    for name in ("click against beyond", "side against beyond"):
        out[f"wide {name}"] = ndimage.gaussian_filter(out[name], WIDE)
    return out, side


def _sorted(values: Singles) -> NDArray[np.int64]:
    """Flat indices in rising order; equal values in that of their places."""
    return np.argsort(values.ravel(), kind="stable")


def _volume(count: NDArray[np.number], window: Window) -> NDArray[np.floating]:
    """Logarithm (base 2) of a number of blocks over that of the ball; of areas, as of the volumes that go with them."""
    return (FLAT if window.scene.is_flat else 1.0) * np.log2(count / window.count_of_ball)


def _ranks(order: NDArray[np.int64], shape: Sequence[int]) -> Singles:
    """Number of blocks up to each one in an order of flat indices."""
    out = np.empty(len(order), np.float32)
    out[order] = np.arange(1, len(order) + 1)
    return out.reshape(shape)


def _levels(name: str, times: Singles, order: NDArray[np.int64], looks: Looks) -> Features:
    """Slowness of the front where a block arrives, contrast across it, edges along it; volume to the likeliest."""
    first, count = int(np.count_nonzero(looks.window.mine)), len(order)
    sizes = np.unique(
        np.geomspace(min(max(first, 8), 0.9 * count), 0.95 * count, 60).astype(np.int64)
    )
    arrived = np.maximum(times.ravel()[order], 1e-9)
    up, down = (
        np.minimum((sizes * 1.25).astype(int) + 1, count) - 1,
        np.maximum((sizes / 1.25).astype(int), 1) - 1,
    )
    slow = np.log(arrived[up] / arrived[down] + 1e-9) / np.log((up + 1) / (down + 1))
    values = looks.values.ravel()[order].astype(np.float64)
    total, squares = (np.concatenate(([0.0], np.cumsum(v))) for v in (values, values * values))
    next_ = np.minimum((sizes * 1.3).astype(int) + 2, count)
    inner, shell = total[sizes] / sizes, (total[next_] - total[sizes]) / (next_ - sizes)
    variance = (
        squares[sizes] / sizes
        - inner**2
        + (squares[next_] - squares[sizes]) / (next_ - sizes)
        - shell**2
    )
    contrast = np.abs(shell - inner) / np.sqrt(np.maximum(variance, 1e-9))
    edges = np.concatenate(([0.0], np.cumsum(looks.gradient.ravel()[order])))
    low, high = (sizes / 1.1).astype(int), np.minimum((sizes * 1.1).astype(int) + 1, count)
    edge = (edges[high] - edges[low]) / (high - low)
    score = (
        np.log(np.maximum(slow, 1e-3)) + np.log(np.maximum(contrast, 1e-3)) + np.log(edge + 1e-9)
    )
    score -= (
        0.5 * ((np.log(2.0) * _volume(sizes, looks.window) - np.log(TIMES_BALL)) / BALL_SPREAD) ** 2
    )
    likely, n = np.exp(score - score.max()), sizes.astype(np.float64)
    best = n[np.argmax(2.0 * np.minimum(n[:, None], n) / (n[:, None] + n) @ likely)]
    rank = np.log(_ranks(order, times.shape))
    out: Features = {f"{name} to likeliest": rank - np.log(best)}
    for part, curve in (
        ("slowness", np.log(np.maximum(slow, 1e-3))),
        ("contrast", contrast),
        ("edge", edge),
    ):
        out[f"{name} {part}"] = np.interp(rank, np.log(n), curve)
    return out


def _rays(maps: Sequence[Singles], middle: NDArray[np.float64]) -> list[Singles]:
    """Largest value on the straight line from a place to each block."""
    shape = maps[0].shape
    axes = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij", sparse=True)
    out = [np.zeros(shape, np.float32) for _ in maps]
    for part in (np.arange(RAY) + 0.5) / RAY:
        at = [m + (axis - m) * part for axis, m in zip(axes, middle, strict=True)]
        places = tuple(
            np.clip(np.rint(a).astype(np.int32), 0, n - 1) for a, n in zip(at, shape, strict=True)
        )
        for best, values in zip(out, maps, strict=True):
            np.maximum(best, values[places], out=best)
    return out


def _likelihood(z: NDArray[np.floating], sample: Mask, beyond: Mask) -> NDArray[np.floating]:
    """(p - q)/(p + q) of the densities of values in a sample and beyond it; 0 where one of them is empty."""
    if not (sample.any() and beyond.any()):
        return np.zeros(z.shape)
    return at_bins(z, likelihood_ratio(z[sample], z[beyond]))


def likelihood_ratio(
    sample: NDArray[np.floating], beyond: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(p - q)/(p + q) of the densities of some values and of others, at the middles of `BINS`."""
    widths = max(2.0, 30.0 / np.sqrt(len(sample))), 2.0
    counts = (np.histogram(part, BINS)[0].astype(np.float64) for part in (sample, beyond))
    smooth = [ndimage.gaussian_filter1d(c, width) for c, width in zip(counts, widths, strict=True)]
    p, q = (density / density.sum() + LEAST for density in smooth)
    return np.asarray((p - q) / (p + q))


def at_bins(z: NDArray[np.floating], ratio: NDArray[np.floating]) -> NDArray[np.floating]:
    """Values at the middles of `BINS`, linear between them."""
    return np.interp(z, 0.5 * (BINS[1:] + BINS[:-1]), ratio)


def _nearest(window: Window, seeds: Sequence[Seed]) -> NDArray[np.floating]:
    """Distance to the nearest of some clicks, in its inscribed radii, as a logarithm."""
    found = [window.distance_to(seed) / max(DEEPER * seed.radius, window.width) for seed in seeds]
    return np.log2(np.minimum.reduce(found) + 0.1)


def _to(faces: Mask, window: Window) -> NDArray[np.floating]:
    """Distance to a face beyond which the image goes on, in radii."""
    if not faces.any():
        return np.array(FAR)
    return np.minimum(
        ndimage.distance_transform_edt(~faces, sampling=window.size) / window.radius, FAR
    )
