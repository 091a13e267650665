"""A plain NIfTI that is written box by box, into a file that is sparse where nothing was written.

The header of a NIfTI-1 is the one that `accelsurf.io.write` gives: ITK writes it for one voxel, and the sizes are put
in. Where an axis has more than 32767 voxels the file is a NIfTI-2.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelsurf.grid.boxes import Box
from accelsurf.grid.geometry import Geometry
from accelsurf.grid.volume import Volume
from accelsurf.io import itk
from accelsurf.io.formats import itk_volumes, nifti, nifti_grid
from accelsurf.io.formats.raw_voxels import RawLayout, RawVoxels, write_box

#: Voxels along an axis of a NIfTI-1: its sizes are 16-bit numbers.
MAX_AXIS = 2**15 - 1
_DIM_OFFSET = 40
_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


class NiftiBoxes:
    """A NIfTI that is being written; one thread at a time.

    Parameters
    ----------
    path : Path
        The file, which is made.
    geometry : Geometry
        The whole grid.
    dtype : numpy.dtype
        Of the values.
    metadata : mapping of str to str
        As in `Volume`: where it has the numbers and codes of a NIfTI header that place this grid, they are given back
        (in a NIfTI-1).
    """

    def __init__(self, path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str]) -> None:
        if max(geometry.shape) > MAX_AXIS:
            _write_second_header(path, geometry, dtype)
        else:
            _write_first_header(path, geometry, dtype, metadata)
        offset = path.stat().st_size
        self._layout = RawLayout(path, offset, dtype.newbyteorder("<"), geometry.shape)
        with path.open("r+b") as file:
            file.truncate(self._layout.end)

    def write(self, box: Box, array: NDArray[Any]) -> None:
        """Write the voxels of a box."""
        write_box(self._layout, box, array)

    def read(self, box: Box) -> NDArray[Any]:
        """Return the voxels of a box; 0 where none were written."""
        return RawVoxels(self._layout).read(box)

    def finish(self) -> None:
        """Nothing is left to do."""


def _write_first_header(path: Path, geometry: Geometry, dtype: np.dtype[Any], metadata: Mapping[str, str]) -> None:
    """Write a NIfTI-1 without voxels."""
    one = Geometry((1, 1, 1), geometry.spacing, geometry.origin, geometry.direction)
    itk.save(Volume(np.zeros((1, 1, 1), dtype), one), path, nifti.ITK_NAME, compress=False)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - dtype.itemsize)
        file.seek(_DIM_OFFSET)
        file.write(struct.pack("<8h", 3, *geometry.size, 1, 1, 1, 1))
    if (fields := metadata.get(nifti_grid.METADATA_KEY)) is not None:
        itk_volumes.restore_grid(path, geometry, nifti.ITK_NAME, lambda file: nifti_grid.put_grid(file, fields))


def _write_second_header(path: Path, geometry: Geometry, dtype: np.dtype[Any]) -> None:
    """Write a NIfTI-2 without voxels, its place as sform and qform."""
    from nibabel.nifti2 import Nifti2Header

    affine = np.eye(4)
    affine[:3, :3] = geometry.direction * geometry.spacing_xyz
    affine[:3, 3] = geometry.origin
    affine = _RAS @ affine
    header = Nifti2Header(endianness="<")
    header.set_data_dtype(dtype)
    header.set_data_shape(geometry.size)
    header.set_qform(affine, code=1)
    header.set_sform(affine, code=1)
    header.set_xyzt_units("mm")
    header["magic"] = b"n+2"
    header["vox_offset"] = nifti.HEADER_BYTES[2] + 4
    path.write_bytes(header.binaryblock + b"\0" * 4)
