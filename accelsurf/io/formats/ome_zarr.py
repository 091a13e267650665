"""OME-Zarr images: their header, a level of one channel and time point lazily, or all of it in memory."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import selection
from accelsurf.io.formats.ome_metadata import OmeMetadata, parse_attributes
from accelsurf.io.formats.zarr_pyramid import CHUNK, ZarrPyramid
from accelsurf.io.formats.zarr_voxels import MARKS, ZarrVoxels, library, open_array
from accelsurf.io.frame_times import TIMES_KEY, FrameTimes
from accelsurf.io.headers import check_within_store, split_name
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.levels import checked_level
from accelsurf.io.memory import check_memory
from accelsurf.io.metadata import FRAME_KEY
from accelsurf.settings.reading import AS_IT_IS, Level, ReadOptions

_SERIES_KEY = "bioformats2raw.layout"


@dataclass(frozen=True, eq=False)
class OmeHeader:
    """What an OME-Zarr claims.

    Attributes
    ----------
    folder : Path
        The group of the image.
    ome : OmeMetadata
        Its metadata.
    shape : tuple of int
        Of the array of the finest level, all axes.
    dtype : numpy.dtype
        Of its values.
    options : ReadOptions
        Which level, channel and time point is read as a whole.
    """

    folder: Path
    ome: OmeMetadata
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    options: ReadOptions = AS_IT_IS

    @property
    def values(self) -> int:
        """How many values are read, those of all channels together; of the finest level where none was named."""
        places = selection.selected(self.count("channel"), self.count("time"), self.options)
        level = self.options.level if isinstance(self.options.level, int) else 0
        array = open_array(self.folder, self.ome.levels[min(level, len(self.ome.levels) - 1)].path)
        return len(places) * math.prod(int(array.shape[axis]) for axis in self.ome.space_axes)

    @property
    def channels(self) -> int:
        """How many there are."""
        return self.count("channel")

    @property
    def time_points(self) -> int:
        """How many there are."""
        return self.count("time")

    @property
    def frame_times(self) -> FrameTimes | None:
        """When they are; None where the metadata do not say it."""
        count = self.count("time")
        if (text := self.ome.metadata.get(TIMES_KEY)) is not None:
            return FrameTimes.from_text(text, count)
        found = self.ome.metadata.get(FRAME_KEY)
        return None if found is None else FrameTimes.regular(count, float(found))

    @property
    def geometry(self) -> Geometry:
        """The grid of the level that is read."""
        grids = _grids(self)
        return grids[checked_level(self.options.level, [grid.shape for grid in grids])]

    def count(self, kind: str) -> int:
        """How many channels ("channel") or time points ("time") there are."""
        return math.prod(n for n, axis in zip(self.shape, self.ome.axes, strict=True) if axis.kind == kind)


def parse(path: Path, options: ReadOptions = AS_IT_IS) -> OmeHeader:
    """Read the metadata of an image, or of the only one in a store that bioformats2raw has written.

    Raises
    ------
    InputError
        When there is none, or it is damaged.
    """
    if not path.is_dir():
        raise InputError("this is a file, the folder of an OME-Zarr expected", "unpack it if it is zipped")
    attributes = _attributes(path)
    ome = attributes.get("ome", attributes)
    if isinstance(ome, dict) and _SERIES_KEY in ome and "multiscales" not in ome:
        series = sorted(entry.name for entry in os.scandir(path) if entry.name.isdigit())
        if len(series) != 1:
            raise InputError(
                f"an OME-Zarr of {len(series)} images given, one expected", f"give one of them, as {path.name}/0"
            )
        check_within_store(path, path / series[0])
        path = path / series[0]
        attributes = _attributes(path)
    ome = parse_attributes(attributes)
    array = open_array(path, ome.levels[0].path)
    if len(array.shape) != len(ome.axes):
        raise InputError(
            f"the OME-Zarr names {len(ome.axes)} axes, its array has {len(array.shape)}", "export it again"
        )
    return OmeHeader(path, ome, tuple(map(int, array.shape)), np.dtype(array.dtype), options)


def _attributes(path: Path) -> dict[str, Any]:
    zarr = library()
    for mark in MARKS:
        check_within_store(path, path / mark)
    try:
        return dict(zarr.open_group(path, mode="r", use_consolidated=False).attrs)
    except (PermissionError, MemoryError):
        raise
    except Exception as error:  # json, zarr and its metadata classes raise errors of many kinds
        if any((path / mark).is_file() for mark in MARKS):
            message = " ".join(str(error).split())[:200]
            raise InputError(f"the metadata of the Zarr are damaged ({message})", "copy the store again") from error
        raise InputError("this folder is no Zarr: no zarr.json or .zgroup is in it", "is it the right one?") from error


def open_lazily(path: Path, header: OmeHeader, opening: Opening) -> LazyVolume:
    """Open a level of one channel and time point.

    Parameters
    ----------
    path : Path
        The folder, as it was given.
    header : OmeHeader
        What it claims.
    opening : Opening
        Which level, channel and time point.

    Raises
    ------
    InputError
        When there are several channels or time points and none was named.
    UsageError
        When there is no such level, channel or time point.
    """
    asked = replace(header.options, channel_index=opening.channel_index, time_index=opening.time_index)
    place = selection.single(header.count("channel"), header.count("time"), asked)
    return _opened(path, header, place, opening.level, opening.cache_bytes)


def _opened(path: Path, header: OmeHeader, place: tuple[int, int], level: Level, cache_bytes: int) -> LazyVolume:
    """A level of the image of a time point and a channel."""
    ome = header.ome
    grids = _grids(header)
    number = checked_level(level, [grid.shape for grid in grids])
    at = {"time": place[0], "channel": place[1]}
    index: list[int | None] = []
    for axis, n in zip(ome.axes, header.shape, strict=True):
        if axis.kind != "space" and axis.kind not in at and n > 1:
            raise InputError(
                f"an image of {n} entries of an axis of type {axis.kind or 'none'} given, one expected", "extract one"
            )
        index.append(None if axis.kind == "space" else at.get(axis.kind, 0))
    voxels = ZarrVoxels(header.folder, ome.levels[number].path, index, ome.space_axes, cache_bytes)
    layout = StoreLayout(grids, voxels.chunk_shape, header.count("channel"), header.count("time"), number)
    return LazyVolume(voxels, grids[number], dict(ome.metadata), path, layout)


def _grids(header: OmeHeader) -> tuple[Geometry, ...]:
    """The grids of the levels, finest first."""
    ome = header.ome
    shapes = [open_array(header.folder, one.path).shape for one in ome.levels]
    for i, shape in enumerate(shapes):
        if len(shape) != len(ome.axes):
            raise InputError(
                f"level {i} of the OME-Zarr has {len(shape)} axes, its metadata name {len(ome.axes)}", "export it again"
            )
    return tuple(ome.geometry(i, shape) for i, shape in enumerate(shapes))


def read(path: Path, header: OmeHeader, available: int) -> Volume:
    """Read a level of one channel and time point, the finest unless another was asked for.

    Raises
    ------
    InputError
        When it is larger than the memory, a chunk is damaged, or there are several channels or time points.
    """
    asked = header.options
    place = selection.single(header.count("channel"), header.count("time"), asked)
    return _in_memory(_opened(path, header, place, asked.level, 0), available, 1)


def read_channels(path: Path, header: OmeHeader, available: int) -> list[Volume]:
    """Read the channels of an image, or the one that was asked for.

    Raises
    ------
    InputError
        As `read`, and for more than `selection.MAX_CHANNELS` channels.
    """
    places = selection.selected(header.count("channel"), header.count("time"), header.options)
    lazy = [_opened(path, header, place, header.options.level, 0) for place in places]
    return [_in_memory(one, available, len(lazy)) for one in lazy]


def _in_memory(lazy: LazyVolume, available: int, count: int) -> Volume:
    check_memory(lazy.geometry.size, count * lazy.dtype.itemsize, available)
    return Volume(lazy.voxels.read(whole_box(lazy.shape)), lazy.geometry, lazy.metadata, lazy.source)


def write(volume: Volume, path: Path) -> None:
    """Write OME-Zarr 0.5 with coarser levels of means."""
    _write(volume, path, labels=False)


def write_labels(volume: Volume, path: Path) -> None:
    """Write a label map as OME-Zarr 0.5, with coarser levels of nearest neighbours and a colour for each label."""
    _write(volume, path, labels=True)


def _write(volume: Volume, path: Path, labels: bool) -> None:
    name = split_name(path)[0]
    pyramid = ZarrPyramid(path, volume.geometry, volume.array.dtype, volume.metadata, name, labels)
    for first in range(0, volume.array.shape[0], CHUNK):
        box = (slice(first, min(first + CHUNK, volume.array.shape[0])), *whole_box(volume.array.shape)[1:])
        pyramid.write(box, volume.array[box])
    pyramid.finish()


def store(
    path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str], source: str | None
) -> ZarrPyramid:
    """Begin a label map that is written box by box."""
    return ZarrPyramid(path, geometry, dtype, metadata, split_name(path)[0], True, source)
