"""What a person would take for the works of `benchmarks.peers.hard_works`: each a function of a work and settings."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from accelsurf.api.segment import segment, segment_objects
from accelsurf.grid.boxes import connected_to
from benchmarks.peers.baselines import gaussian_otsu, graph_cut, largest_part, tv_otsu
from benchmarks.peers.hard_works import Work, drawn, seeds_of
from benchmarks.peers.measure import combinations
from benchmarks.peers.programs import PEERS

Settings = Mapping[str, Any]


class Program(NamedTuple):
    """A name, a function from a work and settings to labels, the settings, and the module that it needs."""

    name: str
    run: Callable[[Work, Settings], np.ndarray]
    grid: list[dict[str, Any]]
    module: str = "scipy"


def _distance(work: Work) -> np.ndarray:
    """Signed distance to the first inside click, voxels."""
    ball = next(iter(work.inside.values()))
    axes = np.ogrid[tuple(map(slice, work.truth.shape))]
    far = sum((axis - at) ** 2 for axis, at in zip(axes, ball[:3], strict=True))
    return (np.sqrt(far) - ball[3]).astype(np.float32)


def _text(ball: tuple[float, float, float, float]) -> str:
    z, y, x, radius = ball
    return f"ball:{x:g},{y:g},{z:g},{radius:g}vox"


def _own_start(work: Work, settings: Settings) -> np.ndarray:
    return segment(work.image, start=_text(work.inside[1]), **settings).labels


def _own_clicks(work: Work, settings: Settings) -> np.ndarray:
    outside = tuple(_text(ball) for ball in work.outside)
    more = {"outside": outside} if outside else {}
    return segment(work.image, inside=_text(work.inside[1]), **more, **settings).labels


def _own_partition(work: Work, settings: Settings) -> np.ndarray:
    rows = [f"{own},{x:g},{y:g},{z:g},{r:g},inside" for own, (z, y, x, r) in work.inside.items()]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "clicks.csv")
        path.write_text("\n".join(["id,x_vox,y_vox,z_vox,r_vox,side", *rows]))
        return segment_objects(work.image, str(path), preset="membrane-cells", **settings).labels


def _otsu(work: Work, settings: Settings) -> np.ndarray:
    return gaussian_otsu(work.image, _distance(work), work.means, settings)


def _tv(work: Work, settings: Settings) -> np.ndarray:
    scale = float(np.diff(work.means)[0])
    return tv_otsu(work.image / abs(scale), _distance(work), work.means, settings)


def _cut(work: Work, settings: Settings) -> np.ndarray:
    return graph_cut(work.image, _distance(work), work.means, settings)


def _local_threshold(work: Work, settings: Settings) -> np.ndarray:
    """Each voxel beside the Gaussian mean around it; the largest part."""
    smooth = ndimage.gaussian_filter(work.image, settings["sigma"])
    return largest_part(smooth > ndimage.gaussian_filter(work.image, settings["width"]))


def _walker(work: Work, settings: Settings) -> np.ndarray:
    """scikit-image's random walker from the clicks, of one object also from the faces of the volume."""
    from skimage.segmentation import random_walker

    seeds, other = _seeds_with_outside(work)
    smooth = ndimage.gaussian_filter(work.image, settings["sigma"]) / abs(
        float(np.diff(work.means)[0])
    )
    labels = random_walker(smooth, seeds, beta=settings["beta"], mode="cg_j", tol=1e-3)
    return np.where(labels == other, 0, labels)


def _seeds_with_outside(work: Work) -> tuple[np.ndarray, int]:
    """Ids in their clicks, 0 where nothing is known; and the id of outside clicks and, of one object, of the faces."""
    seeds = seeds_of(work)
    other = int(seeds.max()) + 1
    seeds[seeds == -1] = other
    if len(work.inside) == 1:
        faces = np.ones(seeds.shape, bool)
        faces[1:-1, 1:-1, 1:-1] = False
        seeds[faces & (seeds == 0)] = other
    return seeds, other


def _watershed(work: Work, settings: Settings) -> np.ndarray:
    """A library's watershed from the clicks, on the image, its gradient, or the depth within Otsu's threshold."""
    from skimage.filters import threshold_otsu

    smooth = ndimage.gaussian_filter(work.image, settings["sigma"])
    seeds, other = _seeds_with_outside(work)
    mask = None
    if settings["flooded"] == "depth":
        mask = (smooth > threshold_otsu(smooth)) | (seeds_of(work) != 0)
        seeds = np.where(mask, seeds, 0)
        smooth = -ndimage.distance_transform_edt(mask)
    elif settings["flooded"] == "gradient":
        smooth = ndimage.gaussian_gradient_magnitude(work.image, settings["sigma"])
    if settings["library"] == "mahotas":
        from mahotas import cwatershed

        labels = cwatershed(smooth, seeds)
        labels = labels if mask is None else labels * mask
    else:
        from skimage.segmentation import watershed

        labels = watershed(smooth, seeds, mask=mask)
    return np.where(labels == other, 0, labels)


def _watersheds(sigmas: tuple[float, ...], flooded: tuple[str, ...]) -> list[Program]:
    """That of both libraries, with the same settings to try."""
    return [
        Program(
            f"{library} watershed",
            _watershed,
            combinations(sigma=sigmas, flooded=flooded, library=(library,)),
            module,
        )
        for library, module in (("scikit-image", "skimage"), ("mahotas", "mahotas"))
    ]


def _sato(work: Work, settings: Settings) -> np.ndarray:
    """scikit-image's tubeness filter, a threshold, and the part with the click."""
    from skimage.filters import sato

    tubes = sato(work.image, sigmas=settings["sigmas"], black_ridges=False)
    mask = tubes > settings["part"] * np.percentile(tubes, 99.9)
    return connected_to(mask, drawn(mask.shape, work.inside[1]))


def _hysteresis(work: Work, settings: Settings) -> np.ndarray:
    """A Gaussian, and hysteresis between two thresholds, connected to the click."""
    from skimage.filters import apply_hysteresis_threshold

    smooth = ndimage.gaussian_filter(work.image, settings["sigma"])
    inside, outside = work.means
    low, high = (outside + part * (inside - outside) for part in (settings["low"], 0.8))
    mask = apply_hysteresis_threshold(smooth, low, high)
    return connected_to(mask, drawn(mask.shape, work.inside[1]))


def _peer(name: str) -> Program:
    """A program that moves a surface, told the true means."""
    peer = PEERS[name]

    def run(work: Work, settings: Settings) -> np.ndarray:
        settings = peer.scaled(settings, max(work.image.shape))
        return peer.run(work.image, _distance(work), work.means, settings)

    return Program(name, run, peer.coarse, peer.module)


OWN = "accelsurf"
_OTSU = Program("Gaussian, Otsu, largest part", _otsu, combinations(sigma=(0.5, 1.0, 1.5)))
_TV = Program(
    "total variation, Otsu, largest part", _tv, combinations(weight=(0.2, 0.5, 1.0), passes=(50,))
)
_CUT = Program("graph cut, SciPy", _cut, combinations(weight=(0.05, 0.2, 0.5)))
_WALKER = Program(
    "scikit-image random_walker", _walker, combinations(sigma=(0.0, 0.7, 1.0), beta=(100.0, 1000.0))
)
_CHAN_VESE = _peer("scikit-image morphological_chan_vese")
_SPARSE = _peer("SimpleITK ThresholdSegmentation")

PROGRAMS: dict[str, list[Program]] = {
    "uneven": [
        Program(
            OWN,
            _own_start,
            [
                *combinations(
                    energy=("local-region:R=8", "local-region:R=12"), presmooth=(0.0, 1.0)
                ),
                {"presmooth": 1.0},
            ],
        ),
        Program("accelsurf, one click", _own_clicks, [{}]),
        _OTSU,
        _TV,
        _CUT,
        _WALKER,
        _CHAN_VESE,
        _SPARSE,
        Program(
            "local threshold", _local_threshold, combinations(sigma=(1.0, 1.5), width=(20.0, 30.0))
        ),
    ],
    "neighbours": [
        Program(OWN, _own_clicks, [{}, {"presmooth": 1.0}]),
        _OTSU,
        _WALKER,
        *_watersheds((1.0, 1.5, 2.0), ("depth", "gradient")),
    ],
    "vessels": [
        Program(
            OWN,
            _own_start,
            [
                {},
                {"presmooth": 0.7},
                {"energy": "likelihood", "smoothness": 0.1},
                {"smoothness": 0.1},
            ],
        ),
        Program("accelsurf, one click", _own_clicks, [{}]),
        _OTSU,
        _TV,
        _CUT,
        _CHAN_VESE,
        _SPARSE,
        Program(
            "scikit-image sato",
            _sato,
            [
                {"sigmas": sigmas, "part": part}
                for sigmas in ((1.0, 2.0), (1.0, 2.0, 3.0))
                for part in (0.2, 0.3, 0.4)
            ],
        ),
        Program(
            "hysteresis threshold",
            _hysteresis,
            combinations(sigma=(0.5, 0.8, 1.2), low=(0.3, 0.4, 0.5)),
        ),
    ],
    "cells": [
        Program(OWN, _own_partition, [{}]),
        *_watersheds((0.5, 1.0, 1.5), ("value",)),
        Program("scikit-image random_walker", _walker, combinations(sigma=(0.7,), beta=(100.0,))),
    ],
}


def missing(program: Program) -> bool:
    """Whether what it needs is not installed."""
    return importlib.util.find_spec(program.module) is None
