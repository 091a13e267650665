"""OME-Zarr images: their header, a level of one channel and time point lazily, or all of it in memory."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io.formats import itk_volumes
from accelsurf.io.formats.ome_metadata import OmeMetadata, parse_attributes
from accelsurf.io.formats.zarr_pyramid import CHUNK, ZarrPyramid
from accelsurf.io.formats.zarr_voxels import MARKS, ZarrVoxels, library, open_array
from accelsurf.io.headers import check_within_store, split_name
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout
from accelsurf.io.memory import available_memory, check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_SERIES_KEY = "bioformats2raw.layout"
#: Of a run, for each voxel, at most.
_RUN_BYTES = 80


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
        """How many values the finest level has, those of all channels and time points together."""
        return math.prod(self.shape)

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
    ome = header.ome
    grids = _grids(header)
    level = _finest_within(grids, available_memory()) if opening.level == "auto" else opening.level
    if not 0 <= level < len(ome.levels):
        raise UsageError(
            f"level {level} asked for, the image has {len(ome.levels)}", f"give 0 to {len(ome.levels) - 1}"
        )
    asked = {"channel": opening.channel_index, "time": opening.time_index}
    index: list[int | None] = []
    for axis, n in zip(ome.axes, header.shape, strict=True):
        index.append(None if axis.kind == "space" else _place(axis.kind, n, asked.get(axis.kind)))
    for kind, place in asked.items():
        if place and all(axis.kind != kind for axis in ome.axes):
            raise UsageError(f"{kind} {place} asked for, the image has one", "leave it out")
    voxels = ZarrVoxels(header.folder, ome.levels[level].path, index, ome.space_axes, opening.cache_bytes)
    layout = StoreLayout(grids, voxels.chunk_shape, header.count("channel"), header.count("time"), level)
    return LazyVolume(voxels, grids[level], dict(ome.metadata), path, layout)


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


def _finest_within(grids: Sequence[Geometry], available: int) -> int:
    """The finest level whose run fits into the memory, else the coarsest."""
    small = (n for n, grid in enumerate(grids) if math.prod(grid.shape) * _RUN_BYTES <= available)
    return next(small, len(grids) - 1)


def _place(kind: str, n: int, asked: int | None) -> int:
    """The index along an axis that is none of space."""
    name = {"channel": "channels", "time": "time points"}.get(kind, f"entries of an axis of type {kind or 'none'}")
    if asked is None and n > 1:
        how = f"say which: {kind}_index=0 to {n - 1}, or extract one" if kind in ("channel", "time") else "extract one"
        raise InputError(f"an image of {n} {name} given, one expected", how)
    if not 0 <= (asked or 0) < n:
        raise UsageError(f"{kind} {asked} asked for, the image has {n} {name}", f"give 0 to {n - 1}")
    return asked or 0


def read(path: Path, header: OmeHeader, available: int) -> Volume:
    """Read a level of one channel and time point, the finest unless another was asked for.

    Raises
    ------
    InputError
        When it is larger than the memory, a chunk is damaged, or there are several channels or time points.
    """
    asked = header.options
    opening = Opening(asked.level, asked.channel_index, asked.time_index, cache_bytes=0)
    return _in_memory(open_lazily(path, header, opening), available, 1)


def read_channels(path: Path, header: OmeHeader, available: int) -> list[Volume]:
    """Read the channels of an image, or the one that was asked for.

    Raises
    ------
    InputError
        As `read`, and for more than `itk_volumes.MAX_CHANNELS` channels.
    """
    if header.options.channel_index is not None:
        return [read(path, header, available)]
    count, asked = header.count("channel"), header.options
    itk_volumes.check_channels(count)
    lazy = [open_lazily(path, header, Opening(asked.level, i, asked.time_index, 0)) for i in range(count)]
    return [_in_memory(one, available, count) for one in lazy]


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
