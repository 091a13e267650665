"""What a user would take instead: methods that label a scan from inside and outside clicks, each with a small grid.

scikit-image's random walker and watershed are the libraries' own. The others are written down plainly, as each would
bring a library of its own for one row: geodesic competition (Criminisi et al. 2008), grow-cut as
shortest paths (Zhu et al. 2014, as in itk-growcut and 3D Slicer), graph cut (Boykov & Jolly 2001, SciPy's maximum
flow), a classifier of ITK-SNAP's kind, and a threshold learned from the clicks.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.clicks.compiled import nearest_seed
from benchmarks.clicks.domain import INSIDE, OUTSIDE, Domain, Solver, connected
from benchmarks.clicks.forest import probability
from benchmarks.cuts import least_cut, pairs_of
from benchmarks.peers.measure import combinations

REACHES = (2.0, 4.0)


@dataclass(frozen=True)
class ClickPeer:
    """A method: its solver, the settings that are tried, and the voxels above which its crop is restricted."""

    name: str
    solver: Solver
    grid: list[dict[str, Any]] = field(default_factory=list)
    cap: int = 1_000_000


def random_walker(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """Probability to come to an inside seed first, less a half."""
    from skimage.segmentation import random_walker as walk

    with warnings.catch_warnings():
        # It advises other solvers, and says when labels are cut off from seeds; neither changes the result.
        warnings.simplefilter("ignore")
        found = walk(
            domain.values,
            domain.seeds.astype(np.int32),
            beta=settings["beta"],
            mode="cg_j",
            tol=1e-3,
            spacing=domain.spacing,
            return_full_prob=True,
        )
    return np.asarray(found[0]) - 0.5


def watershed(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """Flooding of the gradient's magnitude from the seeds."""
    from skimage.segmentation import watershed as flood

    relief = ndimage.gaussian_gradient_magnitude(
        domain.values, [settings["sigma"] / h for h in domain.spacing]
    )
    return np.where(flood(relief, domain.seeds.astype(np.int32)) == INSIDE, 0.5, -0.5)


def geodesic(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """Nearest seed by geodesic distance: mm and changes of value together."""
    offsets, lengths = neighbours(domain.spacing, diagonal=False)
    smooth = smoothed(domain, settings["sigma"])
    label = nearest_seed(smooth, domain.seeds, offsets, lengths, settings["weight"], True)
    return np.where(label == INSIDE, 0.5, -0.5)


def grow_cut(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """Nearest seed by the sum of changes of value over 26 neighbours, and a penalty per length."""
    offsets, lengths = neighbours(domain.spacing, diagonal=True)
    smooth = smoothed(domain, settings["sigma"])
    label = nearest_seed(
        smooth, domain.seeds, offsets, lengths * np.float32(settings["penalty"]), 1.0, False
    )
    return np.where(label == INSIDE, 0.5, -0.5)


def graph_cut(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """The cut of least cost: of values by the clicks' own histograms, of neighbours by their contrast in spreads."""
    values, seeds = smoothed(domain, 0.5), domain.seeds
    links = []
    for (first, other), h in zip(pairs_of(values.shape), domain.spacing, strict=True):
        apart = values.flat[first] - values.flat[other]
        links.append(
            (
                first,
                other,
                (UNIT * settings["weight"] * np.exp(-0.5 * apart**2) / h).astype(np.int32),
            )
        )
    inside, outside = unary(values, seeds)
    common = np.minimum(inside, outside)
    ends = ((UNIT * (cost - common)).ravel().astype(np.int32) for cost in (outside, inside))
    return np.where(connected(least_cut(*ends, links).reshape(values.shape), seeds), 0.5, -0.5)


#: Costs of the graph cut are whole numbers: so many for one unit of log-likelihood.
UNIT = 100.0


def unary(
    values: NDArray[np.float32], seeds: NDArray[np.uint8]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Costs of being inside and outside: minus log of the clicks' smoothed histograms; seeds are bound."""
    edges = np.linspace(values.min(), values.max() + 1e-3, 65)
    bins = np.clip(np.digitize(values, edges) - 1, 0, 63)
    costs = []
    for side in (INSIDE, OUTSIDE):
        counts = np.bincount(bins[seeds == side], minlength=64).astype(float)
        shares = (
            ndimage.gaussian_filter1d(counts / max(counts.sum(), 1.0), 2.0, mode="nearest") + 1e-3
        )
        costs.append(-np.log(shares / shares.sum())[bins])
    bound = 1e4
    costs[0][seeds == OUTSIDE] = bound
    costs[1][seeds == INSIDE] = bound
    return costs[0], costs[1]


def classifier(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """A forest's probability, smoothed by one voxel, above a half and connected to an inside click."""
    smoothed = ndimage.gaussian_filter(
        probability(domain, settings["position"]), [1.0 / h for h in domain.spacing]
    )
    return np.where(connected(smoothed > 0.5, domain.seeds), 0.5, -0.5)


def threshold(domain: Domain, settings: Mapping[str, Any]) -> NDArray[Any]:
    """Values near the median of an inside click, and nearer to it than to any outside click's, in one part with it."""
    smooth = smoothed(domain, 1.0)
    far = {
        "inside": np.full(smooth.shape, np.inf, np.float32),
        "outside": np.full(smooth.shape, np.inf, np.float32),
    }
    for side, values in domain.clicks:
        np.minimum(far[side], np.abs(smooth - np.median(values)), out=far[side])
    near = (far["inside"] < settings["spreads"]) & (far["inside"] < far["outside"])
    return np.where(connected(near, domain.seeds), 0.5, -0.5)


def smoothed(domain: Domain, sigma: float) -> NDArray[np.float32]:
    """Values smoothed by so many of the smallest spacing."""
    return (
        ndimage.gaussian_filter(domain.values, [sigma / h for h in domain.spacing])
        if sigma
        else domain.values
    )


def neighbours(
    spacing: tuple[float, ...], diagonal: bool
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Steps to the 6 or 26 neighbours, and their lengths."""
    steps = [
        s
        for s in itertools.product((-1, 0, 1), repeat=3)
        if any(s) and (diagonal or sum(map(abs, s)) == 1)
    ]
    offsets = np.array(steps, np.int64)
    return offsets, np.sqrt(((offsets * np.array(spacing)) ** 2).sum(axis=1)).astype(np.float32)


#: By name. Those that solve large systems are restricted sooner.
def with_implied(grid: list[dict[str, Any]], **best: Any) -> list[dict[str, Any]]:
    """A grid and its best setting once more, with what accelsurf takes clicks to imply beside the clicks."""
    return [*grid, {**best, "implied": 1}]


PEERS = {
    peer.name: peer
    for peer in (
        ClickPeer("threshold", threshold, combinations(reach=REACHES, spreads=(1.5, 2.5, 4.0))),
        ClickPeer(
            "watershed",
            watershed,
            with_implied(combinations(reach=REACHES, sigma=(0.5, 1.0, 2.0)), reach=4.0, sigma=1.0),
        ),
        ClickPeer(
            "geodesic",
            geodesic,
            with_implied(
                combinations(reach=REACHES, sigma=(0.5,), weight=(64.0, 256.0)),
                reach=2.0,
                sigma=0.5,
                weight=64.0,
            ),
        ),
        ClickPeer(
            "grow-cut",
            grow_cut,
            with_implied(
                combinations(reach=REACHES, sigma=(0.5,), penalty=(0.1, 0.3)),
                reach=2.0,
                sigma=0.5,
                penalty=0.1,
            ),
        ),
        ClickPeer(
            "random-walker",
            random_walker,
            with_implied(combinations(reach=REACHES, beta=(100.0, 400.0)), reach=4.0, beta=100.0),
            120_000,
        ),
        ClickPeer(
            "graph-cut",
            graph_cut,
            with_implied(combinations(reach=REACHES, weight=(2.0, 8.0)), reach=2.0, weight=2.0),
            120_000,
        ),
        ClickPeer(
            "classifier",
            classifier,
            with_implied(
                combinations(reach=REACHES, position=(False, True)), reach=4.0, position=True
            ),
            250_000,
        ),
    )
}
