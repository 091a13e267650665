"""The baselines: what a person takes who needs no surface that moves. Smooth, threshold, largest part; global methods.

Each is a function as in `benchmarks.peers.programs`. The first two are told nothing but the image, not even the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf.grid.boxes import connected_to
from benchmarks.cuts import least_cut, pairs_of
from benchmarks.peers.measure import combinations
from benchmarks.peers.programs import Peer

#: The graph cut's capacities are whole numbers: so many for a weight of 1.
CAPACITY = 1000
#: Voxels above which walks and cuts of these libraries take several GB.
MOST = 4e6


def largest_part(mask: np.ndarray) -> np.ndarray:
    """The largest connected part, its holes filled.

    Examples
    --------
    >>> int(largest_part(np.array([[1, 0, 1, 1, 1], [0, 0, 1, 0, 1], [0, 0, 1, 1, 1]], bool)).sum())
    9
    """
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(ndimage.binary_fill_holes(labels == sizes.argmax()))


def gaussian_otsu(
    image: np.ndarray, _start: np.ndarray, _means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """Gaussian, Otsu's threshold, largest part, holes filled."""
    from skimage.filters import threshold_otsu

    smooth = ndimage.gaussian_filter(image, settings["sigma"])
    return largest_part(smooth > threshold_otsu(smooth))


def tv_otsu(
    image: np.ndarray, _start: np.ndarray, _means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """Total-variation denoising, Otsu's threshold, largest part, holes filled."""
    from skimage.filters import threshold_otsu
    from skimage.restoration import denoise_tv_chambolle

    smooth = denoise_tv_chambolle(image, weight=settings["weight"], max_num_iter=settings["passes"])
    return largest_part(smooth > threshold_otsu(smooth))


def random_walker(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """Random walks from the start and from the faces of the volume, after a Gaussian."""
    from skimage.segmentation import random_walker as walk

    smooth = ndimage.gaussian_filter(image, settings["sigma"]) / abs(means[0] - means[1])
    seeds = np.full(image.shape, 2, np.uint8)
    seeds[1:-1, 1:-1, 1:-1] = 0
    seeds[start < 0] = 1
    return np.asarray(walk(smooth, seeds, beta=settings["beta"], mode="cg_j", tol=1e-3) == 1)


def graph_cut(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """The least of |I - mean|^2 and the weighted area over faces of voxels (Greig et al. 1989), by SciPy's flow.

    It is told the two true means. Only the part with the start counts.
    """
    inside, outside = means
    cost = ((image - inside) ** 2 - (image - outside) ** 2).astype(np.float64) / (
        inside - outside
    ) ** 2
    cost[start < 0] = -CAPACITY
    links = [
        (one, other, np.full(one.size, round(CAPACITY * settings["weight"]), np.int32))
        for one, other in pairs_of(image.shape)
    ]
    ends = np.round(np.clip(cost, -CAPACITY, CAPACITY) * CAPACITY).astype(np.int32).ravel()
    mask = least_cut(np.maximum(-ends, 0), np.maximum(ends, 0), links).reshape(image.shape)
    return connected_to(mask, start < 0)


#: Settings searched. Sigmas are in voxels, weights and sharpness (beta) in units of the contrast.
BASELINES: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer(
            "Gaussian, Otsu, largest part",
            "skimage",
            "scikit-image",
            gaussian_otsu,
            combinations(sigma=(0.7, 1.0, 1.5, 2.0, 2.5)),
        ),
        Peer(
            "total variation, Otsu, largest part",
            "skimage",
            "scikit-image",
            tv_otsu,
            combinations(weight=(0.6, 1.0, 1.5, 2.0), passes=(50,)),
            {"passes": (2.0,)},
        ),
        Peer(
            "scikit-image random_walker",
            "skimage",
            "scikit-image",
            random_walker,
            combinations(sigma=(0.7, 1.0, 1.5), beta=(300.0, 1000.0, 3000.0)),
            most=MOST,
        ),
        Peer(
            "graph cut, SciPy",
            "scipy",
            "scipy",
            graph_cut,
            combinations(weight=(0.4, 0.8, 1.2, 1.8)),
            most=MOST,
        ),
    )
}
