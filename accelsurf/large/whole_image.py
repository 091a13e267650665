"""Statistics of a whole large image for a run in a window, and the image itself by boxes or slabs, never in memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from accelsurf.energies import END_PERCENTILES, Parzen, Summing, least_variance
from accelsurf.errors import InputError
from accelsurf.grid.boxes import Box, corner_of, sum_in_order, whole_box
from accelsurf.grid.pyramid import Level, planes_of_blocks, restrict
from accelsurf.image.check import ImageCheck, Places
from accelsurf.image.filters import NO_FILTERS, ImageFilters
from accelsurf.image.noise import noise_of, noise_of_samples, sample_places
from accelsurf.image.percentiles import FloatCounts, IntegerCounts, OrderStatistics
from accelsurf.image.volume import naming_channel
from accelsurf.io import LazyVolume
from accelsurf.run import SCALE_PERCENTILES, Scale, apply_filters, check_filters, scale_between
from accelsurf.starts import between_means, otsu_level, sums_beside

#: Bytes of the float32 voxels of a slab.
_SLAB_BYTES = 1 << 27

Planes = NDArray[np.float32]
#: Bins of the histogram of Otsu's threshold, as scikit-image has them.
_OTSU_BINS = 256
#: Numbers of an image: by the function that finds them and its arguments, and its scale by name.
Numbers = Mapping[tuple[Any, ...], Any]
_SCALE = ("scale",)


class LevelSlab(NamedTuple):
    """Planes of a level of the pyramid, from number ``first`` on."""

    level: int
    first: int
    values: Planes


class ImageSlabs:
    """An image that is read in parts and filtered with their surroundings: the bytes of the whole, filtered.

    Parameters
    ----------
    source : LazyVolume
    filters : ImageFilters
    slab_bytes : int
        Bytes of a slab as float32; at least a plane is read. About two and a half times as many are in memory at once,
        also of the halo, which is four standard deviations and two radii of a closing on
        either side.

    Raises
    ------
    UsageError
        When a filter is so wide that it takes too long.
    """

    def __init__(
        self, source: LazyVolume, filters: ImageFilters, slab_bytes: int = _SLAB_BYTES
    ) -> None:
        check_filters(filters, source.geometry)
        self.source = source
        self.filters = filters
        self.geometry = source.geometry
        self.planes = max(1, slab_bytes // (4 * math.prod(self.geometry.shape[1:])))

    def window(self, box: Box) -> Planes:
        """The filtered image on a box, a new array."""
        return self.filters.on_box(
            self.source.read, self.geometry.shape, self.geometry.spacing, box
        )

    def raw(self) -> Iterator[NDArray[Any]]:
        """Slabs of the image as it is, of its own dtype."""
        for planes in self._slices(self.geometry.shape[0], self.planes):
            yield self.source.read(self._box(planes))

    def filtered(
        self, needed: Callable[[slice], bool] = lambda planes: True
    ) -> Iterator[tuple[slice, Planes]]:
        """The planes of a slab and its filtered values, of those slabs that are ``needed``."""
        for planes in self._slices(self.geometry.shape[0], self.planes):
            if needed(planes):
                yield planes, self.window(self._box(planes))

    def on_levels(
        self, grids: Sequence[Level], mapped: Callable[[Planes], Planes] = lambda values: values
    ) -> Iterator[LevelSlab]:
        """All planes of all levels, each once, and in order on a level; the image is read about once.

        Parameters
        ----------
        grids : sequence of Level
            Finest first; the image is on the first.
        mapped : callable
            Applied to the filtered values of level 0; may overwrite them.
        """
        top = grids[-1]
        done = [0] * len(grids)
        for planes in self._slices(top.shape[0], max(1, self.planes // top.factors[0])):
            for level, first, values in self._with_finer(grids, planes, mapped):
                # Blocks share planes with the next ones: planes of an earlier block are left out.
                stop = self._own_stop(grids, planes, level)
                yield LevelSlab(level, done[level], values[done[level] - first : stop - first])
                done[level] = stop

    def _with_finer(
        self, grids: Sequence[Level], planes: slice, mapped: Callable[[Planes], Planes]
    ) -> list[LevelSlab]:
        """Planes of the last of ``grids``, and all planes that they are made of on the finer ones."""
        number = len(grids) - 1
        if number == 0:
            return [LevelSlab(0, planes.start, mapped(self.window(self._box(planes))))]
        fine, coarse = grids[number - 1], grids[number]
        finer = self._with_finer(grids[:-1], planes_of_blocks(planes, fine, coarse), mapped)
        source = fine.on_box((finer[-1].first, 0, 0), finer[-1].values.shape)
        target = coarse.on_box(
            (planes.start, 0, 0), (planes.stop - planes.start, *coarse.shape[1:])
        )
        return [*finer, LevelSlab(number, planes.start, restrict(finer[-1].values, source, target))]

    def _own_stop(self, grids: Sequence[Level], planes: slice, level: int) -> int:
        """The plane of a level from which on the next slab counts; ``planes`` are of the coarsest."""
        stop = planes.stop
        for number in range(len(grids) - 1, level, -1):
            if stop == grids[number].shape[0]:
                return grids[level].shape[0]
            stop = planes_of_blocks(slice(stop, stop + 1), grids[number - 1], grids[number]).start
        return stop

    def _box(self, planes: slice) -> Box:
        _, y, x = whole_box(self.geometry.shape)
        return planes, y, x

    @staticmethod
    def _slices(count: int, planes: int) -> Iterator[slice]:
        for start in range(0, count, planes):
            yield slice(start, min(start + planes, count))


class WholeImage:
    """Numbers of a whole image, read slab by slab in a fixed order: the bytes that they have of the image in memory.

    Each is found when it is first asked for, and then known. The scale takes one pass of integers of 8 or 16 bits
    that are not filtered, otherwise two; the noise and the sums of all levels one each, Otsu's level two.

    Parameters
    ----------
    source : LazyVolume
        The whole image.
    filters : ImageFilters, optional
        The filters of the image.
    statistics_from : LazyVolume, optional
        The same image on a coarser level, which all numbers are then of. It is filtered by the same lengths.
    slab_bytes : int, optional
        Bytes of a slab as float32.
    numbers : mapping, optional
        Numbers that another one of the same image has found already.
    channel, channels : int, optional
        Which of several channels it is, for errors.

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
        slab_bytes: int = _SLAB_BYTES,
        numbers: Numbers | None = None,
        channel: int = 0,
        channels: int = 1,
    ) -> None:
        self.geometry = source.geometry
        self._naming = partial(naming_channel, channel, channels)
        self._whole = ImageSlabs(source, filters, slab_bytes)
        self._coarse = statistics_from
        self._slabs = (
            self._whole
            if statistics_from is None
            else ImageSlabs(statistics_from, filters, slab_bytes)
        )
        self._found: dict[tuple[Any, ...], Any] = dict(numbers or {})
        self._sums: dict[tuple[str, int], NDArray[np.float64]] = {}

    @property
    def statistics(self) -> str:
        """Source of the numbers: ``exact``, or the coarser image in words."""
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
            raise InputError(
                f"{bad} not finite", "replace them first, e.g. by the value of the background"
            )
        return values

    @property
    def numbers(self) -> Numbers:
        """The scale, and the results of `found` so far: for a `WholeImage` in another process."""
        return {_SCALE: self.scale, **self._found}

    @property
    def scale(self) -> Scale:
        """The scale by the image's percentiles, as `accelsurf.run.preprocessing.scale_of` finds it.

        Raises
        ------
        InputError
            When the image cannot be used: voxels that are not finite, all the same, or out of range.
        """
        if _SCALE not in self._found:
            self._found[_SCALE] = scale_between(
                self._order.percentiles(SCALE_PERCENTILES), self._order.extremes
            )
        return cast("Scale", self._found[_SCALE])

    def found(self, make: Callable[..., Any], *args: Any) -> Any:
        """Return ``make(image, *args)`` of the scaled image.

        Parameters
        ----------
        make : callable
            `noise_of`, `otsu_level`, `numpy.percentile`, `numpy.ptp`, `Parzen.of_image` or `least_variance`.

        Raises
        ------
        ValueError
            When ``make`` is another one: it would need all of the image.
        """
        # Methods of classes are made anew each time that they are named: they are compared by equality.
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
            raise ValueError(
                f"{getattr(make, '__name__', make)} of a whole image that is read in parts is not known"
            )
        key = (make, *args)
        if key not in self._found:
            self._found[key] = find(*args)
        return self._found[key]

    def sums(
        self, grids: Sequence[Level], level: int, kind: str, summing: Summing
    ) -> NDArray[np.float64]:
        """Sums over the scaled image on a level of its pyramid: ``grids`` are the levels, ``kind`` names the sums.

        With numbers from a coarser image, its sums, for the number of voxels that the level has.
        """
        if (kind, level) not in self._sums:
            if self._coarse is None:
                self._sum_levels(grids, level, kind, summing)
            else:
                slabs = (self._scaled(values) for _, values in self._slabs.filtered())
                total = sum_in_order(summing(plane.ravel()) for values in slabs for plane in values)
                part = np.prod(grids[level].shape, dtype=np.float64) / np.prod(
                    self._coarse.shape, dtype=np.float64
                )
                self._sums[kind, level] = total * part
        return self._sums[kind, level]

    def _sum_levels(self, grids: Sequence[Level], level: int, kind: str, summing: Summing) -> None:
        """The sums on this level and on all finer ones, which are made on the way: one pass."""
        grids = grids[: level + 1]
        rows: list[list[NDArray[np.float64]]] = [[] for _ in grids]
        for slab in self._slabs.on_levels(grids, self._scaled):
            rows[slab.level] += [summing(plane.ravel()) for plane in slab.values]
        for number, row in enumerate(rows):
            self._sums[kind, number] = sum_in_order(row)

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
        with self._naming():
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
        return apply_filters(values, self.scale)

    def _parzen(self) -> Parzen:
        return Parzen.between(
            self._order.percentiles(END_PERCENTILES, self._scaled), self._extremes
        )

    # -- statistics with a separate pass ----------------------------------------------------------------------

    def _noise(self) -> float:
        places = sample_places(self._slabs.geometry.shape)
        samples = [np.empty(tuple(len(sample) for sample in at), np.float32) for at in places]
        looked_at = (
            np.unique(np.concatenate([z for z, _, _ in places]))
            if places
            else np.empty(0, np.int64)
        )

        def needed(planes: slice) -> bool:
            return bool(((looked_at >= planes.start) & (looked_at < planes.stop)).any())

        for planes, values in self._slabs.filtered(needed):
            for (z, y, x), out in zip(places, samples, strict=True):
                here = np.flatnonzero((z >= planes.start) & (z < planes.stop))
                out[here] = values[np.ix_(z[here] - planes.start, y, x)]
        return noise_of_samples([self._scaled(image) for image in samples])

    def _otsu_level(self) -> float:
        low, high = self._extremes
        first = low
        if low < high:
            counts, edges = self._otsu_counts()
            first = threshold_otsu(hist=(counts, (edges[:-1] + edges[1:]) / 2.0))
        return between_means(
            sum_in_order(
                sums_beside(plane, first)
                for _, values in self._slabs.filtered()
                for plane in self._scaled(values)
            )
        )

    def _otsu_counts(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Histogram of the scaled image between its extremes, and the edges of the bins."""
        edges = np.histogram(self._extremes, _OTSU_BINS)[1]
        if isinstance(self._order, IntegerCounts):
            # Values that occur, ascending: how many fall into each bin tells the bin of each.
            occurs = self._order.counts > 0
            share = np.histogram(self._scaled(self._order.values[occurs]), _OTSU_BINS)[0]
            counts = np.zeros(_OTSU_BINS, np.int64)
            np.add.at(counts, np.repeat(np.arange(_OTSU_BINS), share), self._order.counts[occurs])
            return counts, edges
        ends: Any = tuple(self._extremes)  # float32, as numpy takes them from an array
        parts = (
            np.histogram(self._scaled(values), _OTSU_BINS, ends)[0]
            for _, values in self._slabs.filtered()
        )
        return np.sum(list(parts), axis=0, dtype=np.int64), edges
