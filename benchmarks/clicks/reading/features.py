"""Features of each block of a window, for the learned reading.

Lengths are in inscribed radii of the click, volumes in volumes of its ball, values in spreads of the values under the
click: a feature means the same in every scan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import reconstruction

from accelsurf.kernels.arrival import Medium, Tissue, march, shortest_paths
from accelsurf.kernels.grid import Grid
from accelsurf.kernels.walker import walk
from benchmarks.clicks.reading.windows import Floats, Mask, Seed, Window

Features = dict[str, NDArray[np.floating]]
CROSS = ndimage.generate_binary_structure(3, 1)
#: Smoothing before anything is learned, of the smallest side of a block; and of the wide maps, in blocks.
SMOOTHING, WIDE = 0.6, 1.5
#: A click of fewer blocks learns from its neighbours too. A spread is at least so many median gradients per block.
MIN_BLOCKS, MIN_SPREAD = 20, 3.0
#: Values are cut at so many spreads.
CUT = 12.0
#: Cost per mm of the march, see `accelsurf.kernels.arrival.cost_at`; gradients count in so many median ones.
COST, EDGE = (0.02, 0.1, 50.0, 0.15, 2.0, 16.0), 6.0
#: A change by one spread is as long as so many blocks on a shortest path.
CHANGE = 16.0
#: Links of the walk fall off by this; its residual at the end, and most iterations.
SHARPNESS, TOLERANCE, ITERATIONS = 20.0, 2e-2, 200
#: An object has about so many times the volume of its largest ball; spread of the logarithm.
TIMES_BALL, BALL_SPREAD = 5.5, 1.2
#: Points along a ray from the click.
RAY = 10
#: Bins of the histograms of values, and the least density.
BINS, LEAST = np.linspace(-CUT, CUT, 97), 1e-4
#: A length beyond so many radii counts as this.
FAR = 20.0


class Looks:
    """Values under the click and around it: ``values`` smoothed, ``z`` in spreads from their median."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.values = ndimage.gaussian_filter(window.values, SMOOTHING * window.size.min() / window.size)
        parts = [np.gradient(self.values, axis=i) for i in range(3) if self.values.shape[i] > 1]
        gradient = np.sqrt(sum((part**2 for part in parts), np.zeros(self.values.shape)))
        sample = _enough(window.mine)
        self.median, spread = _robust(self.values[sample])
        self.noise = float(np.median(gradient[ndimage.binary_dilation(sample, CROSS, iterations=2)]))
        self.spread = max(spread, MIN_SPREAD * self.noise, 1e-3 * float(np.ptp(window.values)), 1e-9)
        self.z = np.clip((self.values - self.median) / self.spread, -CUT, CUT).astype(np.float32)
        self.gradient = (gradient / self.spread).astype(np.float32)
        self.relative = window.size / window.size.min()

    def arrival(self, seeds: Mask, median: float, spread: float) -> Floats:
        """Arrival times of a front from seeds, slower at edges and where values differ from the median."""
        times = np.full(seeds.size, np.inf, np.float32)
        places = np.flatnonzero(seeds).astype(np.int64)
        times[places] = 0.0
        edge = EDGE * max(self.noise, 1e-6 * spread) / float(self.window.size.min())
        tissue = Tissue(np.array([median]), np.array([spread]), np.array([edge]), np.array(COST))
        medium = Medium(self.values.reshape(1, -1), np.zeros(0, np.bool_))
        grid = Grid(*seeds.shape, *(float(h) for h in self.window.size))
        march(times, medium, tissue, grid, places, np.zeros(0, np.float32), (0, np.inf), seeds.size)
        return times.reshape(seeds.shape)

    def paths(self, seeds: Mask) -> Floats:
        """Geodesic distance from seeds, where a change of the values is what costs."""
        return np.asarray(shortest_paths(seeds, self.z[None], self.relative, CHANGE))

    def walk(self, outside: Mask) -> Floats:
        """Random-walker labelling, -1 at the click, 1 at outside blocks."""
        mine = self.window.mine
        out = np.where(mine, -1.0, np.where(outside, 1.0, 0.0))
        values = (self.z / 5.0)[None]
        sharpness = 0.2 * SHARPNESS / max(float(np.std(values)), 1e-6)
        walk(out, mine | outside, values, self.relative, sharpness, TOLERANCE, ITERATIONS)
        return np.clip(out, -1.0, 1.0).astype(np.float32)


def features_of_first(window: Window, radius: float) -> Features:
    """Features for the answer to a click, whatever was answered before.

    Parameters
    ----------
    window : Window
    radius : float
        Inscribed radius of the click, mm.

    Returns
    -------
    dict of ndarray
        By name: (nz, ny, nx) of each block, or of no dimension where they are the same for all.
    """
    looks = Looks(window)
    mine, theirs, z = window.mine, window.theirs, looks.z
    ball = max(4.0 / 3.0 * np.pi * radius**3 / float(np.prod(window.size)), 1.0)
    faces = window.faces & ~mine
    distance = window.distance_to(window.click)
    wide, edges = ndimage.gaussian_filter(z, WIDE), ndimage.gaussian_filter(looks.gradient, 1.0)
    out: Features = {
        "value": z,
        "difference": np.abs(z),
        "wide value": wide,
        "wide difference": np.abs(wide),
        "gradient": looks.gradient,
        "wide gradient": edges,
        "distance": np.log2(distance / radius + 0.1),
        "blocks": np.array(np.log2(radius / np.prod(window.size) ** (1 / 3))),
        "face": _to(faces, window, radius),
        "limited": np.array(float(window.is_limited)),
    }
    front, path = looks.arrival(mine, looks.median, looks.spread), looks.paths(mine)
    for name, times, unit in (("front", front, radius), ("path", path, radius / window.size.min())):
        order = np.argsort(times.ravel())
        out[f"{name} time"] = np.log2(times / unit + 1e-3)
        out[f"{name} volume"] = np.log2(_ranks(order, times.shape) / ball)
        out |= _levels(name, times, order, looks, ball)
    outside = theirs | faces
    out["walk"] = looks.walk(outside) if outside.any() else np.full(z.shape, -1.0, np.float32)
    out["walk volume"] = np.log2(_ranks(np.argsort(out["walk"].ravel()), z.shape) / ball)
    for name, cost in (("value", np.abs(wide)), ("gradient", edges)):
        start = np.where(mine, cost, cost.max())
        barrier = reconstruction(start, cost, "erosion").astype(np.float32)
        out[f"{name} barrier"] = barrier
        out[f"{name} barrier volume"] = np.log2(_ranks(np.argsort((barrier + 1e-6 * distance).ravel()), z.shape) / ball)
    out["ray difference"], out["ray gradient"] = _rays((np.abs(wide), edges), window.click.middle)
    beyond = (front > np.quantile(front, 0.5)) | theirs
    out["likelihood"] = _likelihood(z, ndimage.binary_dilation(mine, CROSS), beyond)
    out["wide likelihood"] = ndimage.gaussian_filter(out["likelihood"], WIDE)
    if theirs.any():
        median, spread = _robust(looks.values[_enough(theirs)])
        far = looks.arrival(theirs, median, max(spread, 1e-3 * float(np.ptp(looks.values)), 1e-9)), looks.paths(theirs)
        out["front balance"] = (front - far[0]) / (front + far[0] + 1e-6)
        out["path balance"] = (path - far[1]) / (path + far[1] + 1e-6)
        out["distance to others"] = _nearest(window, window.others)
    return out


def features_of_later(
    window: Window, radius: float, before: NDArray[np.bool_], inside: bool, number: int, volume: float
) -> tuple[Features, Mask]:
    """Features for what a later click changes, and the blocks that are on its side already.

    Parameters
    ----------
    window : Window
    radius : float
        Inscribed radius of the click, mm.
    before : ndarray (nz, ny, nx) of bool
        Labels before it, on the image's grid.
    inside : bool
        The click's side.
    number : int
        Of the click, from 1.
    volume : float
        Of the labels, mm3.
    """
    out = features_of_first(window, radius)
    share = window.means(before)
    share = share if inside else 1.0 - share
    side, z = share >= 0.5, out["value"]
    signed = np.full(share.shape, FAR if side.all() else -FAR)
    if side.any() and not side.all():
        inner, outer = (ndimage.distance_transform_edt(part, sampling=window.size) for part in (side, ~side))
        signed = np.clip((inner - outer) / radius, -8.0, 8.0)
    beyond = ~side & (out["distance"] > 1.3)
    out |= {
        "before": share,
        "distance inside": signed,
        "click against beyond": _likelihood(z, ndimage.binary_dilation(window.mine, CROSS), beyond),
        "side against beyond": _likelihood(z, side, beyond) if side.any() else np.zeros_like(z),
        "distance to friends": _nearest(window, window.friends) if window.friends else np.array(5.0),
        "number": np.array(min(number, 6.0)),
        "side": np.array(float(inside)),
        "size": np.array(np.log2(max(volume, 1e-9) / (4.0 / 3.0 * np.pi * radius**3))),
    }
    for name in ("front balance", "path balance", "distance to others"):
        out.setdefault(name, np.array(np.nan))  # there is no click on the other side
    for name in ("click against beyond", "side against beyond"):
        out[f"wide {name}"] = ndimage.gaussian_filter(out[name], WIDE)
    return out, side


def table_of(features: Mapping[str, NDArray[np.floating]], names: Sequence[str], where: NDArray[np.int64]) -> Floats:
    """Features of some blocks, a row each, by flat index."""
    columns = [np.broadcast_to(f, len(where)) if f.ndim == 0 else f.ravel()[where] for f in map(features.get, names)]
    return np.stack(columns, 1).astype(np.float32)


def _enough(mask: Mask) -> Mask:
    return mask if np.count_nonzero(mask) >= MIN_BLOCKS else np.asarray(ndimage.binary_dilation(mask, CROSS))


def _robust(values: NDArray[np.floating]) -> tuple[float, float]:
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))


def _ranks(order: NDArray[np.int64], shape: Sequence[int]) -> Floats:
    """Number of blocks up to each one in an order of flat indices."""
    out = np.empty(len(order), np.float32)
    out[order] = np.arange(1, len(order) + 1)
    return out.reshape(shape)


def _levels(name: str, times: Floats, order: NDArray[np.int64], looks: Looks, ball: float) -> Features:
    """How slow the front is where a block arrives, what differs beyond it, edges along it; volume to the likeliest."""
    first, count = int(np.count_nonzero(looks.window.mine)), len(order)
    sizes = np.unique(np.geomspace(min(max(first, 8), 0.9 * count), 0.95 * count, 60).astype(np.int64))
    arrived = np.maximum(times.ravel()[order], 1e-9)
    up, down = np.minimum((sizes * 1.25).astype(int) + 1, count) - 1, np.maximum((sizes / 1.25).astype(int), 1) - 1
    slow = np.log(arrived[up] / arrived[down] + 1e-9) / np.log((up + 1) / (down + 1))
    values = looks.values.ravel()[order].astype(np.float64)
    total, squares = (np.concatenate(([0.0], np.cumsum(v))) for v in (values, values * values))
    next_ = np.minimum((sizes * 1.3).astype(int) + 2, count)
    inner, shell = total[sizes] / sizes, (total[next_] - total[sizes]) / (next_ - sizes)
    variance = squares[sizes] / sizes - inner**2 + (squares[next_] - squares[sizes]) / (next_ - sizes) - shell**2
    contrast = np.abs(shell - inner) / np.sqrt(np.maximum(variance, 1e-9))
    edges = np.concatenate(([0.0], np.cumsum(looks.gradient.ravel()[order])))
    low, high = (sizes / 1.1).astype(int), np.minimum((sizes * 1.1).astype(int) + 1, count)
    edge = (edges[high] - edges[low]) / (high - low)
    score = np.log(np.maximum(slow, 1e-3)) + np.log(np.maximum(contrast, 1e-3)) + np.log(edge + 1e-9)
    score -= 0.5 * (np.log(sizes / (TIMES_BALL * ball)) / BALL_SPREAD) ** 2
    likely, n = np.exp(score - score.max()), sizes.astype(np.float64)
    best = n[np.argmax(2.0 * np.minimum(n[:, None], n) / (n[:, None] + n) @ likely)]
    rank = np.log(_ranks(order, times.shape))
    out: Features = {f"{name} to likeliest": rank - np.log(best)}
    for part, curve in (("slowness", np.log(np.maximum(slow, 1e-3))), ("contrast", contrast), ("edge", edge)):
        out[f"{name} {part}"] = np.interp(rank, np.log(n), curve)
    return out


def _rays(maps: Sequence[Floats], middle: NDArray[np.float64]) -> list[Floats]:
    """Largest value on the straight line from a place to each block."""
    shape = maps[0].shape
    axes = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij", sparse=True)
    out = [np.zeros(shape, np.float32) for _ in maps]
    for part in (np.arange(RAY) + 0.5) / RAY:
        at = [m + (axis - m) * part for axis, m in zip(axes, middle, strict=True)]
        places = tuple(np.clip(np.rint(a).astype(np.int32), 0, n - 1) for a, n in zip(at, shape, strict=True))
        for best, values in zip(out, maps, strict=True):
            np.maximum(best, values[places], out=best)
    return out


def _likelihood(z: NDArray[np.floating], sample: Mask, beyond: Mask) -> NDArray[np.floating]:
    """(p - q)/(p + q) of the densities of values in a sample and beyond it; 0 where one of them is empty."""
    if not (sample.any() and beyond.any()):
        return np.zeros(z.shape)
    widths = max(2.0, 30.0 / np.sqrt(np.count_nonzero(sample))), 2.0
    counts = (np.histogram(z[part], BINS)[0].astype(np.float64) for part in (sample, beyond))
    smooth = [ndimage.gaussian_filter1d(c, width) for c, width in zip(counts, widths, strict=True)]
    p, q = (density / density.sum() + LEAST for density in smooth)
    return np.interp(z, 0.5 * (BINS[1:] + BINS[:-1]), (p - q) / (p + q))


def _nearest(window: Window, seeds: Sequence[Seed]) -> NDArray[np.floating]:
    """Distance to the nearest of some clicks, in its inscribed radii, as a logarithm."""
    least = float(np.prod(window.size) ** (1 / 3))
    found = [window.distance_to(seed) / max(2.0 * seed.radius, least) for seed in seeds]
    return np.log2(np.minimum.reduce(found) + 0.1)


def _to(faces: Mask, window: Window, radius: float) -> NDArray[np.floating]:
    """Distance to a face beyond which the image goes on, in radii."""
    if not faces.any():
        return np.array(FAR)
    return np.minimum(ndimage.distance_transform_edt(~faces, sampling=window.size) / radius, FAR)
