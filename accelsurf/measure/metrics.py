"""Agreement of two label maps: overlap, volume, distances between their surfaces in mm, and surface Dice.

Definitions, so that numbers can be compared with other programs:

- The object is every voxel with a label > 0; several labels count as one object (`label_metrics` compares each alone).
- Its *surface* is the set of centres of its border voxels: those with a face neighbour that is not object. Voxels
  outside the volume are no object, so an object cut by the volume's border has a surface there. An axis of one voxel
  (a 2D image) has no neighbours: the surface of a 2D object is its outline.
- *Distances* are Euclidean, between voxel centres in mm, with the voxel size along each axis. For each border voxel of
  one map the nearest border voxel of the other is taken, and the other way round.
- *Hausdorff*: the largest of all these. *HD95*: the larger of the two directed 95th percentiles. *Mean surface
  distance*: the mean over both sets together (average symmetric surface distance, ASSD).

Border voxel centres lie up to half a voxel inside the object in both maps, which cancels; and MONAI, medpy and
the medical challenges use them too. For distances finer than a voxel compare meshes with an exact surface
(`accelsurf.phantoms.recipes.distance_at`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from accelsurf.errors import GeometryError, InputError
from accelsurf.grid.arrays import Floats, Mask, Spacing
from accelsurf.grid.boxes import bounding_box, corner_of
from accelsurf.image.volume import Volume
from accelsurf.io import ImageLike, as_volume, from_library, read_labels


@dataclass(frozen=True)
class Metrics:
    """Agreement of a predicted label map with a reference; NaN where a number has no meaning.

    With both objects empty every ratio and distance is NaN (there is nothing to agree on; a mean over cases should
    leave the case out, as nnU-Net does). With one of them empty Dice and IoU are 0 and the distances NaN, because
    there is no surface to measure to. The volume difference in percent is relative to the reference, NaN without one.

    Attributes
    ----------
    dice, iou : float
        2 |A and B| / (|A| + |B|) and |A and B| / |A or B| (the Jaccard index), between 0 and 1.
    volume_pred_mm3, volume_ref_mm3 : float
        Voxel count times voxel volume.
    volume_difference_mm3, volume_difference_percent : float
        Prediction minus reference, signed.
    hausdorff_mm, hd95_mm, mean_surface_distance_mm : float
        See the module's definitions.
    """

    dice: float
    iou: float
    volume_pred_mm3: float
    volume_ref_mm3: float
    volume_difference_mm3: float
    volume_difference_percent: float
    hausdorff_mm: float
    hd95_mm: float
    mean_surface_distance_mm: float

    def to_dict(self) -> dict[str, float | None]:
        """The numbers by name, ready for JSON: NaN, which JSON does not know, becomes None."""
        return {name: None if math.isnan(value) else value for name, value in asdict(self).items()}


def evaluate(
    pred: ImageLike,
    ref: ImageLike,
    *,
    spacing: float | str | tuple[float, float, float] | None = None,
) -> Metrics:
    """Compare two label maps on the same grid.

    Parameters
    ----------
    pred, ref : image
        Label maps, as `accelsurf.segment` takes images; labels > 0 are the object. An array beside an image with a
        geometry lies on its grid.
    spacing : float, str or (hz, hy, hx), optional
        mm, of two arrays; 1 by default.

    Returns
    -------
    Metrics
        Overlap (no unit), volumes (mm3) and surface distances (mm).

    Raises
    ------
    GeometryError
        When the grids differ; the message names the differences.
    InputError
        When a label is NaN, or a label map cannot be used, as `accelsurf.read_labels` and `accelsurf.segment`.

    Examples
    --------
    >>> import numpy as np
    >>> a, b = np.zeros((2, 12, 12, 12), dtype=np.uint8)
    >>> a[2:8, 2:8, 2:8] = 1
    >>> b[4:10, 2:8, 2:8] = 1
    >>> spacing = (1.5, 1.0, 1.0)
    >>> m = evaluate(Volume.from_array(a, spacing), Volume.from_array(b, spacing))
    >>> m.hausdorff_mm, round(m.dice, 3), m.volume_pred_mm3
    (3.0, 0.667, 324.0)
    """
    pair = [
        read_labels(v) if isinstance(v, (str, os.PathLike)) else from_library(v, "labels")
        for v in (pred, ref)
    ]
    grid = next((image.geometry for image in pair if isinstance(image, Volume)), None)
    first, second = (
        as_volume(pair[0], spacing, "pred", grid),
        as_volume(pair[1], spacing, "ref", grid),
    )
    check_same_grid(first, second)
    return agreement(_object(first), _object(second), first.geometry.spacing)


def check_same_grid(pred: Volume, ref: Volume) -> None:
    """Refuse two label maps whose voxels are not at the same places.

    Raises
    ------
    GeometryError
        The message names the differences.
    """
    if not pred.geometry.matches(ref.geometry):
        raise GeometryError(
            f"the two label maps are not on the same grid: {pred.geometry.difference(ref.geometry)}",
            hint="resample one onto the grid of the other (nearest neighbour) and compare again",
        )


def agreement(a: Mask, b: Mask, spacing: tuple[float, float, float]) -> Metrics:
    """Compare two objects on the same grid.

    Parameters
    ----------
    a, b : ndarray of bool, shape (nz, ny, nx)
        The object to judge, and the reference.
    spacing : tuple of float
        (hz, hy, hx) in mm.
    """
    count_a, count_b = int(np.count_nonzero(a)), int(np.count_nonzero(b))
    both = int(np.count_nonzero(a & b))
    voxel = math.prod(spacing)
    hausdorff, hd95, mean = _summary(*surface_distances(a, b, spacing))
    return Metrics(
        dice=_ratio(2 * both, count_a + count_b),
        iou=_ratio(both, count_a + count_b - both),
        volume_pred_mm3=count_a * voxel,
        volume_ref_mm3=count_b * voxel,
        volume_difference_mm3=(count_a - count_b) * voxel,
        volume_difference_percent=_ratio(100 * (count_a - count_b), count_b),
        hausdorff_mm=hausdorff,
        hd95_mm=hd95,
        mean_surface_distance_mm=mean,
    )


def dice(a: ArrayLike, b: ArrayLike) -> float:
    """Dice overlap of two label arrays of the same shape; labels > 0 are the object.

    Returns
    -------
    float
        Between 0 and 1; NaN when both are empty.

    Raises
    ------
    InputError
        When the shapes differ.

    Examples
    --------
    >>> dice([1, 1, 0, 0], [0, 1, 1, 0])
    0.5
    """
    first, second = np.asarray(a) > 0, np.asarray(b) > 0
    if first.shape != second.shape:
        raise InputError(
            f"label arrays of shapes {first.shape} and {second.shape} given, equal shapes expected"
        )
    both = int(np.count_nonzero(first & second))
    return _ratio(2 * both, int(np.count_nonzero(first)) + int(np.count_nonzero(second)))


def surface_distances(
    a: Mask, b: Mask, spacing: tuple[float, float, float]
) -> tuple[Floats, Floats]:
    """Distance of each border voxel of one object to the nearest border voxel of the other.

    Parameters
    ----------
    a, b : ndarray of bool, shape (nz, ny, nx)
        The objects.
    spacing : tuple of float
        (hz, hy, hx) in mm.

    Returns
    -------
    from_a, from_b : ndarray, shape (n,), float64
        In mm, one per border voxel in scan order; both empty when either object is.
    """
    points_a, points_b = border_points(a, spacing), border_points(b, spacing)
    if not len(points_a) or not len(points_b):
        return np.empty(0), np.empty(0)
    return _nearest(points_a, points_b), _nearest(points_b, points_a)


def border_points(mask: Mask, spacing: tuple[float, float, float]) -> Floats:
    """Centres of an object's border voxels: its voxels with a face neighbour outside it.

    Parameters
    ----------
    mask : ndarray of bool, shape (nz, ny, nx)
        The object.
    spacing : tuple of float
        (hz, hy, hx) in mm.

    Returns
    -------
    ndarray, shape (n, 3), float64
        (z, y, x) in mm from the centre of voxel (0, 0, 0), scan order.

    Examples
    --------
    >>> import numpy as np
    >>> len(border_points(np.ones((3, 3, 3), dtype=bool), (1.0, 1.0, 1.0)))  # all but the middle
    26
    >>> len(border_points(np.ones((1, 3, 3), dtype=bool), (1.0, 1.0, 1.0)))  # a 2D image: the outline
    8
    """
    bounds = bounding_box(mask)
    if bounds is None:
        return np.empty((0, 3))
    # Work on the bounding box only. Beyond it there is no object, so the box's faces are border in any case.
    box, along = mask[bounds], [n > 1 for n in mask.shape]
    faces = ndimage.generate_binary_structure(sum(along), 1).reshape([3 if n else 1 for n in along])
    inner = ndimage.binary_erosion(box, faces)
    return (np.argwhere(box & ~inner) + np.array(corner_of(bounds))) * np.asarray(
        spacing, dtype=np.float64
    )


def _nearest(points: Floats, targets: Floats) -> Floats:
    # A plain, unbalanced tree builds three times faster on lattice points and answers as fast.
    tree = cKDTree(targets, balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(points)[0], dtype=np.float64)


def _summary(from_a: Floats, from_b: Floats) -> tuple[float, float, float]:
    """Hausdorff, HD95 and mean of the two directed sets of distances; NaN without any."""
    if not len(from_a):
        return math.nan, math.nan, math.nan
    hausdorff = max(float(from_a.max()), float(from_b.max()))
    hd95 = max(float(np.percentile(from_a, 95)), float(np.percentile(from_b, 95)))
    return hausdorff, hd95, float((from_a.sum() + from_b.sum()) / (len(from_a) + len(from_b)))


def _object(volume: Volume) -> Mask:
    array = volume.array
    if array.dtype.kind == "f" and np.isnan(array).any():
        name = f"{volume.source}: " if volume.source else ""
        raise InputError(
            f"{name}{int(np.isnan(array).sum())} labels are NaN, whole numbers expected",
            "make them 0",
        )
    return np.ascontiguousarray(array > 0)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else math.nan


def surface_dice(a: Mask, b: Mask, spacing: Spacing, tolerances: Sequence[float]) -> list[float]:
    """Part of the two surfaces that lies within a tolerance of the other one, for each tolerance.

    Parameters
    ----------
    a, b : ndarray of bool, shape (nz, ny, nx)
        The objects.
    spacing : tuple of float
        (hz, hy, hx) in mm.
    tolerances : sequence of float
        In mm, at least 0.

    Returns
    -------
    list of float
        Between 0 and 1; 0 when one of the objects is empty, NaN when both are.

    Examples
    --------
    >>> a, b = np.zeros((2, 12, 12, 12), bool)
    >>> a[2:8, 2:8, 2:8] = b[3:9, 2:8, 2:8] = True
    >>> surface_dice(a, b, (1.5, 1.0, 1.0), [1.5, 2.0])
    [1.0, 1.0]
    """
    (points_a, areas_a), (points_b, areas_b) = (
        surface_elements(a, spacing),
        surface_elements(b, spacing),
    )
    total = float(areas_a.sum() + areas_b.sum())
    if not total:
        return [math.nan] * len(tolerances)
    if not len(points_a) or not len(points_b):
        return [0.0] * len(tolerances)
    from_a, from_b = _nearest(points_a, points_b), _nearest(points_b, points_a)
    # A distance equal to the tolerance counts, also where its rounding differs by the place in the volume.
    near = [tolerance * (1 + 1e-9) + 1e-9 for tolerance in tolerances]
    return [
        float(areas_a[from_a <= most].sum() + areas_b[from_b <= most].sum()) / total
        for most in near
    ]


def surface_elements(mask: Mask, spacing: Spacing) -> tuple[Floats, Floats]:
    """Middle and size of each surface element of an object.

    Parameters
    ----------
    mask : ndarray of bool, shape (nz, ny, nx)
        The object.
    spacing : tuple of float
        (hz, hy, hx) in mm.

    Returns
    -------
    points : ndarray, shape (n, 3), float64
        (z, y, x) in mm from the centre of voxel (0, 0, 0), scan order.
    sizes : ndarray, shape (n,), float64
        In mm2; in mm where one axis of the volume has a single voxel, and 1 where two have.

    Examples
    --------
    >>> points, sizes = surface_elements(np.ones((1, 1, 1), bool), (1.0, 1.0, 1.0))
    >>> len(points), len(sizes)
    (0, 0)
    """
    bounds = bounding_box(mask)
    along = tuple(axis for axis in range(3) if mask.shape[axis] > 1)
    if bounds is None or not along:
        return np.empty((0, 3)), np.empty(0)
    box = np.pad(mask[bounds], [(1, 1) if axis in along else (0, 0) for axis in range(3)]).view(
        np.uint8
    )
    code: NDArray[Any] = box
    for bit, axis in enumerate(along):
        n = code.shape[axis]
        low, high = (code.take(range(first, n - 1 + first), axis) for first in (0, 1))
        code = low | (high << (1 << bit))
    sizes = _sizes(tuple(spacing[axis] for axis in along))
    cut = np.argwhere((code > 0) & (code < len(sizes) - 1))
    shift = [corner_of(bounds)[axis] - (0.5 if axis in along else 0.0) for axis in range(3)]
    return (cut + np.array(shift)) * np.asarray(spacing, dtype=np.float64), sizes[
        code[tuple(cut.T)]
    ]


@lru_cache(maxsize=16)
def _sizes(spacing: tuple[float, ...]) -> Floats:
    """Size of the surface element of each neighbourhood.

    A neighbourhood along d axes is a number of 2^d bits: bit i + 2 j (+ 4 k) is the voxel i further along the first of
    the axes, j along the second, k along the third.
    """
    corners = 2 ** len(spacing)
    sizes = np.zeros(2**corners)
    for code in range(1, len(sizes) - 1):
        fewer = code if code.bit_count() <= corners // 2 else len(sizes) - 1 - code
        values = np.array([fewer >> bit & 1 for bit in range(corners)], np.float32)
        sizes[code] = _MEASURES[len(spacing)](values.reshape((2,) * len(spacing)).T, spacing)
    sizes.setflags(write=False)
    return sizes


def _area(values: NDArray[np.float32], spacing: tuple[float, ...]) -> float:
    """Return the area of the triangles in a neighbourhood of 2 x 2 x 2."""
    from skimage.measure import marching_cubes, mesh_surface_area

    vertices, faces, _, _ = marching_cubes(values, 0.5, spacing=spacing, method="lorensen")
    return float(mesh_surface_area(vertices, faces))


def _length(values: NDArray[np.float32], spacing: tuple[float, ...]) -> float:
    """Return the length of the lines in a neighbourhood of 2 x 2, which join the middles of the edges that are cut."""
    if (
        values[0, 0] == values[1, 1] and values[0, 1] == values[1, 0]
    ):  # two corners across are cut off
        return math.hypot(*spacing)
    if values[0, 0] == values[0, 1] and values[1, 0] == values[1, 1]:
        return spacing[1]
    if values[0, 0] == values[1, 0] and values[0, 1] == values[1, 1]:
        return spacing[0]
    return math.hypot(*spacing) / 2


_MEASURES = {3: _area, 2: _length, 1: lambda values, spacing: 1.0}
