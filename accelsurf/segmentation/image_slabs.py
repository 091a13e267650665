"""A large image, filtered as a run sees it, read by boxes or by slabs of whole planes, and its coarser levels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, whole_box
from accelsurf.grid.image_filters import ImageFilters
from accelsurf.grid.pyramid import Level, planes_of_blocks, restrict
from accelsurf.io.lazy_volume import LazyVolume
from accelsurf.segmentation.filters import check_filters

#: Bytes of the float32 voxels of a slab.
SLAB_BYTES = 1 << 27

Planes = NDArray[np.float32]


class LevelSlab(NamedTuple):
    """Planes of a level of the pyramid, from number ``first`` on."""

    level: int
    first: int
    values: Planes


class ImageSlabs:
    """An image that is read in parts and filtered with what lies around them: the bytes of the whole, filtered.

    Parameters
    ----------
    source : LazyVolume
    filters : ImageFilters
    slab_bytes : int
        Bytes of a slab as float32; at least a plane is read. About two and a half times as many are held at once,
        also of the halo, which is four standard deviations and two radii of a closing on
        either side.

    Raises
    ------
    UsageError
        When a filter is so wide that it takes too long.
    """

    def __init__(self, source: LazyVolume, filters: ImageFilters, slab_bytes: int = SLAB_BYTES) -> None:
        check_filters(filters, source.geometry)
        self.source, self.filters, self.geometry = source, filters, source.geometry
        self.planes = max(1, slab_bytes // (4 * math.prod(self.geometry.shape[1:])))

    def window(self, box: Box) -> Planes:
        """The filtered image on a box, a new array."""
        return self.filters.on_box(self.source.read, self.geometry.shape, self.geometry.spacing, box)

    def raw(self) -> Iterator[NDArray[Any]]:
        """Slabs of the image as it is, of its own dtype."""
        for planes in self._slices(self.geometry.shape[0], self.planes):
            yield self.source.read(self._box(planes))

    def filtered(self, needed: Callable[[slice], bool] = lambda planes: True) -> Iterator[tuple[slice, Planes]]:
        """The planes of a slab and its filtered values, of those slabs that are ``needed``."""
        for planes in self._slices(self.geometry.shape[0], self.planes):
            if needed(planes):
                yield planes, self.window(self._box(planes))

    def on_levels(
        self, grids: Sequence[Level], mapped: Callable[[Planes], Planes] = lambda values: values
    ) -> Iterator[LevelSlab]:
        """All planes of all levels, each once and those of a level in order; the image is read about once.

        Parameters
        ----------
        grids : sequence of Level
            Finest first; the image is on the first.
        mapped : callable
            Applied to the filtered values of level 0; may overwrite them.
        """
        top = grids[-1]
        own = [0] * len(grids)
        for planes in self._slices(top.shape[0], max(1, self.planes // top.factors[0])):
            for level, first, values in self._with_finer(grids, planes, mapped):
                # Blocks share planes with the next ones: what was there before is left out.
                stop = self._own_stop(grids, planes, level)
                yield LevelSlab(level, own[level], values[own[level] - first : stop - first])
                own[level] = stop

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
        target = coarse.on_box((planes.start, 0, 0), (planes.stop - planes.start, *coarse.shape[1:]))
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
