"""Label maps written box by box, never in memory as a whole; and label maps put on the grid of their image.

A format that stores only voxels near labels, as DICOM segmentations do, has a grid of its own.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.errors import UsageError
from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import StagedOutput, naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.headers import ZERO_BEYOND_KEY
from accelsurf.io.lazy_volume import check_box
from accelsurf.settings.file_formats import IMAGE_FORMATS, image_format

#: Distance, in voxels of the smallest spacing, within which voxels of two grids are the same ones.
_TOLERANCE = 1e-3


class LabelStore(StagedOutput):
    """A label map that is being written. It appears when it is committed, whole, or not at all.

    Used with ``with``, it is committed at the end, and aborted where an error ends the block.

    Parameters
    ----------
    path : path-like
        An ``.ome.zarr``, in which chunks of zeros take no space, or a ``.nii``, sparse where the file system can. An
        existing one is replaced.
    geometry : Geometry
        The whole grid.
    dtype : dtype
        uint8, uint16 or uint32.
    metadata : mapping of str to str, optional
        As in `Volume`: of the image, so that the labels lie where it does.
    source : path-like, optional
        The image; an OME-Zarr of labels names the OME-Zarr that it was made from.

    Raises
    ------
    UsageError
        When the suffix or the type is another one.
    OutputError
        When nothing can be written there.

    Examples
    --------
    >>> import tempfile
    >>> from accelsurf import io
    >>> grid, box = Geometry((100, 100, 100), (1.0, 1.0, 1.0)), (slice(4, 6), slice(0, 2), slice(8, 9))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with LabelStore(f"{folder}/cells.nii", grid, np.uint8) as store:
    ...         store.write(box, np.full((2, 2, 1), 7, np.uint8))
    ...     int(io.read(f"{folder}/cells.nii").array.sum())
    28
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        geometry: Geometry,
        dtype: Any,
        metadata: Mapping[str, str] | None = None,
        source: str | os.PathLike[str] | None = None,
    ) -> None:
        path = Path(path)
        self.geometry = geometry
        self.dtype = np.dtype(dtype)
        if self.dtype.name not in ("uint8", "uint16", "uint32"):
            raise UsageError(f"labels of type {self.dtype} given, uint8, uint16 or uint32 expected")
        with naming(path):
            headers.check_name(path)
        form = image_format(headers.split_name(path)[1])
        make_store = None if form is None else functions_of(form).store
        if form is None or make_store is None:
            known = [
                form.suffixes[0] for form in IMAGE_FORMATS.values() if functions_of(form).store
            ]
            raise UsageError(f"{path}: label maps are written box by box as {' or '.join(known)}")
        self._lock = Lock()
        super().__init__(path, form.folder_marks)
        with self._aborted_on_failure():
            staged = self._files.staging / path.name
            self._store = make_store(
                staged, geometry, self.dtype, metadata or {}, self._relative(source)
            )

    def write(self, box: Box, array: NDArray[Any]) -> None:
        """Write the labels of a box; those that were there are replaced. Several threads may call it.

        Raises
        ------
        UsageError
            When the box goes beyond the grid, or the array has another shape or type.
        OutputError
            When the disk is full or gone; nothing is left behind then.
        """
        check_box(box, self.geometry.shape)
        shape = tuple(s.stop - s.start for s in box)
        if array.shape != shape or array.dtype != self.dtype:
            raise UsageError(
                f"labels {array.shape} of {array.dtype} given, {shape} of {self.dtype} expected"
            )
        with self._lock, self._aborted_on_failure():
            self._store.write(box, np.ascontiguousarray(array))

    def read(self, box: Box) -> NDArray[Any]:
        """Return the labels of a box, 0 where none were written.

        Raises
        ------
        UsageError
            When the box goes beyond the grid.
        """
        check_box(box, self.geometry.shape)
        with self._lock, self._aborted_on_failure():
            values: NDArray[Any] = self._store.read(box)
        return values

    def commit(self) -> None:
        """Make the coarser levels, and put the label map in its place.

        Raises
        ------
        OutputError
            When it cannot be written; nothing is left behind then.
        """
        with self._lock, self._aborted_on_failure():
            self._store.finish()
            self._files.commit(last=self.path.name)
        self.abort()

    def _relative(self, source: str | os.PathLike[str] | None) -> str | None:
        """The path of an image that is a folder, as seen from the labels."""
        if source is None or not Path(source).is_dir():
            return None
        return Path(os.path.relpath(source, self.path)).as_posix()


def on_grid(labels: Volume, geometry: Geometry) -> Volume:
    """Labels on another grid of the same voxels, 0 beyond those that are stored.

    Parameters
    ----------
    labels : Volume
    geometry : Geometry
        Its axes may be in another order, or reversed.

    Returns
    -------
    Volume
        ``labels`` as they are where their format stores all voxels, where their voxels are none of the grid's, or where
        one with a label lies beyond it.

    Examples
    --------
    >>> stored = Volume(np.array([[[5, 6]]]), Geometry((1, 1, 2), (1, 1, 1), (1, 0, 2)), {ZERO_BEYOND_KEY: "yes"})
    >>> on_grid(stored, Geometry((4, 1, 3), (1, 1, 1))).array[2]
    array([[0, 5, 6]])
    """
    if ZERO_BEYOND_KEY not in labels.metadata or labels.geometry.matches(geometry):
        return labels
    places = _places(labels.geometry, geometry)
    if places is None:
        return labels
    first, axes = places
    order = np.abs(axes).argmax(axis=0)  # the stored axis that is each of the grid's
    signs = axes[order, range(3)]
    array = labels.array.transpose(order)[tuple(slice(None, None, sign) for sign in signs)]
    low = np.where(signs > 0, first, first - np.array(array.shape) + 1)
    begin = np.clip(low, 0, geometry.shape)
    end = np.clip(low + array.shape, begin, geometry.shape)
    inside = array[tuple(slice(a, b) for a, b in zip(begin - low, end - low, strict=True))]
    if np.count_nonzero(inside) < np.count_nonzero(array):
        return labels
    out = np.zeros(geometry.shape, array.dtype)
    out[tuple(slice(a, b) for a, b in zip(begin, end, strict=True))] = inside
    return Volume(out, geometry, labels.metadata, labels.source)


def on_one_grid(a: Volume, b: Volume) -> tuple[Volume, Volume]:
    """Two label maps on the grid of the one that stores all voxels; on one that holds both where none does."""
    if not {ZERO_BEYOND_KEY} <= a.metadata.keys() & b.metadata.keys():
        return on_grid(a, b.geometry), on_grid(b, a.geometry)
    if (places := _places(a.geometry, b.geometry)) is None:
        return a, b
    first, axes = places
    corners = np.stack(
        [
            np.zeros(3, int),
            np.array(b.geometry.shape) - 1,
            first,
            first + axes.T @ _last(a.geometry),
        ]
    )
    low = corners.min(axis=0)
    shape = corners.max(axis=0) - low + 1
    grid = b.geometry
    whole = Geometry(
        tuple(shape.tolist()),
        grid.spacing,
        tuple(grid.index_to_world(low).tolist()),
        grid.direction,
    )
    return on_grid(a, whole), on_grid(b, whole)


def _last(geometry: Geometry) -> NDArray[np.int64]:
    return np.array(geometry.shape) - 1


def _places(
    stored: Geometry, geometry: Geometry
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Index on a grid of the first stored voxel, and steps there along each stored axis, (3, 3); None where the voxels
    are others.
    """
    begin = geometry.world_to_index(stored.index_to_world((0, 0, 0)))
    steps = geometry.world_to_index(stored.index_to_world(np.eye(3))) - begin
    single = np.array(stored.shape) == 1  # of one slice the distance to the next does not matter
    steps[single] /= np.abs(steps[single]).max(axis=1, keepdims=True)
    first, axes = np.rint(begin).astype(int), np.rint(steps).astype(int)
    if any((np.abs(axes).sum(axis=axis) != 1).any() for axis in (0, 1)):
        return None
    ends = np.array(np.meshgrid(*((0, n - 1) for n in stored.shape))).reshape(3, -1).T
    off = stored.index_to_world(ends) - geometry.index_to_world(first + ends @ axes)
    near = np.linalg.norm(off, axis=1).max() <= _TOLERANCE * min(*stored.spacing, *geometry.spacing)
    return (first, axes) if near else None
