"""Other programs on an object of a scan: from the same start, with settings that a search against the reference chose.

The programs see the image in voxels, as by default, cut to what is within `MARGIN` voxels of object and start.
They are given more than a user has: where values lie in a window, the window that is best by the reference, as the soft
two-sided threshold of ITK-SNAP makes it, so that a speed of one sign is right for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from accelsurf.image.volume import Volume
from accelsurf.measure.metrics import dice
from accelsurf.text.starts import psi_of_starts, read_starts
from benchmarks.peers.measure import Trial, best, ranked, search, timed
from benchmarks.peers.programs import PEERS, Peer

#: Voxels around object and start that the programs get, and the voxels above which settings are searched at half the
#: resolution first.
MARGIN, LARGE = 20, 2_000_000
#: Bins of the histograms of `best_window`.
BINS = 256
#: How many of the best settings of half the resolution are tried at the whole.
TRANSFERRED = 2


class Window(NamedTuple):
    """Bounds of values, and the Dice of all that lies between them."""

    low: float
    high: float
    dice: float


def best_window(image: np.ndarray, truth: np.ndarray) -> Window:
    """The pair of global thresholds with the best Dice, of 256 bins between the 0.1 and 99.9 percentiles of the object.

    Examples
    --------
    >>> image = np.array([0, 0, 0, 5, 5, 9, 9], float)
    >>> best_window(image, image == 5).dice
    1.0
    """
    low, high = np.percentile(image[truth], (0.1, 99.9))
    margin = 0.25 * (high - low) + 1e-6
    edges = np.linspace(low - margin, high + margin, BINS + 1)
    edges[0], edges[-1] = -np.inf, np.inf
    count = np.diff(np.searchsorted(np.sort(image, axis=None), edges, side="left"))
    hit = np.diff(np.searchsorted(np.sort(image[truth], axis=None), edges, side="left"))
    all_below, hit_below = np.r_[0, count.cumsum()], np.r_[0, hit.cumsum()]
    between, both = all_below[None] - all_below[:, None], hit_below[None] - hit_below[:, None]
    scores = np.where(between > 0, 2 * both, 0) / np.maximum(between + hit_below[-1], 1)
    i, j = np.unravel_index(scores.argmax(), scores.shape)
    return Window(float(edges[i]), float(edges[j]), float(scores[i, j]))


def compare_peers(
    image: Volume, truth: np.ndarray, texts: tuple[str, ...], window: Window, seconds: float
) -> dict[str, Any]:
    """The best of each program, ``seconds`` of search each, with all that was tried."""
    start = psi_of_starts(read_starts(texts), image)
    where = np.argwhere(truth | (start < 0))
    low, high = where.min(axis=0) - MARGIN, where.max(axis=0) + MARGIN + 1
    box = tuple(slice(max(int(a), 0), int(b)) for a, b in zip(low, high, strict=True))
    values = in_window(image.as_float32()[box], window)
    whole = {
        "image": values,
        "truth": truth[box],
        "start": start[box] / min(image.geometry.spacing),
    }
    found: dict[str, Any] = {
        "seconds_of_search": seconds,
        "voxels": list(values.shape),
        "best": {},
        "missing": [],
    }
    search_peers(found, lambda peer: search_peer(peer, whole, seconds))
    return found


def search_peers(
    found: dict[str, Any], tried: Callable[[Peer], list[Trial]], remark: str = ""
) -> None:
    """Enter the best that each program has ``tried`` into what was ``found``, or that it is missing."""
    for peer in PEERS.values():
        if peer.missing:
            found["missing"].append(peer.missing)
        else:
            found["best"][peer.name + remark] = found_by(peer.name, lambda peer=peer: tried(peer))


def found_by(name: str, search: Callable[[], list[Trial]]) -> dict[str, Any]:
    """What a search found and how long it took, for JSON."""
    seconds, trials = timed(search)
    top = best(trials)
    print(f"   {name}: Dice {top.dice:.4f} in {top.seconds:.1f} s with {top.settings}", flush=True)
    return {**top.to_dict(), "tried": len(trials), "search_s": seconds}


def overlap(found: np.ndarray, case: Mapping[str, np.ndarray]) -> float:
    """Dice of what a program found with the reference."""
    return dice(found, case["truth"])


def in_window(image: np.ndarray, window: Window) -> np.ndarray:
    """Values from 0 to 1, 1/2 on the bounds of a window and above within it."""
    sides = [window.high - window.low] if np.isfinite(window.high - window.low) else []
    spread = 0.25 * min([*sides, float(np.ptp(np.percentile(image, (1, 99))))])
    above = np.minimum(image - window.low, window.high - image)
    return np.asarray(np.clip(0.5 + 0.5 * above / spread, 0.0, 1.0), np.float32)


def search_peer(
    peer: Peer,
    whole: Mapping[str, np.ndarray],
    seconds: float,
    score: Callable[[np.ndarray, Mapping[str, np.ndarray]], float] = overlap,
    halve: bool = True,
) -> list[Trial]:
    """Settings of one program, on half the resolution first where the image is large (with ``halve``)."""
    small = halved(whole) if halve and whole["image"].size > LARGE else None
    first = small or whole

    def run_on(case: Mapping[str, np.ndarray], settings: Mapping[str, Any]) -> float:
        means = tuple(float(case["image"][side].mean()) for side in (case["truth"], ~case["truth"]))
        return score(peer.run(case["image"], case["start"], (means[0], means[1]), settings), case)

    side = max(first["image"].shape)
    coarse = [{**peer.scaled(s, side), "sigma": sigma} for s in peer.coarse for sigma in sigmas(s)]
    share = 0.6 if small else 1.0
    trials = search(lambda s: run_on(first, s), coarse, peer.fine, share * seconds)
    if small is None:
        return trials
    transferred = [
        {**t.settings, "iterations": 2 * t.settings["iterations"]}
        for t in ranked(trials)[:TRANSFERRED]
    ]
    return search(lambda s: run_on(whole, s), transferred, None, (1 - share) * seconds)


def sigmas(settings: Mapping[str, Any]) -> tuple[float, ...]:
    """Presmoothing tried on scans: as in noise, and less."""
    if "edge" in settings or "alpha" in settings:
        return (max(0.7, 0.5 * settings["sigma"]),)
    return (0.0, settings["sigma"]) if settings["sigma"] == 1.0 else (0.5 * settings["sigma"],)


def halved(case: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Image, truth and start at half the resolution; axes of few slices keep theirs."""
    shape = case["image"].shape
    steps = [2 if n >= 48 else 1 for n in shape]
    cut = tuple(slice(0, n // s * s) for n, s in zip(shape, steps, strict=True))
    parts = [n for size, s in zip(shape, steps, strict=True) for n in (size // s, s)]

    def mean(array: np.ndarray) -> np.ndarray:
        return array[cut].astype(np.float32).reshape(parts).mean(axis=(1, 3, 5))

    return {
        "image": mean(case["image"]),
        "truth": mean(case["truth"]) >= 0.5,
        "start": 0.5 * mean(case["start"]),
    }
