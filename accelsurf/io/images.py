"""Read and write volumes, in the formats of `accelsurf.settings.file_formats`.

A file is checked before it is believed: the header is parsed first (`accelsurf.io.headers`), then the memory that the
volume needs is compared with the available memory, then the voxels are counted, and only then are they read. An output
appears whole or not at all, on exactly the grid it was read with.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accelsurf.grid.geometry import Geometry
from accelsurf.image.check import as_labels
from accelsurf.image.volume import Volume
from accelsurf.io import headers
from accelsurf.io.files import naming
from accelsurf.io.format_functions import functions_of
from accelsurf.io.label_store import on_grid
from accelsurf.io.memory import available_memory
from accelsurf.settings.reading import AS_IT_IS, ReadOptions


def read(
    path: str | os.PathLike[str],
    *,
    options: ReadOptions = AS_IT_IS,
    memory_bytes: int | None = None,
) -> Volume:
    """Read a 3D image, or a 2D one as a volume of one slice.

    Parameters
    ----------
    path : path-like
        A file that ends in one of `accelsurf.settings.file_formats.image_suffixes`.
    options : ReadOptions, optional
        Channel, time point or series to read, and values that the file does not give.
    memory_bytes : int, optional
        Memory to plan with; by default the memory of the machine available now.

    Returns
    -------
    Volume
        Voxels in their own type (as float when the header scales them), on a grid in mm, LPS; ``metadata`` holds the
        entries for `write` to give the same header back, and under "warning" a note on the file for the user.

    Raises
    ------
    UsageError
        When the format does not have a requested option.
    InputError
        When the file is missing, damaged, incomplete, not a 3D image of real numbers, or larger than the memory;
        GeometryError when its header does not describe a grid of perpendicular axes.

    Notes
    -----
    NIfTI places an image twice, by qform and sform. As in ITK-SNAP and 3D Slicer, the sform is used when it refers to
    the scanner (code 1) or is the only one, else the qform, and with neither the image starts at the world's origin; a
    sheared sform is refused rather than straightened. Metres and micrometres are converted to mm.

    A PNG is one slice; so is each page of a TIFF. They start at the world's origin. A pixel is 1 mm, unless a TIFF
    gives its resolution per cm or in the words of ImageJ or OME, or a PNG its scale as ITK writes it; dots per inch
    are a printer's and not used. Colours become their luminance, with a warning; grey saved as colour is grey again.
    """
    path = Path(path)
    with naming(path):
        form, header = headers.parse_header(path, options)
        available = available_memory() if memory_bytes is None else memory_bytes
        volume: Volume = functions_of(form).read(path, header, available)
    return volume


def read_labels(
    path: str | os.PathLike[str],
    *,
    ids: Sequence[tuple[int, int]] = (),
    grid: Geometry | None = None,
    memory_bytes: int | None = None,
) -> Volume:
    """Read a label map: as `read`, with values of an integer type.

    Parameters
    ----------
    path : path-like
    ids : sequence of (first, last), optional
        Labels that are wanted, of a file whose labels may overlap (a DICOM segmentation); other files are read whole.
    grid : Geometry, optional
        Where a file stores only voxels near labels (a DICOM segmentation), they are put on this grid if they are voxels
        of it; other files are left on their own.
    memory_bytes : int, optional
        As for `read`.

    Raises
    ------
    InputError
        As `read`, and when a value is not a whole number, or wanted labels overlap.
    """
    path = Path(path)
    with naming(path):
        form, header = headers.parse_header(path)
        available = available_memory() if memory_bytes is None else memory_bytes
        functions = functions_of(form)
        if functions.read_labels is not None:
            volume: Volume = functions.read_labels(path, header, available, ids)
        else:
            volume = functions.read(path, header, available)
        labels = Volume(as_labels(volume.array), volume.geometry, volume.metadata, volume.source)
    return labels if grid is None else on_grid(labels, grid)


def label_type(largest: int) -> np.dtype[Any]:
    """Smallest unsigned type that holds labels up to ``largest``."""
    return np.dtype(np.uint8 if largest <= 255 else np.uint16 if largest <= 65535 else np.uint32)
