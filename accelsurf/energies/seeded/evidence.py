"""Further evidence for the level of an arrival time that is the object: edges along it, and the cost of a wrong one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies.seeded.appearance import Spacing, gradient
from accelsurf.kernels.arrival import Tissue

#: The edge along a level is that of the voxels between the volumes this factor smaller and larger.
ALONG = 1.1


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
