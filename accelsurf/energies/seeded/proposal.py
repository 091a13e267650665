"""Size hypothesis: the iso-value of an arrival time that bounds the object, by a stated size or by evidence.

Evidence is what a person clicks, the change of appearance, edges along the iso-surface, and the cost of a wrong choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.appearance import Spacing, gradient
from accelsurf.kernels.arrival import Tissue

Order = NDArray[np.int64]

#: Volumes that are compared grow by this factor from one to the next.
STEP = 1.08
#: The front's speed is read off between the volumes this factor smaller and larger.
NEAR = 1.25
#: A volume found over blocks is looked for again, over smaller ones, up to this factor smaller and larger.
NEARBY = 1.4
#: An object has about so many times the volume of the largest ball in it, as many times that of the largest disk to the
#: power of two thirds; spread of the logarithm.
TIMES_BALL, BALL_SPREAD = 5.5, 1.2
#: A click of fewer voxels than these is a point, and says nothing of the size.
MIN_BALL = 5
#: The logarithm of how much less the even tissue around a click counts than the click's own width.
EVEN_WEIGHT = -1.0
#: People know a size to about a quarter.
SIZE_SPREAD = 0.25
#: Part of a box that is object; spread of the logarithm.
BOX_FILLED, BOX_SPREAD = 0.4, 0.5
#: The march ends at so many spreads above the expected volume.
FARTHEST = 1.8
#: The edge along a level is that of the voxels between the volumes this factor smaller and larger.
ALONG = 1.1


class Proposal(NamedTuple):
    """The level of an arrival time that is proposed as the object.

    Attributes
    ----------
    volume_mm3 : float
        Of what arrived until then.
    sureness : float
        From 0 (other levels are as likely) to 1.
    others : tuple of float
        Volumes of other candidates, mm3, the likelier first.
    spread : float
        Standard deviation of the logarithm of the volume, as far as is known.
    """

    volume_mm3: float
    sureness: float
    others: tuple[float, ...] = ()
    spread: float = BALL_SPREAD


class LevelEvidence(NamedTuple):
    """Evidence of the image for levels: their ``counts`` of voxels, ascending, and the logarithm of each one's;
    ``reached`` voxels have arrived.
    """

    counts: NDArray[np.int64]
    score: NDArray[np.float64]
    reached: int


def of_size(reached: int, voxel_volume: float, size_mm3: float) -> Proposal:
    """The level that has a stated volume.

    Parameters
    ----------
    reached : int
        How many voxels a march has come to.
    voxel_volume, size_mm3 : float
        mm3.
    """
    return Proposal(min(max(round(size_mm3 / voxel_volume), 1), reached) * voxel_volume, 1.0, (), SIZE_SPREAD)


class Prior(NamedTuple):
    """Prior of the number of voxels, before it is looked for: its logarithm is normally distributed.

    ``voxels`` is the number by the click's width or a box, ``spread`` inf where they say nothing; ``even`` the number
    by the even tissue around the click, 0 where that does not count. Either may be right.
    """

    voxels: float
    spread: float
    even: float = 0.0

    def of(self, counts: NDArray[np.int64]) -> NDArray[np.float64]:
        """Its logarithm for numbers of voxels, but for a constant."""
        by_width = -0.5 * (np.log(counts / self.voxels) / self.spread) ** 2
        if not self.even:
            return np.asarray(by_width)
        by_tissue = EVEN_WEIGHT - 0.5 * (np.log(counts / self.even) / BALL_SPREAD) ** 2
        return np.asarray(np.logaddexp(by_width, by_tissue) if np.isfinite(self.spread) else by_tissue)

    def farthest(self) -> float:
        """The number that is hardly exceeded; inf where nothing is expected."""
        found = self.voxels * np.exp(FARTHEST * self.spread) if np.isfinite(self.spread) else 0.0
        if self.even:
            found = max(found, self.even * np.exp(FARTHEST * BALL_SPREAD))
        return float(found) if found else np.inf


def prior_of(click: int, box: int | None, even: float, flat: bool) -> Prior:
    """Make the prior from a click's voxels, the even tissue around it and a box.

    A person who clicks a ball deep inside makes it about half as wide as the object is thick there, or much smaller;
    then the tissue around it tells how thick. Objects are larger than the largest ball in them. A box is filled to
    about two fifths.

    Parameters
    ----------
    click : int
        Voxels of the click.
    box : int or None
        Voxels of the box.
    even : float
        Voxels of the ball of even tissue, see `accelsurf.energies.seeded.appearance.even_radius`.
    flat : bool
        Whether the image is one slice: balls are disks.
    """
    if box is not None:
        return Prior(BOX_FILLED * box, BOX_SPREAD)
    dimensions = 2 if flat else 3
    times = TIMES_BALL ** (dimensions / 3.0)
    tissue = times * max(even, float(click))
    return Prior(times * 2.0**dimensions * click, BALL_SPREAD if click >= MIN_BALL else np.inf, tissue)


def level_evidence(
    images: NDArray[np.float32],
    edges: NDArray[np.float64],
    times: NDArray[np.float32],
    order: Order,
    first: int,
    size: int = 1,
) -> LevelEvidence:
    """Evidence of the image for the levels of a march.

    A level is the likelier, the slower the front is there (d log T / d log V), the more what arrives next differs from
    what has arrived (difference of the means in units of both spreads), and the stronger the edges along it are.

    Parameters
    ----------
    images : ndarray (channels, n), float32
    edges : ndarray (m,) float64
        Of the blocks in the order of their times, see `accelsurf.energies.seeded.proposal.edges_of`.
    times : ndarray (n,) float32
    order : ndarray (m,) int64
        The blocks in the order of their times.
    first : int
        Number of seeds.
    size : int, optional
        Voxels of a block.
    """
    counts = candidate_counts(first, len(order))
    along = np.log(np.maximum(edge_along(edges, counts), 1e-6))
    return LevelEvidence(size * counts, scores(images, times, order, counts) + along, size * len(order))


def joined(near: LevelEvidence, far: LevelEvidence) -> LevelEvidence:
    """The evidence of a march over voxels, and beyond it that of one over blocks.

    Means of blocks have less noise and weaker edges: what they say is brought to the scale of the voxels where both
    march.
    """
    if not far.counts.size:
        return near
    known = near.counts <= near.reached // 2  # what comes next is known as well
    both = known & (near.counts >= max(near.reached // 8, far.counts[0]))
    shift = 0.0
    if both.any():
        there = np.interp(np.log(near.counts[both]), np.log(far.counts), far.score)
        shift = float(np.mean(near.score[both] - there))
    beyond = far.counts > near.reached // 2
    counts = np.concatenate((near.counts[known], far.counts[beyond]))
    return LevelEvidence(counts, np.concatenate((near.score[known], far.score[beyond] + shift)), far.reached)


def by_evidence(evidence: LevelEvidence, prior: Prior, voxel_volume: float, most: float = np.inf) -> Proposal:
    """The level that is expected to be least wrong: by the evidence, and what is expected of its volume.

    Parameters
    ----------
    evidence : LevelEvidence
    prior : Prior
    voxel_volume : float
        mm3.
    most : float, optional
        It has fewer voxels than these.
    """
    counts = evidence.counts
    if counts.size < 3:
        return Proposal(evidence.reached * voxel_volume, 0.0)
    score = evidence.score + prior.of(counts)
    score[~_below(counts, most)] = -np.inf
    peaks = [i for i in np.flatnonzero(np.isfinite(score)) if score[i] == score[max(i - 3, 0) : i + 4].max()]
    peaks.sort(key=lambda i: (-score[i], i))
    best = safest(counts, score)
    spread = spread_of(counts, score)
    sure = float(1.0 - np.exp(score[peaks[1]] - score[peaks[0]])) if len(peaks) > 1 else 1.0
    others = tuple(float(counts[i] * voxel_volume) for i in peaks if abs(i - best) > 3)
    return Proposal(float(counts[best] * voxel_volume), sure, others[:3], spread)


def with_finer_evidence(
    proposal: Proposal, evidence: LevelEvidence, prior: Prior, voxel_volume: float, most: float = np.inf
) -> Proposal:
    """A proposal that was found over blocks, its volume looked for again over smaller ones, `NEARBY` it.

    Parameters as of `by_evidence`.
    """
    ratio = evidence.counts * voxel_volume / proposal.volume_mm3
    close = (ratio * NEARBY >= 1.0) & (ratio <= NEARBY) & (evidence.counts < most)
    if not close.any():
        return proposal
    counts = evidence.counts[close]
    best = safest(counts, evidence.score[close] + prior.of(counts))
    return proposal._replace(volume_mm3=float(counts[best] * voxel_volume))


def _below(counts: NDArray[np.int64], most: float) -> NDArray[np.bool_]:
    """Mask of the numbers of voxels below a bound; the smallest one where none is."""
    below = counts < most
    below[0] = below[0] or not below.any()
    return below


def candidate_counts(first: int, last: int) -> NDArray[np.int64]:
    """Numbers of voxels whose levels are compared, from somewhat more than the seeds to somewhat less than all."""
    low, high = 1.5 * first, last / NEAR
    if high <= low:
        return np.zeros(0, np.int64)
    steps = int(np.floor(np.log(high / low) / np.log(STEP)))
    return np.unique(np.round(low * STEP ** np.arange(steps + 1)).astype(np.int64))


def scores(
    images: NDArray[np.float32], times: NDArray[np.float32], order: Order, counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Logarithm of the evidence in the image for each candidate, see `level_evidence`."""
    last = len(order) - 1
    late = np.log(np.maximum(times[order].astype(np.float64), 1e-12))
    slow = late[np.minimum((counts * NEAR).astype(np.int64), last)] - late[(counts / NEAR).astype(np.int64)]
    contrast = np.zeros(len(counts))
    above = np.minimum(2 * counts, last)
    for image in images:
        values = image[order].astype(np.float64)
        total = np.concatenate(([0.0], np.cumsum(values)))
        square = np.concatenate(([0.0], np.cumsum(values * values)))
        mean, shell = total[counts] / counts, (total[above] - total[counts]) / (above - counts)
        variance = square[counts] / counts - mean**2 + (square[above] - square[counts]) / (above - counts) - shell**2
        contrast = np.maximum(contrast, np.abs(shell - mean) / np.sqrt(np.maximum(variance, 1e-9)))
    return np.asarray(np.log(np.maximum(slow, 1e-6)) + np.log(np.maximum(contrast, 1e-6)))


def edges_of(
    images: Sequence[NDArray[np.float32]], spacing: Spacing, tissue: Tissue, order: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Length of the gradient in each voxel that a march has come to, in the tissue's edges.

    Parameters
    ----------
    images : sequence of ndarray (nz, ny, nx), float32
        The channels; the length is the root of the sum of their squares.
    spacing : (hz, hy, hx)
        mm.
    tissue : Tissue
        Its ``gradient`` is the one that counts as 1, per mm.
    order : ndarray (m,) int64
        The voxels, as flat indices.

    Returns
    -------
    ndarray (m,) float64
    """
    shape = images[0].shape
    places = np.unravel_index(order, shape)
    box = tuple(slice(max(int(at.min()) - 1, 0), int(at.max()) + 2) for at in places)
    here = tuple(at - side.start for at, side in zip(places, box, strict=True))
    square = np.zeros(len(order))
    for image, edge in zip(images, tissue.gradient, strict=True):
        square += (gradient(image[box], spacing)[here] / edge) ** 2
    return np.asarray(np.sqrt(square))


def edge_along(edges: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean edge of the voxels that come about when so many have come.

    Parameters
    ----------
    edges : ndarray (m,) float64
        Of `edges_of`, in the order of the times.
    counts : ndarray (k,) int64

    Examples
    --------
    >>> edge_along(np.array([1.0, 1.0, 1.0, 7.0, 1.0, 1.0]), np.array([2, 4])).tolist()
    [1.0, 4.0]
    """
    total = np.concatenate(([0.0], np.cumsum(edges)))
    low = (counts / ALONG).astype(np.int64)
    high = np.minimum((counts * ALONG).astype(np.int64) + 1, len(edges))
    return np.asarray((total[high] - total[low]) / (high - low))


def safest(counts: NDArray[np.int64], score: NDArray[np.float64]) -> int:
    """The candidate with the largest expected Dice.

    The likeliest level may be one narrow peak far from all others; one between several likely levels costs less when
    it is wrong. One level holds the other, so that two of n and m voxels have the Dice 2 min(n, m)/(n + m).

    Parameters
    ----------
    counts : ndarray (k,) int64
        Voxels of each candidate.
    score : ndarray (k,) float64
        Logarithm of how likely it is, but for a constant.

    Returns
    -------
    int
        Its index.

    Examples
    --------
    >>> safest(np.array([100, 1000, 1100, 1200]), np.log([0.3, 0.25, 0.2, 0.25]))
    2
    """
    likely = np.exp(score - score.max())
    rows, columns = counts[:, None].astype(np.float64), counts[None, :].astype(np.float64)
    return int(np.argmax(2.0 * np.minimum(rows, columns) / (rows + columns) @ likely))


def spread_of(counts: NDArray[np.int64], score: NDArray[np.float64]) -> float:
    """Standard deviation of the logarithm of the number of voxels under the evidence.

    Parameters
    ----------
    counts : ndarray (k,) int64
    score : ndarray (k,) float64
        As of `safest`; -inf where one is impossible.

    Examples
    --------
    >>> spread_of(np.array([100, 271, 272]), np.log([0.5, 1e-9, 0.5])).__round__(2)
    0.5
    """
    likely = np.exp(score - score.max())
    size = np.log(counts.astype(np.float64))
    middle = np.average(size, weights=likely)
    return float(np.sqrt(np.average((size - middle) ** 2, weights=likely)))
