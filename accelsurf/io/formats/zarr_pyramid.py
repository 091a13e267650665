"""An OME-Zarr 0.5 that is written box by box: the finest level first, then the coarser ones from the written voxels.

A coarser voxel is the mean of a block of two voxels along each axis that is halved (at the end of an axis of odd size,
of the rest), or for label maps the first voxel of the block, which is where the level then has its voxel. The axes
are halved as in the solver's own levels: voxels become more cubic.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box, whole_box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.pyramid import MAX_SPACING_RATIO
from accelsurf.io.formats.ome_metadata import OWN_KEY, VERSIONS, attributes_of
from accelsurf.io.formats.zarr_files import with_record
from accelsurf.io.formats.zarr_voxels import zarr_library
from accelsurf.io.headers import LABELS_KEY
from accelsurf.settings.labels import LabelTable

#: Voxels of a chunk along each axis; of one slice, along the two others.
CHUNK = 64
SLICE_CHUNK = 512
#: Number of labels that get a colour; programs choose colours for the others.
MAX_COLORS = 1024


@dataclass(frozen=True)
class PyramidLevel:
    """A level that is written.

    Attributes
    ----------
    shape : tuple of int
        (nz, ny, nx).
    spacing : tuple of float
        (z, y, x) in mm.
    offset : tuple of float
        Of its first voxel from that of the finest level along the axes, mm.
    halved : tuple of bool
        The axes along which the next finer level has twice the voxels.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    offset: tuple[float, float, float]
    halved: tuple[bool, bool, bool]


def planned_levels(geometry: Geometry, labels: bool) -> list[PyramidLevel]:
    """The levels of an image, until one has a single chunk.

    Parameters
    ----------
    geometry : Geometry
        Of the finest.
    labels : bool
        Whether it is a label map: then no level is shifted.

    Examples
    --------
    >>> for level in planned_levels(Geometry((40, 200, 200), (3.0, 1.0, 1.0)), labels=False):
    ...     print(level.shape, level.spacing, level.offset)
    (40, 200, 200) (3.0, 1.0, 1.0) (0.0, 0.0, 0.0)
    (40, 100, 100) (3.0, 2.0, 2.0) (0.0, 0.5, 0.5)
    (40, 50, 50) (3.0, 4.0, 4.0) (0.0, 1.5, 1.5)
    """
    made = [PyramidLevel(geometry.shape, geometry.spacing, (0.0, 0.0, 0.0), (False, False, False))]
    while any(
        n > width for n, width in zip(made[-1].shape, chunk_shape(geometry.shape), strict=True)
    ):
        last = made[-1]
        finest = min(h for h, n in zip(last.spacing, last.shape, strict=True) if n > 1)
        halved = [
            n > 1 and h <= MAX_SPACING_RATIO * finest
            for n, h in zip(last.shape, last.spacing, strict=True)
        ]
        shape = [-(-n // 2) if half else n for n, half in zip(last.shape, halved, strict=True)]
        spacing = [2.0 * h if half else h for h, half in zip(last.spacing, halved, strict=True)]
        offset = [
            o + 0.5 * h if half and not labels else o
            for o, h, half in zip(last.offset, last.spacing, halved, strict=True)
        ]
        made.append(PyramidLevel(*map(tuple, (shape, spacing, offset, halved))))  # type: ignore[arg-type]
    return made


def chunk_shape(shape: Sequence[int]) -> tuple[int, int, int]:
    """The chunks of an array of a shape (nz, ny, nx)."""
    width = CHUNK if min(shape) > 1 else SLICE_CHUNK
    nz, ny, nx = (min(n, width) for n in shape)
    return nz, ny, nx


class ZarrPyramid:
    """An OME-Zarr that is being written; one thread at a time.

    Parameters
    ----------
    folder : Path
        The folder to make.
    geometry : Geometry
        Of the finest level.
    dtype : numpy.dtype
        Of the values.
    metadata : mapping of str to str
        As in `Volume`.
    name : str
        Of the image.
    labels : bool
        Whether it is a label map.
    source : str, optional
        Path of its image, from the folder.
    """

    def __init__(
        self,
        folder: Path,
        geometry: Geometry,
        dtype: np.dtype[Any],
        metadata: Mapping[str, str],
        name: str,
        labels: bool,
        source: str | None = None,
    ) -> None:
        zarr = zarr_library()
        from zarr.codecs import ZstdCodec

        self._labels = labels
        self._source = source
        self._folder = folder
        self._levels = planned_levels(geometry, labels)
        described = [(str(i), level.spacing, level.offset) for i, level in enumerate(self._levels)]
        method = "nearest" if labels else "mean"
        self._table = LabelTable.from_json(metadata.get(LABELS_KEY, "[]"))
        self._attributes = attributes_of(geometry, described, metadata, name, method)
        self._group = zarr.create_group(folder, zarr_format=3, attributes=self._attributes)
        self._arrays = [
            self._group.create_array(
                str(i),
                shape=level.shape,
                chunks=chunk_shape(level.shape),
                dtype=dtype,
                compressors=[
                    ZstdCodec(level=0, checksum=True)
                ],  # so that a damaged chunk is noticed
                fill_value=0,
                dimension_names=("z", "y", "x"),
            )
            for i, level in enumerate(self._levels)
        ]
        self._written: set[tuple[int, ...]] = set()
        self._values: set[int] = set()

    def write(self, box: Box, array: NDArray[Any]) -> None:
        """Write the voxels of a box of the finest level."""
        self._arrays[0][box] = array
        self._written.update(_places(box, self._arrays[0].chunks))
        if self._labels and len(self._values) <= MAX_COLORS:
            self._values.update(np.unique(array).tolist())

    def write_whole(self, array: NDArray[Any]) -> None:
        """Write all voxels, and finish: a layer of chunks at a time."""
        for first in range(0, len(array), CHUNK):
            layer = slice(first, min(first + CHUNK, len(array)))
            self.write((layer, *whole_box(array.shape)[1:]), array[layer])
        self.finish()

    def read(self, box: Box) -> NDArray[Any]:
        """Return the voxels of a box of the finest level; 0 where none were written."""
        return np.ascontiguousarray(self._arrays[0][box])

    def finish(self) -> None:
        """Make the coarser levels, and for a label map its colours."""
        places = self._written
        for fine, coarse, level in zip(
            self._arrays, self._arrays[1:], self._levels[1:], strict=False
        ):
            widths = [2 if half else 1 for half in level.halved]
            places = {tuple(p // n for p, n in zip(place, widths, strict=True)) for place in places}
            for place in sorted(places):
                box = tuple(
                    slice(p * width, min((p + 1) * width, n))
                    for p, width, n in zip(place, coarse.chunks, coarse.shape, strict=True)
                )
                above = tuple(
                    slice(2 * s.start, min(2 * s.stop, n)) if half else s
                    for s, n, half in zip(box, fine.shape, level.halved, strict=True)
                )
                coarse[box] = (_nearest if self._labels else _means)(fine[above], level.halved)
        if self._labels:
            self._group.attrs["ome"] = self._attributes["ome"] | {
                "image-label": self._image_label()
            }
        self._group.attrs[OWN_KEY] = with_record(
            self._attributes[OWN_KEY], self._folder, self._group
        )

    def _image_label(self) -> dict[str, Any]:
        """Attributes of a label map."""
        values = sorted(self._values - {0})[:MAX_COLORS]
        said: dict[str, Any] = {"version": VERSIONS[-1]}
        if values:
            said["colors"] = [
                {"label-value": value, "rgba": [*self._table[value].color, 255]} for value in values
            ]
            names = [
                {"label-value": value, "name": self._table[value].name}
                for value in values
                if value in self._table.entries
            ]
            if names:
                said["properties"] = names
        if self._source is not None:
            said["source"] = {"image": self._source}
        return said


def _places(box: Box, chunks: Sequence[int]) -> itertools.product[tuple[int, ...]]:
    """The places of the chunks that have voxels of a box."""
    return itertools.product(
        *(range(s.start // n, -(-s.stop // n)) for s, n in zip(box, chunks, strict=True))
    )


def _nearest(array: NDArray[Any], halved: Sequence[bool]) -> NDArray[Any]:
    """The first voxel of each block."""
    return array[tuple(slice(None, None, 2 if half else 1) for half in halved)]


def _means(array: NDArray[Any], halved: Sequence[bool]) -> NDArray[Any]:
    """The means of blocks, whole numbers rounded."""
    means = array.astype(np.float64)
    for axis, half in enumerate(halved):
        if half:
            first = means.take(range(0, means.shape[axis], 2), axis)
            second = means.take(
                [min(i + 1, means.shape[axis] - 1) for i in range(0, means.shape[axis], 2)], axis
            )
            means = 0.5 * first + 0.5 * second  # a sum could be beyond the largest number
    return (np.rint(means) if array.dtype.kind in "ui" else means).astype(array.dtype)
