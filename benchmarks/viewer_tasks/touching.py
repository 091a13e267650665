"""A phantom of three nuclei that touch, each the two others: no public scan at hand has three in its reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from accelsurf import io
from accelsurf.image.volume import Volume

SHAPE = (56, 88, 96)
#: Middle and half axes (z, y, x), voxels, and brightness: stains differ from nucleus to nucleus.
NUCLEI = (
    ((28.0, 32.0, 32.0), (13.0, 15.0, 18.0), 100.0),
    ((26.0, 35.0, 64.0), (14.0, 16.0, 16.0), 75.0),
    ((30.0, 59.0, 47.0), (13.0, 14.0, 18.0), 125.0),
)
#: Of the medium; of the chromatin, as part of the brightness; sigma of the optics, voxels; noise.
BACKGROUND, CHROMATIN, BLUR, NOISE = 12.0, 0.12, 1.2, 10.0


def touching_nuclei(folder: Path) -> tuple[Path, Path]:
    """Write image and labels into a folder; returns their paths."""
    labels = nuclei_labels()
    random = np.random.default_rng(20)
    texture = ndimage.gaussian_filter(random.normal(0.0, 1.0, SHAPE), 2.0)
    brightness = np.array([0.0, *(one[2] for one in NUCLEI)])[labels] * (
        1.0 + CHROMATIN * texture / texture.std()
    )
    image = ndimage.gaussian_filter(BACKGROUND + brightness, BLUR) + random.normal(
        0.0, NOISE, SHAPE
    )
    volume = Volume.from_array(image.astype(np.float32))
    paths = folder / "touching_nuclei.nii.gz", folder / "touching_nuclei_truth.nii.gz"
    io.write(volume, paths[0])
    io.write(volume.with_array(labels.astype(np.uint8)), paths[1])
    return paths


def nuclei_labels() -> NDArray[np.intp]:
    """Ellipsoids that are pressed against each other: a voxel belongs to the one that it lies deepest in.

    Examples
    --------
    >>> labels = nuclei_labels()
    >>> near = [ndimage.binary_dilation(labels == number) for number in (1, 2, 3)]
    >>> [bool((near[a] & (labels == b + 1)).any()) for a, b in ((0, 1), (1, 2), (2, 0))]
    [True, True, True]
    """
    places = np.indices(SHAPE)
    depths = np.stack(
        [
            sum(
                ((place - middle) / half) ** 2
                for place, middle, half in zip(places, one[0], one[1], strict=True)
            )
            for one in NUCLEI
        ]
    )
    return np.where(depths.min(axis=0) < 1.0, depths.argmin(axis=0) + 1, 0)
