"""Preprocessing: from volumes as read, through filters, to the input of a run, in pure stages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.energies import mask_distance
from accelsurf.errors import AccelsurfError, GeometryError, InputError, UsageError
from accelsurf.grid.arrays import Mask
from accelsurf.grid.boxes import Box, Corner, corner_of
from accelsurf.grid.clicks import Click, Clicks
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.window import Window
from accelsurf.image.check import MIN_RANGE
from accelsurf.image.filters import ImageFilters
from accelsurf.image.volume import Volume, check_images
from accelsurf.io import LazyVolume
from accelsurf.run.clicks import placed
from accelsurf.run.image_context import ImageContext, ModelInputs, Scale
from accelsurf.run.region_of_interest import cropped, distance_of_mask
from accelsurf.run.window_input import WindowInput, region_in, whole_of, window_of
from accelsurf.settings import budgets
from accelsurf.settings.run_config import RunConfig
from accelsurf.settings.toml import bounds_of, volume_mm3
from accelsurf.settings.wording import shown
from accelsurf.starts import psi_of_mask
from accelsurf.text.clicks import clicks_of
from accelsurf.text.starts import CLICKS, psi_of_starts, read_starts

#: Percentiles of the image that become 0 and 1, so that settings do not depend on its units or outliers.
SCALE_PERCENTILES = (0.5, 99.5)
#: Values farther beyond those percentiles than this multiple of their range are no measurements: squares overflow.
_MAX_RANGES = 1e15
#: A volume, its first channel filtered, and the part of the whole grid that it is.
Seen = tuple[Volume, NDArray[np.float32], Window]


@dataclass(frozen=True, eq=False)
class PreprocessedInput:
    """Image and mask of a run, the same for all objects, on the grid of the region of interest.

    Attributes
    ----------
    volumes : tuple of Volume
        The channels as they were read, whole.
    box : tuple of slice
        Voxels of the region of interest.
    geometry : Geometry
        Of the region of interest.
    images : tuple of ndarray (nz, ny, nx), float32
        The channels there as energies see them: filtered, 0 and 1 at their percentiles.
    context : ImageContext
        Further data of the image for energies.
    mask_distance : ndarray (nz, ny, nx), float32, or None
        Signed distance of the mask, mm, negative within; None without a mask.
    clicks : Clicks or None
        Clicks before the run, on the region of interest; None without clicks.
    filters : ImageFilters
        Filters of the image.
    filtered : ndarray or None
        The first channel, filtered, on the whole grid; only where that is larger than the region of interest.
    start : ndarray or None
        psi of the start on the whole grid, for an image of one slice; for volumes it would cost memory.
    learns : bool
        Whether a model of the energy is learned once, from given voxels or from the start.
    other_labels : ndarray (nz, ny, nx) or None
        Labels of a label map that is mended which its objects leave as they are, and do not enter; None without one.
    """

    volumes: tuple[Volume, ...]
    box: Box
    geometry: Geometry
    images: tuple[NDArray[np.float32], ...]
    context: ImageContext
    mask_distance: NDArray[np.float32] | None
    clicks: Clicks | None
    filters: ImageFilters
    filtered: NDArray[np.float32] | None
    start: NDArray[np.float32] | None
    learns: bool
    other_labels: NDArray[np.integer[Any]] | None = None

    @property
    def first(self) -> tuple[int, int, int]:
        """Index (z, y, x) in the image of the first voxel of the region of interest."""
        return corner_of(self.box)

    def open_on(self, box: Box) -> Mask | None:
        """Voxels of a box of the region of interest where objects may be; None for all of them."""
        if self.mask_distance is not None:
            return np.asarray(self.mask_distance[box] <= 0)
        return None if self.other_labels is None else np.asarray(self.other_labels[box] == 0)

    def distance_on(self, box: Box) -> NDArray[np.float32] | None:
        """Signed distance, mm, to the border of `open_on` on a box, negative within; None where all is open."""
        if self.mask_distance is not None:
            return self.mask_distance[box]
        is_open = self.open_on(box)
        return (
            None
            if is_open is None or is_open.all()
            else mask_distance(is_open, self.geometry.spacing)
        )

    def corner_on_image(self, corner: Corner) -> Corner:
        """Index in the image of a voxel of the region of interest."""
        (z, y, x), (k, j, i) = corner, self.first
        return z + k, y + j, x + i

    def learned_by(self, context: ImageContext) -> tuple[float, float] | None:
        """Values of the first channel between which an object's should lie; None where no model is learned once."""
        return context.learned(0) if self.learns and context.foreground is not None else None

    def on_whole_grid(self, psi: NDArray[np.float32]) -> NDArray[np.float32]:
        """Psi of the last surface on the whole grid: cut at the mask, and half a voxel beyond the region's voxels."""
        if self.mask_distance is not None:
            psi = np.maximum(psi, self.mask_distance)
        whole = self.volumes[0].geometry
        if self.geometry.shape == whole.shape:
            return psi
        out = np.full(whole.shape, np.abs(psi).max(), np.float32)
        around = tuple(
            slice(max(s.start - 1, 0), min(s.stop + 1, n))
            for s, n in zip(self.box, whole.shape, strict=True)
        )
        before = [
            (s.start - a.start, a.stop - s.stop) for s, a in zip(self.box, around, strict=True)
        ]
        out[around] = np.abs(np.pad(psi, before, mode="edge"))
        out[self.box] = psi
        return out

    def picture(self) -> NDArray[np.float32]:
        """The first channel as energies see it on the whole grid, for pictures."""
        if self.filtered is None:
            return self.images[0]
        return apply_filters(self.filtered.copy(), self.context.scales[0])


def preprocess(
    volumes: Sequence[Volume],
    config: RunConfig,
    given: Mapping[str, NDArray[np.float32]] | None = None,
    clicks: Sequence[Click] = (),
    has_ids: bool = False,
    part: WindowInput | None = None,
) -> tuple[PreprocessedInput, NDArray[np.float32]]:
    """Prepare the image, the first surface and the mask of a run.

    Parameters
    ----------
    volumes : sequence of Volume
        The channels, on one grid.
    config : RunConfig
    given : mapping of str to ndarray (nz, ny, nx), optional
        psi on the whole grid in place of the texts of ``start``, ``mask``, ``foreground`` and ``background``.
    clicks : sequence of Click, optional
        On the whole grid, besides those that ``config`` names.
    has_ids : bool, optional
        Whether there are several objects: --outside then is in none of them.
    part : WindowInput, optional
        The volumes are windows on larger ones.

    Returns
    -------
    prepared : PreprocessedInput
    psi : ndarray (nz, ny, nx), float32
        The first surface on the grid of the region of interest; the caller may overwrite it.

    Raises
    ------
    UsageError, InputError
        As of `accelsurf.segment`.
    """
    first = volumes[0]
    whole = volumes[0].geometry
    given = given or {}
    window, box = window_of(whole, part), region_in(config, whole, part)
    geometry, filters = cropped(whole, box), filters_of(config, window.geometry)
    filtered = _first_channel(volumes, filters, part)
    distance = distance_of_mask(config, given, window, box)
    seen = first, filtered, window
    read = clicks_of(config, first, filtered, has_ids=has_ids, window=window)
    all_clicks = placed([*read, *clicks], first, box, distance)
    start = given["start"] if "start" in given else _first_surface(config, seen, all_clicks, box)
    training = {
        name: _crop(mask, box) for name, mask in _training_voxels(config, given, seen).items()
    }
    psi = _start_within(_crop(start, box), distance, config, _name_of_start(config, given))
    around = None if geometry.shape == whole.shape else filtered  # the result shows it
    values = _crop(filtered, box) if around is None else filtered[box].copy()
    del filtered, start
    images, scales = _scaled_channels(values, volumes, filters, box, part)
    del values
    context, learns = _context(config, volumes, images, scales, psi, training, distance, part)
    if all_clicks.clicks and not has_ids and config.start == (CLICKS,) and config.energy.uses_model:
        context = context.with_clicks(all_clicks)
        psi = _start_within(context.model_start(), distance, config, "of the clicks' model")
    shown = psi.copy() if whole.slice_axis is not None else None
    prepared = PreprocessedInput(
        tuple(volumes),
        box,
        geometry,
        tuple(images),
        context,
        distance,
        all_clicks if all_clicks.clicks else None,
        filters,
        around,
        shown,
        learns,
    )
    return prepared, psi


def _first_channel(
    volumes: Sequence[Volume], filters: ImageFilters, part: WindowInput | None
) -> NDArray[np.float32]:
    """The first channel, filtered; of whole images after all channels were checked."""
    if part is not None:
        return part.filtered[0]
    check_images(volumes)
    check_grids(volumes)
    return filtered_volume(volumes[0], filters)


def _context(
    config: RunConfig,
    volumes: Sequence[Volume],
    images: list[NDArray[np.float32]],
    scales: list[Scale],
    psi: NDArray[np.float32],
    training: dict[str, Mask],
    distance: NDArray[np.float32] | None,
    part: WindowInput | None,
) -> tuple[ImageContext, bool]:
    """Return the context of the energies, and True if a model of the energy is learned once."""
    foreground, background = training.get("foreground"), training.get("background")
    from_start = (
        foreground is None and config.energy.learns
    )  # fixed models learn from the start where nothing else is given
    learned_from = psi < 0 if from_start else foreground
    context = ImageContext(
        images,
        scales,
        volumes[0].geometry.spacing,
        learned_from,
        background,
        is_start=from_start,
        whole=whole_of(part),
    )
    size = None if config.size is None else volume_mm3(config.size)
    limits = None if distance is None else np.asarray(distance < 0)
    partition = None
    if config.energy.parts_space:
        from accelsurf.clicks import BasinsOnce

        partition = BasinsOnce()
    window = None if part is None else part.open_window
    box_mm3 = None
    if (
        limits is not None and config.box is not None and config.objects is None
    ):  # of several objects it holds all
        box_mm3 = float(np.count_nonzero(limits)) * volumes[0].geometry.voxel_volume
    inputs = ModelInputs(size, limits, partition, window, config.answer, box_mm3=box_mm3)
    context = context.with_model_inputs(inputs)
    # Likelihood learns from --foreground once; with update=yes it refuses it.
    return context, config.energy.learns or any(term.name == "likelihood" for term in config.terms)


def _first_surface(config: RunConfig, seen: Seen, clicks: Clicks, box: Box) -> NDArray[np.float32]:
    """Psi of the start on the whole grid; ``clicks`` are on the region of interest, ``box``."""
    volume = seen[0]
    others = [text for text in config.start if text != CLICKS]
    if len(others) == len(config.start) or not clicks.ids():
        return psi_of_starts(read_starts(config.start), *seen)
    inside = np.zeros(volume.geometry.shape, np.bool_)
    inside[box] = clicks.mask("inside")
    psi = psi_of_mask(inside, volume.geometry)
    return np.minimum(psi, psi_of_starts(read_starts(others), *seen)) if others else psi


def _scaled_channels(
    values: NDArray[np.float32],
    volumes: Sequence[Volume],
    filters: ImageFilters,
    box: Box,
    part: WindowInput | None,
) -> tuple[list[NDArray[np.float32]], list[Scale]]:
    """The channels on the region, 0 and 1 at their percentiles; overwrites ``values``, the first one, filtered."""
    whole = whole_of(part)
    scales: list[Scale] = []
    images: list[NDArray[np.float32]] = []
    for place, channel in enumerate(volumes):
        if place > 0:
            values = _crop(
                filtered_volume(channel, filters) if part is None else part.filtered[place], box
            )
        scales.append(whole[place].scale if whole else scale_of(values))
        images.append(apply_filters(values, scales[-1]))
    return images, scales


def check_grids(channels: Sequence[Volume | LazyVolume]) -> None:
    """Refuse channels that lie on different grids.

    Raises
    ------
    GeometryError
    """
    for channel in channels[1:]:
        if not channel.geometry.matches(channels[0].geometry):
            raise GeometryError(
                f"channel {channel.source or ''}: on another grid than the image: "
                f"{channel.geometry.difference(channels[0].geometry)}",
                "resample it to the image's grid first",
            )


def _name_of_start(config: RunConfig, given: Mapping[str, NDArray[np.float32]]) -> str:
    """Return the name of the start in messages."""
    if config.objects is not None:
        return config.objects
    return "array" if "start" in given else " + ".join(config.start)


def _start_within(
    psi: NDArray[np.float32], distance: NDArray[np.float32] | None, config: RunConfig, start: str
) -> NDArray[np.float32]:
    """The start within region and mask, of which a part must remain."""
    where = "the region of interest"
    if distance is not None:
        psi = np.maximum(psi, distance)
        where = "the mask" if config.roi is None else "the mask and the region of interest"
    inside = psi < 0
    if not inside.any():
        raise InputError(f"start {shown(start)}: lies outside of {where}", "start within it")
    if inside.all():
        raise InputError(
            f"start {shown(start)}: covers all of {where}", "leave some background outside"
        )
    return np.ascontiguousarray(psi)


def _training_voxels(
    config: RunConfig, given: Mapping[str, NDArray[np.float32]], seen: Seen
) -> dict[str, Mask]:
    """Return foreground and background, as far as they are given as arrays or written; an error names the option."""
    found = {}
    for name in ("foreground", "background"):
        if name in given:
            found[name] = np.asarray(given[name] < 0)
        elif texts := getattr(config, name):
            try:
                found[name] = np.asarray(psi_of_starts(read_starts(texts), *seen) < 0)
            except AccelsurfError as error:
                raise type(error)(
                    error.message.replace("start ", f"{name} ", 1), error.hint
                ) from None
    return found


def _crop(array: NDArray[Any], box: Box) -> NDArray[Any]:
    return np.ascontiguousarray(array[box])


def scale_of(image: NDArray[np.float32]) -> Scale:
    """Return the scale that maps `SCALE_PERCENTILES` to 0 and 1; of the extremes where those two are equal.

    Raises
    ------
    InputError
        When the image is constant.
    """
    return scale_between(
        np.percentile(image, SCALE_PERCENTILES), np.array([image.min(), image.max()])
    )


def scale_between(percentiles: NDArray[Any], extremes: NDArray[np.float32]) -> Scale:
    """The same of the percentiles (2,) and extremes (2,) of an image."""
    low, high = percentiles
    if not high > low:
        low, high = extremes
    if not high > low:
        raise InputError(
            f"the image is constant here: every voxel is {low:g}",
            "take a larger region of interest",
        )
    width = float(high) - float(low)
    far = max(float(extremes[1]) - float(high), float(low) - float(extremes[0]))
    if width < MIN_RANGE or far > _MAX_RANGES * width:
        raise InputError(
            f"nearly all values lie from {low:g} to {high:g}, some {far:g} beyond, at most {_MAX_RANGES:g} times "
            "their range expected",
            "values far beyond the others often mean that there is no value: replace them by that of the background",
        )
    return Scale(float(low), float(high) - float(low))


def apply_filters(image: NDArray[np.float32], scale: Scale) -> NDArray[np.float32]:
    """Put the image on a scale, in place to save memory."""
    image -= np.float32(scale.low)
    image *= np.float32(1.0 / scale.width)
    return image


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


def filters_of(config: RunConfig, geometry: Geometry) -> ImageFilters:
    """Return the filters of a run's image: ``clip``, ``closing`` and ``presmooth``.

    Raises
    ------
    UsageError
        When one of them would take too long.
    """
    filters = ImageFilters(
        bounds_of(config.clip), in_mm(config.closing, geometry), in_mm(config.presmooth, geometry)
    )
    check_filters(filters, geometry)
    return filters


def check_filters(filters: ImageFilters, geometry: Geometry) -> None:
    """Refuse a Gaussian or a closing that takes too long."""
    smallest = min(geometry.steps)
    budgets.SMOOTHING.check(
        math.ceil(filters.sigma / smallest),
        f"presmooth: a sigma of {filters.sigma:g} mm",
        kind=UsageError,
    )
    budgets.CLOSING.check(
        math.floor(filters.closing / smallest),
        f"closing: a radius of {filters.closing:g} mm",
        kind=UsageError,
    )


def filtered_volume(volume: Volume, filters: ImageFilters) -> NDArray[np.float32]:
    """The image as float32, filtered."""
    return filters.of_whole(volume.as_float32(), volume.geometry.spacing)
