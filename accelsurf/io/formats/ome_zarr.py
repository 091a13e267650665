"""OME-Zarr images: their header, a level of one channel and time point lazily, or all of it in memory."""

from __future__ import annotations

import itertools
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
from accelsurf.image.volume import Volume
from accelsurf.io.channels import selected, single
from accelsurf.io.formats.ome_metadata import OmeMetadata, parse_attributes
from accelsurf.io.formats.zarr_pyramid import ZarrPyramid
from accelsurf.io.formats.zarr_voxels import MARKS, ZarrVoxels, open_array, read_mark, zarr_library
from accelsurf.io.headers import (
    FRAME_KEY,
    TIMES_KEY,
    WARNING_KEY,
    FrameTimes,
    check_within_store,
    split_name,
    with_warnings,
)
from accelsurf.io.lazy_volume import LazyVolume, Opening, StoreLayout, checked_level
from accelsurf.io.memory import check_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions

_SERIES_KEY = "bioformats2raw.layout"
#: Keys of metadata; a group of OME-Zarr has one of them.
_KINDS = {"multiscales", "plate", "well", "labels", _SERIES_KEY}
#: Folders that are looked into for images, and bytes of metadata that are looked at for that.
_LISTED = 64
_QUICK = 1 << 20


@dataclass(frozen=True, eq=False)
class OmeHeader:
    """Claims of the metadata of an OME-Zarr.

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
    def channels(self) -> int:
        """Number of them."""
        return self._count("channel")

    @property
    def time_points(self) -> int:
        """Number of them."""
        return self._count("time")

    @property
    def frame_times(self) -> FrameTimes | None:
        """When they are; None where the metadata do not say it."""
        count = self.time_points
        if (text := self.ome.metadata.get(TIMES_KEY)) is not None:
            return FrameTimes.from_text(text, count)
        found = self.ome.metadata.get(FRAME_KEY)
        return None if found is None else FrameTimes.regular(count, float(found))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on all time points: gaps of the metadata, and the number of missing chunks.

        Raises
        ------
        OSError
            When the folders of the image cannot be looked into.
        """
        places = selected(self.channels, self.time_points, replace(self.options, time_index=0))
        number = checked_level(self.options.level, [grid.shape for grid in _grids(self)])
        at = [{"time": None, "channel": channel} for _, channel in places]
        missing = (_voxels(self, number, place, 0).missing() for place in at)
        return (self.ome.metadata.get(WARNING_KEY, ""), *dict.fromkeys(missing))

    @property
    def geometry(self) -> Geometry:
        """The grid of the level that is read."""
        grids = _grids(self)
        return grids[checked_level(self.options.level, [grid.shape for grid in grids])]

    def _count(self, kind: str) -> int:
        """Number of channels ("channel") or time points ("time")."""
        return math.prod(
            n for n, axis in zip(self.shape, self.ome.axes, strict=True) if axis.kind == kind
        )


def parse_ome_zarr(path: Path, options: ReadOptions = AS_IT_IS) -> OmeHeader:
    """Read the metadata of an image, or of the only one in a store that bioformats2raw has written.

    Raises
    ------
    InputError
        When there is none, or it is damaged.
    """
    if not path.is_dir():
        raise InputError(
            "this is a file, the folder of an OME-Zarr expected", "unpack it if it is packed"
        )
    attributes = _attributes(path)
    ome = attributes.get("ome", attributes)
    if isinstance(ome, dict) and _SERIES_KEY in ome and "multiscales" not in ome:
        series = sorted(entry.name for entry in os.scandir(path) if entry.name.isdigit())
        if len(series) != 1:
            raise InputError(
                f"an OME-Zarr of {len(series)} images given, one expected",
                f"give one of them, as {path.name}/0",
            )
        check_within_store(path, path / series[0])
        path = path / series[0]
        attributes = _attributes(path)
    ome = parse_attributes(attributes)
    array = open_array(path, ome.levels[0].path)
    if len(array.shape) != len(ome.axes):
        raise InputError(
            f"the OME-Zarr names {len(ome.axes)} axes, its array has {len(array.shape)}",
            "export it again",
        )
    return OmeHeader(path, ome, tuple(map(int, array.shape)), np.dtype(array.dtype), options)


def _attributes(path: Path) -> dict[str, Any]:
    """The attributes of a group.

    Raises
    ------
    InputError
        When it is none, or is damaged.
    """
    zarr_library()
    try:
        node = read_mark(path, path / "zarr.json")
        if node is None:
            node = {"attributes": read_mark(path, path / ".zattrs"), "node_type": _old_type(path)}
        kind, attributes = node.get("node_type"), node.get("attributes") or {}
        if kind not in ("array", "group") or not isinstance(attributes, dict):
            raise ValueError(f"a node of type {str(kind)[:40]}")
    except (ValueError, AttributeError, RecursionError) as error:
        message = " ".join(str(error).split())[:200]
        if any((path / mark).is_file() for mark in MARKS):
            raise InputError(
                f"the metadata of the Zarr are damaged ({message})", "copy the store again"
            ) from error
        raise InputError(
            "this folder is no Zarr: no zarr.json or .zgroup is in it", "is it the right one?"
        ) from error
    ome = attributes.get("ome", attributes)
    if kind == "array" or not isinstance(ome, dict) or not _KINDS & set(ome):
        raise InputError(*_plain(path, kind))
    return attributes


def _old_type(path: Path) -> str | None:
    """Type of a node of Zarr 2."""
    return next(
        (kind for kind in ("array", "group") if read_mark(path, path / f".z{kind}") is not None),
        None,
    )


def _plain(path: Path, kind: str) -> tuple[str, str]:
    """Name the kind of a Zarr without metadata of OME, and the remedy."""
    for above in (path.absolute().parent, path.absolute().parent.parent):
        if any(_says_images(above / mark) for mark in ("zarr.json", ".zattrs")):
            number = (
                "" if kind != "array" or not path.name.isdigit() else f", with --level {path.name}"
            )
            return (
                f"the {kind} {path.name} of an OME-Zarr given, its image expected",
                f"give {above.name}{number}",
            )
    if kind == "array":
        return (
            "a Zarr array without the metadata of OME-Zarr given: nothing says how large a voxel is",
            ("convert it to OME-Zarr, e.g. with ngff-zarr; or save it as .npy, and give --spacing"),
        )
    below = sorted(
        entry.name for entry in itertools.islice(os.scandir(path), _LISTED) if entry.is_dir()
    )
    images = [
        name
        for name in below
        if any(_says_images(path / name / mark) for mark in ("zarr.json", ".zattrs"))
    ]
    if images:
        named = ", ".join(images[:5])
        return (
            f"a Zarr group of the images {named} given, one image expected",
            f"give one, as {path.name}/{images[0]}",
        )
    named = f" ({', '.join(below[:5])})" if below else ""
    return (
        f"a Zarr group{named} without the metadata of an OME-Zarr image given: nothing says how large a voxel is",
        (
            "convert an array of it to OME-Zarr, e.g. with ngff-zarr; or save it as .npy, and give --spacing"
        ),
    )


def _says_images(mark: Path) -> bool:
    """Test if a file of metadata is that of an OME-Zarr image; a quick look, which another reading follows."""
    try:
        return (
            mark.is_file()
            and mark.stat().st_size < _QUICK
            and b'"multiscales"' in mark.read_bytes()
        )
    except OSError:
        return False


def open_ome_zarr(path: Path, header: OmeHeader, opening: Opening) -> LazyVolume:
    """Open a level of one channel and time point.

    Parameters
    ----------
    path : Path
        The folder, as it was given.
    header : OmeHeader
        Claims of its metadata.
    opening : Opening
        How many bytes of unpacked chunks are held.

    Raises
    ------
    InputError
        When there are several channels or time points and none was named.
    UsageError
        When the level, channel or time point does not exist.
    """
    place = single(header.channels, header.time_points, header.options)
    return _opened(path, header, place, opening.cache_bytes, not opening.again)[0]


def _opened(
    path: Path,
    header: OmeHeader,
    place: tuple[int, int],
    cache_bytes: int,
    listed: bool = False,
) -> tuple[LazyVolume, ZarrVoxels]:
    """Open the level of a time point and a channel; if ``listed``, with a warning about missing chunks."""
    grids = _grids(header)
    number = checked_level(header.options.level, [grid.shape for grid in grids])
    voxels = _voxels(header, number, {"time": place[0], "channel": place[1]}, cache_bytes)
    layout = StoreLayout(grids, voxels.chunk_shape, header.channels, header.time_points, number)
    note = voxels.missing if listed else None
    return LazyVolume(voxels, grids[number], dict(header.ome.metadata), path, layout, note), voxels


def _voxels(
    header: OmeHeader, number: int, at: Mapping[str, int | None], cache_bytes: int
) -> ZarrVoxels:
    """The voxels of a level, at places along the axes that are none of space."""
    ome = header.ome
    index: list[int | None] = []
    for axis, n in zip(ome.axes, header.shape, strict=True):
        if axis.kind != "space" and axis.kind not in at and n > 1:
            raise InputError(
                f"an image of {n} entries of an axis of type {axis.kind or 'none'} given, one expected",
                "extract one",
            )
        index.append(None if axis.kind == "space" else at.get(axis.kind, 0))
    name = ome.levels[number].path
    return ZarrVoxels(header.folder, name, index, ome.space_axes, cache_bytes, ome.stored.get(name))


def _grids(header: OmeHeader) -> tuple[Geometry, ...]:
    """The grids of the levels, finest first."""
    ome = header.ome
    shapes = [open_array(header.folder, level.path).shape for level in ome.levels]
    for i, shape in enumerate(shapes):
        if len(shape) != len(ome.axes):
            raise InputError(
                f"level {i} of the OME-Zarr has {len(shape)} axes, its metadata name {len(ome.axes)}",
                "export it again",
            )
    return tuple(ome.geometry(i, shape) for i, shape in enumerate(shapes))


def read_ome_zarr(path: Path, header: OmeHeader, available: int) -> Volume:
    """Read a level of one channel and time point, the finest unless another was asked for.

    Raises
    ------
    InputError
        When it is larger than the memory, a chunk is damaged, or there are several channels or time points.
    """
    place = single(header.channels, header.time_points, header.options)
    return _in_memory(*_opened(path, header, place, 0), available, 1)


def read_ome_zarr_channels(path: Path, header: OmeHeader, available: int) -> list[Volume]:
    """Read the channels of an image, or the one that was asked for.

    Raises
    ------
    InputError
        As `read_ome_zarr`, and for more than `accelsurf.io.channels.MAX_CHANNELS` channels.
    """
    places = selected(header.channels, header.time_points, header.options)
    opened = [_opened(path, header, place, 0) for place in places]
    return [_in_memory(*image, available, len(opened)) for image in opened]


def _in_memory(lazy: LazyVolume, voxels: ZarrVoxels, available: int, count: int) -> Volume:
    check_memory(lazy.geometry.size, count * lazy.dtype.itemsize, available)
    array = voxels.read(whole_box(lazy.shape))
    return Volume(
        array,
        lazy.geometry,
        with_warnings(lazy.metadata, voxels.missing(listed=False)),
        lazy.source,
    )


def write_ome_zarr(volume: Volume, path: Path) -> None:
    """Write OME-Zarr 0.5 with coarser levels of means."""
    _write(volume, path, labels=False)


def write_labels(volume: Volume, path: Path) -> None:
    """Write a label map as OME-Zarr 0.5, with coarser levels of nearest neighbours and a colour for each label."""
    _write(volume, path, labels=True)


def _write(volume: Volume, path: Path, labels: bool) -> None:
    name = split_name(path)[0]
    pyramid = ZarrPyramid(path, volume.geometry, volume.array.dtype, volume.metadata, name, labels)
    pyramid.write_whole(volume.array)


def store_ome_zarr(
    path: Path,
    geometry: Geometry,
    dtype: np.dtype[Any],
    metadata: Mapping[str, str],
    source: str | None,
) -> ZarrPyramid:
    """Begin a label map that is written box by box."""
    return ZarrPyramid(path, geometry, dtype, metadata, split_name(path)[0], True, source)
