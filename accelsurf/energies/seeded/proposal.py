"""Which level of an arrival time is the object: by a stated size, or by evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Order = NDArray[np.int64]

#: Volumes that are compared grow by this factor from one to the next.
STEP = 1.08


class Proposal(NamedTuple):
    """The level of an arrival time that is proposed as the object.

    Attributes
    ----------
    level : float
        Arrival time.
    volume_mm3 : float
        Of what arrived until then.
    sureness : float
        From 0 (other levels are as likely) to 1.
    others : tuple of float
        Volumes of other candidates, mm3, the likelier first.
    """

    level: float
    volume_mm3: float
    sureness: float
    others: tuple[float, ...] = ()


def of_size(times: NDArray[np.float32], order: Order, voxel_volume: float, size_mm3: float) -> Proposal:
    """The level that has a stated volume.

    Parameters
    ----------
    times : ndarray (n,) float32
    order : ndarray (m,) int64
        The voxels in the order of their times.
    voxel_volume, size_mm3 : float
        mm3.
    """
    count = min(max(round(size_mm3 / voxel_volume), 1), len(order))
    return Proposal(float(times[order[count - 1]]), count * voxel_volume, 1.0)


def by_evidence(
    images: Sequence[NDArray[np.float32]], times: NDArray[np.float32], order: Order, first: int, voxel_volume: float
) -> Proposal:
    """The level with the most evidence: the front is slow there, and what arrives next differs from what has arrived.

    Parameters
    ----------
    images : sequence of ndarray (n,) float32
    times : ndarray (n,) float32
    order : ndarray (m,) int64
        The voxels in the order of their times.
    first : int
        Number of seeds.
    voxel_volume : float
        mm3.
    """
    counts = candidate_counts(first, len(order))
    if counts.size < 3:
        return Proposal(float(times[order[-1]]), len(order) * voxel_volume, 0.0)
    score = scores(images, times, order, counts)
    peaks = [
        i for i in range(len(score)) if score[i] == score[max(i - 3, 0) : i + 4].max() and np.isfinite(score[i])
    ]
    peaks.sort(key=lambda i: (-score[i], i))
    best = peaks[0]
    second = score[peaks[1]] if len(peaks) > 1 else 0.0
    sure = float(np.clip(1.0 - second / score[best], 0.0, 1.0)) if score[best] > 0.0 else 0.0
    return Proposal(
        float(times[order[counts[best] - 1]]),
        float(counts[best] * voxel_volume),
        sure,
        tuple(float(counts[i] * voxel_volume) for i in peaks[1:4]),
    )


def candidate_counts(first: int, last: int) -> NDArray[np.int64]:
    """Numbers of voxels whose levels are compared, from somewhat more than the seeds to somewhat less than all."""
    low, high = 1.5 * first, last / 1.5
    if high <= low:
        return np.zeros(0, np.int64)
    steps = int(np.floor(np.log(high / low) / np.log(STEP)))
    return np.unique(np.round(low * STEP ** np.arange(steps + 1)).astype(np.int64))


def scores(
    images: Sequence[NDArray[np.float32]], times: NDArray[np.float32], order: Order, counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Evidence of each candidate, see `by_evidence`."""
    late = np.log(np.maximum(times[order].astype(np.float64), 1e-30))
    below, above = (counts / 1.25).astype(np.int64), np.minimum((counts * 1.25).astype(np.int64), len(order) - 1)
    slow = (late[above] - late[below]) / 2.0
    contrast = np.zeros(len(counts))
    for image in images:
        values = image[order].astype(np.float64)
        total = np.concatenate(([0.0], np.cumsum(values)))
        square = np.concatenate(([0.0], np.cumsum(values * values)))
        mean = total[counts] / counts
        spread = np.sqrt(np.maximum(square[counts] / counts - mean * mean, 1e-12))
        shell = (total[above] - total[counts]) / np.maximum(above - counts, 1)
        contrast = np.maximum(contrast, np.abs(shell - mean) / spread)
    return np.asarray(slow * contrast)
