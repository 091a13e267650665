"""Other programs on several objects of a scan: seeded watersheds, and the level-set programs on all objects as one.

A watershed is what users take for touching cells: it floods from the seeds, within a threshold. The level-set programs
move one surface; what it holds is shared out to the nearest start. Both get their settings by a search against the
reference.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from accelsurf.image.volume import Volume
from accelsurf.starts.objects import ObjectStart
from benchmarks.peers.measure import Trial, combinations, search
from benchmarks.peers.programs import level
from benchmarks.peers.scans import Window, found_by, in_window, search_peer, search_peers

#: Settings of the watersheds: presmoothing (voxels), what is flooded, and the threshold between the true means.
WATERSHEDS = combinations(
    sigma=(1.0, 2.0, 3.0), flooded=("value", "distance"), where=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
)


def mean_dice(found: np.ndarray, truth: np.ndarray) -> float:
    """Mean over the labels of ``truth`` of the Dice of each with the same label of ``found``.

    Examples
    --------
    >>> mean_dice(np.array([1, 1, 2, 0]), np.array([1, 1, 2, 2]))
    0.8333333333333333
    """
    largest = int(max(found.max(), truth.max())) + 1
    sizes = [np.bincount(one.ravel(), minlength=largest) for one in (found, truth)]
    both = np.bincount(truth[found == truth], minlength=largest)
    own = np.unique(truth[truth > 0])
    return float(np.mean(2.0 * both[own] / (sizes[0] + sizes[1])[own]))


def compare_on_objects(
    image: Volume, truth: np.ndarray, starts: Sequence[ObjectStart], window: Window, seconds: float
) -> dict[str, Any]:
    """The best of each program, ``seconds`` of search each; the Dice is `mean_dice`."""
    truth = truth.astype(np.int32)
    psi, nearest = together(starts, image)
    case = {
        "image": in_window(image.as_float32(), window),
        "truth": truth > 0,
        "start": psi / min(image.geometry.spacing),
    }
    found: dict[str, Any] = {
        "seconds_of_search": seconds,
        "voxels": list(psi.shape),
        "best": {},
        "missing": [],
    }

    def shared_out(inside: np.ndarray, _: Mapping[str, np.ndarray]) -> float:
        return mean_dice(np.where(inside, nearest, 0), truth)

    search_peers(
        found,
        lambda peer: search_peer(peer, case, seconds, shared_out, halve=False),
        ", shared out",
    )
    seeds = np.where(psi < 0, nearest, 0)
    for name, flood in (
        ("scikit-image watershed", _skimage_flood),
        ("SimpleITK watershed", _sitk_flood),
    ):
        tried = functools.partial(search_watershed, flood, image, truth, seeds, seconds)
        found["best"][name] = found_by(name, tried)
    return found


def together(starts: Sequence[ObjectStart], image: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Psi (mm) of all starts as one, and the id (int32) of the start that each voxel is nearest to."""
    ids = np.zeros(image.array.shape, np.int32)
    psi = np.full(ids.shape, np.inf, np.float32)
    for one in starts:
        box = tuple(slice(c, c + n) for c, n in zip(one.corner, one.psi.shape, strict=True))
        np.minimum(psi[box], one.psi, out=psi[box])
        ids[box][one.psi < 0] = one.id
    far, at = ndimage.distance_transform_edt(
        ids == 0, sampling=image.geometry.spacing, return_indices=True
    )
    return np.where(np.isfinite(psi), psi, far.astype(np.float32)), ids[tuple(at)]


def search_watershed(
    flood: Any, image: Volume, truth: np.ndarray, seeds: np.ndarray, seconds: float
) -> list[Trial]:
    """Try all settings of a watershed."""
    values = image.as_float32()
    means = float(values[truth > 0].mean()), float(values[truth == 0].mean())

    def run(settings: Mapping[str, Any]) -> float:
        smooth = ndimage.gaussian_filter(values, settings["sigma"])
        inside = ((smooth - level(means, settings["where"])) * (means[0] - means[1]) > 0) | (
            seeds > 0
        )
        if settings["flooded"] == "distance":
            relief = -ndimage.distance_transform_edt(
                inside, sampling=image.geometry.spacing
            ).astype(np.float32)
        else:
            relief = smooth * np.float32(np.sign(means[1] - means[0]))
        return mean_dice(np.where(inside, flood(relief, seeds, inside), 0), truth)

    return search(run, WATERSHEDS, None, seconds)


def _skimage_flood(relief: np.ndarray, seeds: np.ndarray, inside: np.ndarray) -> np.ndarray:
    from skimage.segmentation import watershed

    return np.asarray(watershed(relief, seeds, mask=inside))


def _sitk_flood(relief: np.ndarray, seeds: np.ndarray, inside: np.ndarray) -> np.ndarray:
    import SimpleITK as sitk

    high = np.where(inside, relief, relief.max() + 1).astype(np.float32)
    pictures = sitk.GetImageFromArray(high), sitk.GetImageFromArray(seeds.astype(np.int32))
    flooded = sitk.MorphologicalWatershedFromMarkers(
        *pictures, markWatershedLine=False, fullyConnected=False
    )
    return np.asarray(sitk.GetArrayFromImage(flooded))
