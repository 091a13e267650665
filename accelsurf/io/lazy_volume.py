"""Images that stay where they are: a box of voxels is read when it is asked for.

`accelsurf.io.read` brings a whole image into memory; `open_volume` reads its header only. A box holds the same values,
voxel by voxel, in the same type. Unpacked pieces are held up to a number of bytes (`PackedVoxels`).
"""

from __future__ import annotations

import math
import os
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import InputError, UsageError
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume, in_unit_of
from accelsurf.io import headers
from accelsurf.io.channels import selected
from accelsurf.io.files import file_version, naming, refuse_changed
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import with_warnings
from accelsurf.io.memory import available_memory
from accelsurf.settings.reading import AS_IT_IS, Level, ReadOptions, Spacing

#: Of a run, for each voxel, at most.
_RUN_BYTES = 80
#: Bytes of unpacked chunks or pages that are held at most, where the caller says nothing.
CACHE_BYTES = 1 << 28


@dataclass(frozen=True)
class Opening:
    """Arguments of `open_volume` beside the name of the image; see there.

    ``again`` is true where the same image was opened before, so that its warnings have been given.
    """

    options: ReadOptions = AS_IT_IS
    cache_bytes: int = CACHE_BYTES
    again: bool = False


@dataclass(frozen=True)
class StoreLayout:
    """Levels, chunks and axes of a stored image.

    Attributes
    ----------
    levels : tuple of Geometry
        The grids of its levels, finest first.
    chunk_shape : tuple of int or None
        Of the level that was opened, (z, y, x); None where rows lie as they are.
    channels, time_points : int
        How many of them there are.
    level : int
        The one that was opened.
    """

    levels: tuple[Geometry, ...]
    chunk_shape: tuple[int, int, int] | None = None
    channels: int = 1
    time_points: int = 1
    level: int = 0


class VoxelSource(Protocol):
    """Source of the voxels of a `LazyVolume`."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values, in this machine's byte order."""

    @property
    def bytes_read(self) -> int:
        """Bytes that were read so far."""

    def read(self, box: Box) -> NDArray[Any]:
        """Return the voxels of a box within the grid as a new C-contiguous array; may be called by several threads."""


class LazyVolume:
    """An image on a grid whose voxels are read box by box.

    Parameters
    ----------
    voxels : VoxelSource
        Of the shape of the grid.
    geometry : Geometry
        The whole grid.
    metadata : dict of str to str, optional
        As in `Volume`.
    source : Path, optional
        The file or folder.
    layout : StoreLayout, optional
        How it is stored; by default one level, channel and time point, without chunks.
    note : callable, optional
        Returns a further warning, or an empty text; it takes time, and is asked when the metadata are.

    Attributes
    ----------
    voxels, geometry, source, layout
        The same.
    """

    def __init__(
        self,
        voxels: VoxelSource,
        geometry: Geometry,
        metadata: dict[str, str] | None = None,
        source: Path | None = None,
        layout: StoreLayout | None = None,
        note: Callable[[], str] | None = None,
    ) -> None:
        self._metadata: dict[str, str] = metadata or {}
        self.voxels, self.source = voxels, source
        self.geometry = in_unit_of(self._metadata, geometry)
        levels = layout.levels if layout is not None else (geometry,)
        self.layout = replace(
            layout or StoreLayout((geometry,)),
            levels=tuple(in_unit_of(self._metadata, grid) for grid in levels),
        )
        self._note = note
        self._opened: tuple[Path, Opening] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """One that was opened is opened again by whoever unpickles it: another process, on the same files."""
        if self._opened is None:
            return LazyVolume, (self.voxels, self.geometry, self.metadata, self.source)
        return _reopened, self._opened

    def keep_opening(self, path: Path, opening: Opening) -> None:
        """Keep the arguments by which another process, or `coarser`, opens it again."""
        self._opened = path, opening

    @classmethod
    def of_array(cls, volume: Volume) -> LazyVolume:
        """A volume that is in memory, to be read like one that is not."""
        return cls(
            _ArrayVoxels(volume.array), volume.geometry, dict(volume.metadata), volume.source
        )

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata as in `Volume`, with a warning about missing chunks.

        Raises
        ------
        InputError
            When the folders of the image cannot be looked into.
        """
        if self._note is not None:
            with naming(self.source or Path()):
                self._metadata = with_warnings(self._metadata, self._note())
            self._note = None
        return self._metadata

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values, as `accelsurf.io.read` would give them."""
        return self.voxels.dtype

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels of the whole grid, (nz, ny, nx)."""
        return self.geometry.shape

    def coarser(self) -> LazyVolume | None:
        """The next coarser level of the same image, opened; None where it is stored on no coarser one.

        Raises
        ------
        InputError
            As `open_volume`.
        """
        if self._opened is None or self.layout.level + 1 >= len(self.layout.levels):
            return None
        path, opening = self._opened
        coarser = replace(opening.options, level=self.layout.level + 1)
        return _reopened(path, replace(opening, options=coarser))

    @property
    def bytes_read(self) -> int:
        """Bytes that were read from the file so far; of packed chunks and pages, those after unpacking."""
        return self.voxels.bytes_read

    def read(self, box: Box) -> NDArray[Any]:
        """Return the voxels of a box.

        Parameters
        ----------
        box : three slices
            (z, y, x), each with a first voxel and the one after the last, within the grid.

        Returns
        -------
        ndarray, shape of the box
            A new array, C-contiguous.

        Raises
        ------
        UsageError
            When the box is empty or goes beyond the grid.
        InputError
            When the file cannot be read, is damaged, or is no longer the one that was opened.

        Examples
        --------
        >>> image = LazyVolume.of_array(Volume.from_array(np.arange(24).reshape(2, 3, 4)))
        >>> image.read((slice(1, 2), slice(0, 2), slice(2, 4))).tolist()
        [[[14, 15], [18, 19]]]
        """
        check_box(box, self.shape)
        if self.source is None:
            return self.voxels.read(box)
        with naming(self.source):
            return self.voxels.read(box)

    def __repr__(self) -> str:
        source = f", source={str(self.source)!r}" if self.source is not None else ""
        return f"LazyVolume({self.dtype}, {self.geometry!r}{source})"


class _ArrayVoxels:
    """Voxels in memory; they count as read when they are asked for."""

    def __init__(self, array: NDArray[Any]) -> None:
        self._array, self.dtype = array, array.dtype.newbyteorder("=")
        self.bytes_read = 0

    def read(self, box: Box) -> NDArray[Any]:
        values = np.array(self._array[box], self.dtype, order="C", copy=True)
        self.bytes_read += values.nbytes
        return values


def check_box(box: Box, shape: tuple[int, int, int]) -> None:
    """Refuse a box that is no part of a grid.

    Raises
    ------
    UsageError
        With the box and the grid.
    """
    for along, n in zip(box, shape, strict=True):
        start, stop = along.start, along.stop
        if (
            along.step not in (None, 1)
            or start is None
            or stop is None
            or not 0 <= start < stop <= n
        ):
            text = ", ".join(f"{s.start}:{s.stop}" + (f":{s.step}" if s.step else "") for s in box)
            raise UsageError(
                f"the box [{text}] was given, expected one within the grid {shape}",
                "give the first voxel and the one after the last, (z, y, x)",
            )


def open_volume(
    path: str | os.PathLike[str],
    *,
    level: Level = 0,
    channel_index: int | None = None,
    time_index: int | None = None,
    cache_bytes: int = CACHE_BYTES,
    spacing: Spacing | None = None,
) -> LazyVolume:
    """Open an image without reading its voxels.

    Parameters
    ----------
    path : path-like
        An OME-Zarr, a TIFF in grey, slices, an .npy, or an uncompressed NIfTI, NRRD or MetaImage.
    level : int or "auto", optional
        Of an image that is stored as a pyramid: 0 is the finest, "auto" the finest whose run fits into the memory.
    channel_index, time_index : int, optional
        Which channel and time point, from 0 on; needed where there are several.
    cache_bytes : int, optional
        Bytes of unpacked chunks or pages that are held at most; those that were used last stay. Voxels that lie in a
        file as they are need none: the operating system has a cache of files.
    spacing : tuple of float, optional
        Size of a voxel (x, y, z), mm, of a picture, a stack or an array that does not say it.

    Raises
    ------
    InputError
        When the image is missing, damaged, too short, or packed as a whole, so that no box can be read by itself;
        GeometryError as `accelsurf.io.read`.
    UsageError
        When the level, channel or time point does not exist.
    """
    options = ReadOptions(level, channel_index, time_index, spacing=spacing)
    return _opened(Path(path), Opening(options, cache_bytes))


def _opened(path: Path, opening: Opening) -> LazyVolume:
    """Open an image; see `open_volume`."""
    with naming(path):
        form, header = headers.parse_header(path, opening.options)
        open_form = functions_of(form).open
        if open_form is None:
            raise InputError(
                f"{headers.kind_of(form)} is packed or held as a whole, an image that is read box by box expected",
                "convert it to OME-Zarr, or save it uncompressed as .nii, .nrrd or .mha",
            )
        volume: LazyVolume = open_form(path, header, opening)
    volume.keep_opening(path.absolute(), opening)
    return volume


def _reopened(path: Path, opening: Opening) -> LazyVolume:
    """A volume that was opened, once more."""
    return _opened(path, replace(opening, again=True))


def open_with(path: str | os.PathLike[str], options: ReadOptions) -> LazyVolume:
    """Open a volume with those options of an image that the format of the file has; see `open_volume`."""
    asked = options.restricted_to(headers.options_of(path))
    return _opened(Path(path), Opening(replace(asked, channels_from_time=False, series=None)))


def open_channels(path: str | os.PathLike[str], options: ReadOptions) -> list[LazyVolume]:
    """Open the channels of an image, or the one that was asked for, with those options that the format has.

    Raises
    ------
    InputError
        As `open_volume`, and for a sequence of which no time point was named.
    """
    path = Path(path)
    asked = options.restricted_to(headers.options_of(path))
    with naming(path):
        places = selected(*headers.header_counts(path, asked), asked)
    return [
        open_with(path, replace(asked, channels_from_time=False, time_index=t, channel_index=c))
        for t, c in places
    ]


def checked_level(level: Level, shapes: Sequence[tuple[int, ...]]) -> int:
    """The number of a level that was asked for.

    Parameters
    ----------
    level : int or "auto"
        "auto" is the finest whose run fits into the free memory, else the coarsest.
    shapes : sequence of tuple of int
        Of the levels, finest first.

    Raises
    ------
    UsageError
        When the level does not exist.

    Examples
    --------
    >>> checked_level("auto", [(10**5, 10**5, 10**5), (8, 8, 8)])
    1
    """
    if level == "auto":
        free = available_memory()
        small = (n for n, shape in enumerate(shapes) if math.prod(shape) * _RUN_BYTES <= free)
        return next(small, len(shapes) - 1)
    if not 0 <= level < len(shapes):
        raise UsageError(
            f"level {level} asked for, the image has {len(shapes)}", f"give 0 to {len(shapes) - 1}"
        )
    return level


class StackedVoxels:
    """Slabs, one after the other along z.

    Parameters
    ----------
    slabs : sequence of VoxelSource
        Of one type.
    depths : sequence of int
        Slices of each.

    Raises
    ------
    InputError
        When their types differ.
    """

    def __init__(self, slabs: Sequence[VoxelSource], depths: Sequence[int]) -> None:
        self._slabs, self.dtype = tuple(slabs), slabs[0].dtype
        if any(slab.dtype != self.dtype for slab in slabs):
            raise InputError(
                "the slices have values of several types", "convert them to one type first"
            )
        self._ends = np.cumsum(depths)

    @property
    def bytes_read(self) -> int:
        """Bytes that were read so far."""
        return sum(slab.bytes_read for slab in self._slabs)

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box; see `accelsurf.io.LazyVolume.read`."""
        values = np.empty([s.stop - s.start for s in box], self.dtype)
        at = box[0].start
        while at < box[0].stop:
            number = int(np.searchsorted(self._ends, at, side="right"))
            begin = int(self._ends[number - 1]) if number else 0
            stop = min(box[0].stop, int(self._ends[number]))
            inside = (slice(at - begin, stop - begin), *box[1:])
            values[at - box[0].start : stop - box[0].start] = self._slabs[number].read(inside)
            at = stop
        return values


class FileVoxels:
    """Voxels of a file that is the same as long as it is open; of a store, of its file of metadata.

    Several threads may read it.

    Parameters
    ----------
    path : Path
        It is opened anew for each box: nothing stays open, and a file that is gone or replaced is noticed.

    Attributes
    ----------
    bytes_read : int
        Bytes of the voxels that were read so far; of packed ones, unpacked.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._version = file_version(path)
        self.bytes_read = 0
        self._lock = Lock()

    def read(self, box: Box) -> NDArray[Any]:
        """Return the values in a box; see `LazyVolume.read`.

        Raises
        ------
        InputError
            When it is damaged, or has changed since it was opened; OSError when it is gone.
        """
        refuse_changed(self._path, self._version)
        values = self._values_in(box)
        refuse_changed(self._path, self._version)
        return values

    def _values_in(self, box: Box) -> NDArray[Any]:
        """Return the values in a box, in a new array."""
        raise NotImplementedError


class PackedVoxels(FileVoxels):
    """Voxels that are unpacked piece by piece; pieces that were used last are held.

    Parameters
    ----------
    path : Path
    cache_bytes : int
        Of unpacked pieces that are held. One that is larger by itself is not held.
    """

    def __init__(self, path: Path, cache_bytes: int) -> None:
        super().__init__(path)
        self._cache_bytes = cache_bytes
        self._held: OrderedDict[Hashable, NDArray[Any]] = OrderedDict()
        self._held_bytes = 0

    def _piece(self, key: Hashable, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return the piece of a key, made if it is not held; nobody writes into it.

        Two threads that miss it at the same time both make it.
        """
        with self._lock:
            if (array := self._held.get(key)) is not None:
                self._held.move_to_end(key)
                return array
        array = make()
        array.setflags(write=False)
        with self._lock:
            self.bytes_read += array.nbytes
            if array.nbytes <= self._cache_bytes and key not in self._held:
                self._held[key] = array
                self._held_bytes += array.nbytes
                while self._held_bytes > self._cache_bytes:
                    self._held_bytes -= self._held.popitem(last=False)[1].nbytes
        return array
