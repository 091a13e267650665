"""Mosaics: the slices of a volume side by side in one picture, as Siemens scanners write them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from accelsurf.errors import InputError
from accelsurf.io.dicom.library import quiet
from accelsurf.io.dicom.sources import DicomFile

#: First row and column, rows, columns, position.
Tile = tuple[tuple[int, int], int, int, tuple[float, ...]]
_COUNT = 0x0019_100A


def tiles_of(path: DicomFile, dataset: Any) -> list[Tile]:
    """Where each slice of a mosaic lies in the picture and in the patient.

    The file says where the whole picture would lie if it were a slice with the middle of the first one; the slices
    follow along the normal that the private block says.

    Raises
    ------
    InputError
        When the file does not say how many slices there are, or which way they follow.
    """
    with quiet():  # it warns of itself
        from nibabel.nicom import csareader

    count = dataset.get(_COUNT)
    block = csareader.get_csa_header(dataset, "image")
    count = int(count.value) if count is not None else (csareader.get_n_mosaic(block) if block else None)
    normal = csareader.get_slice_normal(block) if block else None
    turn, place = dataset.get("ImageOrientationPatient"), dataset.get("ImagePositionPatient")
    size, step = dataset.get("PixelSpacing"), dataset.get("SpacingBetweenSlices")
    if not count or count < 1 or normal is None or None in (turn, place, size, step):
        raise InputError(
            f"{path.name}: a mosaic without what says where its slices lie", "convert it by dcm2niix first"
        )
    side = math.ceil(math.sqrt(count))
    rows, columns = int(dataset.Rows) // side, int(dataset.Columns) // side
    along_row, along_column = np.array(turn, float)[:3], np.array(turn, float)[3:]
    shift = (int(dataset.Columns) - columns) / 2 * float(size[1]) * along_row
    shift = shift + (int(dataset.Rows) - rows) / 2 * float(size[0]) * along_column
    own = np.cross(along_row, along_column)
    step = float(step) * (1.0 if float(np.dot(own, normal)) >= 0 else -1.0)
    first = np.array(place, float) + shift
    return [
        ((n // side * rows, n % side * columns), rows, columns, tuple((first + n * step * own).tolist()))
        for n in range(count)
    ]
