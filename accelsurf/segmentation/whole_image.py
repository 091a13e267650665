"""What a run in a window needs of the whole image, found without holding it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from accelsurf.energies import Parzen
from accelsurf.energies.image_noise import noise_of, noise_of_samples, sample_places
from accelsurf.energies.likelihood import END_PERCENTILES, least_variance
from accelsurf.energies.region_sums import RegionMoments, Summing, moments_of
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, corner_of, sum_in_order
from accelsurf.grid.image_check import ImageCheck, Places
from accelsurf.grid.image_filters import NO_FILTERS, ImageFilters
from accelsurf.grid.order_statistics import FloatCounts, IntegerCounts, OrderStatistics
from accelsurf.grid.pyramid import Level
from accelsurf.initialization.region_growing import between_means, otsu_level, sums_beside
from accelsurf.io.lazy_volume import LazyVolume
from accelsurf.segmentation.image_context import Scale
from accelsurf.segmentation.image_slabs import SLAB_BYTES, ImageSlabs, Planes
from accelsurf.segmentation.preprocessing import SCALE_PERCENTILES, apply, scale_between

#: Bins of the histogram of Otsu's threshold, as scikit-image has them.
OTSU_BINS = 256
#: Numbers of an image: by the function that finds them and its arguments, and its scale by name.
Numbers = Mapping[tuple[Any, ...], Any]
_SCALE = ("scale",)


class WholeImage:
    """Numbers of a whole image, read slab by slab in a fixed order: the bytes that they have of the image in memory.

    Each is found when it is first asked for, and then known. The scale takes one pass of integers of 8 or 16 bits
    that are not filtered, otherwise two; the noise and the sums of all levels one each, Otsu's level two.

    Parameters
    ----------
    source : LazyVolume
        The whole image.
    filters : ImageFilters, optional
        What it is filtered by.
    statistics_from : LazyVolume, optional
        The same image on a coarser level, which all numbers are then of. It is filtered by the same lengths.
    slab_bytes : int, optional
        Bytes of a slab as float32.
    numbers : mapping, optional
        What another one of the same image has found already.

    Attributes
    ----------
    geometry : Geometry
        Of the whole.
    """

    def __init__(
        self,
        source: LazyVolume,
        filters: ImageFilters = NO_FILTERS,
        statistics_from: LazyVolume | None = None,
        slab_bytes: int = SLAB_BYTES,
        numbers: Numbers | None = None,
    ) -> None:
        self.geometry = source.geometry
        self._whole = ImageSlabs(source, filters, slab_bytes)
        self._coarse = statistics_from
        self._slabs = self._whole if statistics_from is None else ImageSlabs(statistics_from, filters, slab_bytes)
        self._found: dict[tuple[Any, ...], Any] = dict(numbers or {})
        self._sums: dict[tuple[str, int], NDArray[np.float64]] = {}

    @property
    def statistics(self) -> str:
        """What the numbers are of: ``exact``, or the coarser image in words."""
        if self._coarse is None:
            return "exact"
        nz, ny, nx = self._coarse.geometry.shape
        return f"a coarser level of {nx} x {ny} x {nz} voxels"

    def window(self, box: Box) -> Planes:
        """The filtered image on a box, in its own unit: the bytes of that box of the whole, filtered; a new array.

        Raises
        ------
        InputError
            With numbers from a coarser level, when a voxel is not finite; otherwise `scale` looks at all voxels.
        """
        values = self._whole.window(box)
        if self._coarse is not None and not np.isfinite(values).all():
            bad = Places()
            bad.add(~np.isfinite(values), corner_of(box))
            raise InputError(f"{bad} not finite", "replace them first, e.g. by the value of the background")
        return values

    @property
    def numbers(self) -> Numbers:
        """The scale, and what `found` has found so far: for a `WholeImage` in another process."""
        return {_SCALE: self.scale, **self._found}

    @property
    def scale(self) -> Scale:
        """What maps the image's percentiles to 0 and 1, as `accelsurf.segmentation.preprocessing.scale_of` finds it.

        Raises
        ------
        InputError
            When the image cannot be used: voxels that are not finite, all the same, or out of range.
        """
        if _SCALE not in self._found:
            self._found[_SCALE] = scale_between(self._order.percentiles(SCALE_PERCENTILES), self._order.extremes)
        return cast("Scale", self._found[_SCALE])

    def found(self, make: Callable[..., Any], *args: Any) -> Any:
        """What ``make(image, *args)`` is of the scaled image.

        Parameters
        ----------
        make : callable
            `noise_of`, `otsu_level`, `numpy.percentile`, `numpy.ptp`, `Parzen.of_image` or `least_variance`.

        Raises
        ------
        ValueError
            When ``make`` is another one: it would have to hold the image.
        """
        # Methods of classes are made anew each time that they are named: they are compared by what they are equal to.
        ways: list[tuple[Callable[..., Any], Callable[..., Any]]] = [
            (noise_of, self._noise),
            (otsu_level, self._otsu_level),
            (np.percentile, lambda q: self._order.percentiles(q, self._scaled)),
            (np.ptp, lambda: np.ptp(self._extremes)),
            (Parzen.of_image, self._parzen),
            (least_variance, lambda: least_variance(self._extremes)),
        ]
        find = next((way for made, way in ways if made == make), None)
        if find is None:
            raise ValueError(f"{getattr(make, '__name__', make)} of a whole image that is read in parts is not known")
        key = (make, *args)
        if key not in self._found:
            self._found[key] = find(*args)
        return self._found[key]

    def moments(self, grids: Sequence[Level], level: int) -> RegionMoments:
        """Sums over the scaled image on a level of its pyramid, of which ``grids`` are the whole levels."""
        return RegionMoments(*(float(v) for v in self.sums(grids, level, "moments", moments_of)))

    def sums(self, grids: Sequence[Level], level: int, kind: str, summing: Summing) -> NDArray[np.float64]:
        """The same of any sums; ``kind`` is their name.

        With numbers from a coarser image, those of it, for the number of voxels that the level has.
        """
        if (kind, level) not in self._sums:
            if self._coarse is None:
                self._sum_levels(grids, level, kind, summing)
            else:
                slabs = (self._scaled(values) for _, values in self._slabs.filtered())
                one = sum_in_order(summing(plane.ravel()) for values in slabs for plane in values)
                part = np.prod(grids[level].shape, dtype=np.float64) / np.prod(self._coarse.shape, dtype=np.float64)
                self._sums[kind, level] = one * part
        return self._sums[kind, level]

    def _sum_levels(self, grids: Sequence[Level], level: int, kind: str, summing: Summing) -> None:
        """The sums on this level and on all finer ones, which are made on the way: one pass."""
        grids = grids[: level + 1]
        rows: list[list[NDArray[np.float64]]] = [[] for _ in grids]
        for slab in self._slabs.on_levels(grids, self._scaled):
            rows[slab.level] += [summing(plane.ravel()) for plane in slab.values]
        for number, one in enumerate(rows):
            self._sums[kind, number] = sum_in_order(one)

    # -- order statistics ------------------------------------------------------------------------------------

    @cached_property
    def _order(self) -> OrderStatistics:
        """Values of the filtered image by their size, after a look at whether it can be used."""
        check, dtype = ImageCheck(), self._slabs.source.dtype
        if self._slabs.filters.change_nothing and IntegerCounts.can_count(dtype):
            counts: OrderStatistics = IntegerCounts(dtype)
        else:
            counts = FloatCounts(lambda: (values for _, values in self._slabs.filtered()))
        as_it_is = self._slabs.filters.change_nothing and dtype == np.float32
        raw_is_counted = as_it_is or isinstance(counts, IntegerCounts)
        for raw in self._slabs.raw():
            check.add(raw)
            if raw_is_counted:
                counts.add(raw)
        check.refuse()
        if not raw_is_counted:
            for _, values in self._slabs.filtered():
                counts.add(values)
        return counts

    @cached_property
    def _extremes(self) -> NDArray[np.float32]:
        """Smallest and largest value of the scaled image, (2,)."""
        return self._scaled(self._order.extremes)

    def _scaled(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Put values on the scale, in place."""
        return apply(values, self.scale)

    def _parzen(self) -> Parzen:
        return Parzen.between(self._order.percentiles(END_PERCENTILES, self._scaled), self._extremes)

    # -- what takes a pass of its own ------------------------------------------------------------------------

    def _noise(self) -> float:
        places = sample_places(self._slabs.geometry.shape)
        samples = [np.empty(tuple(len(one) for one in at), np.float32) for at in places]
        looked_at = np.unique(np.concatenate([z for z, _, _ in places])) if places else np.empty(0, np.int64)

        def needed(planes: slice) -> bool:
            return bool(((looked_at >= planes.start) & (looked_at < planes.stop)).any())

        for planes, values in self._slabs.filtered(needed):
            for (z, y, x), out in zip(places, samples, strict=True):
                here = np.flatnonzero((z >= planes.start) & (z < planes.stop))
                out[here] = values[np.ix_(z[here] - planes.start, y, x)]
        return noise_of_samples([self._scaled(one) for one in samples])

    def _otsu_level(self) -> float:
        low, high = self._extremes
        first = low
        if low < high:
            counts, edges = self._otsu_counts()
            first = threshold_otsu(hist=(counts, (edges[:-1] + edges[1:]) / 2.0))
        return between_means(
            sum_in_order(
                sums_beside(plane, first) for _, values in self._slabs.filtered() for plane in self._scaled(values)
            )
        )

    def _otsu_counts(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Histogram of the scaled image between its extremes, and the edges of the bins."""
        edges = np.histogram(self._extremes, OTSU_BINS)[1]
        if isinstance(self._order, IntegerCounts):
            # Values that occur, ascending: how many fall into each bin tells the bin of each.
            occurs = self._order.counts > 0
            share = np.histogram(self._scaled(self._order.values[occurs]), OTSU_BINS)[0]
            counts = np.zeros(OTSU_BINS, np.int64)
            np.add.at(counts, np.repeat(np.arange(OTSU_BINS), share), self._order.counts[occurs])
            return counts, edges
        ends: Any = tuple(self._extremes)  # float32, as numpy takes them from an array
        parts = (np.histogram(self._scaled(values), OTSU_BINS, ends)[0] for _, values in self._slabs.filtered())
        return np.sum(list(parts), axis=0, dtype=np.int64), edges
