"""The peers: for each a function from an image and a start to labels, and the settings that are searched.

Every function does what a user would write: presmooth with its own library, run, threshold. Images are (z, y, x) at
1 mm. ``start`` is a signed distance, negative inside. ``means`` are the true means inside and outside: a program that
needs a threshold is given the best one. Libraries are imported where they are used, so that a peer's process
loads its own only.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.peers.measure import combinations

Run = Callable[[np.ndarray, np.ndarray, tuple[float, float], Mapping[str, Any]], np.ndarray]


@dataclass(frozen=True)
class Peer:
    """A program that segments.

    ``coarse`` settings are all tried, ``fine`` are factors tried on the best of them; ``iterations`` in them are for
    96 voxels a side and grow with the side. ``module`` is what must be importable, ``package`` how to get it.
    Volumes of more than ``most`` voxels need more memory or time than a person has.
    """

    name: str
    module: str
    package: str
    run: Run
    coarse: list[dict[str, Any]]
    fine: dict[str, tuple[float, ...]] = field(default_factory=dict)
    most: float = float("inf")

    @property
    def missing(self) -> str | None:
        """Why it cannot be run, or None."""
        if importlib.util.find_spec(self.module) is not None:
            return None
        return f"{self.name}: skipped, {self.package} is not installed (pip install {self.package})"

    def scaled(self, settings: Mapping[str, Any], side: int) -> dict[str, Any]:
        """Settings with the iterations that a volume of ``side`` voxels needs for the same journey."""
        if "iterations" not in settings:
            return dict(settings)
        return {**settings, "iterations": max(2, round(settings["iterations"] * side / 96))}


def level(means: tuple[float, float], where: float) -> float:
    """The value at ``where`` (0: mean outside, 1: mean inside)."""
    inside, outside = means
    return outside + where * (inside - outside)


# -- SimpleITK ---------------------------------------------------------------------------------------------


def _itk(array: np.ndarray) -> Any:
    import SimpleITK as sitk

    return sitk.GetImageFromArray(np.asarray(array, np.float32))


def _itk_smooth(image: np.ndarray, sigma: float) -> Any:
    import SimpleITK as sitk

    return sitk.SmoothingRecursiveGaussian(_itk(image), sigma) if sigma > 0 else _itk(image)


def _inside(level_set: Any) -> np.ndarray:
    import SimpleITK as sitk

    return np.asarray(sitk.GetArrayViewFromImage(level_set) < 0)


def _sparse(solver: Any, settings: Mapping[str, Any]) -> Any:
    """What the sparse-field filters of ITK have in common."""
    solver.SetPropagationScaling(1.0)
    solver.SetCurvatureScaling(settings["curvature"])
    solver.SetNumberOfIterations(settings["iterations"])
    solver.SetMaximumRMSError(settings.get("rms", 1e-4))
    return solver


def _region_speed(image: Any, means: tuple[float, float], where: float) -> Any:
    """Speed in -1 .. 1: above the threshold outwards, below inwards, full at the two means."""
    import SimpleITK as sitk

    scale = 2.0 / (means[0] - means[1])
    return sitk.Clamp((image - level(means, where)) * scale, sitk.sitkFloat32, -1.0, 1.0)


def sitk_threshold(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """ThresholdSegmentationLevelSet with the known threshold; the upper one lies as far above the inside's mean."""
    import SimpleITK as sitk

    solver = _sparse(sitk.ThresholdSegmentationLevelSetImageFilter(), settings)
    low = level(means, settings["where"])
    solver.SetLowerThreshold(low)
    solver.SetUpperThreshold(level(means, settings.get("upper", 4.0)))
    return _inside(solver.Execute(_itk(start), _itk_smooth(image, settings["sigma"])))


def sitk_geodesic(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """GeodesicActiveContourLevelSet, on edges or on the signed region speed that c3d gets."""
    import SimpleITK as sitk

    if settings["feature"] == "region":
        feature = _region_speed(_itk_smooth(image, settings["sigma"]), means, settings["where"])
    else:
        size = sitk.GradientMagnitudeRecursiveGaussian(_itk(image), settings["sigma"])
        half = settings["edge"] * abs(means[0] - means[1])
        feature = sitk.Cast(1.0 / (1.0 + (size / half) ** 2), sitk.sitkFloat32)
    solver = _sparse(sitk.GeodesicActiveContourLevelSetImageFilter(), settings)
    solver.SetAdvectionScaling(settings["advection"])
    return _inside(solver.Execute(_itk(start), feature))


def sitk_chan_vese(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """ScalarChanAndVeseDenseLevelSet; it works in the whole volume and finds the means itself.

    What it reaches depends on the image's scale and on which side of the start is called inside: both are searched.
    """
    import SimpleITK as sitk

    solver = sitk.ScalarChanAndVeseDenseLevelSetImageFilter()
    solver.SetNumberOfIterations(settings["iterations"])
    solver.SetMaximumRMSError(0.0)
    solver.SetLambda1(1.0)
    solver.SetLambda2(1.0)
    solver.SetEpsilon(1.0)
    solver.SetCurvatureWeight(settings["curvature"])
    solver.SetAreaWeight(0.0)
    solver.SetReinitializationSmoothingWeight(0.0)
    solver.SetVolume(0.0)
    solver.SetVolumeMatchingWeight(0.0)
    step = {"atan": solver.AtanRegularizedHeaviside, "step": solver.Heaviside}
    solver.SetHeavisideStepFunction(step[settings["heaviside"]])
    brightness = _itk_smooth(image, settings["sigma"]) * (
        settings["scale"] / abs(means[0] - means[1])
    )
    found = solver.Execute(_itk(-start if settings["swapped"] else start), brightness)
    labels = np.asarray(sitk.GetArrayViewFromImage(found)) > 0
    # Which of the two regions it labels is a convention: the one that the start lies in is meant.
    return labels if labels[start < 0].mean() >= 0.5 else ~labels


# -- ITK-SNAP ----------------------------------------------------------------------------------------------


def c3d(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """`c3d -levelset`, the solver of ITK-SNAP, through its Python package: no files between."""
    import io

    from picsl_c3d import Convert3D

    tool = Convert3D(out=io.StringIO())
    tool.push(_region_speed(_itk_smooth(image, settings["sigma"]), means, settings["where"]))
    tool.push(_itk(start))
    tool.execute(
        f"-levelset-curvature {settings['curvature']} -levelset-advection {settings['advection']} "
        f"-levelset {settings['iterations']}"
    )
    return _inside(tool.pop())


# -- scikit-image ------------------------------------------------------------------------------------------


def _smooth(image: np.ndarray, sigma: float) -> np.ndarray:
    from scipy import ndimage

    return ndimage.gaussian_filter(image, sigma) if sigma > 0 else image


def skimage_chan_vese(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """morphological_chan_vese."""
    from skimage.segmentation import morphological_chan_vese

    return np.asarray(
        morphological_chan_vese(
            _smooth(image, settings["sigma"]),
            num_iter=settings["iterations"],
            init_level_set=(start < 0).astype(np.int8),
            smoothing=settings["smoothing"],
            lambda1=settings.get("lambda1", 1.0),
        ),
        dtype=bool,
    )


def skimage_geodesic(
    image: np.ndarray, start: np.ndarray, means: tuple[float, float], settings: Mapping[str, Any]
) -> np.ndarray:
    """morphological_geodesic_active_contour, growing from inside up to the edges."""
    from skimage.segmentation import (
        inverse_gaussian_gradient,
        morphological_geodesic_active_contour,
    )

    contrast = abs(means[0] - means[1])
    edges = inverse_gaussian_gradient(
        image / contrast, alpha=settings["alpha"], sigma=settings["sigma"]
    )
    return np.asarray(
        morphological_geodesic_active_contour(
            edges,
            num_iter=settings["iterations"],
            init_level_set=(start < 0).astype(np.int8),
            smoothing=settings["smoothing"],
            threshold=settings["threshold"],
            balloon=1,
        ),
        dtype=bool,
    )


ITERATIONS = {"iterations": (0.67, 1.5, 2.5)}

#: Settings searched. Iterations are for 96 voxels a side.
PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer(
            "c3d -levelset",
            "picsl_c3d",
            "picsl-c3d",
            c3d,
            combinations(
                sigma=(1.0, 1.5, 2.0),
                curvature=(0.0, 0.2, 0.5),
                where=(0.5,),
                advection=(0.0,),
                iterations=(300,),
            ),
            ITERATIONS,
        ),
        Peer(
            "SimpleITK ThresholdSegmentation",
            "SimpleITK",
            "SimpleITK",
            sitk_threshold,
            combinations(
                sigma=(1.0, 1.5, 2.0),
                curvature=(0.0, 0.05),
                where=(0.5,),
                upper=(1.5, 2.5),
                iterations=(400,),
            ),
            {"iterations": (0.75, 1.5)},
        ),
        Peer(
            "SimpleITK GeodesicActiveContour",
            "SimpleITK",
            "SimpleITK",
            sitk_geodesic,
            combinations(
                feature=("region",),
                sigma=(1.0, 1.5),
                curvature=(0.0, 0.2),
                where=(0.5,),
                advection=(0.0,),
                iterations=(300,),
            )
            + combinations(
                feature=("edge",),
                sigma=(1.5, 2.5),
                curvature=(0.2,),
                edge=(0.1, 0.05),
                advection=(1.0,),
                iterations=(300,),
            ),
            ITERATIONS,
        ),
        Peer(
            "SimpleITK ScalarChanAndVeseDense",
            "SimpleITK",
            "SimpleITK",
            sitk_chan_vese,
            combinations(
                sigma=(1.5, 2.5),
                scale=(100.0,),
                swapped=(False, True),
                heaviside=("atan", "step"),
                curvature=(0.0, 1.0),
                iterations=(20,),
            ),
            {"scale": (0.01, 100.0), "iterations": (0.5, 2.0)},
        ),
        Peer(
            "scikit-image morphological_chan_vese",
            "skimage",
            "scikit-image",
            skimage_chan_vese,
            combinations(smoothing=(0, 1, 2), sigma=(1.0, 1.5, 2.0), iterations=(60,)),
            {"iterations": (0.67, 2.0)},
        ),
        Peer(
            "scikit-image morphological_geodesic",
            "skimage",
            "scikit-image",
            skimage_geodesic,
            combinations(
                sigma=(2.0, 3.0),
                alpha=(100.0, 1000.0),
                smoothing=(1,),
                threshold=("auto", 0.5),
                iterations=(60,),
            ),
            {"iterations": (0.67, 2.0)},
        ),
    )
}
