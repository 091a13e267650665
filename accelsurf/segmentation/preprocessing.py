"""What a run begins with: the image as energies see it, the first surface, the fence and the region of interest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf import io
from accelsurf.energies import Energy
from accelsurf.energies.constraints.mask import MaskConstraint, mask_distance
from accelsurf.errors import AccelsurfError, GeometryError, InputError, UsageError
from accelsurf.grid import pyramid
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.smoothing import gaussian_mm
from accelsurf.grid.volume import Volume, check_image
from accelsurf.initialization import starts
from accelsurf.segmentation.energy_assembly import ImageContext, Mask, Scale
from accelsurf.settings import energy_expression
from accelsurf.settings.run_config import RunConfig

#: Percentiles of the image that become 0 and 1, so that settings do not depend on its units or outliers.
SCALE_PERCENTILES = (0.5, 99.5)


class PreprocessedInput:
    """Everything that a run begins with, on the grid of its region of interest.

    Parameters
    ----------
    volume : Volume
        The first channel, whole.
    others : sequence of Volume
        The other channels, on the same grid.
    config : RunConfig
    start : ndarray (nz, ny, nx), optional
        psi of the first surfaces on the whole grid, in place of the start of ``config``.

    Attributes
    ----------
    box : tuple of slice
        Voxels of the region of interest.
    geometry : Geometry
        Of the region of interest.
    image : ndarray (nz, ny, nx), float32
        The first channel there, as energies see it.
    psi : ndarray (nz, ny, nx), float32
        The first surface there; whoever uses up its memory takes it away.
    facts : Facts
        For the energies.
    presmooth : float
        Sigma that the image was smoothed by, mm.

    Raises
    ------
    UsageError, InputError
        As `accelsurf.segment` says.
    """

    def __init__(
        self,
        volume: Volume,
        others: Sequence[Volume],
        config: RunConfig,
        start: NDArray[np.float32] | None = None,
    ) -> None:
        for one in (volume, *others):
            check_image(one)
            if not one.geometry.matches(volume.geometry):
                raise GeometryError(
                    f"channel {one.source or ''}: on another grid than the image: "
                    f"{one.geometry.difference(volume.geometry)}",
                    "resample it to the image's grid first",
                )
        self._files = [volume, *others]
        self._whole, self.box = volume.geometry, region_of_interest(config.roi, volume.geometry)
        self.geometry = cropped(volume.geometry, self.box)
        self.presmooth = in_mm(config.presmooth, volume.geometry)
        smoothed = presmoothed(volume, self.presmooth)
        psi = starts.build(config.start, volume, smoothed) if start is None else start
        foreground, background = (
            _cut(_learned_from(name, texts, volume, smoothed), self.box) if texts else None
            for name, texts in (("foreground", config.foreground), ("background", config.background))
        )
        mask = read_mask(config.mask, volume.geometry) if config.mask is not None else None
        self._fences = None if mask is None else [mask_distance(_cut(mask, self.box), self.geometry.spacing)]
        self.psi = self._started(_cut(psi, self.box), config)
        #: psi of the start on the whole grid, for an image of one slice; for volumes it would cost memory.
        self.start = psi.copy() if volume.geometry.slice_axis is not None else None
        # What lies around a region of interest is shown at the end.
        self._smoothed = smoothed if config.roi is not None else None
        values = _cut(smoothed, self.box) if config.roi is None else smoothed[self.box].copy()
        scales = [scale_of(values)]
        self.image = apply(values, scales[0])
        del smoothed, psi, values
        images = [self.image]
        for one in others:
            values = _cut(presmoothed(one, self.presmooth), self.box)
            scales.append(scale_of(values))
            images.append(apply(values, scales[-1]))
        self._grids = pyramid.levels(self.geometry.shape, self.geometry.spacing)
        self._others: list[list[NDArray[np.float32]]] = [images[1:]]
        # Fixed models learn from the start where nothing else is given.
        self._terms = terms = energy_expression.parse(config.energy)
        self._learns = any(energy_expression.learns(term) for term in terms)
        learns_from_start = foreground is None and self._learns
        if learns_from_start:
            foreground = self.psi < 0
        self.context = ImageContext(
            images, scales, self.geometry.spacing, foreground, background, self._others_on, self._raw,
            is_start=learns_from_start,
        )

    def _raw(self, channel: int, box: Box, mask: Mask) -> NDArray[Any]:
        """Values of a channel before presmoothing, on the scale that energies see, where a box's mask is set."""
        low, width = self.context.scales[channel]
        values = self._files[channel].array[self.box][box][mask].astype(np.float32)
        return np.asarray((values - np.float32(low)) / np.float32(width))

    @property
    def learned(self) -> tuple[float, float] | None:
        """Values of the first channel between which the object's should lie; None where no model is learned once."""
        return self.learned_by(self.context)

    def learned_by(self, context: ImageContext) -> tuple[float, float] | None:
        """The same for one of several objects."""
        # What is given with --foreground is learned from by likelihood unless it updates, and then it is refused.
        names = {term.name for term in self._terms}
        learns = self._learns or "likelihood" in names
        return context.learned(0) if learns and context.foreground is not None else None

    def _started(self, psi: NDArray[np.float32], config: RunConfig) -> NDArray[np.float32]:
        """The start within region and fence, which must leave something of it."""
        where, what = "the region of interest", config.objects or " + ".join(config.start)
        if self._fences is not None:
            psi = np.maximum(psi, self._fences[0])
            where = "the mask" if config.roi is None else "the mask and the region of interest"
        inside = psi < 0
        if not inside.any():
            raise InputError(f"start {what}: nothing of it lies in {where}", "start within it")
        if inside.all():
            raise InputError(
                f"start {what}: it takes in all of {where}", "leave some background outside"
            )
        return np.ascontiguousarray(psi)

    def _level_of(self, shape: tuple[int, ...]) -> int:
        return next(i for i, grid in enumerate(self._grids) if grid.shape == tuple(shape))

    def _others_on(self, shape: tuple[int, ...], spacing: tuple[float, float, float]) -> list[NDArray[np.float32]]:
        """The other channels on the grid of a level."""
        level = self._level_of(shape)
        while len(self._others) <= level:
            fine, coarse = self._grids[len(self._others) - 1], self._grids[len(self._others)]
            self._others.append([pyramid.restrict(image, fine, coarse) for image in self._others[-1]])
        return self._others[level]

    def fenced(self, energy: Energy, shape: tuple[int, ...]) -> Energy:
        """An energy on the grid of a level with the fence around it, if there is one."""
        return energy if self._fences is None else MaskConstraint(energy, self._fence_on(shape))

    def _fence_on(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        assert self._fences is not None
        level = self._level_of(shape)
        while len(self._fences) <= level:
            fine, coarse = self._grids[len(self._fences) - 1], self._grids[len(self._fences)]
            self._fences.append(pyramid.restrict(self._fences[-1], fine, coarse))
        return self._fences[level]

    @property
    def first(self) -> tuple[int, int, int]:
        """Index (z, y, x) in the image of the first voxel of the region of interest."""
        z, y, x = self.box
        return z.start, y.start, x.start

    def project(self, psi: NDArray[np.float32]) -> None:
        """Cut psi (in place) on the grid of a level off at the fence, if there is one."""
        if self._fences is not None:
            np.maximum(psi, self._fence_on(psi.shape), out=psi)

    def fence(self, box: Box) -> NDArray[np.float32] | None:
        """The fence on a box of the region of interest; None where there is none."""
        return None if self._fences is None else self._fences[0][box]

    def finished(self, psi: NDArray[np.float32]) -> NDArray[np.float32]:
        """Psi of the last surface on the whole grid: cut at the fence, and half a voxel beyond the region's voxels."""
        if self._fences is not None:
            psi = np.maximum(psi, self._fences[0])
        if self.geometry.shape == self._whole.shape:
            return psi
        out = np.full(self._whole.shape, np.abs(psi).max(), np.float32)
        around = tuple(
            slice(max(s.start - 1, 0), min(s.stop + 1, n)) for s, n in zip(self.box, self._whole.shape, strict=True)
        )
        before = [(s.start - a.start, a.stop - s.stop) for s, a in zip(self.box, around, strict=True)]
        out[around] = np.abs(np.pad(psi, before, mode="edge"))
        out[self.box] = psi
        return out

    def shown(self) -> NDArray[np.float32]:
        """The first channel as energies see it on the whole grid, for pictures."""
        if self._smoothed is None:
            return self.image
        return apply(self._smoothed.copy(), self.context.scales[0])


def region_of_interest(text: str | None, geometry: Geometry) -> Box:
    """Voxels of a box, the whole grid for None; on an oblique grid all between the box's corners along its axes.

    Raises
    ------
    UsageError
        When the text is no box.
    InputError
        When fewer than two voxels along an axis (with more than one) are in it.

    Examples
    --------
    >>> region_of_interest("1,1,0,3,4,9", Geometry((8, 6, 4), (1.0, 1.0, 1.0)))
    (slice(0, 8, None), slice(1, 5, None), slice(1, 4, None))
    """
    if text is None:
        return slice(0, geometry.shape[0]), slice(0, geometry.shape[1]), slice(0, geometry.shape[2])
    try:
        box = starts.parse(f"box:{text}")
    except UsageError:
        raise UsageError(
            f"roi: {text} was given, expected X0,Y0,Z0,X1,Y1,Z1 with the first corner below the second",
            "world mm, or voxel indices with the suffix vox",
        ) from None
    corners = np.array([[box.numbers[3 * (i >> axis & 1) + axis] for axis in range(3)] for i in range(8)])
    index = corners[:, ::-1] if box.vox else np.array([geometry.world_to_index(corner) for corner in corners])
    slices = []
    for axis, n in enumerate(geometry.shape):
        low = max(int(np.ceil(index[:, axis].min() - 1e-6)), 0)
        high = min(int(np.floor(index[:, axis].max() + 1e-6)), n - 1)
        if high - low + 1 < min(n, 2):
            raise InputError(
                f"roi: {text} was given, which holds fewer than two of the image's voxels along {'zyx'[axis]}",
                "accelsurf reads world mm (LPS); the suffix vox takes voxel indices",
            )
        slices.append(slice(low, high + 1))
    return slices[0], slices[1], slices[2]


def cropped(geometry: Geometry, box: Box) -> Geometry:
    """The grid of some of the voxels of another."""
    shape = tuple(s.stop - s.start for s in box)
    if shape == geometry.shape:
        return geometry
    origin = geometry.index_to_world(np.array([float(s.start) for s in box]))
    corner = (float(origin[0]), float(origin[1]), float(origin[2]))
    return Geometry((shape[0], shape[1], shape[2]), geometry.spacing, corner, geometry.direction)


def _learned_from(name: str, texts: Sequence[str], volume: Volume, image: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Voxels that are written as a start; what is wrong with them is told of ``name``, the option."""
    try:
        return np.asarray(starts.build(texts, volume, image) < 0)
    except AccelsurfError as error:
        raise type(error)(error.message.replace("start ", f"{name} ", 1), error.hint) from None


def _cut(array: NDArray[Any], box: Box) -> NDArray[Any]:
    return np.ascontiguousarray(array[box])


def read_mask(file: str, geometry: Geometry) -> NDArray[np.bool_]:
    """Voxels above 0 of a label map on the image's grid.

    Raises
    ------
    InputError
        When there is none, or the file cannot be read; GeometryError when it lies on another grid.
    """
    labels = io.read_labels(file)
    if not labels.geometry.matches(geometry):
        raise GeometryError(
            f"mask {file}: on another grid than the image: {labels.geometry.difference(geometry)}",
            "resample it to the image's grid first",
        )
    mask = np.asarray(labels.array > 0)
    if not mask.any():
        raise InputError(f"mask {file}: it is empty", "give one with voxels above 0, where the surface may be")
    return mask


def in_mm(length: float | str, geometry: Geometry) -> float:
    """A length of `RunConfig` in mm: as it is, or ``Nvox`` in voxels of the smallest spacing.

    Examples
    --------
    >>> in_mm("1.5vox", Geometry((8, 6, 4), (3.0, 2.0, 2.0)))
    3.0
    """
    if not isinstance(length, str):
        return length
    return float(length.removesuffix("vox")) * min(geometry.steps)


def presmoothed(volume: Volume, sigma: float) -> NDArray[np.float32]:
    """The image as float32, smoothed by a Gaussian of ``sigma`` mm (0: as it is)."""
    image = volume.as_float32()
    if sigma > 0:
        image = gaussian_mm(image, volume.geometry.spacing, sigma, border="reflect")
    return image


def scale_of(image: NDArray[np.float32]) -> Scale:
    """What maps an image's `SCALE_PERCENTILES` to 0 and 1; its extremes where those two are equal.

    Raises
    ------
    InputError
        When the image is constant.
    """
    low, high = np.percentile(image, SCALE_PERCENTILES)
    if not high > low:
        low, high = image.min(), image.max()
    if not high > low:
        raise InputError(f"the image is constant here: every voxel is {low:g}", "take a larger region of interest")
    return Scale(float(low), float(high) - float(low))


def apply(image: NDArray[np.float32], scale: Scale) -> NDArray[np.float32]:
    """Put the image on a scale; in place: on a large image each volume counts."""
    image -= np.float32(scale.low)
    image *= np.float32(1.0 / scale.width)
    return image


def scale(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Put the `SCALE_PERCENTILES` of the image at 0 and 1, its extremes where those two are equal; in place.

    Examples
    --------
    >>> import numpy as np
    >>> image = scale(np.arange(-50, 51, dtype=np.float32).reshape(1, 1, 101))
    >>> [float(v) for v in np.percentile(image, SCALE_PERCENTILES).round(6)]
    [0.0, 1.0]
    """
    return apply(image, scale_of(image))
