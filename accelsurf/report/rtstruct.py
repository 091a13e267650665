"""RT Structure Sets of a run: each object's contours in the planes of the source's slices, at sub-voxel positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelsurf import __version__
from accelsurf.analysis.contours import in_slices
from accelsurf.io.dicom.structure_set import Region, structure_set_bytes
from accelsurf.io.files import write_bytes
from accelsurf.report.dicom_source import objects_of, seed_of, source_of
from accelsurf.segmentation.result import Result, SegmentedObject
from accelsurf.settings.labels import LabelTable


def write(result: Result, table: LabelTable, path: Path) -> None:
    """Write the contours of the objects as the regions of a DICOM RT Structure Set.

    Parameters
    ----------
    result : Result
        Of an image that was read from DICOM.
    table : LabelTable
        Names and colours of the regions.
    path : Path
        The file; an existing one is replaced.

    Raises
    ------
    UsageError
        When the image was not read from DICOM, no object is left, or a package is missing.
    InputError
        When the slices cannot be read any more, have no identifiers, or are not parallel to the grid's.
    OutputError
        When the file cannot be written.
    """
    source = source_of(result)
    regions = [Region(table[one.id], loops_of(one)) for one in objects_of(result)]
    seed = seed_of("structure set", result, table, source)
    write_bytes(path, structure_set_bytes(regions, result.geometry, source, __version__, seed))


def loops_of(one: SegmentedObject) -> dict[int, tuple[NDArray[np.float64], ...]]:
    """Closed contours of an object in world mm, LPS, by the index of the slice in the whole grid."""
    first = one.box[0].start or 0
    return {first + k: found.loops for k, found in in_slices(one.psi, one.geometry).items()}
